"""Paths and names that come out of files: they stay inside the folder that they belong to.

A file may come from elsewhere: what it calls a path or an id is text until it was checked.
"""

from __future__ import annotations

import re
from pathlib import Path, PurePosixPath
from typing import Any

from lightstage.errors import FormatError, LightstageError

NAME = re.compile(r"\w[\w@+.-]{0,99}")
NAME_RULE = "a name of letters, digits and _ @ + . -, at most 100, that begins with a letter"
_HINT = "Give a path inside the folder, with /, without .. and without links that lead out of it."


def path_inside(
    root: Path,
    given: Any,
    where: str | Path,
    field: str = "",
    error: type[LightstageError] = FormatError,
) -> Path:
    """The path of a relative path that a file names, which must not leave its folder.

    Args:
        root: the folder.
        given: from the file; in a valid one, a path with ``/`` relative to `root`.
        where: the file that names it, for the error.
        field: of that file.
        error: the class of the error.

    Returns:
        The path below `root`; whether anything is there is for the caller to see.

    Raises:
        error: no text, an absolute path, one with ``..``, with a backslash or with control
            characters, or one that leads out of the folder over a link.
    """
    path = root / relative_path(given, where, field, error)
    try:
        inside = path.resolve().is_relative_to(root.resolve())
        wrong = "" if inside else "which leads out of the folder over a link"
    except (OSError, RuntimeError):  # links that lead back to themselves
        wrong = "which leads nowhere"
    if wrong:
        raise _no_path(given, wrong, where, field, error)
    return path


def require_utf8(path: Path) -> None:
    """FormatError for a path of other bytes than UTF-8: libraries that read pictures take none."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise FormatError(
            path,
            found="a path that is not UTF-8",
            expected="one that is",
            hint="Rename the folder or the file.",
        ) from None


def relative_path(
    given: Any, where: str | Path, field: str = "", error: type[LightstageError] = FormatError
) -> str:
    """A path as `path_inside` takes it by its text alone, whatever links are on the disk.

    Arguments and errors are those of `path_inside`.
    """
    wrong = _path_problem(given)
    if wrong is not None:
        raise _no_path(given, wrong, where, field, error)
    return str(given)


def check_name(
    given: Any, where: str | Path, field: str, error: type[LightstageError] = FormatError
) -> str:
    """An id or a name of a file that becomes the name of a file or a folder.

    Args:
        given: from the file.
        where: the file that names it, for the error.
        field: of that file.
        error: the class of the error.

    Raises:
        error: anything but a plain name.
    """
    if not isinstance(given, str) or not NAME.fullmatch(given):
        raise error(
            where,
            field=field,
            found=ascii(given)[:100],
            expected=NAME_RULE,
            hint="It becomes the name of a file or a folder.",
        )
    return given


def _no_path(
    given: Any, wrong: str, where: str | Path, field: str, error: type[LightstageError]
) -> LightstageError:
    shown = ascii(given)
    return error(
        where,
        field=field,
        found=f"{shown if len(shown) <= 100 else shown[:100] + '..'}, {wrong}",
        expected="a relative path that stays inside the folder",
        hint=_HINT,
    )


def _path_problem(given: Any) -> str | None:
    """Why a text is no path that stays in its folder; None where it is one."""
    if not isinstance(given, str) or not given:
        return "no path"
    if "\\" in given or not given.isprintable():
        return "with a backslash or a character that cannot be printed"
    pure = PurePosixPath(given)
    if pure.is_absolute():
        return "an absolute path"
    return "which leaves the folder" if ".." in pure.parts else None
