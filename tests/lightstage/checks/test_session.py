"""`lightstage check`: a good session passes, each damage is named, all in one message."""

import hashlib
import json
import re

import numpy as np
import pytest

from lightstage.cameras.camera import CardFile
from lightstage.checks import check_session
from lightstage.day import seen_session
from lightstage.errors import FormatError
from lightstage.formats.exr import write_exr
from lightstage.formats.files import sha256_file, write_json
from lightstage.patterns import pattern_levels
from lightstage.session import SessionPlan, SessionWriter
from lightstage.session.manifest import write_manifest
from tests.programs import run_program

PATTERNS = ["full", "x+", "x-"]


@pytest.fixture
def session(tmp_path, small_rig, dng):
    root = tmp_path / "S"
    writer = SessionWriter.new(root, small_rig, SessionPlan(tuple(PATTERNS), "p1"))
    for shot, pattern in enumerate(PATTERNS):
        levels = pattern_levels(pattern, small_rig)
        for index, camera in enumerate(small_rig.cameras):
            data = dng(512 + int(4000 * levels.mean()), seed=10 * shot + index)
            incoming = writer.incoming(pattern, camera.id, 1)
            incoming.write_bytes(data)
            file = CardFile("DSC", len(data))
            writer.keep(pattern, camera.id, 1, incoming, file, hashlib.sha256(data).hexdigest())
        writer.shot(pattern, levels=levels.tolist())
    writer.finish()
    writer.close()
    return root


def rehash(root, relative):
    """Pretend that a file was so from the beginning."""
    value = json.loads((root / "session.json").read_text())
    for frame in value["frames"]:
        if frame["path"] == relative:
            frame["sha256"] = sha256_file(root / relative)
    write_json(root / "session.json", value)


def test_a_good_session_passes(session):
    report = check_session(session)
    assert (report.frames, report.sums) == (9, 3)
    assert report.worst_sum < 0.01
    assert report.clipped == 0


def test_missing_truncated_changed_and_misnamed_frames_make_one_message(session):
    (session / "frames/full/cam0.dng").unlink()
    cut = session / "frames/x+/cam1.dng"
    cut.write_bytes(cut.read_bytes()[:-50])
    changed = session / "frames/x-/cam2.dng"
    data = bytearray(changed.read_bytes())
    data[-1] ^= 1
    changed.write_bytes(data)
    done = run_program("lightstage", "check", session)
    assert done.code == 2
    assert "Traceback" not in done.err
    assert "3 problems" in done.err
    assert f"{session}/frames/full/cam0.dng: found no such file, expected" in done.err
    assert "frames/x+/cam1.dng, sha256: found" in done.err
    assert "frames/x-/cam2.dng, sha256: found" in done.err


def test_a_frame_truncated_before_it_was_hashed_is_found_by_its_header(session):
    cut = session / "frames/x+/cam1.dng"
    cut.write_bytes(cut.read_bytes()[:-50])
    rehash(session, "frames/x+/cam1.dng")
    with pytest.raises(FormatError, match=r"x\+/cam1.dng: found \d+ bytes, expected picture data"):
        check_session(session)


def test_a_frame_of_another_size_is_found(session, dng):
    (session / "frames/x+/cam1.dng").write_bytes(dng(2512, width=48, height=32))
    rehash(session, "frames/x+/cam1.dng")
    with pytest.raises(FormatError, match=r"found 48 x 32 pixels, expected 32 x 48 \(rig.json"):
        check_session(session)


def test_a_photograph_under_another_light_than_recorded_is_found(session, dng):
    (session / "frames/x+/cam1.dng").write_bytes(dng(512))
    rehash(session, "frames/x+/cam1.dng")
    with pytest.raises(FormatError, match=r"patterns of cam1: found x\+ \+ x- = .* full = "):
        check_session(session)


def test_one_photograph_for_two_patterns_is_found(session):
    data = (session / "frames/x+/cam1.dng").read_bytes()
    (session / "frames/x-/cam1.dng").write_bytes(data)
    rehash(session, "frames/x-/cam1.dng")
    with pytest.raises(
        FormatError, match=r"x-/cam1.dng, sha256: found the bytes of frames/x\+/cam1"
    ):
        check_session(session)


def test_an_overexposed_photograph_is_found(session, dng):
    (session / "frames/full/cam1.dng").write_bytes(dng(16383))
    rehash(session, "frames/full/cam1.dng")
    with pytest.raises(FormatError, match=r"exposure: found 100\.0 % of the pixels clipped"):
        check_session(session)


