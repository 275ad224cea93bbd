"""Files whose light or label is not certain: kept under recovered/CAMERA/, each once."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Iterator
from pathlib import Path

from lightstage.cameras.camera import CameraDevice, CardFile
from lightstage.counting import counted
from lightstage.errors import CaptureError
from lightstage.formats.files import fsync_path
from lightstage.session.disk import disk_errors, make_folder, rename_new
from lightstage.session.durable_rename import sha256_on_disk

FOLDER = "recovered"


@dataclasses.dataclass(frozen=True)
class Aside:
    """A file under ``recovered/``.

    Attributes:
        path: of its file.
        sha256: of its bytes on the disk.
    """

    path: Path
    sha256: str


def take_aside(
    root: Path,
    camera: CameraDevice,
    file: CardFile,
    pattern: str | None,
    is_anothers: Callable[[str], bool],
) -> Aside | None:
    """Bring a file from a camera's card to ``recovered/``; the same bytes are kept only once.

    Args:
        root: the session's folder.
        camera: on whose card it is.
        file: there.
        pattern: what it may be of.
        is_anothers: whether bytes of this SHA-256 are a photograph of another session.

    Returns:
        None for a photograph of another session, which stays on the card alone.

    Raises:
        DeviceError: it did not come.
        CaptureError: the disk holds other bytes, or refuses.
    """
    folder = root / FOLDER / camera.id
    name = _plain(file.name)
    partial = folder / f".{name}.partial"
    with disk_errors(folder):
        make_folder(folder, root)
        partial.unlink(missing_ok=True)
    got = camera.download(file.name, partial, pattern or "*")
    with disk_errors(partial):
        found, size = sha256_on_disk(partial), partial.stat().st_size
    if (found, size) != (got.sha256, file.size):
        raise CaptureError(
            f"{file.name} of {camera.id}",
            found=f"{counted(size, 'byte')}, {found[:12]}.. on the disk",
            expected=f"{counted(file.size, 'byte')}, {got.sha256[:12]}.. as the camera gave it",
            hint="The file is still on the camera.",
        )
    if is_anothers(found):
        with disk_errors(partial):
            partial.unlink()
        return None
    return _name(partial, folder, name, found)


def put_aside(root: Path, camera: str, path: Path, name: str) -> Aside:
    """Move a file of the session to ``recovered/``.

    Args:
        root: the session's folder.
        camera: whose it is.
        path: of the file.
        name: that it shall have there, if it is free.

    Raises:
        CaptureError: the disk refuses.
    """
    folder = root / FOLDER / camera
    with disk_errors(path):
        make_folder(folder, root)
        aside = _name(path, folder, _plain(name), sha256_on_disk(path))
        fsync_path(path.parent)
    return aside


def asides(root: Path) -> Iterator[tuple[str, Path]]:
    """Camera and path of each file under ``recovered/``."""
    for folder in sorted((root / FOLDER).glob("*/")):
        for path in sorted(folder.iterdir()):
            if not path.name.startswith("."):
                yield folder.name, path


def _name(partial: Path, folder: Path, name: str, sha256: str) -> Aside:
    """Give a file the first free name; where one of its bytes has it already, that one stays."""
    stem, suffix = Path(name).stem, Path(name).suffix
    number = 1
    with disk_errors(folder):
        while True:
            path = folder / (name if number == 1 else f"{stem}.{number}{suffix}")
            try:
                rename_new(partial, path)
            except FileExistsError:
                # Left by a crash before its line, or another file after the card was emptied.
                if sha256_on_disk(path) != sha256:
                    number += 1
                    continue
                partial.unlink()
            fsync_path(folder)
            return Aside(path, sha256)


def _plain(name: str) -> str:
    """A card's path as one file name."""
    return re.sub(r"[^\w.-]+", "_", name.strip("/")).lstrip(".") or "file"
