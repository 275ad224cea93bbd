"""What all commands share: exit codes, messages, the last line; and errors that list all faults."""

import json
import os
import pty
import re
import signal
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from lightstage.commands import finish, make_app, progress_bar
from lightstage.errors import DeviceError, LightstageError, RigError, one_error
from lightstage.formats.exr import write_exr
from tests.programs import run_here

SCRIPT = """
import time
from pathlib import Path
import typer
from lightstage.commands import JsonFlag, finish, make_app, progress_bar, run_app
from lightstage.formats.exr import read_exr
from lightstage.formats.files import atomic_path

app = make_app("test")

@app.command()
def use(texture: Path, out: Path, slow: bool = False, as_json: bool = JsonFlag):
    with progress_bar("use") as progress, atomic_path(out) as beside:
        beside.write_text("half")
        image = read_exr(texture, finite=True)
        for done in range(3):
            progress(done + 1, 3)
        if slow:
            print("ready", flush=True)
            time.sleep(30)
    finish(f"mean {image.mean():.1f}", {"mean": float(image.mean())}, as_json)
"""
PROGRAM = f"{SCRIPT}\nrun_app(app)"
SECONDS = r"\d+\.\d s"


def run(*arguments):
    scope = {}
    exec(SCRIPT, scope)
    ended = run_here(scope["app"], "test", "use", *arguments)
    return subprocess.CompletedProcess(arguments, ended.code, ended.out, ended.err)


@pytest.fixture
def texture(tmp_path):
    return write_exr(tmp_path / "t.exr", np.full((4, 6, 3), 2.0))


def test_a_command_ends_with_its_facts(texture, tmp_path):
    done = run(texture, tmp_path / "out")
    assert (done.returncode, done.stdout) == (0, "mean 2.0\n")
    done = run(texture, tmp_path / "out", "--json")
    assert json.loads(done.stdout) == {"mean": 2.0}


def test_facts_are_json_where_a_number_is_none(capsys):
    facts = {"db": {"low": float("nan"), "high": np.float64("inf")}, "rgb": (1.5, float("nan"))}
    finish("told", facts, as_json=True)
    stated = capsys.readouterr().out
    found = json.loads(stated, parse_constant=lambda word: pytest.fail(f"{word} is no JSON"))
    assert found == {"db": {"low": None, "high": None}, "rgb": [1.5, None]}


def test_a_missing_argument_is_reported_with_what_it_is(tmp_path):
    code = PROGRAM.replace("out: Path,", "out: Path = typer.Option(..., help='Where to write.'),")
    done = subprocess.run([sys.executable, "-c", code, "use", "t"], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.endswith("Missing option '--out'.\nIt is: Where to write.\n")


def test_a_log_gets_one_plain_line_as_work_begins_and_one_as_it_ends(texture, tmp_path):
    for words in ([], ["--json"]):
        done = run(texture, tmp_path / "out", *words)
        assert re.fullmatch(rf"use: begun\nuse: done in {SECONDS}\n", done.stderr)


def read_to_end(terminal: int) -> bytes:
    """What was written to a terminal until its last writer ended."""
    found = b""
    while True:
        try:
            piece = os.read(terminal, 1 << 16)
        except OSError:  # Linux says so that there is no writer any more
            return found
        if not piece:
            return found
        found += piece


def test_a_terminal_gets_the_bar_and_no_such_line(texture, tmp_path):
    ours, theirs = pty.openpty()
    command = [sys.executable, "-c", PROGRAM, "use", str(texture), str(tmp_path / "out")]
    environment = {**os.environ, "TERM": "xterm"}
    child = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=theirs, env=environment)
    os.close(theirs)
    # A terminal that nobody reads holds a few screens, then stops who writes.
    shown = read_to_end(ours).decode()
    os.close(ours)
    assert child.wait() == 0
    assert "\x1b[" in shown
    assert "begun" not in shown


