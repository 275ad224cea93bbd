"""An operator at a real terminal: what keys do, what is shown, how it is left."""

import contextlib
import io
import json
import os
import re
import signal
import subprocess
import sys
import threading

import pytest
from rich.console import Console

from lightstage.errors import DeviceError
from lightstage.findings import Finding
from lightstage.operator import OperatorConfig, TerminalOperator, Wish, open_operator
from lightstage.operator.screen import Ask, Screen
from lightstage.operator.view import View

BAD = Finding("retake", "blur", "x+ by cam0", "blurred", "sharp", "Ask for quiet.", "x+", "cam0")
MISSING = Finding("retake", "not-taken", "x+ by cam0", "no answer", "a photograph")

CAPTURE = """
import json, sys, threading, time
from lightstage.commands import make_app, run_app
from lightstage.errors import StoppedError
from lightstage.findings import Finding
from lightstage.interrupts import signals_put_off
from lightstage.operator import open_operator

out = sys.argv[1]
lines = [json.loads(line) for line in open(sys.argv[2])]

def light(state):
    with open(out, "a") as file:
        file.write(state + " ")

def main():
    light("lit")
    try:
        with open_operator("S/1") as operator:
            operator.at_abort(lambda: light("dark-by-key"))
            for line in lines:
                operator.receive(line)
            {body}
    finally:
        light("dark")

app = make_app("A capture.")
app.command("main")(main)
sys.argv[1:] = ["main"]
run_app(app)
"""
LOOP = """
            while True:
                wish = operator.command()
                if wish is not None:
                    light(wish.do)
                if wish is not None and wish.do == "abort":
                    raise StoppedError("the operator's wish")
                time.sleep(0.01)
"""
DEAF = """
            with signals_put_off():
                light("deaf")
                while not (wish := operator.command()):
                    time.sleep(0.01)
                time.sleep(0.5)
                light(wish.do)
"""
STUCK = "threading.Event().wait()"
ASK = """
            bad = Finding("retake", "blur", "x+ by cam0", "blurred", "sharp", "Ask for quiet.")
            light(operator.decide([bad], 2))
"""
RAISE = "raise ZeroDivisionError('inside')"


def begun(told):
    """A capture in its second pattern."""
    told.begin()
    told.shoot("full")
    told.light("x+")
    return told


def assert_went_dark(lights, *before):
    """The key's thread darkens, the capture's thread ends: either may come first, both happen."""
    states = lights.read_text().split()
    assert tuple(states[: len(before)]) == before
    *stopping, last = states[len(before) :]
    assert sorted(stopping) == ["abort", "dark-by-key"]
    assert last == "dark"


@pytest.fixture
def capture(terminals, tmp_path, story, written):
    """Starts a made-up capture on a terminal; its lights are a file."""
    lights = tmp_path / "lights"

    def start(body, told=None, **size):
        told = told or begun(story(3))
        journal = written(tmp_path / "lines.jsonl", told.lines)
        program = CAPTURE.replace("{body}", body.strip())
        return terminals("-c", program, str(lights), str(journal), **size), lights

    return start


def test_the_picture_is_shown_and_q_stops_with_the_terminal_as_it_was(capture):
    terminal, lights = capture(LOOP)
    terminal.wait_for("TAKING x+")
    terminal.wait_for("stop, dark at once")
    assert terminal.mode() != terminal.before
    terminal.press("q")
    assert terminal.end() == 130
    terminal.wait_for("STOPPING")
    assert_went_dark(lights, "lit")
    assert terminal.mode() == terminal.before
    terminal.wait_for("the operator's wish")


def test_q_darkens_the_lights_though_the_capture_waits_for_something_else(capture):
    terminal, lights = capture(STUCK)
    terminal.wait_for("stop, dark at once")
    terminal.press("q")
    terminal.wait_until(lambda: "dark-by-key" in lights.read_text(), "the lights stayed on")
    assert terminal.process.poll() is None  # the capture itself has not come to it
    terminal.process.send_signal(signal.SIGTERM)
    terminal.end()
    assert terminal.mode() == terminal.before


def test_ctrl_c_stops(capture):
    terminal, lights = capture(STUCK)
    terminal.wait_for("stop, dark at once")
    terminal.press("\x03")
    assert terminal.end() not in (0, 2)
    assert lights.read_text().split()[-1] == "dark"
    assert terminal.mode() == terminal.before


def test_a_signal_is_seen_and_darkens_at_once_though_the_main_thread_does_not_hear_it(capture):
    terminal, lights = capture(DEAF)
    terminal.wait_until(lambda: lights.exists() and "deaf" in lights.read_text(), "it hears")
    terminal.press("\x03")
    terminal.wait_for("STOPPING for 0 s")
    assert terminal.end() == 130
    assert_went_dark(lights, "lit", "deaf")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_a_signal_leaves_the_terminal_as_it_was(capture, number):
    terminal, lights = capture(STUCK)
    terminal.wait_for("stop, dark at once")
    os.killpg(terminal.process.pid, number)
    terminal.end()
    assert terminal.mode() == terminal.before
    assert lights.read_text().split()[-1] == "dark"


