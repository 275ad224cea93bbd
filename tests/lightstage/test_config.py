"""Configuration: defaults, overrides, and unknown keys refused."""

import dataclasses
from pathlib import Path
from typing import Literal

import pytest

from lightstage.errors import ConfigError
from lightstage.formats.config import as_dict, make_config, read_toml, require_bounds


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
    ("values", "message"),
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
def test_unknown_keys_and_wrong_types_are_refused(values, message):
    with pytest.raises(ConfigError, match=message):
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


@dataclasses.dataclass(frozen=True)
class Bounded:
    size_px: int = 10
    share: float = 0.5
    on: bool = False

    def __post_init__(self):
        require_bounds(self, "bounded", {"size_px": (1, 100)})


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"size_px": 0}, "size_px: found 0, expected from 1 to 100"),
        ({"size_px": 101}, "size_px: found 101"),
        ({"share": -0.1}, "share: found -0.1, expected 0 or more"),
        ({"share": float("nan")}, "share: found nan"),
        ({"share": float("inf")}, "share: found inf"),
        ({"share": -1.0, "size_px": -1}, "2 problems"),
    ],
)
def test_a_number_outside_its_bounds_is_refused(values, message):
    with pytest.raises(ConfigError, match=message):
        make_config(Bounded, values, "t")
    assert make_config(Bounded, {"size_px": 100, "share": 0, "on": True}, "t").share == 0


@pytest.mark.parametrize("values", [{"sizes": [1, "a"]}, {"sizes": [True]}, {"sizes": [[1]]}])
def test_each_value_of_a_list_has_its_type(values):
    with pytest.raises(ConfigError, match=r"sizes\[\d\]: found .*, expected int"):
        make_config(Outer, values, "t")


OF_A_CAPTURE = [
    "[checks]\nthumbnail_px = 0",
    "[checks]\nthumbnail_px = 1000000000",
    "[checks]\nkept_photographs = -1",
    "[checks]\nmin_snr = -1.0",
    "[operator]\nretakes = -1",
    "[calibration]\nretakes_per_pose = -1",
    "[calibration]\nclock_slack_s = -5.0",
    "[calibration]\ndark_poses = 0",
    "[calibration.look]\nlooked_at_px = 0",
    "[calibration.look]\nmin_board_cameras = 0",
    "[deadlines]\nopen_s = 0.0",
    "[preflight]\nspace_margin = -0.5",
    "trigger_lead_s = -1.0",
    "downloads = 0",
    "downloads = 1000000",
]


@pytest.mark.parametrize("text", OF_A_CAPTURE)
def test_a_capture_refuses_a_number_out_of_bounds_before_any_device_is_opened(tmp_path, text):
    from lightstage.capture.command import read_config

    path = tmp_path / "capture.toml"
    path.write_text(text)
    name = text.split("\n")[-1].split(" ")[0]
    with pytest.raises(ConfigError, match=f"{name}: found"):
        read_config(path)