def test_a_texture_with_nan_exits_2_with_one_message_and_nothing_half_written(texture, tmp_path):
    image = np.ones((4, 6, 3), np.float32)
    image[1, 2, 0] = np.nan
    write_exr(texture, image)
    done = run(texture, tmp_path / "out")
    assert (done.returncode, done.stdout) == (2, "")
    log, text = done.stderr.split("FormatError: ")
    assert re.fullmatch(rf"use: begun\nuse: stopped after {SECONDS}\n", log)
    assert text == (
        f"{texture}, element (1, 2, 0): found 1 NaN or infinite value, "
        "expected finite numbers. Mask such texels (0) before passing the map on.\n"
    )
    assert os.listdir(tmp_path) == ["t.exr"]


def test_wrong_arguments_exit_2_without_a_traceback(texture):
    for arguments in ([], [texture], [texture, "o", "--fast"]):
        done = run(*arguments)
        assert done.returncode == 2
        assert "Traceback" not in done.stderr


def test_a_bug_shows_its_traceback_and_is_not_called_bad_input():
    script = "from lightstage.commands import *\napp = make_app('x')\n"
    script += "@app.command()\ndef f(): 1 / 0\nrun_app(app)"
    done = subprocess.run([sys.executable, "-c", script, "f"], capture_output=True, text=True)
    assert done.returncode == 1
    assert "ZeroDivisionError" in done.stderr


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_leaves_no_half_written_file(texture, tmp_path, number):
    command = [sys.executable, "-c", PROGRAM, "use", str(texture), str(tmp_path / "out"), "--slow"]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert child.stdout.readline() == "ready\n"
    child.send_signal(number)
    child.communicate(timeout=20)
    assert child.returncode not in (0, 2)
    assert os.listdir(tmp_path) == ["t.exr"]


def test_a_list_of_commands_has_the_whole_first_sentence_of_each():
    sentence = "Do one thing that takes more than the forty-five characters of Typer's own lists"
    app, below = make_app("test"), make_app("below")
    app.add_typer(below, name="below")
    for group in (app, below):
        group.command("one", help=f"{sentence}. And another.")(lambda: None)
    for words in ([], ["below"]):
        shown = CliRunner().invoke(app, [*words, "--help"]).output
        assert sentence in " ".join(shown.split())
        assert "another" not in shown


def test_commands_start_without_what_few_of_them_need():
    """SciPy and numba take half a second of every command's start."""
    script = "import sys, lightstage.__main__; print(sorted({'numba', 'scipy'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.stdout == "[]\n", done.stderr


def test_an_error_states_where_what_was_found_what_was_expected_and_what_to_try():
    error = LightstageError("a.exr", field="size", found="3", expected="4", hint="Grow it.")
    assert str(error) == "a.exr, size: found 3, expected 4. Grow it."
    assert str(LightstageError("a.exr")) == "a.exr"
    assert str(LightstageError("a.exr", expected="4")) == "a.exr: expected 4"


def test_many_errors_fold_into_one_of_the_first_kind():
    only = RigError("a")
    assert one_error([only]) is only
    folded = one_error([RigError("a", found="b"), DeviceError("c")])
    assert isinstance(folded, RigError)
    assert str(folded) == "2 problems:\n  a: found b\n  c"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_that_a_library_swallowed_still_ends_the_command(tmp_path, number):
    script = f"""
import os, time
from lightstage.commands import make_app, progress_bar, run_app
app = make_app("x")

class Gone:
    def __del__(self):  # Python drops whatever is raised in here
        os.kill(os.getpid(), {int(number)})
        time.sleep(0.01)

@app.command()
def f():
    with progress_bar("f") as progress:
        Gone()
        progress(1, 2)
        print("went on")

run_app(app)
"""
    command = [sys.executable, "-c", script, "f"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=20)
    assert done.returncode not in (0, 2)
    assert "went on" not in done.stdout
    assert "Exception ignored" in done.stderr


def test_a_log_file_says_now_and_then_how_far_the_work_is(capsys, monkeypatch):
    clock = iter([0.0, 1.0, 31.0, 40.0, 62.0, 70.0])
    monkeypatch.setattr(
        "lightstage.commands.progress.time", SimpleNamespace(monotonic=lambda: next(clock))
    )
    with progress_bar("work") as progress:
        for done in range(1, 5):
            progress(done, 9)
    lines = capsys.readouterr().err.splitlines()
    assert lines == ["work: begun", "work: 2 of 9", "work: 4 of 9", "work: done in 70.0 s"]