def test_an_exception_leaves_the_terminal_as_it_was(capture):
    terminal, lights = capture(RAISE)
    assert terminal.end() == 1
    assert terminal.mode() == terminal.before
    terminal.wait_for("ZeroDivisionError")
    assert lights.read_text().split()[-1] == "dark"


def test_ctrl_z_and_ctrl_backslash_do_not_leave_the_lights_on(capture):
    terminal, lights = capture(LOOP)
    terminal.wait_for("stop, dark at once")
    terminal.press("\x1a\x1c\x13")
    terminal.press("p")
    terminal.wait_until(lambda: "pause" in lights.read_text(), "it stands still")
    terminal.press("q")
    assert terminal.end() == 130


def test_keys_are_wishes_and_what_makes_no_sense_is_reported(capture):
    terminal, lights = capture(LOOP)
    terminal.wait_for("this pattern again")
    terminal.press("r")
    terminal.wait_for("x+ will be retaken next")
    terminal.wait_until(lambda: "retake" in lights.read_text(), "no retake")
    terminal.press("a")
    terminal.wait_for("Not now: nothing waits to be accepted")
    terminal.press("p")
    terminal.wait_until(lambda: "pause" in lights.read_text(), "no pause")
    terminal.wait_for("continue")
    terminal.press("\x1b[A")
    terminal.press("c")
    terminal.wait_until(lambda: "resume" in lights.read_text(), "no resume")
    terminal.press("q")
    terminal.end()
    assert_went_dark(lights, "lit", "retake", "pause", "resume")


@pytest.mark.parametrize(("key", "decision"), [("r", "retake"), ("a", "accept"), ("q", "abort")])
def test_a_question_is_asked_in_plain_words_and_answered_by_a_key(capture, key, decision):
    terminal, lights = capture(ASK)
    terminal.wait_for("What now?")
    for part in ("x+ by cam0: blurred", "wanted: sharp", "Ask for quiet.", "accept as it is"):
        terminal.wait_for(part)
    terminal.press(key)
    assert terminal.end() == 0
    assert decision in lights.read_text().split()
    assert terminal.mode() == terminal.before


@pytest.mark.parametrize("columns", [60, 200])
def test_the_picture_fits_the_terminal(capture, columns):
    terminal, _ = capture(LOOP, columns=columns, rows=24)
    terminal.wait_for("stop, dark at once")
    assert max(len(line.rstrip("\r")) for line in terminal.output.split("\n")) <= columns
    terminal.press("q")
    terminal.end()


def pictured(told, columns, rows):
    """What the screen shall show: all of its rows."""
    view, file = View("S/1"), io.StringIO()
    for line in told.lines:
        view.receive(line)
    Console(file=file, width=columns, height=rows).print(
        Screen(view, Ask(keys=("retake", "pause", "abort")))
    )
    lines = [line.rstrip() for line in file.getvalue().split("\n")]
    return lines[:rows] + [""] * (rows - len(lines))


@pytest.mark.parametrize(
    "sizes",
    [
        [(120, 40)],
        [(50, 12), (100, 30)],
        [(60, 15), (80, 24), (40, 40), (200, 10), (60, 15)],
    ],
    ids=["grows", "shrinks-and-grows", "many"],
)
def test_after_a_resize_the_whole_screen_is_right(capture, story, sizes):
    journal = begun(story(9))
    journal.add("failed", pattern="x+", camera="cam8", take=1, said="no answer within 30 s, " * 20)
    terminal, _ = capture(LOOP, journal, columns=100, rows=30)
    for columns, rows in [(100, 30), *sizes]:
        terminal.resize(columns, rows)
        wanted = pictured(journal, columns, rows)
        terminal.wait_until(
            lambda wanted=wanted: terminal.emulator.screen == wanted,
            lambda wanted=wanted: "\n".join(["not", *wanted, "but", *terminal.emulator.screen]),
        )
    terminal.press("q")
    assert terminal.end() == 130
    terminal.wait_for("the operator's wish")
    # What is left in the window afterwards is the last picture, once, and the last words.
    emulator = terminal.emulator
    assert not emulator.alternate
    assert emulator.cursor_shown
    assert sum(line.startswith("P1, neutral") for line in emulator.history) == 1
    assert any(line.startswith("STOPPING") for line in emulator.history)


def test_what_others_say_meanwhile_stands_below_the_last_picture(capture):
    terminal, _ = capture("print('a library warns', file=sys.stderr); time.sleep(0.5)")
    assert terminal.end() == 0
    terminal.wait_for("a library warns")
    emulator = terminal.emulator
    assert not emulator.alternate
    text = next(i for i, line in enumerate(emulator.history) if "a library warns" in line)
    picture = [i for i, line in enumerate(emulator.history) if line.startswith("cam2 ")]
    assert len(picture) == 1
    assert picture[0] < text


