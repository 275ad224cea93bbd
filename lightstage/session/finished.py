"""session.json, made from a journal."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from lightstage.errors import FormatError
from lightstage.formats.session import Calibration, Driven, Frame, SessionFile
from lightstage.session.reading import Line, read_journal
from lightstage.session.state import SessionState

EXTRA = ("take", "acknowledged", "verified")
"""What a frame has beside the fields that every session has, where the journal knows it."""


def session_from_journal(path: Path) -> SessionFile:
    """What session.json says: of each pattern and camera the take that counts.

    Raises:
        FormatError: a shot of the sequence that was not finished, or a photograph that is missing.
    """
    state = SessionState(read_journal(path))
    missing = [pattern for pattern in state.patterns if state.shot(pattern) is None]
    lines = [state.accepted(p, c) for p in state.patterns for c in state.cameras]
    if missing or (lacking := lines.count(None)):
        said = f"no finished shot of {', '.join(missing)}" if missing else f"{lacking} photographs"
        raise FormatError(
            path,
            found=said if missing else f"{said} missing",
            expected="all shots of the sequence",
            hint="Go on with it: lightstage capture --resume.",
        )
    driven = {pattern: _levels(state, pattern) for pattern in state.patterns}
    extra: dict[str, Any] = {}
    if state.begin.get("consent") is not None:
        extra["consent"] = state.begin["consent"]
    return SessionFile(
        id=state.begin["session"],
        created_utc=state.begin["created_utc"],
        subject=state.begin["subject"],
        expression=state.begin["expression"],
        sequence=list(state.patterns),
        frames=[_frame(line) for line in lines if line is not None],
        patterns={p: Driven(levels=levels) for p, levels in driven.items() if levels is not None},
        calibration=Calibration(**state.calibration()),
        **extra,
    )


def _frame(line: Line) -> Frame:
    names = (*Frame.model_fields, *EXTRA)
    return Frame.model_validate({name: line[name] for name in names if name in line})


def _levels(state: SessionState, pattern: str) -> list[float] | None:
    """What was driven: as last lit, or as an older journal's ``shot`` says."""
    for line in (state.shot(pattern), state.lit(pattern)):
        if line is not None and "levels" in line:
            return list(line["levels"])
    return None
