"""Configuration: one frozen dataclass per stage holds the defaults, a TOML file overrides them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

from lightstage.errors import ConfigError, LightstageError, one_error
from lightstage.formats.values import TOML, read_toml_value, require_plain

T = TypeVar("T")
MOST = 1e12
"""No number of a configuration is larger, in whatever unit."""


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file; ConfigError when it is missing or malformed (formats.values)."""
    return read_toml_value(path)


def make_config(cls: type[T], values: Mapping[str, Any], where: str | Path) -> T:
    """Build a configuration dataclass from overriding values.

    Types are strict: no text is taken for a number and no number for true or false. A whole number
    is taken for a float, a list for a tuple and a text for a path, as no file has the latter.

    Args:
        cls: a frozen dataclass; its fields may be dataclasses, or tuples and dictionaries of them.
        values: what differs from the defaults.
        where: what to name in an error, such as the TOML file.

    Raises:
        ConfigError: unknown keys and values of another type, all in one message, or a value that
            no file can hold, such as NaN.
        LightstageError: what the dataclass itself refuses, in the class that it raises.
    """
    from lightstage.formats.validation import dataclass_of  # pydantic delays a command's help

    require_plain(values, where, TOML, ConfigError)
    return dataclass_of(cls, values, where)


def require_bounds(
    config: Any, where: str | Path, bounds: Mapping[str, tuple[float, float]]
) -> None:
    """Refuse a configuration whose numbers leave their bounds; all of them in one message.

    Args:
        config: a dataclass, with those in it.
        where: what to name in an error.
        bounds: of a field, by its name with dots, the least and the largest value, also of each of
            several, of which there must be one; every other number must be 0 or more, and at most
            `MOST`.

    Raises:
        ConfigError: numbers that are not between their bounds.
    """
    problems: list[LightstageError] = []
    for name, value in all_fields(config):
        values = value if isinstance(value, tuple) else (value,)
        least, most = bounds.get(name, (0.0, MOST))
        if not values and name in bounds:
            problems.append(
                ConfigError(where, field=name, found="no value", expected="at least one")
            )
        numbers = [v for v in values if isinstance(v, (int, float)) and not isinstance(v, bool)]
        wrong = [number for number in numbers if not least <= number <= most]  # NaN is in none
        if wrong:
            expected = f"{least:g} or more" if most == MOST else f"from {least:g} to {most:g}"
            problems.append(ConfigError(where, field=name, found=repr(wrong[0]), expected=expected))
    if problems:
        raise one_error(problems)


def all_fields(config: Any, above: str = "") -> Iterator[tuple[str, Any]]:
    """Every field of a dataclass and of those in it, by its name with dots."""
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if dataclasses.is_dataclass(value):
            yield from all_fields(value, f"{above}{field.name}.")
        else:
            yield above + field.name, value


def as_dict(config: Any) -> dict[str, Any]:
    """The resolved configuration as JSON-ready values, to be saved beside each output."""
    return {
        key: str(value) if isinstance(value, Path) else value
        for key, value in dataclasses.asdict(config).items()
    }
