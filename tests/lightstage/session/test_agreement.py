"""A session's files beside each other: what was changed is told by those that were not."""

import json
import stat
import subprocess
import sys

import pytest

from lightstage.errors import FormatError, LightstageError
from lightstage.findings import Finding
from lightstage.formats.files import sha256_file, write_json
from lightstage.formats.session import load_session
from lightstage.session import (
    SessionPlan,
    SessionWriter,
    accepted_findings,
    disagreements,
    read_journal,
    whole_session,
)
from lightstage.session.manifest import check_manifest, write_manifest

pytestmark = pytest.mark.usefixtures("forked")

FAULT = Finding("retake", "blur", "x+ by cam1", "blur", "sharp", pattern="x+", camera="cam1")
OF_ALL = Finding("retake", "sum", "pattern x+", "too dark", "a sum", pattern="x+")


@pytest.fixture
def session(tmp_path, small_rig, fill):
    """A finished session of two patterns by three cameras."""
    levels = {name: [1.0] * 8 for name in ("full", "x+")}
    plan = SessionPlan(("full", "x+"), "p1", "neutral", levels, "C-17")
    facts = {"led_device": {"firmware": "fw 7"}, "config": {}}
    writer = SessionWriter.new(tmp_path / "S", small_rig, plan, facts=facts)
    fill(writer)
    writer.finish()
    write_manifest(writer.root)
    writer.end()
    writer.close()
    return writer.root


def problems_of(root):
    return "\n".join(map(str, disagreements(root, load_session(root).file)))


def edit(path, change):
    value = json.loads(path.read_text())
    change(value)
    write_json(path, value)


def swap(root):
    """Exchange two photographs' files, and their hashes in session.json and the manifest."""
    one, two = root / "frames/full/cam0.dng", root / "frames/full/cam1.dng"
    first, second = one.read_bytes(), two.read_bytes()
    one.write_bytes(second)
    two.write_bytes(first)

    def rehash(value):
        for frame in value["frames"]:
            frame["sha256"] = sha256_file(root / frame["path"])

    edit(root / "session.json", rehash)
    edit(
        root / "manifest.json",
        lambda value: value["files"].update(
            {name: sha256_file(root / name) for name in value["files"]}
        ),
    )


def test_a_whole_session_agrees_with_its_journal(session):
    assert problems_of(session) == ""


def test_two_swapped_frames_are_reported_by_the_journal_though_all_hashes_were_changed_along(
    session,
):
    swap(session)
    assert check_manifest(session) == []
    text = problems_of(session)
    assert "frame full by cam0, sha256: found" in text
    assert "frame full by cam1, sha256: found" in text
    assert "(journal.jsonl)" in text


@pytest.mark.parametrize("name", ["subject", "consent", "id", "expression", "created_utc"])
def test_another_person_or_consent_in_session_json_is_reported_by_the_journal(session, name):
    edit(session / "session.json", lambda value: value.update({name: "C-99"}))
    assert f"session.json, {name}: found 'C-99', expected" in problems_of(session)


@pytest.mark.parametrize("name", ["subject", "consent", "session", "expression"])
def test_a_manifest_of_another_session_or_person_is_an_error(session, name):
    edit(session / "manifest.json", lambda value: value.update({name: "C-99"}))
    (problem,) = check_manifest(session)
    assert f"manifest.json, {name}: found 'C-99', expected" in str(problem)


def test_a_manifest_from_which_session_json_was_left_out_is_an_error(session):
    edit(session / "manifest.json", lambda value: value["files"].pop("session.json"))
    (problem,) = check_manifest(session)
    assert "found no hash of session.json" in str(problem)


def test_a_line_that_was_removed_from_the_journal_is_an_error(session):
    path = session / "journal.jsonl"
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(lines[:2] + lines[3:]))
    assert "after id 2: found id 4, expected 3" in problems_of(session)


def test_a_journal_without_its_end_is_an_error(session):
    path = session / "journal.jsonl"
    path.write_bytes(b"".join(path.read_bytes().splitlines(keepends=True)[:-1]))
    assert check_manifest(session) == []
    assert "found shot as its last line, expected end" in problems_of(session)


def test_a_journal_that_was_cut_is_distinguished_from_one_that_was_edited(session):
    path = session / "journal.jsonl"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    assert any("bytes, cut" in str(problem) for problem in check_manifest(session))


