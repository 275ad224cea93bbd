"""A session's life on disk: nothing half-written, nothing overwritten, nothing unverified."""

import hashlib
import json
import os

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.errors import CaptureError, ConfigError, FormatError
from lightstage.formats.files import write_json
from lightstage.formats.session import load_session
from lightstage.session import (
    Journal,
    SessionWriter,
    check_pseudonym,
    read_colour,
    read_journal,
    session_from_journal,
)


@pytest.fixture
def writer(tmp_path, small_rig):
    made = SessionWriter(tmp_path / "S", small_rig, ["full", "x+"], "p1", "neutral", {"extra": 3})
    yield made
    made.close()


def sha(data):
    return hashlib.sha256(data).hexdigest()


def fill(writer, dng, patterns=("full", "x+")):
    for pattern in patterns:
        for index in (2, 0, 1):
            data = dng(1000, seed=index)
            writer.keep(pattern, f"cam{index}", data, sha(data))
        writer.shot(pattern, [1.0] * 8)


def test_a_finished_session_reads_back_in_the_rigs_order(writer, dng):
    fill(writer, dng)
    writer.finish()
    session = load_session(writer.root)
    assert [(f.pattern, f.camera) for f in session.file.frames] == [
        (p, c) for p in ("full", "x+") for c in ("cam0", "cam1", "cam2")
    ]
    assert session.levels("x+").tolist() == [1.0] * 8
    assert session.file.subject == "p1"
    events = read_journal(writer.root / "journal.jsonl")
    assert events[0]["extra"] == 3
    assert events[-1] == events[-1] | {"event": "end", "frames": 6}


def test_a_photograph_that_reads_back_differently_is_not_kept(writer, dng):
    data = dng(1000)
    with pytest.raises(CaptureError, match=r"full by cam0, sha256: found .* on the disk"):
        writer.keep("full", "cam0", data, sha(data + b"x"))
    assert list((writer.root / "frames").rglob("*.dng")) == []
    assert list(writer.root.rglob(".*")) == []
    assert len(read_journal(writer.root / "journal.jsonl")) == 1


def test_a_photograph_is_never_overwritten(writer, dng):
    first, second = dng(1000), dng(2000)
    path = writer.keep("full", "cam0", first, sha(first))
    with pytest.raises(CaptureError, match="a photograph of this name"):
        writer.keep("full", "cam0", second, sha(second))
    assert path.read_bytes() == first
    assert list(path.parent.iterdir()) == [path]


def test_a_truncated_photograph_is_not_kept(writer, dng):
    data = dng(1000)[:-100]
    with pytest.raises(FormatError, match=r"full by cam0: found \d+ bytes, expected picture data"):
        writer.keep("full", "cam0", data, sha(data))
    assert not (writer.root / "frames").exists()


def test_a_session_is_not_finished_before_all_its_shots_are(writer, dng):
    fill(writer, dng, ["full"])
    with pytest.raises(FormatError, match=r"no finished shot of x\+"):
        writer.finish()
    assert not (writer.root / "session.json").exists()


def test_a_folder_with_something_in_it_is_refused(tmp_path, small_rig):
    (tmp_path / "S").mkdir()
    (tmp_path / "S" / "a").write_text("x")
    with pytest.raises(CaptureError, match="something there already"):
        SessionWriter(tmp_path / "S", small_rig, ["full"], "p1", "neutral", {})
    assert os.listdir(tmp_path / "S") == ["a"]


@pytest.mark.parametrize("cut", range(1, 40, 3))
def test_a_journal_cut_in_its_last_line_is_read_up_to_it(writer, dng, cut):
    fill(writer, dng, ["full"])
    path = writer.root / "journal.jsonl"
    whole = read_journal(path)
    path.write_bytes(path.read_bytes()[:-cut])
    assert read_journal(path) == whole[: len(whole) - (cut > 1)]


def test_a_journal_damaged_in_the_middle_is_refused(writer, dng):
    fill(writer, dng, ["full"])
    path = writer.root / "journal.jsonl"
    lines = path.read_bytes().split(b"\n")
    lines[2] = lines[2][:20]
    path.write_bytes(b"\n".join(lines))
    with pytest.raises(FormatError, match="line 3"):
        read_journal(path)


def test_a_journal_of_a_newer_version_or_none_is_refused(tmp_path):
    path = tmp_path / "journal.jsonl"
    with pytest.raises(FormatError, match="no such file"):
        read_journal(path)
    path.write_text(json.dumps({"event": "begin", "schema": "lightstage.journal/2"}) + "\n")
    with pytest.raises(FormatError, match="newer version"):
        read_journal(path)
    path.write_text('{"event": "frame"}\n')
    with pytest.raises(FormatError, match="begin"):
        session_from_journal(path)


def test_a_journal_is_never_opened_twice_and_refuses_lines_after_its_end(tmp_path):
    journal = Journal(tmp_path / "j")
    with pytest.raises(FileExistsError):
        Journal(tmp_path / "j")
    journal.close()
    journal.close()
    with pytest.raises(CaptureError, match="closed"):
        journal.write("late")


@pytest.mark.parametrize("text", ["subject-1", "P 07", "lps", "person_3.b", "Ω7"])
def test_pseudonyms_are_taken(text):
    assert check_pseudonym(text, "subject") == text


@pytest.mark.parametrize("text", ["", "a/b", "a\\b", "me@home.org", "a\nb", " a", "..", "x" * 65])
def test_what_may_name_a_person_or_a_path_is_refused(text):
    with pytest.raises(ConfigError, match="--subject"):
        check_pseudonym(text, "subject")


@given(st.text(max_size=80))
def test_no_accepted_pseudonym_holds_a_separator_an_at_or_a_control(text):
    try:
        check_pseudonym(text, "subject")
    except ConfigError:
        return
    assert not set(text) & set("/\\@:;\0\n\r\t\x7f")
    assert text.isprintable()


def colour(matrix):
    cameras = {f"cam{i}": {"linear_from_raw": matrix} for i in range(3)}
    return {"schema": "lightstage.colour/1", "cameras": cameras}


def test_a_colour_calibration_goes_into_the_session(writer, dng, tmp_path, small_rig):
    path = write_json(tmp_path / "colour.json", colour(np.eye(3).tolist()))
    writer.add_colour(read_colour(path, small_rig))
    fill(writer, dng)
    writer.finish()
    assert load_session(writer.root).file.calibration.colour == "calibration/colour.json"
    assert (writer.root / "calibration" / "colour.json").is_file()


@pytest.mark.parametrize("matrix", [None, [[1, 0, 0]], [[1, 0], [0, 1], [0, 0]], [["a"] * 3] * 3])
def test_a_colour_calibration_without_a_matrix_for_each_camera_is_refused(
    tmp_path, small_rig, matrix
):
    path = write_json(tmp_path / "colour.json", colour(matrix))
    with pytest.raises(FormatError, match=r"cameras\.cam0\.linear_from_raw"):
        read_colour(path, small_rig)
