"""One person after another before one stage: no photograph of the first is taken for the second."""

from __future__ import annotations

import dataclasses
import datetime

import pytest

from lightstage.capture.freshness import Freshness
from lightstage.checks import check_session
from lightstage.errors import FormatError
from lightstage.exif import read_exif
from lightstage.preflight import PreflightConfig
from lightstage.session import SessionWriter
from sim.camera.exposure import with_exposure
from sim.devices.faults import Fault

HOURS = 3 * 3600.0
FIRST_SHOT_OF_THE_SECOND = 2  # the first person is photographed under one pattern alone
NOT_REPORTED = ("clock_offset_s",)
NO_CLOCK = {f"cam{i}": {"clock_offset_s": None} for i in range(3)}


@pytest.fixture
def doubting(stage):
    """A stage whose cameras' clocks are not believed."""
    preflight = PreflightConfig(believe_camera_clocks=False)
    stage.config = dataclasses.replace(stage.config, preflight=preflight)
    return stage


def stale(**more):
    return Fault("stale", camera="cam0", **{"at": FIRST_SHOT_OF_THE_SECOND, **more})


def second(standing, **more):
    """The session of the person who sits down after another one."""
    first = standing.capture(patterns=("full",), **more)
    assert first.message == ""
    return standing.capture(**more)


def refused_once(ending, why):
    """An old picture was refused, kept aside, and the pattern taken again by its camera alone."""
    assert ending.message == ""
    assert ending.fine
    assert ending.happened == ["stale"]
    (found,) = [e for e in ending.lines("finding") if e["code"] == "not-taken"]
    assert why in found["found"], found
    assert (found["pattern"], found["camera"]) == ("full", "cam0")
    assert "full/cam0.take2" in ending.kept()
    assert "full/cam1" in ending.kept()
    (aside,) = ending.recovered()
    assert aside in found["found"]
    (rejected,) = ending.lines("rejected")
    assert (rejected["pattern"], rejected["camera"], rejected["take"]) == ("full", "cam0", 1)


def test_the_picture_of_the_person_before_is_refused_kept_aside_and_taken_again(stage):
    with stage.standing(stale()) as standing:
        refused_once(second(standing), "the bytes of full by cam0 in the session session1")


def test_cameras_without_a_clock_give_no_picture_of_the_session_beside_this_one(stage):
    with stage.standing(stale(), settings=NO_CLOCK) as standing:
        ending = second(standing, untold=NOT_REPORTED)
    refused_once(ending, "the bytes of full by cam0 in the session session1")


def test_a_clock_that_is_hours_off_still_tells_an_old_picture_of_a_session_elsewhere(stage):
    preflight = PreflightConfig(max_clock_offset_s=2 * HOURS)
    stage.config = dataclasses.replace(stage.config, preflight=preflight)
    settings = {"cam0": {"clock_offset_s": HOURS}, "cam1": {"clock_offset_s": -HOURS + 41.0}}
    with stage.standing(stale(), settings=settings) as standing:
        standing.capture(stage.root / "elsewhere" / "first", ("full",))
        pretend_older(standing)
        ending = standing.capture()
    refused_once(ending, "the camera's clock showed")


def pretend_older(standing):
    """Have the picture on cam0's card say that it was taken a minute before it was."""
    (path,) = (standing.coded.cameras.folder("cam0") / "card").glob("*.DNG")
    taken = read_exif(path).taken - datetime.timedelta(minutes=1)
    path.write_bytes(with_exposure(path.read_bytes(), taken=taken.strftime("%Y:%m:%d %H:%M:%S")))


def test_a_clock_that_is_set_in_the_middle_refuses_no_picture(stage):
    jump = Fault("drift", camera="cam1", at=2, setting="clock_offset_s", value="5000")
    ending = stage.capture(jump)
    assert ending.message == ""
    assert ending.fine
    assert ending.report.retakes == 0
    assert any("its clock was set" in e.get("said", "") for e in ending.lines("note"))


def test_a_camera_that_goes_on_giving_old_pictures_stops_the_capture_with_what_to_do(stage):
    with stage.standing(stale(until=99)) as standing:
        ending = second(standing)
    assert "full by cam0" in ending.message
    assert "the bytes of full by cam0" in ending.message
    assert "Switch the camera off and on" in ending.message
    assert "To resume: lightstage capture --resume" in ending.message
    assert ending.lines("end") == []
    assert not (ending.root / "session.json").exists()
    assert ending.dark
    assert len(ending.recovered()) >= 1


def test_an_old_full_that_nothing_tells_is_found_where_it_contradicts_and_taken_again(doubting):
    # Neither clock nor bytes: the first session lies elsewhere. Its x+ becomes the second's full.
    with doubting.standing(stale(), settings=NO_CLOCK) as standing:
        standing.capture(doubting.root / "elsewhere" / "first", ("x+",), untold=NOT_REPORTED)
        ending = standing.capture(untold=NOT_REPORTED)
    assert ending.message == ""
    assert ending.fine
    again = sorted((e["pattern"], e["camera"]) for e in ending.lines("rejected"))
    assert ("full", "cam0") in again
    assert {camera for _, camera in again} == {"cam0"}
    assert len(again) <= 2 * doubting.config.operator.retakes


def test_check_finds_a_photograph_of_the_session_beside_and_one_older_than_its_session(
    stage, monkeypatch
):
    """What a capture would have let pass: without the two looks that refuse an old picture."""
    with monkeypatch.context() as blind, stage.standing(stale()) as standing:
        blind.setattr(SessionWriter, "look_beside", lambda _: None)
        blind.setattr(Freshness, "doubt", lambda *_: "")
        standing.capture(patterns=("full",))
        pretend_older(standing)
        ending = standing.capture(patterns=("full",))
        assert ending.message == ""
        assert ending.labels.of_another
    with pytest.raises(FormatError, match=r"cam0\.dng, time in the file: .* when the session") as e:
        check_session(ending.root)
    assert "cam1" not in str(e.value)
    (ending.root.parent / "session1" / "journal.jsonl").write_text(
        (ending.root / "journal.jsonl").read_text().replace(session_of(ending), "another")
    )
    with pytest.raises(FormatError, match="the bytes of full by cam0 in the session session1"):
        check_session(ending.root)


def session_of(ending):
    """A session's id."""
    return str(ending.lines("begin")[0]["session"])
