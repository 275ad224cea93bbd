"""The manifest: everything a session is of, nothing of whose machine or person it was."""

import getpass
import json
import os
import platform
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.cameras.camera import CardFile
from lightstage.errors import FormatError
from lightstage.findings import Finding
from lightstage.formats.files import sha256_file
from lightstage.session import SessionPlan, SessionWriter
from lightstage.session.manifest import _light_figures, _plain, check_manifest, write_manifest

TOLD = {
    "serial": "600",
    "model": "Nikon DSC D750",
    "firmware": "1.15",
    "mode": "M",
    "iso": "100",
    "owner": "Ann Person",
    "artist": "Ann Person",
    "place": "51.5 N",
    "battery_percent": 80.0,
}
FACTS = {
    "version": "0.1.0",
    "led_device": {"firmware": "fw 7", "light_count": 8, "acknowledged": True},
    "told": {"cam0": TOLD, "cam1": {**TOLD, "serial": "601"}},
    "not_verifiable": {"cam0": ["focus"], "cam1": ["focus"]},
    "config": {"camera_deadline_s": 30.0, "log": "/home/ann/logs/x.txt"},
}
CHECKED = {"worst_flashes_per_s": 2.5}


@pytest.fixture
def session(tmp_path, small_rig, fill):
    """A finished session with its manifest."""
    levels = {name: [1.0] * 8 for name in ("full", "x+")}
    plan = SessionPlan(("full", "x+"), "p1", "neutral", levels, "C-17")
    writer = SessionWriter.new(tmp_path / "S", small_rig, plan, facts=FACTS)
    fill(writer)
    writer.finding(Finding("warn", "pulses-unknown", "LED device", "no frequency", "one"))
    writer.finding(Finding("note", "told-now", "camera cam0, iso", "100", "as before"))
    writer.finish()
    write_manifest(writer.root, {"safety": CHECKED, "calibration_shots": "/data/calib/2026/a"})
    writer.end()
    writer.close()
    return writer.root


def manifest(root):
    return json.loads((root / "manifest.json").read_text())


def test_it_holds_versions_devices_hashes_and_settings(session):
    found = manifest(session)
    assert found["schema"] == "lightstage.manifest/1"
    assert (found["subject"], found["consent"]) == ("p1", "C-17")
    assert found["software"]["python"] == platform.python_version()
    assert found["software"]["numpy"]
    assert found["software"]["libgphoto2"].startswith("2.")
    assert found["cameras"]["cam1"]["serial"] == "601"
    assert found["cameras"]["cam0"]["firmware"] == "1.15"
    assert found["leds"]["firmware"] == "fw 7"
    assert found["not_verifiable"] == {"cam0": ["focus"], "cam1": ["focus"]}
    assert found["facts"]["safety"] == CHECKED
    assert found["configuration"]["camera_deadline_s"] == 30.0
    assert (found["unacknowledged"], found["resumed"]) == ([], 0)
    assert found["light"]["lit"] == 2
    assert found["warnings"] == {"pulses-unknown": 1}
    frames = [name for name in found["files"] if name.startswith("frames/")]
    assert len(frames) == 6
    for name, sha256 in found["files"].items():
        assert sha256_file(session / name) == sha256
    assert {"rig.json", "session.json"} < set(found["files"])


def test_a_whole_session_agrees_with_its_manifest(session):
    assert check_manifest(session) == []


def test_its_part_of_the_journal_ends_with_the_named_line(session):
    stated = manifest(session)["journal"]
    data = (session / "journal.jsonl").read_bytes()
    last = json.loads(data[: stated["bytes"]].splitlines()[-1])
    assert last["id"] == stated["last_id"]
    # Only the session's end is written after it.
    assert [json.loads(line)["event"] for line in data[stated["bytes"] :].splitlines()] == ["end"]


