"""Configuration: defaults, overrides, and unknown keys refused."""

import dataclasses
from pathlib import Path
from typing import Literal

import pytest

from lightstage.errors import ConfigError
from lightstage.formats.config import as_dict, make_config, read_toml


@dataclasses.dataclass(frozen=True)
class Inner:
    size_px: int = 3
    gain: float = 1.0


@dataclasses.dataclass(frozen=True)
class Outer:
    mode: Literal["fast", "exact"] = "fast"
    limit_mm: float | None = None
    name: str = "a"
    on: bool = False
    path: Path = Path("x")
    sizes: tuple[int, ...] = (1, 2)
    inner: Inner = dataclasses.field(default_factory=Inner)


def test_defaults_stand_where_nothing_is_given():
    assert make_config(Outer, {}, "t") == Outer()


def test_values_override_defaults_nested_too():
    values = {
        "mode": "exact",
        "limit_mm": 2,
        "path": "y/z",
        "sizes": [4],
        "on": True,
        "inner": {"gain": 2},
    }
    got = make_config(Outer, values, "t")
    expected = Outer("exact", 2.0, "a", True, Path("y/z"), (4,), Inner(3, 2.0))
    assert got == expected
    assert isinstance(got.inner.gain, float)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"mod": "fast"}, "t, mod: found an unknown key, expected one of inner, limit_mm, mode"),
        ({"inner": {"size": 1}}, r"t, \[inner\], size: found an unknown key"),
        ({"mode": "slow"}, "mode: found 'slow', expected one of"),
        ({"name": 3}, "name: found 3, expected str"),
        ({"on": 1}, "on: found 1, expected bool"),
        ({"inner": {"size_px": True}}, "size_px: found True, expected int"),
        ({"inner": {"size_px": 1.5}}, "size_px: found 1.5, expected int"),
        ({"inner": {"gain": "high"}}, "gain: found 'high', expected float"),
        ({"inner": 3}, "inner: found 3"),
        ({"sizes": 3}, "sizes: found 3"),
        ({"limit_mm": "far"}, "limit_mm: found 'far'"),
    ],
)
def test_unknown_keys_and_wrong_types_are_refused(values, said):
    with pytest.raises(ConfigError, match=said):
        make_config(Outer, values, "t")


def test_a_toml_file_is_read_or_refused_with_its_name(tmp_path):
    path = tmp_path / "c.toml"
    with pytest.raises(ConfigError, match="no such file"):
        read_toml(path)
    path.write_text("[inner]\ngain = 2\n")
    assert read_toml(path) == {"inner": {"gain": 2}}
    path.write_bytes(b"\xff\xfe = [")
    with pytest.raises(ConfigError, match="UTF-8"):
        read_toml(path)


def test_a_resolved_configuration_is_json_ready():
    assert as_dict(Outer())["path"] == "x"
    assert as_dict(Outer())["inner"] == {"size_px": 3, "gain": 1.0}
