"""The one reader of JSON, JSON Lines and TOML: every file is read within limits.

A file may come from another laboratory, a damaged disk or somebody who means harm. The reader takes
regular files alone and opens them without waiting, so that a pipe or a device cannot hold a command
up. It refuses what JSON and TOML allow and a program stumbles over: values nested very deeply, a
key that is there twice, numbers that no 64 bits hold, NaN and infinity, text with NUL characters.
"""

from __future__ import annotations

import dataclasses
import json
import os
import stat
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NoReturn

from lightstage.errors import ConfigError, FormatError, LightstageError


@dataclasses.dataclass(frozen=True)
class Limits:
    """What a file or a message may hold.

    Attributes:
        size_bytes: of the whole.
        depth: lists and objects in each other.
        plain_text: whether text must be free of NUL characters and of halves of characters. Names
            that a camera gave its capture may hold such things.
    """

    size_bytes: int = 1 << 26
    depth: int = 40
    plain_text: bool = True


FILE = Limits()
"""A JSON file."""
TOML = Limits(size_bytes=1 << 22)
"""A TOML file: written by hand, and tomllib is slow."""
LINE = Limits(size_bytes=1 << 26, plain_text=False)
"""One line of a journal, or one message between our own processes."""
LINES_BYTES = 1 << 30
"""A file of many lines."""
LEAST, MOST = -(1 << 63), (1 << 64) - 1
"""Whole numbers that 64 bits hold, with or without a sign."""
SHOWN = 60
"""Characters of a file's text that a message repeats."""


def read_value(path: Path) -> Any:
    """The value of a JSON file; FormatError where there is none within the limits."""
    return parse_json(read_regular(path, FILE.size_bytes), path)


def read_toml_value(path: Path) -> dict[str, Any]:
    """The value of a TOML file; ConfigError where there is none within the limits."""
    data = read_regular(path, TOML.size_bytes, "a TOML file", ConfigError)
    text = _text(data, path, ConfigError)
    try:
        value = tomllib.loads(text)
    except tomllib.TOMLDecodeError as wrong:
        raise ConfigError(path, found=str(wrong), expected="valid TOML") from None
    except RecursionError:
        _too_deep(path, TOML, ConfigError)
    except ValueError as wrong:  # a date that is none, or a number of thousands of digits
        raise ConfigError(path, found=str(wrong)[:SHOWN], expected="valid TOML") from None
    require_plain(value, path, TOML, ConfigError)
    return value


def read_lines(path: Path) -> list[Any]:
    """The values of a JSON Lines file, one a line; empty lines are passed over.

    Raises:
        FormatError: a line that is no JSON within the limits; it names the line.
    """
    data = read_regular(path, LINES_BYTES, "a file of JSON lines")
    return [
        parse_json(line, f"{path}, line {number}", LINE)
        for number, line in enumerate(data.split(b"\n"), 1)
        if line.strip()
    ]


def read_text_lines(path: Path, wanted: str) -> list[str]:
    """The lines of a text that somebody wrote by hand; ConfigError where there is none.

    Args:
        path: the file; it has the limits of a TOML file.
        wanted: what an error names as expected.
    """
    data = read_regular(path, TOML.size_bytes, wanted, ConfigError)
    return _text(data, path, ConfigError).splitlines()


def parse_json(
    data: bytes | str,
    where: str | Path,
    limits: Limits = FILE,
    error: type[LightstageError] = FormatError,
) -> Any:
    """A JSON value.

    Args:
        data: its text.
        where: what an error names.
        limits: what the value may hold.
        error: the class of the errors.

    Raises:
        error: no JSON, or a value outside the limits.
    """
    if len(data) > limits.size_bytes:
        _too_large(where, limits.size_bytes, error)
    text = _text(data, where, error) if isinstance(data, bytes) else data
    try:
        value = json.loads(text, object_pairs_hook=_object)
    except _TwiceError as twice:
        raise error(
            where,
            field=_shown(twice.args[0]),
            found="the same key twice in one object",
            expected="each key once",
            hint="Remove one of the two.",
        ) from None
    except json.JSONDecodeError as wrong:
        raise error(where, found=str(wrong), expected="a readable JSON file") from None
    except RecursionError:
        _too_deep(where, limits, error)
    except ValueError:
        raise error(where, found="a number of thousands of digits", expected=_NUMBERS) from None
    require_plain(value, where, limits, error)
    return value


def read_regular(
    path: Path,
    most_bytes: int,
    wanted: str = "a JSON file",
    error: type[LightstageError] = FormatError,
) -> bytes:
    """The bytes of a regular file.

    Args:
        path: the file, or a link to it.
        most_bytes: a larger one is refused.
        wanted: what an error names as expected.
        error: the class of the errors.

    Raises:
        error: no such file, no regular file, one that is too large, or one that cannot be read.
    """
    handle = open_regular(path, wanted, error)
    try:
        with open(handle, "rb") as file:
            data = file.read(most_bytes + 1)
    except OSError as wrong:
        _unreadable(path, wrong, wanted, error)
    if len(data) > most_bytes:
        _too_large(path, most_bytes, error)
    return data


