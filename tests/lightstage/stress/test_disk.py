"""Captures on a full, a read-only and a vanishing disk: said, dark, nothing lost, gone on with."""

import os
import resource
import shutil

import pytest


def fill(folder):
    """Use up every byte that is free there."""
    with (folder / "filler").open("wb", buffering=0) as file:
        for size in (1 << 16, 1 << 10, 1):
            try:
                while True:
                    file.write(bytes(size))
            except OSError:
                continue


def test_a_disk_that_fills_up_ends_dark_and_the_session_goes_on_when_there_is_room(bench, tools):
    # Where no disk can be mounted, the system refuses the same writes by a limit on files' sizes.
    with tools.small_disk(bench.desk / "disk", "64m") as mounted:
        bench.out = bench.desk / "disk" / "S"
        child = bench.start()
        bench.wait_for(child, "frames/x-/cam*.dng", 2)
        if mounted:
            fill(bench.desk / "disk")
        else:
            size = max(path.stat().st_size for path in bench.out.rglob("*") if path.is_file())
            limit = (size, resource.RLIM_INFINITY)
            resource.prlimit(child.pid, resource.RLIMIT_FSIZE, limit)
        message = tools.message(tools.ended(child), "CaptureError")
        assert bench.stage.device.dark
        assert str(bench.out) in message
        # In the words of whoever wrote first: the journal's process, or a camera's.
        assert ("o space left on" if mounted else "File too large") in message
        assert "expected " in message
        assert "resume" in message
        kept = bench.photographs()
        assert len(kept) >= 6
        assert not (bench.out / "session.json").exists()
        # Every line of the journal is whole.
        lines = tools.journal_of(bench.out)
        assert [line["id"] for line in lines] == list(range(1, len(lines) + 1))
        if mounted:
            (bench.desk / "disk" / "filler").unlink()
        done = bench.run(resume=True)
        assert done.returncode == 0, done.stderr
        bench.require_whole()
        assert {path: path.read_bytes() for path in kept} == kept


def test_a_disk_without_room_for_the_whole_plan_is_refused_before_a_light_goes_on(bench, tools):
    text = bench.stage.rig_path.read_text().replace('"width_px": 48', '"width_px": 65536')
    bench.stage.rig_path.write_text(text.replace('"height_px": 64', '"height_px": 65536'))
    message = tools.message(bench.run(), "DeviceError")
    assert f"disk of {bench.desk}: found" in message
    assert "GB free, expected" in message
    assert "GB for the whole capture. Make room, or give an --out on another disk." in message
    assert "camera cam1, card: found 64.0 GB free, expected" in message
    assert not bench.out.exists()
    assert all(not state.counts.any() for state in bench.stage.device.states)


def test_a_folder_that_may_not_be_written_to_is_refused_before_a_light_goes_on(bench, tools):
    shelf = bench.desk / "shelf"
    shelf.mkdir()
    shelf.chmod(0o555)
    try:
        done = bench.run(out=shelf / "S", before=tools.obey_permissions)
    finally:
        shelf.chmod(0o755)
    message = tools.message(done, "DiskError")
    assert f"{shelf / 'S'}, --out: found no permission" in message
    assert "expected a place that you may read and write. Name another place" in message
    assert os.listdir(shelf) == []
    assert all(not state.counts.any() for state in bench.stage.device.states)


def test_a_session_that_becomes_read_only_ends_dark_and_goes_on_later(bench, tools):
    child = bench.start(before=tools.obey_permissions)
    bench.wait_for(child, "frames/x-/cam*.dng", 2)
    frames = bench.out / "frames"
    frames.chmod(0o555)  # no folder for a further pattern
    try:
        message = tools.message(tools.ended(child), "CaptureError")
    finally:
        frames.chmod(0o755)
    assert bench.stage.device.dark
    assert str(frames) in message
    assert "found no permission to write, expected a disk that can be written" in message
    assert "Change the folder's permissions, then resume." in message
    kept = bench.photographs()
    assert len(kept) >= 6
    done = bench.run(resume=True)
    assert done.returncode == 0, done.stderr
    bench.require_whole()
    assert {path: path.read_bytes() for path in kept} == kept


def test_a_file_where_the_session_should_lie_is_refused(bench, tools):
    bench.out.write_text("mine")
    message = tools.message(bench.run(), "DiskError")
    assert f"{bench.out}, --out: found a file, expected a folder to write into" in message
    assert bench.out.read_text() == "mine"


@pytest.mark.parametrize("how", ["removed", "renamed"])
def test_a_session_folder_that_goes_away_is_reported_and_the_cameras_keep_the_photographs(
    bench, tools, how
):
    child = bench.start()
    bench.wait_for(child, "frames/x-/cam*.dng", 2)
    if how == "removed":
        shutil.rmtree(bench.out, ignore_errors=True)
    else:
        bench.out.rename(bench.desk / "moved")
    message = tools.message(tools.ended(child), "CaptureError")
    assert bench.stage.device.dark
    assert str(bench.out) in message
    assert "found the file or its folder is gone" in message
    assert "Was the folder removed, renamed or unplugged?" in message
    assert "The photographs are still on the cameras." in message
    cards = [
        len(list(bench.stage.cameras.folder(c.id).glob("card/*"))) for c in bench.stage.rig.cameras
    ]
    assert min(cards) >= 3
    # It is not made again behind the operator's back.
    assert not (bench.out / "journal.jsonl").exists()
    if how == "renamed":
        (bench.desk / "moved").rename(bench.out)
        done = bench.run(resume=True)
        assert done.returncode == 0, done.stderr
        bench.require_whole()
