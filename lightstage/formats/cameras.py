"""cameras.json: how cameras were measured. A session's states it where nobody measured them."""

from __future__ import annotations

from typing import Any

from lightstage.formats.files import read_json
from lightstage.formats.session import Session

SCHEMA = "lightstage.cameras/1"
NAME = "cameras.json"


def read_session_cameras(session: Session) -> dict[str, Any]:
    """A session's facts on how its cameras were measured; empty where it has none.

    Raises:
        FormatError: session.json names a file that is not there or of another schema.
    """
    named = session.file.calibration.cameras
    return {} if named is None else dict(read_json(session.root / named, SCHEMA))


def approximate_warnings(facts: dict[str, Any]) -> list[str]:
    """A warning where cameras were found from the photographs themselves; else none."""
    if not facts.get("approximate"):
        return []
    lengths = ", ".join(facts.get("scale", {}).get("lengths", {}))
    return [
        "the cameras are approximate: found from the photographs themselves "
        f"({facts.get('residual_px')} px), scaled by {lengths}; every length in mm is as good as "
        "that, and where lamps were is not known"
    ]
