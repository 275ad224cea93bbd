"""A session's folder before and when a capture begins in it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lightstage.errors import CaptureError
from lightstage.formats.files import write_bytes, write_json
from lightstage.rig import Rig, rig_to_json, save_rig
from lightstage.session.colour import COLOUR_PATH
from lightstage.session.disk import disk_errors
from lightstage.session.journal import begun_name

JOURNAL = "journal.jsonl"
RIG = "rig.json"


def save_beside(
    root: Path, rig: Rig, colour: Mapping[str, Any] | None, beside: Mapping[str, bytes]
) -> None:
    """Write the files that a session's folder has before its journal begins.

    Args:
        root: the folder.
        rig: for rig.json.
        colour: content of colour.json; None where the session carries none.
        beside: bytes of other files of the calibration, by name.
    """
    save_rig(rig, root / RIG)
    if colour is not None:
        write_json(root / COLOUR_PATH, dict(colour))
    for name, data in beside.items():
        write_bytes((root / COLOUR_PATH).with_name(name), data)


def require_new(root: Path) -> None:
    """CaptureError when the folder for a new session exists and holds something.

    What a capture leaves that was killed before its journal began is nothing.
    """
    begun = begun_name(root / JOURNAL)
    with disk_errors(root):
        names = {path.name for path in root.iterdir()} if root.is_dir() else set()
        there = root.exists() and not root.is_dir()
    if begun in names:
        own = {begun, RIG, Path(COLOUR_PATH).parts[0]}
        names -= own | {name for name in names if name.startswith(".rig.")}
    if there or names:
        raise CaptureError(
            root,
            found="something there already",
            expected="a new folder",
            hint="Sessions are never overwritten: another --out, or --resume an unfinished one.",
        )


def rig_hash(rig: Rig) -> str:
    """SHA-256 of rig.json's content, however it is formatted, as a journal has it.

    Calibration shots have another one of the same content, `rig.rig_sha256`, which is taken of it
    without spaces.
    """
    return hashlib.sha256(json.dumps(rig_to_json(rig), sort_keys=True).encode()).hexdigest()