def plain(operator_does, replay, **more):
    file = io.StringIO()
    console = Console(file=file, width=40)
    with TerminalOperator(console, "S/1", **more) as operator:
        for line in replay:
            operator.receive(line)
        result = operator_does(operator)
    return file.getvalue(), result


def test_a_log_gets_plain_lines_without_control_codes(replay):
    text, _ = plain(lambda _: None, replay)
    lines = text.splitlines()
    assert all(line.isprintable() for line in lines)
    assert sum(" done. " in line for line in lines) == 7
    assert lines[-1].endswith("+ The session is complete: 63 photographs.")
    assert any("cam4: no answer for 30 s. It is tried again" in line for line in lines)
    assert any(line.startswith("10:20:") for line in lines)
    assert "27 of 63 photographs, about" in text
    assert len(lines) < 20


def test_a_log_of_a_resumed_capture_begins_where_it_goes_on(replay):
    def report(operator):
        operator.receive({"event": "resume", "time_utc": "2031-05-06T11:00:00"})
        operator.receive(replay[-1])

    file = io.StringIO()
    with TerminalOperator(Console(file=file, width=40), "S/1") as operator:
        for line in replay[:-1]:
            operator.receive(line, old=True)
        report(operator)
    assert [line[9:] for line in file.getvalue().splitlines()] == [
        "The session continues where it stopped.",
        "+ The session is complete: 63 photographs.",
    ]
    assert len(operator.view.done) == 7


def test_without_keys_the_rule_decides_and_nobody_is_waited_for(replay):
    config = OperatorConfig(then="accept")
    asked = [([BAD], 1), ([BAD], 0), ([MISSING], 0)]
    _, decisions = plain(
        lambda operator: [operator.decide(*each) for each in asked], replay, config=config
    )
    assert decisions == ["retake", "accept", "abort"]


def test_clients_can_answer_what_the_terminal_asks():
    asked, other = os.openpty()
    answers = []
    with TerminalOperator(Console(file=io.StringIO()), "S", keys=other) as operator:
        waiting = threading.Thread(target=lambda: answers.append(operator.decide([MISSING], 0)))
        waiting.start()
        while operator.request("retake") is not None:
            pass
        waiting.join(30)
        assert answers == ["retake"]
        dark = []

        def fail():
            dark.append(True)
            raise DeviceError("lights", found="silence")

        operator.at_abort(fail)
        assert operator.request("abort") is None
        assert dark == [True]
        assert operator.command() == Wish("abort")
        assert operator.decide([BAD], 1) == "abort"
    os.close(asked)
    os.close(other)


def test_a_reader_who_has_stopped_does_not_hold_a_capture(replay):
    reader, writer = os.pipe()
    with (
        contextlib.suppress(BrokenPipeError),
        os.fdopen(writer, "w") as file,
        TerminalOperator(Console(file=file), "S") as operator,
    ):
        for _ in range(200):  # far more than the pipe holds
            for line in replay:
                operator.receive(line)
        assert operator.view.phase == "complete"
        os.close(reader)


def test_a_terminal_without_unicode_is_told_all_the_same(story):
    journal = story(1)
    journal.begin()
    journal.add("failed", pattern="full", camera="cam0", said="日本 " * 200)
    file = io.TextIOWrapper(io.BytesIO(), encoding="ascii", write_through=True)
    with TerminalOperator(Console(file=file), "S") as operator:
        for line in journal.lines:
            operator.receive(line)
    file.seek(0)
    assert "full, cam0: ??" in file.read()


def test_a_pipe_is_not_asked():
    program = (
        "from lightstage.operator import open_operator\n"
        "from lightstage.findings import Finding\n"
        "with open_operator('S') as operator:\n"
        "    print(operator.decide([Finding('retake', 'blur', 'x', 'y', 'z')], 0))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, stdin=subprocess.DEVNULL
    )
    assert done.stdout == "abort\n"
    assert done.stderr == ""


def test_a_session_that_shall_ask_nobody_has_no_keys(terminals):
    program = (
        "from lightstage.operator import open_operator\n"
        "from lightstage.findings import Finding\n"
        "with open_operator('S', ask=False) as operator:\n"
        "    decision = operator.decide([Finding('retake', 'blur', 'x', 'y', 'z')], 1)\n"
        "print('decided:', decision)\n"
    )
    terminal = terminals("-c", program)
    terminal.wait_for("decided: retake")
    assert terminal.end() == 0
    assert "dark at once" not in terminal.output


def test_an_operator_can_be_made_without_a_terminal(replay):
    file = io.StringIO()
    with open_operator("S", console=Console(file=file)) as operator:
        for line in replay:
            operator.receive(json.loads(json.dumps(line)))
    last = file.getvalue().rstrip().splitlines()[-1]
    assert re.fullmatch(r"\d\d:\d\d:30 \+ The session is complete: 63 photographs\.", last)
