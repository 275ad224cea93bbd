"""A session's life on disk: nothing half-written, nothing overwritten, nothing unverified."""

import dataclasses
import errno
import json
import os
import shutil

import numpy as np
import pytest

from lightstage.cameras.camera import CardFile
from lightstage.errors import CaptureError, ConfigError, FormatError
from lightstage.formats.files import sha256_file, write_json
from lightstage.formats.session import load_session
from lightstage.rig import save_rig
from lightstage.session import (
    SessionPlan,
    SessionWriter,
    read_colour,
    read_journal,
    session_from_journal,
)


def events(writer):
    return [line["event"] for line in read_journal(writer.root / "journal.jsonl")]


def test_a_finished_session_reads_back_in_the_rigs_order(writer, fill):
    fill(writer)
    writer.finish()
    writer.end(overhead_s=0.5)
    session = load_session(writer.root)
    assert [(f.pattern, f.camera) for f in session.file.frames] == [
        (p, c) for p in ("full", "x+") for c in ("cam0", "cam1", "cam2")
    ]
    assert session.levels("x+").tolist() == [1.0] * 8
    assert session.file.subject == "p1"
    lines = read_journal(writer.root / "journal.jsonl")
    assert lines[0]["extra"] == 3
    assert lines[-1] == lines[-1] | {"event": "end", "frames": 6, "overhead_s": 0.5}


def test_each_frame_says_whether_its_light_was_acknowledged_and_which_take_it_is(
    tmp_path, small_rig, plan, keep, dng
):
    writer = SessionWriter.new(tmp_path / "S", small_rig, plan)
    for pattern, acknowledged in (("full", False), ("x+", True)):
        writer.lit(pattern, [0.5] * 8, acknowledged=acknowledged)
        for index in range(3):
            take = 2 if (pattern, index) == ("x+", 1) else 1
            data = dng(1000, seed=index + 7 * acknowledged)
            writer.exposed(pattern, take, f"cam{index}", CardFile("a", len(data)))
            keep(writer, pattern, f"cam{index}", data, take)
        writer.shot(pattern)
    writer.finish()
    writer.close()
    frames = json.loads((writer.root / "session.json").read_text())["frames"]
    assert [frame["acknowledged"] for frame in frames] == [False] * 3 + [True] * 3
    assert [frame["take"] for frame in frames] == [1, 1, 1, 1, 2, 1]
    assert frames[4]["path"] == "frames/x+/cam1.take2.dng"


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"sha256": "0" * 64}, r"full by cam0, sha256: found .* on the disk"),
        ({"size": 5}, r"full by cam0, size: found \d+ bytes on the disk, expected 5"),
    ],
)
def test_a_photograph_that_reads_back_differently_gets_no_name_and_no_line(
    writer, keep, dng, wrong, message
):
    with pytest.raises(CaptureError, match=message):
        keep(writer, "full", "cam0", dng(1000), **wrong)
    assert list((writer.root / "frames").rglob("*.dng")) == []
    assert events(writer) == ["begin"]


def test_a_photograph_is_never_overwritten(writer, keep, dng):
    first, second = dng(1000), dng(2000)
    path = keep(writer, "full", "cam0", first)
    with pytest.raises(CaptureError, match="a photograph of this name"):
        keep(writer, "full", "cam0", second)
    assert path.read_bytes() == first


@pytest.mark.parametrize("number", [errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS])
def test_on_a_disk_without_hard_links_a_photograph_is_kept_and_never_overwritten(
    writer, keep, dng, monkeypatch, number
):
    def no_links(*_):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "link", no_links)
    first, second = dng(1000), dng(2000)
    path = keep(writer, "full", "cam0", first)
    with pytest.raises(CaptureError, match="a photograph of this name"):
        keep(writer, "full", "cam0", second)
    assert path.read_bytes() == first
    assert sorted(p.name for p in path.parent.iterdir()) == [".cam0.take1.partial", "cam0.dng"]


def test_a_truncated_photograph_is_not_kept(writer, keep, dng):
    with pytest.raises(FormatError, match=r"full by cam0: found \d+ bytes, expected picture data"):
        keep(writer, "full", "cam0", dng(1000)[:-100])
    assert list((writer.root / "frames").rglob("*.dng")) == []
    assert events(writer) == ["begin"]


def test_a_download_asked_for_again_finds_its_place_free(writer, dng):
    writer.incoming("full", "cam0", 1).write_bytes(b"half")
    assert not writer.incoming("full", "cam0", 1).exists()


