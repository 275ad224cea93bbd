"""What a session owes to the person in it: consent that is recorded, files that stay private."""

import json
import os
import stat
import subprocess
import sys

import pytest

from tests.lightstage.capture.test_command import one_clear_message, run


@pytest.fixture
def open_umask():
    """A user's umask under which everything is open to everybody."""
    before = os.umask(0)
    yield
    os.umask(before)


def config(tmp_path, text):
    path = tmp_path / "config.toml"
    path.write_text(text)
    return str(path)


def modes(root):
    """Permissions of a folder and all in it: of folders, and of files."""
    folders, files = set(), set()
    for path in (root, *root.rglob("*")):
        mode = stat.S_IMODE(path.stat().st_mode)
        (folders if path.is_dir() else files).add(oct(mode))
    return folders, files


def test_a_capture_without_consent_says_so_wherever_it_is_looked_for(stage, tmp_path):
    out = tmp_path / "S"
    done = run(stage, out, "--sequence", "full", "--json")
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("no record of this person's consent") == 1
    facts = json.loads(done.stdout.splitlines()[-1])
    assert facts["consent"] is None
    lines = [json.loads(line) for line in (out / "journal.jsonl").read_text().splitlines()]
    codes = [line.get("code") for line in lines]
    assert lines[0]["consent"] is None
    assert codes.count("no-consent") == 1
    assert codes.index("no-consent") < [line["event"] for line in lines].index("lit")
    assert json.loads((out / "session.json").read_text())["consent"] is None
    manifest = json.loads((out / "manifest.json").read_text())
    assert (manifest["consent"], manifest["warnings"]["no-consent"]) == (None, 1)


def test_a_lab_that_requires_consent_lights_nothing_without_it(stage, tmp_path):
    out = tmp_path / "S"
    required = config(tmp_path, "[session]\nrequire_consent = true\n")
    done = run(stage, out, "--sequence", "full", "--config", required)
    one_clear_message(done, "--consent: found no id", "require_consent = true")
    assert not out.exists()
    assert stage.device.dark
    done = run(stage, out, "--sequence", "full", "--config", required, "--consent", "C-17")
    assert done.returncode == 0, done.stderr
    assert "consent" not in done.stderr
    assert json.loads((out / "session.json").read_text())["consent"] == "C-17"


def test_a_captured_face_is_nobody_elses_whatever_the_umask(stage, tmp_path, open_umask):
    out = tmp_path / "S"
    out.mkdir()  # open to everybody before the session
    done = run(stage, out, "--sequence", "full")
    assert done.returncode == 0, done.stderr
    assert modes(out) == ({"0o700"}, {"0o600"})


@pytest.mark.parametrize(
    ("group", "folder", "file"), [("read", "0o750", "0o640"), ("write", "0o770", "0o660")]
)
def test_a_lab_may_open_its_sessions_to_its_group(stage, tmp_path, group, folder, file):
    out = tmp_path / "S"
    opened = config(tmp_path, f'[session]\ngroup = "{group}"\n')
    done = run(stage, out, "--sequence", "full", "--config", opened)
    assert done.returncode == 0, done.stderr
    assert modes(out) == ({folder}, {file})


def test_the_sequence_olat_is_of_the_lights_of_the_rig_that_is_given(stage, tmp_path):
    run(stage, tmp_path / "S", "--sequence", "olat")  # this stage's single lights are too dim
    begin = json.loads((tmp_path / "S" / "journal.jsonl").read_text().splitlines()[0])
    assert begin["sequence"] == [f"olat-{light.id:03d}" for light in stage.rig.lights]


def test_a_session_that_is_gone_on_with_is_not_opened_wider(stage, tmp_path, open_umask):
    out = tmp_path / "S"
    show = stage.device.on_state

    def lose(levels):
        show(levels)
        if levels.any():
            stage.seeds[1].unlink(missing_ok=True)

    stage.device.on_state = lose
    assert run(stage, out, "--sequence", "full").returncode == 2
    assert modes(out) == ({"0o700"}, {"0o600"})
    stage.device.on_state = show
    stage.seeds[1].write_bytes(stage.seeds[0].read_bytes())
    opened = config(tmp_path, '[session]\ngroup = "write"\n')
    done = subprocess.run(
        [sys.executable, "-m", "lightstage", "capture", "--resume", "--out", str(out),
         "--leds", stage.device.url, "--cameras", str(stage.cameras_path), "--config", opened],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert modes(out) == ({"0o700"}, {"0o600"})
