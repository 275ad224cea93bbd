"""Photographs that vanish from the disk while a session is captured: never called complete."""

import dataclasses
import json
import shutil

import pytest

from lightstage.capture import Order
from lightstage.checks import check_session
from lightstage.formats.session import changed_frames, load_session, missing_frames
from lightstage.sequence import plan_shots
from lightstage.session.manifest import check_manifest


class At:
    """Does something to a session's folder, once, when a line of this kind is on the disk."""

    def __init__(self, event, does, pattern=None):
        self.event, self.pattern, self.does = event, pattern, does
        self.done = False

    def __call__(self, root, line):
        right = line["event"] == self.event and line.get("pattern") == self.pattern
        if right and not self.done:
            self.done = True
            self.does(root)


def remove_frames(root):
    shutil.rmtree(root / "frames")


def remove_one(root):
    (root / "frames/full/cam1.dng").unlink()


def spoil_one(root):
    path = root / "frames/full/cam1.dng"
    data = bytearray(path.read_bytes())
    data[-1] ^= 1
    path.write_bytes(data)


def assert_whole(ending):
    """A finished session of which every photograph is on the disk as it was taken."""
    assert ending.message == ""
    session = load_session(ending.root)
    assert [*missing_frames(session), *changed_frames(session)] == []
    assert check_manifest(ending.root) == []
    assert ending.fine


@pytest.mark.parametrize("does", [remove_one, remove_frames, spoil_one])
@pytest.mark.parametrize("delete", [False, True])
def test_a_session_whose_photographs_vanish_is_complete_only_when_they_are_there_again(
    stage, does, delete
):
    stage.config = dataclasses.replace(stage.config, delete_from_cameras=delete)
    stage.watch = At("shot", does, "x+")
    ending = stage.capture()
    assert stage.watch.done
    assert_whole(ending)
    again = {line["pattern"] for line in ending.lines("rejected")}
    assert ("full" in again) == delete  # else it came from its card again
    check_session(ending.root)


def test_what_is_still_on_its_card_is_brought_again_and_not_taken_again(stage):
    stage.watch = At("shot", remove_frames, "x+")
    ending = stage.capture()
    assert_whole(ending)
    restored = [line for line in ending.lines("note") if line.get("about") == "restored"]
    assert len(restored) == 6
    assert ending.lines("rejected") == []
    assert ending.report.taken == 9


def test_nothing_more_is_deleted_on_a_card_when_photographs_are_missing_on_the_disk(stage):
    stage.config = dataclasses.replace(stage.config, delete_from_cameras=True)
    stage.watch = At("shot", remove_one, "x+")
    ending = stage.capture()
    assert_whole(ending)
    lost = next(i["id"] for i in ending.lines("shot") if i["pattern"] == "x+")
    home = next(i["id"] for i in ending.lines("rejected"))
    between = [i for i in ending.lines("deleting") if lost < i["id"] < home]
    assert between == []
    kept = [line for line in ending.lines("finding") if line["code"] == "not-deleted"]
    assert len(kept) == 3
    assert ending.report.warnings >= 3


def test_a_capture_whose_photographs_vanish_again_and_again_ends_with_the_reason(stage):
    stage.config = dataclasses.replace(stage.config, delete_from_cameras=True)
    stage.watch = lambda root, line: line["event"] == "shot" and remove_frames(root)
    ending = stage.capture()
    assert "vanished from the disk" in ending.message
    assert "capture --resume" in ending.message
    assert ending.dark
    assert ending.lines("end") == []
    assert ending.lines("aborted") != []
    assert not (ending.root / "manifest.json").exists()


@pytest.mark.parametrize("name", ["rig.json", "frames/x+/cam2.dng"])
def test_a_file_that_vanishes_at_the_very_end_is_never_called_complete(stage, name, monkeypatch):
    from lightstage.capture import session_run

    write = session_run.write_manifest

    def write_and_remove(root, facts):
        path = write(root, facts)
        (root / name).unlink()
        return path

    monkeypatch.setattr(session_run, "write_manifest", write_and_remove)
    ending = stage.capture()
    assert f"no {name}" in ending.message
    assert ending.lines("end") == []


def test_the_manifest_lists_a_take_that_is_lost_apart_and_check_accepts_it(stage):
    stage.config = dataclasses.replace(stage.config, delete_from_cameras=True)
    stage.watch = At("shot", remove_one, "x+")
    ending = stage.capture()
    manifest = json.loads((ending.root / "manifest.json").read_text())
    assert list(manifest["lost"]) == ["frames/full/cam1.dng"]
    assert "frames/full/cam1.dng" not in manifest["files"]
    assert "frames/full/cam1.take2.dng" in manifest["files"]


def test_a_finished_session_that_lost_a_photograph_is_gone_on_with_and_ended_again(stage):
    shots = plan_shots(stage.patterns, stage.rig, stage.drive)
    with stage.standing() as standing:
        first = standing.capture()
        remove_one(first.root)
        again = standing.capture(first.root, order=Order(first.root, shots, resume=True))
    assert_whole(again)
    assert again.report.taken == 0
    restored = [line for line in again.lines("note") if line.get("about") == "restored"]
    assert [line["path"] for line in restored] == ["frames/full/cam1.dng"]
    assert len(again.lines("end")) == 2
    assert again.lines("end", "note")[-1]["event"] == "end"
    check_session(again.root)
