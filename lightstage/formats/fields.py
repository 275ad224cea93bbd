"""The fields of a JSON object, each asked for with what it must be."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from lightstage.errors import FormatError, LightstageError

T = TypeVar("T")
MOST = 1e9
"""No length, gain or focal length of a rig is larger; squares of larger ones overflow."""
SHOWN = 60


class Fields:
    """Asks a JSON object for its fields.

    Args:
        value: what is in the file where an object is wanted.
        where: the file, for errors.
        place: of the object in the file, such as ``lights[3]``; empty for the whole file.
        error: the class of the errors; every method raises it where a field is missing or is
            something else.
        known: names of the format's fields; others are `rest`.
    """

    def __init__(
        self,
        value: Any,
        where: str | Path,
        place: str = "",
        error: type[LightstageError] = FormatError,
        known: Collection[str] = (),
    ) -> None:
        self._where, self._place, self._error, self._known = where, place, error, known
        if not isinstance(value, dict):
            raise error(where, field=place, found=_shown(value), expected="an object")
        self._value: dict[str, Any] = value

    def has(self, key: str) -> bool:
        """Whether the object has a field, and it is not null."""
        return self._value.get(key) is not None

    def text(self, key: str) -> str:
        """A text that can be printed."""
        value = self._get(key)
        if not isinstance(value, str) or not (value.isprintable()):
            raise self._wrong(key, value, "a text that can be printed")
        return value

    def whole(self, key: str, least: int, most: int) -> int:
        """A whole number from `least` to `most`."""
        value = whole_number(self._get(key))
        if type(value) is not int or not least <= value <= most:
            raise self._wrong(key, value, f"a whole number from {least} to {most}")
        return value

    def number(self, key: str) -> float:
        """A finite number."""
        value = self._get(key)
        if not is_number(value):
            raise self._wrong(key, value, "a finite number")
        return float(value)

    def numbers(self, key: str, count: int, default: tuple[float, ...] = ()) -> tuple[float, ...]:
        """So many finite numbers; where the field is missing, `default` if that holds any."""
        if default and key not in self._value:
            return default
        value = self._get(key)
        if not isinstance(value, list) or len(value) != count or not all(map(is_number, value)):
            raise self._wrong(key, value, f"{count} finite numbers")
        return tuple(float(each) for each in value)

    def rows(self, key: str, rows: int, columns: int) -> list[list[float]]:
        """A table of finite numbers, row by row."""
        value = self._get(key)
        right = isinstance(value, list) and len(value) == rows
        for row in value if right else ():
            right = right and isinstance(row, list) and len(row) == columns
            right = right and all(map(is_number, row))
        if not right:
            raise self._wrong(key, value, f"{rows} rows of {columns} finite numbers")
        return [[float(each) for each in row] for row in value]

    def rest(self) -> dict[str, Any]:
        """What else is there: others may add fields, and they are kept."""
        return {key: value for key, value in self._value.items() if key not in self._known}

    def _get(self, key: str) -> Any:
        if key in self._value:
            return self._value[key]
        near = difflib.get_close_matches(key, self.rest(), n=1, cutoff=0.6)
        hint = f"Is {_shown(near[0])} misspelt?" if near else ""
        raise self._error(
            self._where, field=self._place, found=f"no '{key}'", expected="it", hint=hint
        )

    def _wrong(self, key: str, value: Any, expected: str) -> LightstageError:
        field = f"{self._place}.{key}" if self._place else key
        return self._error(self._where, field=field, found=_shown(value), expected=expected)


def whole_number(value: Any) -> Any:
    """`value`, as an int where it is whole: some programs write every number with a point."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


def is_number(value: Any) -> bool:
    """Whether a file's value is a number, not true or false, and of `MOST` at most."""
    return type(value) in (int, float) and -MOST <= value <= MOST


def array_of(value: Any, *shape: int) -> np.ndarray:
    """A file's lists of numbers as an array; numpy's own way takes true for 1 and texts too.

    Args:
        value: what is in the file.
        shape: how many entries each list has, -1 for any number of the outermost; none for a
            number without a list.

    Raises:
        ValueError: something else than numbers of at most `MOST` in lists of that shape.
    """
    numbers = list(_entries(value, shape))
    if not all(map(is_number, numbers)):
        raise ValueError("something else than numbers")
    return np.array(numbers, float).reshape(shape)


def _entries(value: Any, shape: tuple[int, ...]) -> Iterator[Any]:
    """What is in lists of a shape, one after another."""
    if not shape:
        yield value
        return
    if not isinstance(value, list) or shape[0] not in (-1, len(value)):
        raise ValueError("lists of another shape")
    for each in value:
        yield from _entries(each, shape[1:])


def _shown(value: Any) -> str:
    shown = ascii(value)
    return shown if len(shown) <= SHOWN else f"{shown[:SHOWN]}.."