def test_a_session_is_not_finished_before_all_its_shots_are(writer, fill):
    fill(writer, ["full"])
    with pytest.raises(FormatError, match=r"no finished shot of x\+.*--resume"):
        writer.finish()
    assert not (writer.root / "session.json").exists()


def test_a_shot_is_not_finished_before_all_its_photographs_are_kept(writer, keep, dng):
    keep(writer, "full", "cam1", dng(1000))
    with pytest.raises(CaptureError, match="no photograph by cam0, cam2"):
        writer.shot("full")


def test_a_rejected_take_does_not_count_and_its_file_stays(writer, fill, keep, dng):
    fill(writer)
    writer.rejected("x+", "cam1", "blurred")
    assert writer.state.wanted() == {"x+": ("cam1",)}
    with pytest.raises(FormatError, match=r"no finished shot of x\+"):
        writer.finish()
    assert writer.next_take("x+", "cam1") == 2
    again = keep(writer, "x+", "cam1", dng(1200), take=2)
    assert writer.state.wanted() == {"x+": ()}
    writer.shot("x+")
    writer.finish()
    session = load_session(writer.root)
    assert session.frame_path(session.frame("x+", "cam1")) == again
    assert (again.parent / "cam1.dng").is_file()
    assert len(session.file.frames) == 6
    with pytest.raises(CaptureError, match="no photograph"):
        writer.rejected("full", "cam9", "why")


def test_a_take_whose_name_lies_there_already_is_passed_over(writer):
    (writer.root / "frames" / "full").mkdir(parents=True)
    (writer.root / "frames" / "full" / "cam0.dng").write_text("somebody's")
    assert writer.next_take("full", "cam0") == 2


def test_a_folder_with_something_in_it_is_refused(tmp_path, small_rig, plan):
    (tmp_path / "S").mkdir()
    (tmp_path / "S" / "rig.json").write_text("mine")
    with pytest.raises(CaptureError, match="something there already"):
        SessionWriter.new(tmp_path / "S", small_rig, plan)
    assert (tmp_path / "S" / "rig.json").read_text() == "mine"
    (tmp_path / "F").write_text("a file")
    with pytest.raises(CaptureError, match="something there already"):
        SessionWriter.new(tmp_path / "F", small_rig, plan)


def test_what_a_capture_left_that_never_began_is_no_hindrance(tmp_path, small_rig, plan):
    (tmp_path / "S").mkdir()
    (tmp_path / "S" / ".journal.jsonl.begun").write_text('{"id": 1, "ev')
    save_rig(small_rig, tmp_path / "S" / "rig.json")
    with pytest.raises(FormatError, match="capture without --resume"):
        SessionWriter.resumed(tmp_path / "S")
    SessionWriter.new(tmp_path / "S", small_rig, plan).close()
    assert sorted(os.listdir(tmp_path / "S")) == ["journal.jsonl", "rig.json"]


def test_a_session_goes_on_where_it_was_left(writer, fill, small_rig):
    fill(writer, ["full"])
    with pytest.raises(CaptureError, match="another capture that is writing"):
        SessionWriter.resumed(writer.root, small_rig)
    writer.close()
    again = SessionWriter.resumed(writer.root, small_rig)
    assert again.state.wanted() == {"x+": ("cam0", "cam1", "cam2")}
    with pytest.raises(CaptureError, match="expected first resume"):
        again.note("note")
    again.resume({"cam0": [CardFile("a", 3)]}, {"cam0": "600"})
    fill(again, ["x+"])
    again.finish()
    again.end()
    again.close()
    assert len(load_session(writer.root).file.frames) == 6
    with pytest.raises(CaptureError, match="a session that is finished"):
        SessionWriter.resumed(writer.root)


def test_a_session_of_another_rig_is_not_resumed(writer, small_rig):
    writer.close()
    other = dataclasses.replace(small_rig, cameras=small_rig.cameras[:2])
    with pytest.raises(CaptureError, match="a session of another rig"):
        SessionWriter.resumed(writer.root, other)
    save_rig(other, writer.root / "rig.json")
    with pytest.raises(FormatError, match="another rig than"):
        SessionWriter.resumed(writer.root)


