"""After a crash before any operation, or several crashes: nothing lost, doubled or mislabelled."""

import collections
import dataclasses
import itertools
import json

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lightstage.errors import DeviceError
from lightstage.formats.files import sha256_file
from lightstage.formats.session import changed_frames, load_session, missing_frames
from lightstage.session import read_journal
from tests.lightstage.session.crashes import Desk, label


@pytest.fixture(scope="module")
def places(tmp_path_factory):
    """New folders, one after another."""
    top = tmp_path_factory.mktemp("desks")
    return (top / f"S{number}" for number in itertools.count())


@pytest.fixture
def rig(small_rig):
    return dataclasses.replace(small_rig, cameras=small_rig.cameras[:2])


def check(desk, cards_whole=True):
    """What must hold for a finished session, whatever happened before."""
    session = load_session(desk.root)
    assert missing_frames(session) == []
    assert changed_frames(session) == []
    assert len(session.file.frames) == 4
    frames, recovered = desk.photographs("frames"), desk.photographs("recovered")
    assert [path for path, _ in frames + recovered if path.name.startswith(".")] == []
    for path, data in frames:
        assert label(data) == (path.parent.name, path.name.split(".")[0])
    for frame in session.file.frames:
        data = session.frame_path(frame).read_bytes()
        assert label(data) == (frame.pattern, frame.camera)
    exposed = [data for body in desk.bodies.values() for data in body.exposed]
    there = collections.Counter(data for _, data in frames + recovered)
    for data in exposed:
        assert there[data] == 1 or (not cards_whole and there[data] == 0)
    lines = read_journal(desk.root / "journal.jsonl")
    assert [line["event"] for line in lines].count("end") == 1
    values = {line["path"]: line for line in lines if line["event"] in ("frame", "recovered")}
    for path, _ in frames + recovered:
        line = values[path.relative_to(desk.root).as_posix()]
        assert line["sha256"] == sha256_file(path)


def operations(places, rig, delete):
    desk = Desk.new(next(places), rig, delete)
    return desk.live()


@pytest.mark.parametrize("delete", [False, True])
def test_a_crash_before_any_operation_loses_doubles_and_mislabels_nothing(places, rig, delete):
    count = operations(places, rig, delete)
    assert count > 100
    for left in range(count):
        desk = Desk.new(next(places), rig, delete)
        assert desk.live(left) == left
        desk.live()
        check(desk)
        recovered = desk.photographs("recovered")
        # Only what was exposed when its light was not yet known to have lasted is taken again.
        assert sum(len(body.exposed) for body in desk.bodies.values()) == 4 + len(recovered)
        assert len(recovered) <= 2
        on_cards = sum(len(body.card) for body in desk.bodies.values())
        assert on_cards == (2 + len(recovered) if delete else 6 + len(recovered))


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(crashes=st.lists(st.integers(0, 120), min_size=2, max_size=5), delete=st.booleans())
def test_crashes_during_the_resume_itself_do_no_more_harm(places, rig, crashes, delete):
    desk = Desk.new(next(places), rig, delete)
    desk.live(crashes[0])
    for left in crashes[1:]:
        desk.live(left)
    desk.live()
    check(desk)


def test_every_crash_during_the_resume_after_every_fifth_crash_does_no_harm(places, rig):
    count = operations(places, rig, delete=True)
    for first in range(20, count, 9):
        for second in range(0, 60, 7):
            desk = Desk.new(next(places), rig, delete=True)
            desk.live(first)
            desk.live(second)
            desk.live()
            check(desk)


def test_resuming_again_changes_nothing(places, rig):
    desk = Desk.new(next(places), rig)
    desk.live(70)
    desk.live(50)
    desk.live()
    before = dict(desk.photographs("."))
    desk.live()
    assert dict(desk.photographs(".")) == before


def emptied(desk):
    for body in desk.bodies.values():
        body.card.clear()


def formatted_and_used(desk):
    for body in desk.bodies.values():
        body.card.clear()
        body.number = 1  # the oldest file's number is not given again, the session's are
        body.shoot_elsewhere(3)


