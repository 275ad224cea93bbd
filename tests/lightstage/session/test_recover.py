"""Going on after a crash, case by case: what is adopted, kept aside, taken again, and said."""

import dataclasses
import datetime
import hashlib
import json

import numpy as np
import pytest

from lightstage.cameras.camera import CardFile
from lightstage.errors import DeviceError
from lightstage.operator.words import notice_of
from lightstage.session import (
    SessionState,
    SessionWriter,
    arrived,
    bring_home,
    read_journal,
    reconcile,
)
from sim.camera.dng import Exif, dng_bytes
from sim.camera.sensor import Sensor, SensorConfig
from tests.lightstage.session.crashes import Camera, Desk, Life, label, picture


@pytest.fixture
def desk(tmp_path, small_rig):
    return Desk.new(tmp_path / "S", dataclasses.replace(small_rig, cameras=small_rig.cameras[:2]))


@pytest.fixture
def begun(desk, plan):
    """A session whose cam0 and cam1 were triggered and exposed `full`; nothing is downloaded."""
    cameras = [Camera(name, body, Life()) for name, body in desk.bodies.items()]
    cards = {camera.id: camera.card() for camera in cameras}
    serials = {camera.id: camera.body.serial for camera in cameras}
    writer = SessionWriter.new(desk.root, desk.rig, plan, cards, serials)
    writer.lit("full", [1.0] * 8, acknowledged=False)
    writer.trigger("full", {"cam0": 1, "cam1": 1})
    for camera in cameras:
        writer.exposed("full", 1, camera.id, camera.trigger("full"))
    return writer, cameras


def resumed(desk, cameras):
    writer = SessionWriter.resumed(desk.root, desk.rig)
    writer.resume({camera.id: camera.card() for camera in cameras}, {})
    return writer


def lines_of(writer, event):
    return [line for line in read_journal(writer.journal.path) if line["event"] == event]


def test_an_exposure_whose_light_lasted_is_brought_from_the_card_and_keeps_what_is_known_of_it(
    desk, begun
):
    writer, cameras = begun
    found = reconcile(writer, cameras)
    assert found.adopted == (("full", "cam0", 1), ("full", "cam1", 1))
    assert found.wanted == {"full": (), "x+": ("cam0", "cam1")}
    assert (found.recovered, found.rejected, found.findings) == ((), (), ())
    assert [line["acknowledged"] for line in lines_of(writer, "frame")] == [False, False]
    again = reconcile(writer, cameras)
    assert (again.adopted, again.wanted) == ((), found.wanted)
    writer.close()


def test_a_picture_of_a_light_that_may_not_have_lasted_is_kept_aside_and_taken_again(desk, begun):
    writer, cameras = begun
    reconcile(writer, cameras)
    writer.trigger("x+", {"cam0": 1, "cam1": 1})
    cameras[0].trigger("x+")
    found = reconcile(writer, cameras)
    assert [path.parent.name for path in found.recovered] == ["cam0"]
    assert label(found.recovered[0].read_bytes()) == ("x+", "cam0")
    assert found.rejected == (("x+", "cam0", 1), ("x+", "cam1", 1))
    assert writer.next_take("x+", "cam0") == 2
    (line,) = lines_of(writer, "recovered")
    assert line["pattern"] == "x+"
    assert line["file"][0] in cameras[0].body.card
    writer.close()


def test_of_an_emptied_card_a_whole_download_is_kept_and_reported_to_be_less_certain(desk, begun):
    writer, cameras = begun
    data = cameras[0].body.exposed[0]
    writer.incoming("full", "cam0", 1).write_bytes(data)
    writer.incoming("full", "cam1", 1).write_bytes(cameras[1].body.exposed[0][:50])
    for camera in cameras:
        camera.body.card.clear()
    writer.close()
    writer = resumed(desk, cameras)
    found = reconcile(writer, cameras)
    assert found.adopted == (("full", "cam0", 1),)
    assert [line["verified"] for line in lines_of(writer, "frame")] == ["size and header"]
    assert found.rejected == (("full", "cam1", 1),)
    assert [path.read_bytes() for path in found.recovered] == [cameras[1].body.exposed[0][:50]]
    codes = sorted(finding.code for finding in found.findings)
    assert codes == ["card-changed", "card-changed", "verified-by-size"]
    stated = [
        line["code"] for line in read_journal(writer.journal.path) if line["event"] == "finding"
    ]
    assert sorted(stated) == codes
    assert reconcile(writer, cameras).findings == ()
    writer.close()


