"""Everything before a capture in one message."""

import dataclasses

import pytest

from lightstage.cameras.binding import CamerasFile
from lightstage.cameras.camera import Summary
from lightstage.errors import ConfigError, DeviceError
from lightstage.formats.config import make_config
from lightstage.leds.controller import Hello
from lightstage.preflight import Plan, PreflightConfig, preflight, require
from lightstage.rig import LightAddress

GOOD = Summary(
    "600", "D750", "1.0", "M", "100", "1/8", "f/8", "Daylight", "RAW", "MF", 80.0, 10**10, 0.0,
    "", "", "", "off",
)  # fmt: skip


@dataclasses.dataclass
class Leds:
    """What is asked of lights before a capture."""

    light_count: int = 8
    acknowledged: bool = True
    pulse_hz: float | None = 400.0

    @property
    def hello(self):
        return Hello(1, self.light_count, "test")


def look(rig, out, leds=None, **changes):
    values = {camera.id: GOOD for camera in rig.cameras}
    values["cam1"] = dataclasses.replace(GOOD, **changes)
    config = PreflightConfig()
    return preflight(rig, values, CamerasFile(), leds or Leds(), out, Plan(7), config)


def test_a_stage_that_is_ready_has_no_findings(tmp_path, small_rig):
    found = look(small_rig, tmp_path / "s")
    assert found == []
    require(found)


def test_lights_cameras_and_disk_are_reported_in_one_message(tmp_path, small_rig):
    free_of_names = {"iso": "400", "battery_percent": 5.0, "owner": "Ann Person", "shutter": "1/9"}
    found = look(
        small_rig, tmp_path / ("s" * 300), Leds(7, False), card_free_bytes=10, **free_of_names
    )
    with pytest.raises(DeviceError) as caught:
        require(found)
    message = str(caught.value)
    for part in ("lamp count", "pulses of 400 Hz", "iso", "battery", "owner", "card", "bytes"):
        assert part in message, part
    assert "Ann" not in message
    assert "unacknowledged" not in message
    assert [f.code for f in found if f.severity == "warn"] == ["unacknowledged"]


@pytest.mark.parametrize(("count", "fits"), [(8, False), (9, False), (10, True), (16, True)])
def test_a_device_needs_as_many_channels_as_the_rigs_addresses_go(tmp_path, small_rig, count, fits):
    lights = [
        dataclasses.replace(light, address=LightAddress(channel))
        for light, channel in zip(small_rig.lights, (9, 1, 2, 3, 4, 5, 6, 7), strict=True)
    ]
    rig = dataclasses.replace(small_rig, lights=tuple(lights))
    found = look(rig, tmp_path / "s", Leds(count))
    assert [f.expected for f in found] == ["at least 10 (addresses in rig.json)"] * (not fits)


def test_warnings_alone_let_a_capture_begin(tmp_path, small_rig):
    found = look(small_rig, tmp_path / "s", Leds(8, False, None), image_format="RAW+JPEG")
    assert [f.severity for f in found] == ["warn"] * 3
    require(found)


@pytest.mark.parametrize(
    "values",
    [
        {"min_battery_percent": -1.0},
        {"max_pulse_error": float("nan")},
        {"max_clock_offset_s": float("inf")},
        {"shutter_series": "any"},
        {"unknown": 1},
    ],
)
def test_limits_that_are_none_are_refused(values):
    with pytest.raises(ConfigError):
        make_config(PreflightConfig, values, "a.toml")


@pytest.mark.parametrize("name", ["max_pulse_error", "max_clock_offset_s"])
@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_limit_that_is_no_finite_number_is_refused_where_no_file_has_it(name, value):
    with pytest.raises(ConfigError, match=name):
        PreflightConfig(**{name: value})
