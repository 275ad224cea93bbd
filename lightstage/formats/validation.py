"""Values of files checked by pydantic, and what it finds wrong with them in our words."""

from __future__ import annotations

import dataclasses
import functools
import json
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from lightstage.counting import counted
from lightstage.errors import ConfigError, FormatError, LightstageError, one_error

T = TypeVar("T")
Place = tuple[int | str, ...]
"""Keys and indices that lead to a value."""
EXPECTED = {
    "int_type": "a whole number",
    "float_type": "a number",
    "bool_type": "true or false",
    "string_type": "a text",
    "tuple_type": "a list",
    "list_type": "a list",
    "dict_type": "a table",
    "dataclass_type": "a table",
    "model_type": "a table",
}
"""What was expected, by pydantic's name of an error; of others its own message has it."""
MOST_LISTED = 50
"""Problems of a file, at most, that a message lists; a hostile file may have a million."""


def validation_error(
    wrong: ValidationError,
    where: str | Path,
    error: type[LightstageError] = FormatError,
    cls: type[Any] | None = None,
) -> LightstageError:
    """All that pydantic found wrong in a file, as one error.

    Args:
        wrong: pydantic's error.
        where: what to name in an error, such as the file.
        error: the class of the errors.
        cls: the dataclass that was to be made, where unknown keys are refused.
    """
    problems: dict[Place, LightstageError] = {}
    for each in wrong.errors(include_url=False)[:MOST_LISTED]:
        place, value, kind, facts = each["loc"], each["input"], each["type"], each.get("ctx", {})
        found, hint = repr(value), ""
        expected = EXPECTED.get(kind, each["msg"].removeprefix("Input should be "))
        if kind == "unexpected_keyword_argument":
            found, expected = "an unknown key", f"one of {', '.join(_keys(cls, place[:-1]))}"
        elif kind == "too_long":
            found = counted(facts["actual_length"], "value")
            expected = counted(facts["max_length"], "value")
        elif kind == "missing" and isinstance(place[-1], int):
            # One of a tuple, each of which is reported: the last one shows how many there must be.
            found, expected = counted(len(value), "value"), counted(place[-1] + 1, "value")
            place = place[:-1]
        elif kind == "missing":
            found, expected = "no such field", "it"
        elif kind == "string_type" and isinstance(value, int | float):
            hint = f'Write it in quotes: "{str(value).lower()}".'
        problems[place] = error(
            where, field=_dotted(place), found=found, expected=expected, hint=hint
        )
    more = wrong.error_count() - MOST_LISTED
    rest = [error(where, found=counted(more, "more problem"))] if more > 0 else []
    return one_error([*problems.values(), *rest])


def dataclass_of(cls: type[T], values: Mapping[str, Any], where: str | Path) -> T:
    """A dataclass from values that a file can hold; see `lightstage.formats.config.make_config`."""
    try:  # as JSON, for then pydantic takes a list for a tuple and a text for a path, strictly
        adapter: TypeAdapter[T] = _adapter(typing.cast(Any, cls))
        return adapter.validate_json(json.dumps(values), strict=True, extra="forbid")
    except ValidationError as wrong:
        raise validation_error(wrong, where, ConfigError, cls) from None
    except LightstageError as error:  # the dataclass does not know the file of its values
        raise type(error)(f"{where}: {error}") from None


@functools.cache
def _adapter(cls: Any) -> TypeAdapter[Any]:
    """What validates a dataclass; made once, for that takes milliseconds."""
    return TypeAdapter(cls)


def _keys(kind: Any, place: Place) -> list[str]:
    """The fields of the dataclass that is at a place in another one."""
    for name in place:
        if dataclasses.is_dataclass(kind):
            kind = typing.get_type_hints(kind)[str(name)]
        else:  # tuple[Table, ...] or dict[str, Table]
            kind = typing.get_args(kind)[isinstance(name, str)]
        if typing.get_origin(kind) in (typing.Union, types.UnionType):  # Table | None
            kind = typing.get_args(kind)[0]
    return sorted(field.name for field in dataclasses.fields(kind))


def _dotted(place: Place) -> str:
    """A place as it is written, such as ``frames[3].camera``."""
    return "".join(f"[{p}]" if isinstance(p, int) else f".{p}" for p in place).removeprefix(".")
