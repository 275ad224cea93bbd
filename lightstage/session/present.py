"""Whether photographs that were kept are still on the disk."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from lightstage.counting import counted
from lightstage.errors import FormatError
from lightstage.formats.files import read_json
from lightstage.formats.paths import path_inside
from lightstage.session.disk import disk_errors
from lightstage.session.durable_rename import sha256_on_disk
from lightstage.session.opening import JOURNAL
from lightstage.session.photo_entry import Kept, Key
from lightstage.session.state import SessionState


def absent(root: Path, photographs: Iterable[Kept]) -> list[Kept]:
    """Photographs whose file is missing or has another size; their bytes are not read.

    Args:
        root: the session's folder.
        photographs: to search for.

    Raises:
        FormatError: one that leads out of the session over a link.
        CaptureError: the disk refuses.
    """
    return [each for each in photographs if not _is_there(root, each)]


def damaged(root: Path, photographs: Iterable[Kept]) -> list[Kept]:
    """Photographs whose file is missing or has other bytes, as read back from the disk.

    Arguments and errors are those of `absent`.
    """
    wrong = []
    for each in photographs:
        if not _is_there(root, each):
            wrong.append(each)
            continue
        with disk_errors(root / each.path):
            if sha256_on_disk(root / each.path) != each.sha256:
                wrong.append(each)
    return wrong


def why_not_delete(root: Path, state: SessionState, key: Key) -> str:
    """Why a photograph must stay on its camera's card; empty where it may be deleted there.

    Its own file must have its bytes on the disk, and every other photograph of the session must be
    there: where photographs vanish from the disk, the cards may hold the last copies.

    Args:
        root: the session's folder.
        state: of the session.
        key: pattern, camera and take of a photograph that counts.

    Raises:
        FormatError, CaptureError: as `absent`.
    """
    photographs = state.frames()
    own = [each for each in photographs if each.key == key]
    if not own or damaged(root, own):
        return "its file on the disk is missing or damaged"
    missing = absent(root, photographs)
    if missing:
        return f"the disk lacks {counted(len(missing), 'photograph')}, such as {missing[0].path}"
    return ""


def require_on_disk(root: Path, state: SessionState) -> None:
    """Search for everything of a session that is about to be called complete.

    The photographs' bytes are not read: a moment ago that was done by `damaged`.

    Args:
        root: the session's folder.
        state: of the session.

    Raises:
        FormatError: a photograph or another file of the session is missing.
        CaptureError: the disk refuses.
    """
    calibration = read_json(root / "session.json", "lightstage.session/1")["calibration"]
    files = [JOURNAL, "rig.json", "manifest.json", *filter(None, calibration.values())]
    missing = [name for name in files if not (root / name).is_file()]
    missing += [each.path for each in absent(root, state.frames())]
    if missing:
        raise FormatError(
            root,
            found=f"no {', no '.join(missing[:5])}{' and others' if missing[5:] else ''}",
            expected="all files of the session",
            hint="Something removes files from this folder. Stop it, then continue.",
        )


def _is_there(root: Path, kept: Kept) -> bool:
    path = path_inside(root, kept.path, root / JOURNAL, "path")
    with disk_errors(path):
        # A journal of version 1 does not have the size.
        return path.is_file() and kept.file.size in (0, path.stat().st_size)
