"""LibRaw's errors for a file that it cannot read: damaged, unknown, no photograph."""

from __future__ import annotations

from pathlib import Path

import rawpy

from lightstage.counting import counted
from lightstage.errors import FormatError, unreadable_file
from lightstage.formats.paths import require_utf8
from lightstage.photo_file import identify_file

SHORT = 1 << 16
"""A camera's own RAW of fewer bytes is a part of one: LibRaw calls its format unknown."""
LIBRAW = ".".join(map(str, rawpy.libraw_version))


def unreadable_raw(path: Path, error: Exception) -> FormatError:
    """The error of a RAW that could not be opened or unpacked.

    Args:
        path: the file.
        error: of rawpy, or of the system.
    """
    if isinstance(error, OSError):
        return unreadable_file(path, error)
    try:
        require_utf8(path)
        # A fault of its own header is clearer than LibRaw's error.
        kind = identify_file(path)
    except OSError as refused:
        return unreadable_file(path, refused)
    except FormatError as refused:
        return refused
    text = error.args[0] if error.args else error
    message = text.decode(errors="replace") if isinstance(text, bytes) else str(text)
    unknown = (rawpy.LibRawFileUnsupportedError, rawpy.NotSupportedError, NotImplementedError)
    name = kind.suffix.removeprefix(".").upper()
    size = path.stat().st_size
    if isinstance(error, unknown) and size < SHORT and kind.suffix not in (".dng", ".tif"):
        return FormatError(
            path,
            found=f"a {name} of {counted(size, 'byte')}, of which LibRaw {LIBRAW} reads nothing",
            expected="a whole one, which is larger",
            hint="Copy it from the camera again.",
        )
    if isinstance(error, unknown):
        return FormatError(
            path,
            found=f"a {name} of a format or compression that LibRaw {LIBRAW} does not know",
            expected="a RAW that it reads",
            hint="Convert it to DNG, with a lossless compression that older readers know.",
        )
    return FormatError(
        path,
        found=f"a damaged RAW (LibRaw: {message})",
        expected="a whole one",
        hint="Copy it from the camera again.",
    )
