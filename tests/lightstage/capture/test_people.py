"""What a session owes to the person in it: consent that is recorded, files that stay private."""

import json
import os
import stat
import subprocess
import sys

import pytest

from lightstage.errors import ConfigError
from lightstage.preflight import require_known
from lightstage.session.config import SessionConfig
from tests.lightstage.capture.test_command import one_clear_message, run

pytestmark = pytest.mark.usefixtures("forked")


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


def test_a_capture_without_consent_reports_it_wherever_it_is_looked_for(stage, tmp_path):
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
    # The last before the light: it is in view where there is room for one alone.
    warned = [line["code"] for line in lines if line.get("severity") == "warn"]
    assert warned[-1] == "no-consent"
    assert codes.index("no-consent") < [line["event"] for line in lines].index("lit")
    assert json.loads((out / "session.json").read_text())["consent"] is None
    manifest = json.loads((out / "manifest.json").read_text())
    assert (manifest["consent"], manifest["warnings"]["no-consent"]) == (None, 1)


def test_the_last_line_states_what_was_warned_of(stage, tmp_path):
    done = run(stage, tmp_path / "S", "--sequence", "full")
    assert done.returncode == 0, done.stderr
    lines = [json.loads(line) for line in (tmp_path / "S/journal.jsonl").read_text().splitlines()]
    codes = dict.fromkeys(line["code"] for line in lines if line.get("severity") == "warn")
    assert f"while it ran ({', '.join(codes)})," in done.stdout.splitlines()[-1]
    assert "no-consent" in codes


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


@pytest.fixture
def table(tmp_path):
    """A lab's configuration, and the table of pseudonyms that it names."""
    folder = tmp_path / "lab"
    folder.mkdir()
    (folder / "known.txt").write_text("# of this year\nP07\n\nsubject-12  # moved\nP19\n")
    return config(folder, '[session]\npseudonyms = "known.txt"\n'), folder / "known.txt"


def test_a_subject_that_the_labs_table_lacks_lights_nothing(stage, tmp_path, table):
    out = tmp_path / "S"
    settings, known = table
    more = ("--sequence", "full", "--config", settings, "--consent", "C-17")
    done = run(stage, out, "--subject", "P70", *more)
    one_clear_message(
        done, f"{known}, subject: found no 'P70'", "Add the line P70", "nearest known one is P07"
    )
    assert not out.exists()
    assert stage.device.dark
    done = run(stage, out, "--subject", "anybody", *more)
    one_clear_message(done, "check for a typing error.")
    done = run(stage, out, "--subject", "subject-12", *more)
    assert done.returncode == 0, done.stderr
    assert str(tmp_path) not in (out / "manifest.json").read_text()


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"P07\nAnna Maria\n", "line 2: found 'Anna Maria'"),
        (b"\xff\xfeP\0", "byte-order mark"),
        (b"P07\n\xff\n", "byte 4 is not UTF-8"),
        (b"P07\0\n", "line 1: found 'P07\\x00'"),
        (b"P07\n" * (1 << 20) + b"P07", "more than 4 MiB"),
        (None, "no such file"),
    ],
)
def test_a_table_that_is_none_is_refused_with_its_name_and_line(tmp_path, table, data, message):
    _, known = table
    known.unlink() if data is None else known.write_bytes(data)
    with pytest.raises(ConfigError) as wrong:
        require_known("P07", SessionConfig(pseudonyms=str(known)))
    assert str(wrong.value).startswith(str(known))
    assert message in str(wrong.value)


def test_a_pseudonym_is_known_however_its_accents_were_written(table):
    _, known = table
    known.write_text("e\u03017\r\nP08\r\n")
    require_known("\u00e97", SessionConfig(pseudonyms=str(known)))