def test_a_picture_with_the_bytes_of_another_is_no_photograph_of_this_light(desk, begun):
    writer, cameras = begun
    reconcile(writer, cameras)
    stale = cameras[0].body.exposed[0]
    cameras[0].body.card["/DCIM/DSC_9999.DNG"] = stale
    writer.trigger("x+", {"cam0": 1})
    writer.exposed("x+", 1, "cam0", CardFile("/DCIM/DSC_9999.DNG", len(stale)))
    found = reconcile(writer, cameras)
    assert found.rejected == (("x+", "cam0", 1),)
    assert [path.read_bytes() for path in found.recovered] == [stale]
    assert writer.state.missing("x+") == ("cam0", "cam1")
    writer.close()


def dated(moment, offset="+00:00"):
    counts = np.random.default_rng(3).integers(512, 4000, (24, 24)).astype(np.uint16)
    exif = Exif("Nikon", "600", 8.0, 85.0, moment.strftime("%Y:%m:%d %H:%M:%S"), offset)
    return dng_bytes(counts, Sensor(SensorConfig(), np.eye(3), 0.01), exif)


@pytest.mark.parametrize(
    ("off_s", "offset", "same"),
    [
        (0, "+00:00", True),
        (60, "+00:00", True),
        (2 * 3600 + 30, None, True),  # a clock that shows local time and does not tell its zone
        (400, "+00:00", False),
        (3600, "+00:00", False),
        (-86400 * 3, None, False),
        (400, None, False),
    ],
)
def test_on_a_card_formatted_and_used_again_a_picture_of_another_time_is_not_taken_for_ours(
    desk, plan, off_s, offset, same
):
    body = desk.bodies["cam0"]
    body.card.clear()  # nothing is on it that would be missed
    cameras = [Camera(name, each, Life()) for name, each in desk.bodies.items()]
    cards = {camera.id: camera.card() for camera in cameras}
    writer = SessionWriter.new(desk.root, desk.rig, plan, cards)
    writer.trigger("full", {"cam0": 1})
    taken = datetime.datetime.now(datetime.UTC) + datetime.timedelta(seconds=off_s)
    data = dated(taken, offset)
    body.card["/DCIM/DSC_0001.DNG"] = data
    writer.exposed("full", 1, "cam0", CardFile("/DCIM/DSC_0001.DNG", len(data)))
    found = reconcile(writer, cameras)
    assert (len(found.adopted), len(found.rejected)) == ((1, 0) if same else (0, 1))
    assert [path.read_bytes() for path in found.recovered] == ([] if same else [data])
    writer.close()


def test_what_is_no_photograph_is_kept_aside_and_taken_again(desk, begun):
    writer, cameras = begun
    name = list(cameras[1].body.card)[-1]
    cameras[1].body.card[name] = bytes(len(cameras[1].body.card[name]))
    found = reconcile(writer, cameras)
    assert found.adopted == (("full", "cam0", 1),)
    assert found.rejected == (("full", "cam1", 1),)
    assert not any(found.recovered[0].read_bytes())
    writer.close()


def test_a_second_file_of_a_shot_is_known_and_not_brought(desk, begun):
    writer, cameras = begun
    reconcile(writer, cameras)
    raw = cameras[0].trigger("x+")
    cameras[0].body.card["/DCIM/DSC_0003.JPG"] = b"preview"
    writer.trigger("x+", {"cam0": 1})
    writer.exposed("x+", 1, "cam0", raw, [CardFile("/DCIM/DSC_0003.JPG", 7)])
    found = reconcile(writer, cameras)
    assert (found.adopted, found.recovered) == ((("x+", "cam0", 1),), ())
    writer.close()


def test_a_camera_that_does_not_answer_holds_nothing_up_but_is_not_given_up(desk, begun):
    writer, cameras = begun
    cameras[0].body.unreachable = True
    with pytest.raises(DeviceError, match="camera cam0: found no answer"):
        reconcile(writer, cameras)
    assert writer.state.missing("full") == ("cam0",)
    cameras[0].body.unreachable = False
    assert reconcile(writer, cameras).adopted == (("full", "cam0", 1),)
    writer.close()


