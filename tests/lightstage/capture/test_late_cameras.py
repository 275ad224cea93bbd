"""When light is put out because of cameras that do not answer, to the tick of a simulated clock."""

import types

import pytest

from lightstage.cameras.process import Deadlines
from lightstage.capture import CaptureConfig, late_cameras
from lightstage.capture.late_cameras import ExposureTimes, LateCameras

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
