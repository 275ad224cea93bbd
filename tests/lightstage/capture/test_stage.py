"""The stage as a capture opens it: dark first, and a light is known to be the one that was lit."""

from __future__ import annotations

import numpy as np
import pytest

from lightstage.cameras.binding import CamerasFile
from lightstage.cameras.camera import CardFile
from lightstage.capture import stage
from lightstage.capture.camera_shot import Photographer
from lightstage.capture.config import CaptureConfig
from lightstage.capture.pattern_light import PatternLight
from lightstage.errors import DeviceError
from lightstage.leds.controller import LightLostError
from lightstage.rig import default_rig
from lightstage.safety import SafeLights, SafetyConfig
from tests.lightstage.capture.fakes import Lights


class Opened(Lights):
    """Lights that are opened and closed."""

    def __enter__(self) -> Opened:
        return self

    def __exit__(self, *_: object) -> None:
        self.log.append("closed")


def test_lights_that_an_earlier_program_left_on_go_out_before_cameras_are_searched_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    log: list[str] = []
    rig = default_rig()
    lights = Opened(log, len(rig.lights))
    lights.levels[:] = 1.0

    def none_there(*_: object) -> None:
        log.append("cameras")
        raise DeviceError("camera cam3", found="not connected", expected="a camera")

    monkeypatch.setattr(stage, "open_rig_leds", lambda *_: lights)
    monkeypatch.setattr(stage, "find_cameras", none_there)
    with (
        pytest.raises(DeviceError, match="cam3"),
        stage.open_stage(rig, "socket://127.0.0.1:9", CamerasFile(), CaptureConfig()),
    ):
        raise AssertionError
    assert log.index("dark") < log.index("cameras") < log.index("closed")
    assert not lights.levels.any()


def test_a_light_that_is_put_out_in_the_moment_in_which_it_was_lit_did_not_last(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rig = default_rig()
    device = Lights([], len(rig.lights))
    with SafeLights(device, SafetyConfig(light_interval_s=0.0), rig) as lights:
        light = lights.light

        def stopped(levels: np.ndarray) -> np.ndarray:
            driven = light(levels)
            lights.dark()  # by another thread
            return driven

        monkeypatch.setattr(lights, "light", stopped)
        shown = PatternLight(lights, np.ones(len(rig.lights)), ["cam0"], 2.0)
        assert isinstance(shown.over("cam0"), LightLostError)
        monkeypatch.setattr(lights, "light", light)
        assert PatternLight(lights, np.ones(len(rig.lights)), ["cam0"], 2.0).over("cam0") is None


def test_of_raw_and_jpeg_that_are_on_the_card_after_a_failed_trigger_the_raw_is_taken() -> None:
    class Silent:
        def note(self, *_: object, **__: object) -> None:
            """Nobody reads it."""

    class Card:
        id = "cam0"

        def card(self) -> tuple[CardFile, ...]:
            return CardFile("/s/DSC_1.JPG", 10), CardFile("/s/DSC_1.NEF", 20)

    photographer = Photographer.__new__(Photographer)
    photographer._known, photographer._doubtful = {"cam0": set()}, set()
    photographer._writer = Silent()  # type: ignore[assignment]
    found = photographer._search("x+", Card(), 0.0, DeviceError("x"))  # type: ignore[arg-type]
    assert [file.name for file in found.files] == ["/s/DSC_1.NEF", "/s/DSC_1.JPG"]