def change(path, data=b"x"):
    path.write_bytes(path.read_bytes()[:-1] + data)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda s: change(s / "frames/full/cam1.dng"), "frames/full/cam1.dng: found sha256"),
        (lambda s: (s / "frames/x+/cam2.dng").unlink(), "cam2.dng: found no such file"),
        (lambda s: change(s / "session.json", b" "), "session.json: found sha256"),
        (lambda s: change(s / "rig.json", b" "), "rig.json: found sha256"),
        (lambda s: (s / "frames/full/cam9.dng").write_bytes(b"x"), "cam9.dng: found a file"),
        (
            lambda s: (s / "journal.jsonl").write_bytes(
                (s / "journal.jsonl").read_bytes().replace(b'"p1"', b'"p2"')
            ),
            "journal.jsonl: found another beginning",
        ),
        (lambda s: (s / "journal.jsonl").unlink(), "journal.jsonl: found no journal"),
        (lambda s: (s / "manifest.json").write_text("{"), "a readable JSON file"),
        (lambda s: (s / "manifest.json").write_text("[]"), "schema"),
        (lambda s: (s / "manifest.json").unlink(), "expected the manifest"),
    ],
)
def test_each_change_is_one_clear_problem(session, spoil, message):
    spoil(session)
    (problem,) = check_manifest(session)
    assert isinstance(problem, FormatError)
    assert message in str(problem)


def test_all_changes_are_reported_at_once(session):
    change(session / "frames/full/cam0.dng")
    (session / "frames/full/cam1.dng").unlink()
    change(session / "rig.json", b" ")
    assert len(check_manifest(session)) == 3


def test_hashes_taken_just_now_are_not_taken_again(session):
    files = manifest(session)["files"]
    change(session / "frames/full/cam0.dng")
    assert check_manifest(session, files) == []
    assert len(check_manifest(session, {**files, "frames/x+/cam0.dng": "0" * 64})) == 1


@pytest.mark.parametrize("name", ["/etc/passwd", "../outside", "frames/../../outside"])
def test_a_path_out_of_the_session_is_not_followed(session, name):
    found = manifest(session)
    found["files"][name] = "0" * 64
    (session / "manifest.json").write_text(json.dumps(found))
    (problem,) = check_manifest(session)
    assert "a relative path that stays inside the folder" in str(problem)


def damaged():
    journal = {"bytes": 1e300, "last_id": 1, "sha256": ""}
    broken = st.sampled_from(
        [None, 7, "x", [], {}, {"bytes": "x"}, {"a": None}, -1, 1e300, journal]
    )
    names = st.sampled_from(["files", "journal", "light_map_sha256", "session"])
    return st.dictionaries(names, broken, min_size=1)


@given(damaged())
def test_a_damaged_manifest_is_told_not_crashed_on(scratch, fields):
    (scratch / "manifest.json").write_text(
        json.dumps({"schema": "lightstage.manifest/1", "files": {}, **fields})
    )
    assert check_manifest(scratch)


@pytest.fixture(scope="module")
def scratch(tmp_path_factory):
    return tmp_path_factory.mktemp("manifest")


def test_an_imported_or_unfinished_session_needs_none(tmp_path, writer, fill):
    fill(writer)
    writer.finish()
    writer.end()
    assert check_manifest(writer.root) == []
    (tmp_path / "elsewhere").mkdir()
    assert check_manifest(tmp_path / "elsewhere") == []


def test_takes_that_do_not_count_and_recovered_files_are_in_it(
    tmp_path, small_rig, plan, fill, keep, dng, memory_camera
):
    writer = SessionWriter.new(tmp_path / "S", small_rig, plan, facts=FACTS)
    fill(writer)
    writer.rejected("full", "cam0", "blurred")
    writer.trigger("full", {"cam0": 2})
    data = dng(1000, seed=99)
    writer.exposed("full", 2, "cam0", CardFile("DSC_9.DNG", len(data)))
    keep(writer, "full", "cam0", data, 2)
    writer.shot("full")
    camera = memory_camera("cam1")
    writer.recover(camera, camera.expose(dng(1000, seed=98)), "full", "no light is certain")
    writer.finish()
    write_manifest(writer.root)
    writer.end()
    writer.close()
    names = set(manifest(writer.root)["files"])
    assert {"frames/full/cam0.dng", "frames/full/cam0.take2.dng"} < names
    assert any(name.startswith("recovered/cam1/") for name in names)
    assert check_manifest(writer.root) == []


def test_unacknowledged_light_is_named(tmp_path, small_rig, plan, fill):
    writer = SessionWriter.new(tmp_path / "S", small_rig, plan, facts=FACTS)
    fill(writer)
    writer.lit("x+", [1.0] * 8, acknowledged=False)
    writer.finish()
    write_manifest(writer.root)
    writer.close()
    assert manifest(writer.root)["unacknowledged"] == ["x+"]