def test_another_rig_than_the_journals_is_an_error(session):
    edit(session / "rig.json", lambda value: value["cameras"][0].update({"serial": "999"}))
    assert "rig.json: found another rig" in problems_of(session)


def test_a_finished_session_is_whole_only_after_a_look_at_the_disk(session):
    assert whole_session(session) == (6, [])
    photograph = session / "frames/x+/cam2.dng"
    data = photograph.read_bytes()
    photograph.write_bytes(data[:-1] + b"x")
    assert whole_session(session) is None
    photograph.unlink()
    assert whole_session(session) is None


def test_a_finished_session_with_an_edited_journal_is_refused_not_mended(session):
    path = session / "journal.jsonl"
    path.write_bytes(path.read_bytes().replace(b'"p1"', b'"p2"'))
    with pytest.raises(LightstageError, match=r"journal.jsonl: found another beginning"):
        whole_session(session)


def resumed(session):
    """`capture --resume` where there is no device."""
    return subprocess.run(
        [
            *(sys.executable, "-m", "lightstage", "capture", "--resume", "--out", str(session)),
            *("--leds", "serial:///dev/none", "--cameras", "none.toml"),
        ],
        capture_output=True,
        text=True,
        timeout=60,
    )


def test_resume_of_a_finished_session_reports_that_it_is_whole_and_opens_no_device(session):
    before = {path: path.read_bytes() for path in session.rglob("*") if path.is_file()}
    done = resumed(session)
    assert done.returncode == 0, done.stderr
    assert "finished and whole, 6 photographs read back" in done.stdout
    assert before == {path: path.read_bytes() for path in session.rglob("*") if path.is_file()}


@pytest.mark.parametrize(
    "lost", [("session.json",), ("manifest.json",), ("session.json", "manifest.json")]
)
def test_resume_writes_lost_records_again_and_opens_no_device(session, lost):
    session.chmod(0o700)
    before = {name: (session / name).read_bytes() for name in lost}
    journal = (session / "journal.jsonl").read_bytes()
    for name in lost:
        (session / name).unlink()
    done = resumed(session)
    assert done.returncode == 0, done.stderr
    assert f"{' and '.join(lost)} written again" in done.stdout
    assert whole_session(session) == (6, [])
    assert (session / "journal.jsonl").read_bytes() == journal
    for name in lost:
        assert stat.S_IMODE((session / name).stat().st_mode) == 0o600
        if name == "session.json":
            assert (session / name).read_bytes() == before[name]
        else:
            again, was = json.loads((session / name).read_bytes()), json.loads(before[name])
            assert again["files"] == was["files"]
            assert again["journal"]["bytes"] == len(journal)


def test_records_are_not_written_again_where_a_photograph_is_lost_too(session):
    (session / "session.json").unlink()
    (session / "frames/full/cam0.dng").unlink()
    assert resumed(session).returncode == 2
    assert not (session / "session.json").exists()


def test_accepted_findings_stand_in_session_json_and_manifest(writer, fill):
    fill(writer)
    writer.accept("x+", [FAULT, OF_ALL])
    writer.finish()
    write_manifest(writer.root)
    for name in ("session.json", "manifest.json"):
        accepted = json.loads((writer.root / name).read_text())["accepted"]
        assert [each["code"] for each in accepted["x+"]] == ["blur", "sum"]
    assert problems_of(writer.root) == ""
    edit(writer.root / "session.json", lambda value: value.pop("accepted"))
    assert "session.json, accepted: found None" in problems_of(writer.root)


def test_what_was_accepted_holds_no_more_when_the_photograph_is_taken_again(writer, fill):
    fill(writer)
    writer.accept("x+", [FAULT, OF_ALL, FAULT])
    writer.rejected("x+", "cam0", "again")
    path = writer.journal.path
    assert [each["code"] for each in accepted_findings(read_journal(path))["x+"]] == ["blur"]
    writer.rejected("x+", "cam1", "again")
    assert accepted_findings(read_journal(path)) == {}


def test_a_journal_whose_accepted_findings_are_none_is_refused(session):
    path = session / "journal.jsonl"
    lines = path.read_text().splitlines()
    lines[-1] = json.dumps(
        {**json.loads(lines[-1]), "event": "accepted", "pattern": "x+", "findings": [3]}
    )
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(FormatError, match="findings: found"):
        read_journal(path)
