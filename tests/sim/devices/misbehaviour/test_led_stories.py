"""What an operator sees when the lights misbehave: each test is a story of `lightstage capture`."""

from __future__ import annotations

import dataclasses

import pytest

from lightstage.checks import check_session
from lightstage.patterns import pattern_levels
from lightstage.rig import LightAddress
from sim.devices.faults import Fault
from sim.errors import SimError

# HELLO? is packet 1 and DARK packet 2; each shot is a SET and a STATE? of each camera.
SET_FULL, STATE_FULL, SET_X, SET_X_MINUS = 3, 4, 7, 11
LOST = "not as they were set"


def refused(ending, *parts):
    """The operator is told, and there is no session that looks finished."""
    for part in parts:
        assert part in ending.message, ending.message
    assert not (ending.root / "session.json").exists()


def test_with_no_fault_all_is_well_and_dark(stage):
    ending = stage.capture()
    assert ending.fine
    assert ending.dark
    assert ending.happened == []
    assert ending.report.retakes == 0
    assert check_session(ending.root).frames == 9


def test_a_rig_with_addresses_lights_the_lamps_that_its_patterns_name(stage):
    lights = [
        dataclasses.replace(light, address=LightAddress(2 * (7 - i)))
        for i, light in enumerate(stage.rig.lights)
    ]
    stage.rig = dataclasses.replace(stage.rig, lights=tuple(lights))
    ending = stage.capture(Fault("drop", at=SET_X, way="request"))
    assert ending.fine, ending.message
    assert ending.dark
    shone = [state.counts for state in ending.shone if state.counts.any()]
    assert {len(counts) for counts in shone} == {15}
    assert not any(counts[1::2].any() for counts in shone)
    right = pattern_levels("x+", stage.rig)[::-1] > 0
    assert any(((counts[::2] > 0) == right).all() for counts in shone)


@pytest.mark.parametrize("way", ["request", "answer"])
@pytest.mark.parametrize("name", ["drop", "corrupt", "delay", "duplicate", "reorder"])
def test_what_one_packet_suffers_on_the_line_is_mended_by_asking_again(stage, name, way):
    more = {"seconds": 0.3} if name == "delay" else {"bits": 3} if name == "corrupt" else {}
    ending = stage.capture(Fault(name, at=SET_X, way=way, **more))
    assert ending.happened == [name]
    assert ending.fine, ending.message
    assert ending.dark


def test_a_bad_line_from_the_first_packet_to_the_last_loses_nothing(stage):
    names = ["drop", "corrupt", "delay", "duplicate", "reorder"]
    faults = [
        Fault(name, probability=0.05, way=way) for name in names for way in ("request", "answer")
    ]
    ending = stage.capture(*faults, seed=3, attempts=8)
    assert len(set(ending.happened)) >= 3
    assert ending.fine, ending.message
    assert ending.dark


@pytest.mark.parametrize("watchdog_s", [None, 0.6])
def test_a_line_that_drops_everything_ends_the_capture_and_reports_that_lights_may_be_on(
    stage, watchdog_s
):
    stage.watchdog_s = watchdog_s
    ending = stage.capture(Fault("drop", at=SET_X, until=1000))
    refused(ending, "no answer to", "The lights may still be on")
    # The host asks for a second at least before it gives up: a device with a watchdog is dark then.
    assert ending.dark == (watchdog_s is not None)


def test_a_set_that_was_held_back_does_not_light_the_stage_after_it_was_told_dark(stage):
    # The only attempt is overtaken by the DARK with which the capture gives up.
    ending = stage.capture(Fault("reorder", at=SET_X), attempts=1)
    assert ending.dark


def test_a_device_that_dies_leaves_its_lights_on_and_the_operator_is_warned(stage):
    ending = stage.capture(Fault("die", at=STATE_FULL, until=1000))
    refused(ending, "no answer", "The lights may still be on: switch their power supply off")
    assert not ending.dark
    assert ending.shots() == []


@pytest.mark.parametrize("seconds", [0.0, 0.05])
def test_a_device_that_restarts_is_greeted_again_and_its_photographs_are_kept_apart(stage, seconds):
    # Over before the host asks again, where it takes no time.
    ending = stage.capture(Fault("reset", at=STATE_FULL, seconds=seconds))
    assert ending.happened == ["reset"]
    assert ending.fine, ending.message
    assert ending.dark
    assert ending.report.retakes == len(ending.recovered()) == 3


def test_a_board_that_restarts_when_its_port_opens_is_waited_for(stage):
    ending = stage.capture(Fault("reset-on-open", seconds=0.2))
    assert "reset-on-open" in ending.happened
    assert ending.fine, ending.message


@pytest.mark.parametrize("name", ["stuck-on", "dead-light"])
def test_a_lamp_of_which_the_device_tells_ends_the_capture_before_a_photograph_counts(stage, name):
    ending = stage.capture(Fault(name, lights=[2]))
    refused(ending, LOST)
    assert ending.kept() == []


def test_a_light_that_gets_stuck_during_a_shot_makes_that_shot_void(stage):
    ending = stage.capture(Fault("stuck-on", lights=[2], at=SET_X + 1))
    refused(ending, LOST, "The lights may still be on")
    assert not ending.dark
    assert ending.shots() == ["full"]
    assert len(ending.recovered()) == 3


@pytest.mark.parametrize(
    ("name", "lights"), [("stuck-on-hidden", [4, 5]), ("dead-light-hidden", [0, 1])]
)
def test_lights_of_which_the_device_says_what_it_was_told_show_in_the_photographs(
    stage, name, lights
):
    # Broken when x- is lit: x+ and x- no longer sum to full.
    ending = stage.capture(Fault(name, lights=lights, at=SET_X_MINUS))
    refused(ending, "x-", "To resume: lightstage capture --resume")


def test_a_wrong_acknowledgement_voids_the_photograph_alone(stage):
    ending = stage.capture(Fault("wrong-acknowledgement", at=SET_X))
    assert ending.fine, ending.message
    assert ending.dark
    assert ending.kept() == [f"{p}/cam{i}" for p in ("full", "x+", "x-") for i in range(3)]


def test_banks_that_make_no_difference_are_reported_whatever_the_device_reports(stage):
    stage.patterns = ("full@parallel", "full@cross")
    ending = stage.capture(Fault("swapped-bank"))
    # Only the pictures can tell, and these show nothing that mirrors.
    refused(ending, "all cameras, pattern full@cross", "Are the polarisers on lamps and lenses?")


def test_a_light_or_a_bank_that_is_not_there_cannot_be_faulty(stage):
    with pytest.raises(SimError, match=r"stuck-on, lights: found 8, expected 0 to 7"):
        stage.capture(Fault("stuck-on", lights=[8]))
