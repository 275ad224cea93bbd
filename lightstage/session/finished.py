"""session.json, made from a journal."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from lightstage.counting import counted
from lightstage.errors import FormatError
from lightstage.formats.session import Calibration, Driven, Frame, SessionFile
from lightstage.resume_line import known_options
from lightstage.session.accepted import accepted_findings
from lightstage.session.events import Line
from lightstage.session.photo_entry import key_of
from lightstage.session.reading import read_journal
from lightstage.session.state import SessionState
from lightstage.ways import readers_ways

EXTRA = ("take", "acknowledged", "verified")
"""What a frame has beside the fields that every session has, where the journal knows it."""


def session_from_journal(path: Path) -> SessionFile:
    """The content of session.json: of each pattern and camera the take that counts.

    Raises:
        FormatError: a shot of the sequence that was not finished, or a photograph that is missing.
    """
    return session_from_lines(read_journal(path), path)


def session_from_lines(lines: Sequence[Line], path: Path) -> SessionFile:
    """The same of a journal that was read.

    Args:
        lines: of the journal.
        path: of it, for errors.

    Raises:
        FormatError: as session_from_journal.
    """
    state = SessionState(lines)
    missing = [pattern for pattern in state.patterns if not state.is_shot(pattern)]
    kept = [state.accepted(p, c) for p in state.patterns for c in state.cameras]
    if missing or (lacking := kept.count(None)):
        counts = (
            f"no finished shot of {', '.join(missing)}"
            if missing
            else counted(lacking, "photograph")
        )
        raise FormatError(
            path,
            found=counts if missing else f"{counts} missing",
            expected="all shots of the sequence",
            hint=readers_ways().resume(path.parent, known_options(lines)),
        )
    frames = {key_of(line): line for line in lines if line["event"] == "frame"}
    driven = _levels(lines)
    # Null means that there is no record of it; an older journal has no such field.
    extra: dict[str, Any] = {k: state.begin[k] for k in ("consent",) if k in state.begin}
    if accepted := accepted_findings(lines):
        extra["accepted"] = accepted
    return SessionFile(
        id=state.begin["session"],
        created_utc=state.begin["created_utc"],
        subject=state.begin["subject"],
        expression=state.begin["expression"],
        sequence=list(state.patterns),
        frames=[_frame(frames[each.key]) for each in kept if each is not None],
        patterns={p: Driven(levels=driven[p]) for p in state.patterns if p in driven},
        calibration=Calibration(**state.calibration()),
        **extra,
    )


def _frame(line: Line) -> Frame:
    names = (*Frame.model_fields, *EXTRA)
    return Frame.model_validate({name: line[name] for name in names if name in line})


def _levels(lines: Sequence[Line]) -> dict[str, list[float]]:
    """What was driven for each pattern: from an older journal's ``shot``, or as last lit."""
    levels: dict[str, dict[str, list[float]]] = {"lit": {}, "shot": {}}
    for line in lines:
        if line["event"] in levels and "levels" in line:
            levels[line["event"]][line["pattern"]] = list(line["levels"])
    return levels["lit"] | levels["shot"]