def swapped(desk):
    for body in desk.bodies.values():
        body.card = {"/DCIM/IMG_7.DNG": b"somebody else's"}


def used(desk):
    for body in desk.bodies.values():
        body.shoot_elsewhere(2)


def partly_emptied(desk):
    for body in desk.bodies.values():
        if len(body.card) > 1:
            del body.card[sorted(body.card)[0]]


MEANWHILE = {each.__name__: each for each in (emptied, formatted_and_used, swapped, used)}
MEANWHILE[partly_emptied.__name__] = partly_emptied


@pytest.mark.parametrize("name", MEANWHILE)
def test_whatever_happens_to_the_cards_meanwhile_no_label_is_wrong(places, rig, name):
    count = operations(places, rig, delete=False)
    lost = 0
    for left in range(0, count, 2):
        desk = Desk.new(next(places), rig)
        desk.live(left)
        MEANWHILE[name](desk)
        desk.live()
        check(desk, cards_whole=False)
        files = [label(data) for _, data in desk.photographs("frames")]
        assert "elsewhere" not in {pattern for pattern, _ in files}
        there = {data for folder in ("frames", "recovered") for _, data in desk.photographs(folder)}
        exposed = {data for body in desk.bodies.values() for data in body.exposed}
        lost += len(exposed - there)
        if (desk.root / "recovered").exists() and name == "swapped":
            assert b"somebody else's" not in there
    # What was exposed and not yet downloaded goes with its card; nothing else does.
    assert (lost > 0) == (name in ("emptied", "formatted_and_used", "swapped", "partly_emptied"))


def damaged(desk):
    for path, data in desk.photographs("frames"):
        path.write_bytes(data[:-10] + bytes(10))


def removed(desk):
    for path, _ in desk.photographs("frames"):
        path.unlink()


@pytest.mark.parametrize("harm", [damaged, removed])
@pytest.mark.parametrize("card", ["whole", "emptied"])
def test_a_photograph_lost_on_the_disk_comes_from_the_card_or_is_taken_again(
    places, rig, harm, card
):
    count = operations(places, rig, delete=False)
    for left in range(0, count - 4, 4):
        desk = Desk.new(next(places), rig)
        desk.live(left)
        harm(desk)
        if card == "emptied":
            emptied(desk)
        taken = sum(len(body.exposed) for body in desk.bodies.values())
        desk.live()
        session = load_session(desk.root)
        assert missing_frames(session) == changed_frames(session) == []
        for frame in session.file.frames:
            data = session.frame_path(frame).read_bytes()
            assert label(data) == (frame.pattern, frame.camera)
        again = sum(len(body.exposed) for body in desk.bodies.values()) - taken
        uncertain = len([p for p, d in desk.photographs("recovered") if d.endswith(b" ")])
        if card == "whole":
            assert again <= 4 - taken + uncertain
        events = [line["event"] for line in read_journal(desk.root / "journal.jsonl")]
        assert events.count("end") == 1


def test_a_camera_that_is_another_one_or_does_not_answer_is_refused_and_nothing_given_up(
    places, rig
):
    desk = Desk.new(next(places), rig)
    desk.live(60)
    desk.bodies["cam1"].serial = "another"
    with pytest.raises(DeviceError, match=r"camera cam1, serial: found another, another camera"):
        desk.live()
    desk.bodies["cam1"].serial = rig.cameras[1].serial
    desk.live()
    check(desk)


def test_a_session_json_that_a_rejection_overtook_is_written_again(places, rig):
    count = operations(places, rig, delete=False)
    desk = Desk.new(next(places), rig)
    desk.live(count - 4)
    assert (desk.root / "session.json").exists()
    for path, _ in desk.photographs("frames")[:1]:
        path.unlink()
    emptied(desk)
    desk.live()
    check_frames = json.loads((desk.root / "session.json").read_text())["frames"]
    assert sorted(frame["take"] for frame in check_frames) == [1, 1, 1, 2]
    assert changed_frames(load_session(desk.root)) == []
