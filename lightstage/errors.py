"""Errors that a user can mend: where, what was found, what was expected, what to try."""

from __future__ import annotations

from pathlib import Path

from lightstage.counting import counted
from lightstage.printable import printable, printable_lines

LONGEST_MESSAGE = 1 << 17
"""Characters of a whole message; it may hold those of very many devices."""


class LightstageError(Exception):
    """Base of all errors of the four packages that a user can mend; a command exits 2 on it.

    The message reads ``where, field: found X, expected Y. Hint``. What is not printable in it, such
    as an escape sequence in a file's name, is escaped, and a part of endless length is cut.
    """

    def __init__(
        self,
        where: str | Path,
        *,
        field: str = "",
        found: str = "",
        expected: str = "",
        hint: str = "",
    ) -> None:
        # A file's name is one line, whatever is in it.
        named = (
            printable(where, LONGEST_MESSAGE, squeeze=False) if isinstance(where, Path) else where
        )
        self.where = printable_lines(named, LONGEST_MESSAGE)
        self.field = printable_lines(field)
        self.found = printable_lines(found)
        self.expected = printable_lines(expected)
        self.hint = printable_lines(hint)
        place = f"{self.where}, {self.field}" if field else self.where
        parts = [f"found {self.found}"] if found else []
        parts += [f"expected {self.expected}"] if expected else []
        text = f"{place}: {', '.join(parts)}" if parts else place
        super().__init__(f"{text}. {self.hint}" if hint else text)


class FormatError(LightstageError):
    """A file does not hold what its format requires."""


def unreadable_file(path: Path, error: OSError) -> FormatError:
    """The system's error for a file that cannot be read."""
    return FormatError(path, found=error.strerror or str(error), expected="a file")


class RigError(FormatError):
    """A rig whose lights or cameras cannot be used."""


class MotionError(LightstageError):
    """Photographs that do not show where their cameras were, or how large anything is."""


class FaceError(LightstageError):
    """A picture in which no face can be searched for, or that shows none."""


class PatternError(LightstageError):
    """An unknown pattern, or one that the rig cannot show."""


class ConfigError(LightstageError):
    """An unknown configuration key, or a value out of range."""


class DeviceError(LightstageError):
    """Lights or cameras that are missing, silent or disagree."""


class CaptureError(LightstageError):
    """A capture that could not be finished; what was taken before is kept."""


class CutPhotographError(CaptureError):
    """A photograph whose bytes on the disk are not those on the camera; it can be asked again."""


class StoppedError(LightstageError):
    """Work that somebody ended on purpose, by a key, a signal or from elsewhere; no failure."""


class DiskError(LightstageError):
    """A file or folder that the system does not let us read or write."""


class DiskFullError(DiskError):
    """No room on the disk for what was being written; nothing is left of it.

    Attributes:
        written: bytes of it that were on the disk when it was full.
    """

    written: int = 0


class MemoryLimitError(LightstageError):
    """More memory than the machine, or the graphics processor, has."""


def one_error(problems: list[LightstageError]) -> LightstageError:
    """Fold many errors into one message, so that five loose cables make one report.

    Args:
        problems: at least one error.

    Returns:
        The only error, or one of the first error's class whose text lists them all.
    """
    if len(problems) == 1:
        return problems[0]
    lines = "\n  ".join(str(problem) for problem in problems)
    return type(problems[0])(f"{len(problems)} problems:\n  {lines}")


def alike_as_one(problems: list[LightstageError], what: str) -> list[LightstageError]:
    """Errors with one for all that differ in their file alone: the first file, and how many more.

    Args:
        problems: errors, which are about one file each.
        what: the file is, such as ``photograph``.
    """
    groups: dict[tuple[type, str, str, str, str], list[LightstageError]] = {}
    for each in problems:
        key = (type(each), each.field, each.found, each.expected, each.hint)
        # Without a text of its own it is a list of errors already.
        groups.setdefault(key if each.found else (*key[:4], str(each)), []).append(each)
    return [
        first
        if not more
        else type(first)(
            f"{first.where} and {counted(len(more), f'more {what}')}",
            field=first.field,
            found=first.found,
            expected=first.expected,
            hint=first.hint,
        )
        for first, *more in groups.values()
    ]
