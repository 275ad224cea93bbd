"""What an operator sees when the lights misbehave: each test is a story of `lightstage capture`."""

from __future__ import annotations

import pytest

from lightstage.checks import check_session
from lightstage.errors import FormatError
from sim.devices.faults import Fault
from sim.errors import SimError

# HELLO? is packet 1 and DARK packet 2; each shot is a SET and a STATE?; DARK ends it.
SET_FULL, STATE_FULL, SET_X = 3, 4, 5


def refused(ending, *parts):
    """The operator is told, and there is no session that looks finished."""
    for part in parts:
        assert part in ending.said, ending.said
    assert not (ending.root / "session.json").exists()


def test_with_no_fault_all_is_well_and_dark(stage):
    ending = stage.capture()
    assert ending.fine
    assert ending.dark
    assert ending.happened == []
    assert stage.mislabelled(ending) == []
    assert check_session(ending.root).frames == 9


@pytest.mark.parametrize("way", ["request", "answer"])
@pytest.mark.parametrize("name", ["drop", "corrupt", "delay", "duplicate", "reorder"])
def test_what_one_packet_suffers_on_the_line_is_mended_by_asking_again(stage, name, way):
    more = {"seconds": 0.3} if name == "delay" else {"bits": 3} if name == "corrupt" else {}
    ending = stage.capture(Fault(name, at=SET_X, way=way, **more))
    assert ending.happened == [name]
    assert ending.said == ""
    assert ending.fine
    assert ending.dark
    assert stage.mislabelled(ending) == []


def test_a_bad_line_from_the_first_packet_to_the_last_loses_nothing(stage):
    names = ["drop", "corrupt", "delay", "duplicate", "reorder"]
    faults = [
        Fault(name, probability=0.05, way=way) for name in names for way in ("request", "answer")
    ]
    ending = stage.capture(*faults, seed=3, attempts=8)
    assert len(set(ending.happened)) >= 3
    assert ending.said == ""
    assert ending.fine
    assert ending.dark
    assert stage.mislabelled(ending) == []


def test_a_line_that_drops_everything_ends_the_capture_and_says_that_lights_may_be_on(stage):
    ending = stage.capture(Fault("drop", at=SET_X, until=1000))
    refused(ending, "no answer to 3 SET of 0.2 s", "The lights may still be on")
    assert not ending.dark
    assert ending.shots() == ["full"]


def test_a_set_that_was_held_back_does_not_light_the_stage_after_it_was_told_dark(stage):
    # The only attempt is overtaken by the DARK with which the capture gives up.
    ending = stage.capture(Fault("reorder", at=SET_X), attempts=1)
    refused(ending, "no answer to 1 SET")
    assert ending.dark


def test_a_device_that_dies_leaves_its_lights_on_and_the_operator_is_told(stage):
    ending = stage.capture(Fault("die", at=STATE_FULL))
    refused(ending, "no answer", "The lights may still be on: switch their power supply off")
    assert not ending.dark
    assert ending.shots() == []
    assert len(ending.kept()) == 3


def test_a_device_that_restarts_is_noticed_and_its_photographs_make_no_shot(stage):
    ending = stage.capture(Fault("reset", at=STATE_FULL))
    refused(ending, "boot id", "the device was reset and is dark")
    assert ending.dark
    assert ending.shots() == []
    assert len(ending.kept()) == 3


def test_a_restart_whose_hello_is_lost_is_noticed_by_the_state(stage):
    # Over before the host asks again, and what it said at its start did not arrive.
    ending = stage.capture(
        Fault("reset", at=STATE_FULL, seconds=0.0), Fault("drop", at=STATE_FULL, way="answer")
    )
    refused(ending, "boot id")
    assert ending.dark


def test_a_board_that_restarts_when_its_port_opens_is_waited_for(stage):
    ending = stage.capture(Fault("reset-on-open", seconds=0.2))
    assert ending.happened == ["reset-on-open"]
    assert ending.fine
    assert stage.mislabelled(ending) == []


def test_a_light_that_stays_on_is_told_before_a_photograph_when_the_device_knows(stage):
    ending = stage.capture(Fault("stuck-on", lights=[2]))
    refused(ending, "The lights are not as they were set")
    assert not ending.root.exists()


def test_a_light_that_gets_stuck_during_a_shot_makes_that_shot_void(stage):
    ending = stage.capture(Fault("stuck-on", lights=[2], at=SET_X + 1))
    refused(ending, "not as they were set", "The lights may still be on")
    assert not ending.dark
    assert ending.shots() == ["full"]


def test_a_dead_light_is_told_when_the_device_knows(stage):
    ending = stage.capture(Fault("dead-light", lights=[7]))
    refused(ending, "The lights are not as they were set")
    assert ending.dark
    assert ending.kept() == []


@pytest.mark.parametrize(
    ("name", "lights"), [("stuck-on-hidden", [4, 5]), ("dead-light-hidden", [0, 1])]
)
def test_lights_of_which_the_device_says_what_it_was_told_show_in_the_photographs(
    stage, name, lights
):
    # Broken when x- is lit: x+ and x- no longer sum to full.
    ending = stage.capture(Fault(name, lights=lights, at=SET_X + 2))
    assert ending.fine
    with pytest.raises(FormatError, match=r"x\+ \+ x- = .*Was a pattern not lit"):
        check_session(ending.root)


def test_swapped_banks_light_the_others_lights(stage):
    stage.patterns = ("full@parallel", "full@cross")
    ending = stage.capture(Fault("swapped-bank"))
    # The device says what it was told: only pictures can show it.
    assert ending.said == ""
    assert len(stage.mislabelled(ending)) == 6


def test_a_wrong_acknowledgement_is_refused(stage):
    ending = stage.capture(Fault("wrong-acknowledgement", at=SET_X))
    refused(ending, "SET", "The lights are not as they were set")
    assert ending.dark
    assert ending.shots() == ["full"]
    assert ending.kept() == ["full/cam0", "full/cam1", "full/cam2"]


def test_a_light_or_a_bank_that_is_not_there_cannot_be_faulty(stage):
    with pytest.raises(SimError, match=r"stuck-on, lights: found 8, expected 0 to 7"):
        stage.capture(Fault("stuck-on", lights=[8]))