def test_how_often_the_light_changed_is_reported_as_it_was_journaled():
    times = {"begin": [0.0, 0.4, 0.9, 2.5], "resume": [0.1, 0.6, 0.95, 1.05]}
    lines = []
    for event, lit in times.items():
        lines.append({"event": event, "elapsed_s": 0.0})
        lines += [{"event": "lit", "elapsed_s": each} for each in lit]
    figures = _light_figures(lines)
    assert figures["lit"] == 8
    assert figures["shortest_interval_s"] == pytest.approx(0.1)
    assert figures["most_in_one_second"] == 4
    assert _light_figures(lines[:1]) == {
        "lit": 0,
        "shortest_interval_s": None,
        "most_in_one_second": 0,
    }


def test_it_is_written_again_when_a_session_is_gone_on_with(session):
    before = (session / "manifest.json").read_bytes()
    write_manifest(session)
    after = manifest(session)
    assert after["journal"]["last_id"] > json.loads(before)["journal"]["last_id"]
    assert check_manifest(session) == []


def test_neither_person_nor_machine_nor_path_is_in_it(session):
    text = (session / "manifest.json").read_text()
    for word in ("Ann", "51.5", "/home", "/data", str(session), str(Path.home())):
        assert word not in text, word
    stated = {json.dumps(each) for each in (platform.node(), getpass.getuser())}
    assert not stated & {json.dumps(value) for value in values(json.loads(text))}


def values(tree):
    """Every text in a JSON value, keys too."""
    if isinstance(tree, dict):
        for key, value in tree.items():
            yield key
            yield from values(value)
    elif isinstance(tree, list):
        for value in tree:
            yield from values(value)
    elif isinstance(tree, str):
        yield tree


def test_a_telling_user_host_and_folder_leave_no_trace(session, tmp_path):
    """In a process whose user, host name and home say who it is."""
    script = (
        "import os, platform, sys, pathlib, socket\n"
        "name = lambda *_: 'annpersonhost'\n"
        "platform.node = socket.gethostname = socket.getfqdn = name\n"
        "from lightstage.session.manifest import write_manifest\n"
        "write_manifest(pathlib.Path(sys.argv[1]), {'cameras_file': pathlib.Path(sys.argv[1])})\n"
    )
    home = tmp_path / "annpersonhome"
    home.mkdir()
    moved = home / "annpersonfolder"
    session.rename(moved)
    env = {**os.environ, "HOME": str(home), "USER": "annpersonuser", "LOGNAME": "annpersonuser"}
    env |= {"HOSTNAME": "annpersonhost"}
    subprocess.run([sys.executable, "-c", script, str(moved)], env=env, check=True, timeout=60)
    assert "annperson" not in (moved / "manifest.json").read_text()
    assert check_manifest(moved) == []


def test_no_fact_can_keep_the_manifest_from_being_written():
    facts = {
        "nan": float("nan"),
        "inf": [float("inf"), np.float64("nan"), np.float32(0.5), np.int64(3), np.array([1, 2])],
        7: {True},
        "finding": Finding("warn", "x", "/srv/a/b", "1", "2"),
        "path": Path("/srv/a"),
        "odd": object,
    }
    plain = json.loads(json.dumps(_plain(facts), allow_nan=False))
    assert plain["nan"] is None
    assert plain["inf"] == [None, None, 0.5, 3, [1, 2]]
    assert plain["7"] == [True]
    assert plain["finding"]["where"] == plain["path"] == "(path)"


@pytest.mark.parametrize(
    "text",
    ["/home/ann/x", "in /tmp/a b", "serial:///dev/ttyUSB0?baud=9", "C:\\Users\\ann", "~/photos",
     "file:///srv/x", "'/srv/x/y'", "\\\\server\\share", "(/home/ann)"],
)  # fmt: skip
def test_absolute_paths_are_replaced_wherever_they_stand(text):
    cleaned = _plain({"a": [text]})["a"][0]
    assert "(path)" in cleaned
    assert not any(part in cleaned for part in ("ann", "dev", "srv", "tmp", "server", "photos"))


@pytest.mark.parametrize(
    "text",
    ["1/60", "f/8", "frames/x+/cam0.dng", "lightstage.manifest/1", "and/or", "a / b", "", "/"],
)
def test_what_is_no_absolute_path_stays(text):
    assert _plain({text: [text]}) == {text: [text]}