def test_a_removed_folder_a_full_and_a_read_only_disk_are_reported_plainly(
    writer, keep, dng, monkeypatch, tmp_path, small_rig, plan
):
    def refuse(number):
        def refused(*_, **__):
            raise OSError(number, os.strerror(number))

        return refused

    with monkeypatch.context() as patch:
        patch.setattr(os, "link", refuse(errno.ENOSPC))
        with pytest.raises(CaptureError, match="no space left on the disk"):
            keep(writer, "full", "cam0", dng(1000))
    with monkeypatch.context() as patch:
        patch.setattr(os, "open", refuse(errno.EROFS))
        with pytest.raises(CaptureError, match="a disk that can only be read"):
            SessionWriter.new(tmp_path / "T", small_rig, plan)
    shutil.rmtree(writer.root)
    with pytest.raises(CaptureError, match="its folder is gone"):
        keep(writer, "full", "cam0", dng(1000))
    with pytest.raises(CaptureError, match="its folder is gone"):
        writer.note("note")


def test_a_consent_records_id_goes_into_the_session(tmp_path, small_rig, fill):
    plan = SessionPlan(("full",), "p1", "neutral", {}, consent="C-2031.7")
    writer = SessionWriter.new(tmp_path / "S", small_rig, plan)
    fill(writer, ["full"])
    writer.finish()
    writer.close()
    assert json.loads((tmp_path / "S" / "session.json").read_text())["consent"] == "C-2031.7"


@pytest.mark.parametrize("name", ["../x", "a/b", "", ".hidden", "x+.take2", "a b", "x" * 200])
def test_a_name_that_cannot_name_a_file_is_refused_before_anything_is_written(
    tmp_path, small_rig, name
):
    with pytest.raises(ConfigError, match="cannot name a file"):
        SessionWriter.new(tmp_path / "S", small_rig, SessionPlan((name,)))
    assert not (tmp_path / "S").exists()


def test_names_that_differ_in_capitals_only_are_refused(tmp_path, small_rig):
    with pytest.raises(ConfigError, match="differ in more than capitals"):
        SessionWriter.new(tmp_path / "S", small_rig, SessionPlan(("full", "Full")))


def colour(matrix):
    cameras = {f"cam{i}": {"linear_from_raw": matrix} for i in range(3)}
    return {"schema": "lightstage.colour/1", "cameras": cameras}


def test_a_colour_calibration_is_in_the_session_from_its_first_line_on(
    tmp_path, fill, small_rig, plan
):
    path = write_json(tmp_path / "colour.json", colour(np.eye(3).tolist()))
    matrices = read_colour(path, small_rig)
    writer = SessionWriter.new(tmp_path / "S", small_rig, plan, colour=matrices)
    writer.close()
    writer = SessionWriter.resumed(tmp_path / "S")
    writer.resume({}, {})
    fill(writer)
    writer.finish()
    assert load_session(writer.root).file.calibration.colour == "calibration/colour.json"
    assert (writer.root / "calibration" / "colour.json").is_file()
    writer.close()


@pytest.mark.parametrize(
    "matrix", [None, [[1, 0, 0]], [[1, 0], [0, 1], [0, 0]], [["a"] * 3] * 3, [[0, 0, 0]] * 3]
)
def test_a_colour_calibration_without_a_matrix_for_each_camera_is_refused(
    tmp_path, small_rig, matrix
):
    path = write_json(tmp_path / "colour.json", colour(matrix))
    with pytest.raises(FormatError, match="no usable linear_from_raw for cam0"):
        read_colour(path, small_rig)


def test_a_journal_of_version_1_gives_the_same_session_json(tmp_path, small_rig, dng):
    save_rig(small_rig, tmp_path / "rig.json")
    lines = [
        {
            "event": "begin", "schema": "lightstage.journal/1", "id": "abc", "created_utc": "2026",
            "subject": "p1", "expression": "neutral", "sequence": ["full"],
            "cameras": ["cam0", "cam1", "cam2"],
        }
    ]  # fmt: skip
    for index in range(3):
        path = tmp_path / "frames" / "full" / f"cam{index}.dng"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(dng(1000, seed=index))
        frame = {"pattern": "full", "camera": f"cam{index}", "path": f"frames/full/cam{index}.dng"}
        lines.append({"event": "frame", **frame, "sha256": sha256_file(path), "encoding": "raw"})
    lines.append({"event": "shot", "pattern": "full", "levels": [0.25] * 8})
    text = "".join(json.dumps(line) + "\n" for line in lines)
    (tmp_path / "journal.jsonl").write_text(text)
    file = session_from_journal(tmp_path / "journal.jsonl")
    assert (file.id, len(file.frames)) == ("abc", 3)
    assert file.patterns["full"].levels == [0.25] * 8
    with pytest.raises(FormatError, match="older version"):
        SessionWriter.resumed(tmp_path)