def open_regular(
    path: Path, wanted: str = "a JSON file", error: type[LightstageError] = FormatError
) -> int:
    """A handle of a regular file, opened for reading without waiting; the caller closes it.

    Arguments and errors are those of `read_regular`.
    """
    try:
        # Some devices do something when they are opened: look first.
        _require_regular(os.stat(path), path, wanted, error)
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY)
        try:
            _require_regular(os.fstat(handle), path, wanted, error)
        except LightstageError:
            os.close(handle)
            raise
    except OSError as wrong:
        _unreadable(path, wrong, wanted, error)
    except ValueError:
        shown = ascii(str(path))
        raise error(shown, found="a path that no system takes", expected=wanted) from None
    return handle


_NUMBERS = "whole numbers that 64 bits hold"
_OTHER_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


class _TwiceError(ValueError):
    """A key that is in one object twice."""


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    value = dict(pairs)
    if len(value) != len(pairs):
        names = [name for name, _ in pairs]
        raise _TwiceError(next(name for name in names if names.count(name) > 1))
    return value


def _unreadable(path: Path, wrong: OSError, wanted: str, error: type[LightstageError]) -> NoReturn:
    if isinstance(wrong, FileNotFoundError):
        raise error(path, found="no such file", expected=wanted) from None
    reason = wrong.strerror or str(wrong)
    raise error(path, found=reason, expected=f"{wanted} that can be read") from None


def _require_regular(
    found: os.stat_result, path: Path, wanted: str, error: type[LightstageError]
) -> None:
    if stat.S_ISREG(found.st_mode):
        return
    kind = next((name for is_kind, name in _OTHER_KINDS if is_kind(found.st_mode)), "no file")
    raise error(
        path, found=kind, expected=f"{wanted}, a regular file", hint="Name the file itself."
    )


def _text(data: bytes, where: str | Path, error: type[LightstageError]) -> str:
    hint = "Save it as UTF-8 without a byte-order mark."
    if data.startswith((b"\xef\xbb\xbf", b"\xff\xfe", b"\xfe\xff")):
        raise error(where, found="a byte-order mark", expected="UTF-8 text", hint=hint)
    try:
        return data.decode()
    except UnicodeDecodeError as wrong:
        found = f"byte {wrong.start} is not UTF-8 ({wrong.reason})"
        raise error(where, found=found, expected="UTF-8 text", hint=hint) from None


def require_plain(
    value: Any, where: str | Path, limits: Limits, error: type[LightstageError]
) -> None:
    """Refuse a value that no JSON or TOML file may hold; the message names its place in the file.

    Args:
        value: what was read.
        where: what an error names.
        limits: what the value may hold.
        error: the class of the errors.

    Raises:
        error: a value outside the limits, or one that is neither text, a number, true or false,
            a list or a table.
    """
    todo: list[tuple[str, Any, int]] = [("", [value], 0)]
    while todo:
        place, holder, depth = todo.pop()
        is_object = isinstance(holder, dict)
        pairs: Iterable[tuple[Any, Any]] = holder.items() if is_object else enumerate(holder)
        for key, inner in pairs:
            kind, hint = type(inner), ""
            if kind is dict or kind is list or kind is tuple:
                if depth >= limits.depth:
                    _too_deep(where, limits, error)
                todo.append((_place(place, key, depth), inner, depth + 1))
                wrong = None
            elif kind is float:
                wrong = None if inner - inner == 0 else (str(inner), "a finite number")
            elif kind is int:
                wrong = None if LEAST <= inner <= MOST else ("a number too large", _NUMBERS)
            elif kind is str:
                wrong = _text_problem(inner) if limits.plain_text else None
            elif inner is None or kind is bool:
                wrong = None
            else:  # TOML's dates and times
                wrong = (f"a {kind.__name__}", "text, a number, true or false, a list or a table")
                hint = f'A day or a time is a text here: write it in quotes, "{inner}".'
            if wrong is None and is_object and limits.plain_text:
                wrong = _text_problem(key)
            if wrong is not None:
                found, expected = wrong
                field = _place(place, key, depth)
                raise error(where, field=field, found=found, expected=expected, hint=hint)


def _place(place: str, key: str | int, depth: int) -> str:
    """A value's place, such as ``lights[3].name``; empty for the whole file's value."""
    if depth == 0:
        return ""
    if isinstance(key, int):
        return f"{place}[{key}]"
    return f"{place}.{_shown(key)}" if place else _shown(key)


def _shown(key: str) -> str:
    """A key as a message may show it."""
    return key if key.isascii() and key.isprintable() and len(key) <= SHOWN else ascii(key)[:SHOWN]


def _text_problem(text: str) -> tuple[str, str] | None:
    if "\0" in text:
        return "text with a NUL character", "text without"
    if text.isascii():
        return None
    try:
        text.encode()
    except UnicodeEncodeError:
        return "text with half a character", "whole characters"
    return None


def _too_deep(where: str | Path, limits: Limits, error: type[LightstageError]) -> NoReturn:
    raise error(
        where,
        found="values nested too deeply",
        expected=f"at most {limits.depth} lists and objects in each other",
    )


def _too_large(where: str | Path, most_bytes: int, error: type[LightstageError]) -> NoReturn:
    size = f"{most_bytes >> 20} MiB"
    raise error(where, found=f"more than {size}", expected=f"at most {size}", hint="Is it damaged?")
