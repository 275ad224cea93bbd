"""cameras.json: how cameras were measured. A session's says so where nobody measured them."""

from __future__ import annotations

from typing import Any

from lightstage.formats.files import read_json
from lightstage.formats.session import Session

SCHEMA = "lightstage.cameras/1"
NAME = "cameras.json"


def read_session_cameras(session: Session) -> dict[str, Any]:
    """What a session tells of how its cameras were measured; empty where it tells nothing.

    Raises:
        FormatError: session.json names a file that is not there or of another schema.
    """
    named = session.file.calibration.cameras
    return {} if named is None else dict(read_json(session.root / named, SCHEMA))


def said_approximate(told: dict[str, Any]) -> list[str]:
    """A warning where cameras were found from the photographs themselves; else none."""
    if not told.get("approximate"):
        return []
    lengths = ", ".join(told.get("scale", {}).get("lengths", {}))
    return [
        "the cameras are approximate: found from the photographs themselves "
        f"({told.get('residual_px')} px), scaled by {lengths}; every length in mm is as good as "
        "that, and where lights stood is not known"
    ]