def test_before_a_session_ends_first_takes_that_never_came_are_brought_home(desk, begun, keep):
    writer, cameras = begun
    for camera in cameras:
        writer.trigger("full", {camera.id: 2})
        file = camera.trigger("full")
        writer.exposed("full", 2, camera.id, file)
        incoming = writer.incoming("full", camera.id, 2)
        got = camera.download(file.name, incoming)
        writer.keep("full", camera.id, 2, incoming, file, got.sha256)
    cameras[1].body.unreachable = True
    found = bring_home(writer, cameras)
    assert found.adopted == (("full", "cam0", 1),)
    assert writer.state.accepted("full", "cam0").take == 2
    assert [(each.code, each.severity) for each in found.findings] == [("card-unread", "warn")]
    assert found.wanted["full"] == ()
    writer.close()


def test_a_camera_that_was_started_again_is_looked_at_alone(desk, begun):
    writer, cameras = begun
    assert reconcile(writer, cameras[:1]).adopted == (("full", "cam0", 1),)
    assert writer.state.missing("full") == ("cam1",)
    writer.close()


def test_a_file_that_nobody_knows_is_reported_and_left_alone(desk, begun):
    writer, cameras = begun
    reconcile(writer, cameras)
    stray = desk.root / "frames" / "full" / "holiday.dng"
    stray.write_bytes(picture("elsewhere", "nobody", 1))
    found = reconcile(writer, cameras)
    assert [finding.code for finding in found.findings] == ["stray-file"]
    assert stray.exists()
    writer.close()


def test_pictures_of_before_the_session_are_never_copied(desk, begun):
    writer, cameras = begun
    reconcile(writer, cameras)
    paths = [path for path in desk.root.rglob("*") if path.is_file()]
    assert not any(b"elsewhere" in path.read_bytes() for path in paths)
    writer.close()


