"""The stories of misbehaving lights, each a capture, with the firmware as the device's mind.

The line and the lamps with their faults are the simulated device's; the bytes are answered, and the
lamps told, by the firmware. Not here: stories in which the device is dead, or the photographs alone
can tell.
"""

from __future__ import annotations

import time

import pytest

from lightstage.safety import SafeLights
from sim.devices.faults import Fault
from tests.firmware.bench import FirmwareProtocol
from tests.sim.devices.misbehaviour import test_led_stories as stories
from tests.sim.devices.misbehaviour.conftest import SmallStage, make_rig
from tests.sim.devices.misbehaviour.test_led_stories import (  # noqa: F401
    test_a_bad_line_from_the_first_packet_to_the_last_loses_nothing,
    test_a_board_that_restarts_when_its_port_opens_is_waited_for,
    test_a_device_that_restarts_is_greeted_again_and_its_photographs_are_kept_apart,
    test_a_lamp_of_which_the_device_tells_ends_the_capture_before_a_photograph_counts,
    test_a_light_that_gets_stuck_during_a_shot_makes_that_shot_void,
    test_a_set_that_was_held_back_does_not_light_the_stage_after_it_was_told_dark,
    test_a_wrong_acknowledgement_voids_the_photograph_alone,
    test_with_no_fault_all_is_well_and_dark,
)

WATCHDOG_S = 0.9


# What befalls the answer is the driver's matter, but for a request that comes twice because of it.
SUFFERED = [
    *((name, "request") for name in ("drop", "corrupt", "delay", "duplicate", "reorder")),
    ("drop", "answer"),
]


@pytest.fixture
def live_stage(tmp_path, compiled, monkeypatch):
    """A small stage whose lights have the firmware's mind."""
    program = compiled("bench", 8)
    small = SmallStage(tmp_path, make_rig())
    small.watchdog_s = WATCHDOG_S
    made = []

    def firmware(*args):
        clock = (lambda: 0.0) if small.watchdog_s is None else time.monotonic
        made.append(FirmwareProtocol(program, clock, *args))
        return made[-1]

    monkeypatch.setattr("sim.devices.led_faults.LedProtocol", firmware)
    yield small
    assert len(made) == 1
    made[0].close()


@pytest.fixture
def stage(live_stage, monkeypatch):
    """The same, without a watchdog and without what keeps it quiet.

    The stories count packets: on a slow computer those that keep the lights awake, four in .9 s,
    would be counted too. The firmware's clock stands still instead.
    """
    live_stage.watchdog_s = None
    monkeypatch.setattr(SafeLights, "_keep_awake", lambda _: None)
    return live_stage


@pytest.mark.parametrize(("name", "way"), SUFFERED)
def test_what_one_packet_suffers_on_the_line_is_mended_by_asking_again(stage, name, way):
    stories.test_what_one_packet_suffers_on_the_line_is_mended_by_asking_again(stage, name, way)


def test_a_line_that_drops_everything_ends_the_capture_and_reports_that_lights_may_be_on(
    live_stage,
):
    ending = live_stage.capture(Fault("drop", at=stories.SET_X, until=1000))
    stories.refused(ending, "no answer to", "The lights may still be on")
    assert ending.dark


def test_a_capture_keeps_the_firmware_awake_and_ends_dark(live_stage):
    ending = live_stage.capture()
    assert ending.fine, ending.message
    assert ending.dark