def test_a_raw_that_libraw_does_not_read_is_found(session, dng):
    (session / "frames/full/cam1.dng").write_bytes(dng(1000, width=16, height=16))
    rehash(session, "frames/full/cam1.dng")
    with pytest.raises(FormatError, match=r"full/cam1.dng: found .*LibRaw .* does not know"):
        check_session(session)


def test_a_linear_frame_with_nan_is_found(session):
    image = np.ones((48, 32, 3), np.float32)
    image[3, 4, 1] = np.nan
    path = write_exr(session / "frames/full/cam0.exr", image)
    value = json.loads((session / "session.json").read_text())
    value["frames"][0] |= {"path": "frames/full/cam0.exr", "encoding": "linear"}
    value["frames"][0]["sha256"] = sha256_file(path)
    write_json(session / "session.json", value)
    with pytest.raises(
        FormatError, match=r"cam0.exr, element \(3, 4, 1\): found 1 NaN or infinite value"
    ):
        check_session(session)


def test_an_encoding_that_the_bytes_contradict_is_found(session):
    value = json.loads((session / "session.json").read_text())
    value["frames"][0]["encoding"] = "linear"
    write_json(session / "session.json", value)
    with pytest.raises(FormatError, match=r"encoding: found raw, expected linear"):
        check_session(session)


def test_an_interrupted_capture_is_distinguished_from_no_session(session, tmp_path):
    (session / "session.json").unlink()
    with pytest.raises(FormatError, match=r"interrupted\.\n.*\n  To resume: lightstage capture"):
        check_session(session)
    with pytest.raises(FormatError, match="found no such folder, expected a session folder"):
        check_session(tmp_path / "none")


@pytest.mark.parametrize(
    ("text", "found"), [("", "nothing"), ("2031-05-06 dear diary", "'2031-05-06 dear diary'")]
)
def test_a_journal_that_is_none_of_ours_is_shown_with_what_to_try(session, text, found):
    (session / "journal.jsonl").write_text(text)
    said = rf"line 1: found {found}, expected the event begin .*Restore the journal from a copy"
    with pytest.raises(FormatError, match=said):
        check_session(session)
    assert re.search(said, seen_session(session).said)


def checked(root):
    """The command `check`."""
    return run_program("lightstage", "check", root)


@pytest.mark.parametrize(
    ("lacks", "notes"),
    [
        ((), ["Hashes without"]),
        (("manifest.json",), ["There is no manifest.json", "Hashes without"]),
        (
            ("journal.jsonl", "manifest.json"),
            ["There is no journal.jsonl", "There is no manifest.json", "Hashes without"],
        ),
    ],
)
def test_check_states_what_the_files_that_a_session_has_do_not_prove(session, lacks, notes):
    write_manifest(session)
    for name in lacks:
        (session / name).unlink()
    done = checked(session)
    assert done.code == 0, done.err
    printed = [line for line in done.err.splitlines() if line.startswith("note: ")]
    assert len(printed) == len(notes)
    for line, part in zip(printed, notes, strict=True):
        assert line.startswith(f"note: {part}")
        assert line.endswith((" known.", " noticed."))


@pytest.mark.parametrize(
    "changed_along", [(), ("session.json",), ("session.json", "manifest.json")]
)
def test_check_tells_two_photographs_that_were_exchanged_on_the_disk(session, changed_along):
    write_manifest(session)
    names = ["frames/x+/cam0.dng", "frames/x+/cam1.dng"]
    first, second = ((session / name).read_bytes() for name in names)
    (session / names[0]).write_bytes(second)
    (session / names[1]).write_bytes(first)
    if "session.json" in changed_along:
        for name in names:
            rehash(session, name)
    if "manifest.json" in changed_along:
        value = json.loads((session / "manifest.json").read_text())
        for name in value["files"]:
            value["files"][name] = sha256_file(session / name)
        write_json(session / "manifest.json", value)
    done = checked(session)
    assert done.code == 2
    assert "Traceback" not in done.err
    assert done.out == ""
    for name, camera in zip(names, ("cam0", "cam1"), strict=True):
        stated = (
            f"frame x+ by {camera}, sha256: found" if changed_along else f"{name}, sha256: found"
        )
        assert stated in done.err, done.err