def test_photographs_of_other_sessions_on_a_card_are_reported_once_a_camera(desk, begun):
    writer, cameras = begun
    cameras[0].body.shoot_elsewhere(5)
    other = desk.root.parent / "other"
    other.mkdir()
    theirs = [hashlib.sha256(picture("elsewhere", "nobody", i)).hexdigest() for i in range(5)]
    frames = [{"event": "frame", "pattern": "x", "camera": "cam0", "sha256": n} for n in theirs]
    lines = [{"event": "begin", "session": "other"}, *frames]
    (other / "journal.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    writer.look_beside()
    reconcile(writer, cameras)
    words = [
        str(notice_of(line)) for line in lines_of(writer, "note") if notice_of(line).tone != "quiet"
    ]
    assert words == ["cam0: 5 photographs of other sessions on its card, left alone."]
    assert not list((desk.root / "recovered").rglob("*.DNG"))
    writer.close()


def test_a_name_that_comes_again_after_a_card_was_formatted_is_another_file(desk, begun):
    writer, cameras = begun
    reconcile(writer, cameras)
    body = cameras[0].body
    body.card.clear()
    body.number = 1  # the next file is called as the one that was kept
    writer.trigger("x+", {"cam0": 1})
    file = cameras[0].trigger("x+")
    assert file.name == writer.state.accepted("full", "cam0").file.name
    writer.exposed("x+", 1, "cam0", file)
    found = reconcile(writer, cameras)
    # Since when the card is another nobody knows: its file is kept, without a label.
    assert [label(path.read_bytes()) for path in found.recovered] == [("x+", "cam0")]
    assert writer.state.accepted("x+", "cam0") is None
    path = desk.root / writer.state.accepted("full", "cam0").path
    assert label(path.read_bytes()) == ("full", "cam0")
    writer.close()


def test_a_name_that_comes_again_after_its_file_was_deleted_is_another_file(desk, begun):
    writer, cameras = begun
    reconcile(writer, cameras, delete=True)
    body = cameras[0].body
    assert len(body.card) == 1
    body.number = 1
    writer.trigger("x+", {"cam0": 1})
    cameras[0].trigger("x+")  # and the process dies: no line of it, the old name, the old size
    found = reconcile(writer, cameras)
    assert [label(path.read_bytes()) for path in found.recovered] == [("x+", "cam0")]
    assert found.wanted == {"full": (), "x+": ("cam0", "cam1")}
    writer.close()


@pytest.mark.parametrize("same", [True, False])
def test_a_photograph_lost_here_comes_from_the_card_only_if_it_is_the_same_to_the_byte(
    desk, begun, same
):
    writer, cameras = begun
    reconcile(writer, cameras)
    kept = writer.state.accepted("full", "cam1")
    path = desk.root / kept.path
    path.write_bytes(path.read_bytes()[:-5] + b"wrong")
    if not same:
        cameras[1].body.card[kept.file.name] = picture("elsewhere", "nobody", 3)
    found = reconcile(writer, cameras)
    key = ("full", "cam1", 1)
    assert (found.restored, found.rejected) == (((key,), ()) if same else ((), (key,)))
    assert [each.read_bytes()[-5:] for each in found.recovered] == [b"wrong"]
    assert path.exists() == same
    if same:
        assert path.read_bytes() == cameras[1].body.exposed[0]
    assert writer.state.missing("full") == (() if same else ("cam1",))
    writer.close()


def test_what_is_deleted_on_a_card_is_the_photograph_that_is_kept_and_no_other(desk, begun):
    writer, cameras = begun
    reconcile(writer, cameras)
    name = writer.state.accepted("full", "cam0").file.name
    cameras[0].body.card[name] = picture("elsewhere", "nobody", 7)
    reconcile(writer, cameras, delete=True)
    assert name in cameras[0].body.card
    assert writer.state.accepted("full", "cam1").file.name not in cameras[1].body.card
    assert len(lines_of(writer, "deleted")) == 1
    writer.close()


def test_a_file_that_was_named_before_the_crash_is_ours_whatever_its_camera_states_of_the_time(
    desk, plan
):
    cameras = [Camera(name, each, Life()) for name, each in desk.bodies.items()]
    cards = {camera.id: camera.card() for camera in cameras}
    writer = SessionWriter.new(desk.root, desk.rig, plan, cards)
    data = dated(datetime.datetime(1999, 1, 1))
    cameras[0].body.card["/DCIM/DSC_7.DNG"] = data
    writer.trigger("full", {"cam0": 1})
    writer.exposed("full", 1, "cam0", CardFile("/DCIM/DSC_7.DNG", len(data)))
    incoming = writer.incoming("full", "cam0", 1)
    incoming.with_name("cam0.dng").write_bytes(data)
    found = reconcile(writer, cameras)
    assert found.adopted == (("full", "cam0", 1),)
    assert not incoming.exists()
    writer.close()


def test_a_number_once_intended_is_never_given_again(desk, begun):
    writer, cameras = begun
    reconcile(writer, cameras)
    for take in (1, 2, 3):
        assert writer.next_take("x+", "cam0") == take
        writer.trigger("x+", {"cam0": take})
    writer.close()


def test_two_files_of_one_name_are_both_kept_aside(desk, begun):
    writer, cameras = begun
    reconcile(writer, cameras)
    files = []
    for data in (b"one", b"two", b"one"):
        cameras[0].body.card["/DCIM/A.DNG"] = data
        files.append(writer.recover(cameras[0], CardFile("/DCIM/A.DNG", 3), None, "test").name)
    assert files == ["DCIM_A.DNG", "DCIM_A.2.DNG", "DCIM_A.DNG"]
    writer.close()


def test_what_arrived_on_a_card_is_reported_by_name_and_size():
    before = [CardFile("a", 1), CardFile("b", 2)]
    now = [CardFile("b", 3), CardFile("a", 1), CardFile("c", 2)]
    assert arrived(before, now) == (CardFile("b", 3), CardFile("c", 2))


def test_the_state_of_a_journal_is_that_of_the_writer(desk, begun):
    writer, cameras = begun
    reconcile(writer, cameras)
    writer.rejected("full", "cam1", "blurred")
    state = SessionState(read_journal(writer.journal.path))
    assert (
        state.wanted()
        == writer.state.wanted()
        == {
            "full": ("cam1",),
            "x+": ("cam0", "cam1"),
        }
    )
    assert state.next_take("full", "cam1") == 2
    assert state.all_frames() == writer.state.all_frames()
    json.dumps(state.begin)
    writer.close()
