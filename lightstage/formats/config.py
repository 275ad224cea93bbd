"""Configuration: one frozen dataclass per stage holds the defaults, a TOML file overrides them."""

from __future__ import annotations

import dataclasses
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from lightstage.counting import counted
from lightstage.errors import ConfigError, LightstageError, one_error
from lightstage.formats.values import read_toml_value

T = TypeVar("T")
MOST = 1e12
"""No number of a configuration is larger, in whatever unit."""


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file; ConfigError when it is missing or malformed (formats.values)."""
    return read_toml_value(path)


def make_config(cls: type[T], values: Mapping[str, Any], where: str | Path) -> T:
    """Build a configuration dataclass from overriding values.

    Args:
        cls: a frozen dataclass whose fields all have defaults; fields may be dataclasses.
        values: what differs from the defaults.
        where: what to name in an error, such as the TOML file.

    Raises:
        ConfigError: an unknown key, a value of another type, or one that the dataclass refuses.
    """
    hints = typing.get_type_hints(cls)
    known = {f.name: f for f in dataclasses.fields(typing.cast(Any, cls))}
    resolved: dict[str, Any] = {}
    for key, value in values.items():
        if key not in known:
            raise ConfigError(
                where,
                field=key,
                found="an unknown key",
                expected=f"one of {', '.join(sorted(known))}",
            )
        resolved[key] = _convert(hints[key], value, where, key)
    try:
        return cls(**resolved)
    except LightstageError as error:  # the dataclass does not know the file of its values
        raise type(error)(f"{where}: {error}") from None


def _convert(hint: Any, value: Any, where: str | Path, key: str) -> Any:
    """Turn a TOML value into the field's type, or raise ConfigError."""
    if dataclasses.is_dataclass(hint) and isinstance(value, Mapping):
        return make_config(typing.cast(type, hint), value, f"{where}, [{key}]")
    origin = typing.get_origin(hint)
    if origin in (typing.Union, types.UnionType):
        options = [h for h in typing.get_args(hint) if h is not type(None)]
        if value is None:
            return None
        if len(options) == 1:
            return _convert(options[0], value, where, key)
        return _first_that_takes(options, value, where, key)
    if origin is typing.Literal:
        if value not in typing.get_args(hint):
            raise ConfigError(
                where,
                field=key,
                found=repr(value),
                expected=f"one of {', '.join(map(str, typing.get_args(hint)))}",
            )
        return value
    if origin is tuple and isinstance(value, (list, tuple)):
        inner, *rest = typing.get_args(hint)
        if rest == [...]:
            kinds: Sequence[Any] = [inner] * len(value)
        else:
            kinds = [inner, *rest]
        if len(value) != len(kinds):
            found, expected = counted(len(value), "value"), counted(len(kinds), "value")
            raise ConfigError(where, field=key, found=found, expected=expected)
        return tuple(
            _convert(kind, each, where, f"{key}[{index}]")
            for index, (kind, each) in enumerate(zip(kinds, value, strict=True))
        )
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        if abs(value) > 10**300:
            raise ConfigError(where, field=key, found="a number too large", expected="float")
        return float(value)
    if hint is Path and isinstance(value, str):
        return Path(value)
    plain = origin or hint
    wrong_bool = isinstance(value, bool) and plain is not bool
    if isinstance(plain, type) and (wrong_bool or not isinstance(value, plain)):
        raise ConfigError(where, field=key, found=repr(value), expected=plain.__name__)
    return value


def _first_that_takes(options: list[Any], value: Any, where: str | Path, key: str) -> Any:
    """A value as the first of several types that takes it."""
    for option in options:
        try:
            return _convert(option, value, where, key)
        except ConfigError:
            continue
    names = " or ".join(getattr(option, "__name__", str(option)) for option in options)
    raise ConfigError(where, field=key, found=repr(value), expected=names)


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
