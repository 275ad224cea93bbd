"""What all commands share as a user sees it: help, version, errors as JSON, Ctrl-C at the start."""

import json
import signal
import subprocess
import sys

import pytest
import typer

import lightstage

PROGRAMS = ("lightstage", "processing", "learning", "sim")
WITHOUT_JSON = [("sim", (name,)) for name in ("stage", "calibrate", "icl")]
"""Commands that stand for devices."""


def test_every_command_explains_itself_in_whole(each_command, run_command):
    ended = run_command(each_command.program, *each_command.words, "--help")
    assert ended.code == 0
    assert "<bool>" not in ended.out
    takes_json = any("--json" in param.opts for param in each_command.parser.params)
    assert takes_json == ((each_command.program, each_command.words) not in WITHOUT_JSON)
    shown = " ".join(ended.out.split())
    for param in each_command.parser.params:
        if getattr(param, "help", None):
            # Markup would swallow `[safety]`; only the wrapping of lines may change a text.
            assert "".join(param.help.split()) in "".join(shown.split())


@pytest.mark.parametrize("program", PROGRAMS)
def test_every_program_states_its_version(program, run_command):
    ended = run_command(program, "--version")
    assert (ended.code, ended.out) == (0, f"lightstage {lightstage.__version__}\n")


@pytest.mark.parametrize("program", PROGRAMS)
def test_wrong_words_are_an_error_in_json_too(program, run_command):
    ended = run_command(program, "no-such-command", "--json")
    assert ended.code == 2
    error = json.loads(ended.out.splitlines()[-1])["error"]
    assert error["message"] in ended.err
    assert "no-such-command" in error["message"]


def test_an_input_that_is_not_there_is_an_error_in_json_too(tmp_path, run_command):
    ended = run_command("lightstage", "check", tmp_path / "none", "--json")
    assert ended.code == 2
    error = json.loads(ended.out)["error"]
    assert str(tmp_path / "none") in error["where"]
    # Nothing of work that never began.
    assert ended.err.splitlines() == [f"{error['type']}: {error['message']}"]


def test_a_traceback_is_shown_where_it_is_asked_for(tmp_path, run_command, monkeypatch):
    monkeypatch.setenv("LIGHTSTAGE_TRACEBACK", "1")
    ended = run_command("lightstage", "check", tmp_path / "none")
    assert ended.code == 2
    assert "Traceback" in ended.err


def test_a_reader_that_ends_early_gets_no_traceback():
    command = f"{sys.executable} -m lightstage capture --help | head -1"
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True)
    assert done.stderr == ""
    assert done.stdout.count("\n") == 1


WITH_CTRL_C = """
import os, runpy, signal, sys

class CtrlC:
    def find_spec(self, name, *rest):
        if name == {module!r}:
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, CtrlC())
sys.argv = ["program", *{words!r}]
runpy.run_module({program!r}, run_name="__main__")
"""
"""Runs a program that gets Ctrl-C when it comes to import a module."""


@pytest.mark.parametrize("module", ["typer", "lightstage.commands.app"])
@pytest.mark.parametrize("program", PROGRAMS)
def test_ctrl_c_while_a_program_starts_ends_it_without_a_traceback(program, module):
    script = WITH_CTRL_C.format(program=program, module=module, words=["--help"])
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (-signal.SIGINT, "", "")


def test_ctrl_c_while_a_command_imports_what_it_needs_ends_it_in_order(tmp_path):
    words = ["occlusion", "--out", str(tmp_path / "a.npz"), "--json"]
    for module in ("learning.occlusion_command", "torch", "torch.nn"):
        script = WITH_CTRL_C.format(program="learning", module=module, words=words)
        done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
        assert (done.returncode, done.stderr) == (130, "Interrupted.\n"), module
        assert json.loads(done.stdout) == {
            "error": {"type": "Interrupted", "message": "Interrupted."}
        }
        assert list(tmp_path.iterdir()) == []


def test_a_programs_list_states_of_each_command_what_the_command_says():
    from lightstage.__main__ import COMMANDS, app

    group = typer.main.get_command(app)
    assert group.list_commands(None) == list(COMMANDS)
    for name, (_, summary) in COMMANDS.items():
        assert group.get_command(None, name).help.split("\n")[0] == summary


def test_listing_the_commands_imports_none_of_what_they_need():
    script = """
import sys
sys.argv = ["lightstage", "--help"]
import lightstage.__main__
try:
    lightstage.__main__.main()
except SystemExit:
    pass
heavy = {"numpy", "cv2", "pydantic", "rich.console", "scipy", "numba", "lightstage.capture"}
print(sorted(heavy & set(sys.modules)), file=sys.stderr)
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert "capture" in done.stdout
    assert done.stderr == "[]\n"


def test_one_of_something_is_reported_as_one(world, tmp_path, run_command):
    ended = run_command(
        "processing", "dataset", "build", world["processed"], "--out", tmp_path / "S"
    )
    assert ended.out.endswith("1 scan of 1 subject\n")
    ended = run_command("lightstage", "check", world["session"])
    assert "2 photographs whole and unchanged, 0 pattern sums" in ended.out
