"""When light is put out because of cameras that do not answer, to the tick of a simulated clock."""

import dataclasses
import types

import pytest

from lightstage.cameras.process import Deadlines
from lightstage.capture import CaptureConfig, late_cameras
from lightstage.capture.late_cameras import ExposureTimes, LateCameras
from lightstage.errors import ConfigError

TICK_S = 0.01
TRIGGER_S = 100.0
"""When the cameras are triggered."""
CONFIG = CaptureConfig(late_camera_grace_s=0.5, deadlines=Deadlines(trigger_s=3.0))


class World:
    """A clock that goes on by hand, a light, and a journal."""

    def __init__(self, cameras):
        self.now_s = TRIGGER_S
        self.needed_by = frozenset(cameras)
        self.last_over_s = float("-inf")
        self.out_s = None
        self.reported = []

    def monotonic(self):
        return self.now_s

    def put_out(self):
        self.out_s = self.now_s
        return True

    def note(self, event, **facts):
        self.reported.append((round(self.now_s - TRIGGER_S, 6), event, facts))


@pytest.fixture
def run(monkeypatch):
    """Lets a shot of cameras with these shutter times go on, and looks at each tick."""

    def look_on(shutters, exposed_s, seconds):
        names = [f"cam{i}" for i in range(len(shutters))]
        world, times = World(names), ExposureTimes(shutters)
        monkeypatch.setattr(late_cameras, "time", types.SimpleNamespace(monotonic=world.monotonic))
        late = LateCameras("full", world, times, TRIGGER_S, CONFIG, world)
        for tick in range(round(seconds / TICK_S)):
            world.now_s = TRIGGER_S + tick * TICK_S
            for name in [name for name, at_s in exposed_s.items() if tick == round(at_s / TICK_S)]:
                times.note(name, exposed_s[name])
                world.needed_by -= {name}
                world.last_over_s = world.now_s
            late.look()
        return world

    return look_on


@pytest.mark.parametrize("shutters", [["1/4"], ["1/4", "1/8", "1/60"]])
def test_cameras_that_all_hang_on_the_first_shot_are_lit_for_the_shutter_time_and_the_grace(
    run, shutters
):
    world = run(shutters, {}, 3.0)
    assert world.out_s == TRIGGER_S + 0.75
    names = [f"cam{i}" for i in range(len(shutters))]
    warned, dark = world.reported
    assert warned == (
        0.5,
        "waiting",
        {"pattern": "full", "cameras": names, "lit": True, "dark_in_s": 0.25, "ended_in_s": 2.5},
    )
    assert dark == (
        0.75,
        "waiting",
        {"pattern": "full", "cameras": names, "lit": False, "ended_in_s": 2.25},
    )


def test_a_camera_that_hangs_is_lit_for_the_grace_after_the_last_of_the_others(run):
    world = run(["1/4"] * 3, {"cam0": 0.5, "cam2": 0.7}, 3.0)
    assert world.out_s == TRIGGER_S + 1.2
    assert [facts["cameras"] for _, _, facts in world.reported] == [["cam1"], ["cam1"]]


def test_a_camera_whose_deadline_comes_first_is_left_to_it(run):
    world = run(["2.4"] * 2, {"cam0": 2.6}, 3.0)
    assert world.out_s is None
    assert world.reported == []


@pytest.mark.parametrize("value", [0.0, 0.4, 60.1, float("inf"), float("nan"), -1.0])
def test_a_grace_that_would_void_good_photographs_or_never_ends_is_refused(value):
    with pytest.raises(ConfigError, match=r"late_camera_grace_s: found .*, expected seconds from"):
        CaptureConfig(late_camera_grace_s=value)


def test_a_camera_without_an_exposure_is_waited_for_as_long_as_the_slowest_other_one_takes():
    times = ExposureTimes(["1/60", "2", "Bulb", None])
    assert times.usual_s(["cam0"]) == 2.0  # nothing else is known before the first exposure
    times.note("cam0", 0.5)
    assert times.usual_s(["cam0"]) == 2.0  # the shutter alone is open for so long
    times.note("cam1", 4.0)
    times.note("cam1", 3.0)
    assert times.usual_s(["cam0"]) == 2.0
    assert times.usual_s(["cam2"]) == times.usual_s(["cam0", "cam1"]) == 4.0


def test_of_cameras_that_report_no_shutter_time_the_first_exposure_is_waited_for():
    times = ExposureTimes(["Bulb", None])
    assert times.usual_s(["cam0"]) is None
    times.note("cam0", 0.5)
    assert times.usual_s(["cam0"]) == 0.5


def test_a_camera_that_is_slow_but_within_the_grace_keeps_its_light(bench, monkeypatch):
    monkeypatch.setattr(late_cameras, "TELL_S", 0.3)
    bench.config = dataclasses.replace(bench.config, late_camera_grace_s=4.0)
    bench.cameras[2].faults[2] = "late"  # by a second
    bench.run()
    (finding,) = bench.events("waiting")
    assert (finding["pattern"], finding["cameras"], finding["lit"]) == ("x+", ["cam2"], True)
    assert bench.kept("x+") == ["cam0.dng", "cam1.dng", "cam2.dng"]
