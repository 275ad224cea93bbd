"""`lightstage watch`: from another terminal, while a capture runs, was killed, or is over."""

import html
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time

import pytest

from lightstage.errors import CaptureError, FormatError
from lightstage.operator.client import ask, follow
from tests.programs import run_program

pytestmark = pytest.mark.usefixtures("forked")

CAPTURING = """
import json, sys, time
from pathlib import Path
from lightstage.operator import Unattended, serve_events
from lightstage.operator.journal_stream import JournalTail

class Writer:
    def __init__(self, root):
        self.root, self.listeners = root, []
        self.file = open(root / "journal.jsonl", "ab", buffering=0)
        with JournalTail(root / "journal.jsonl") as tail:
            tail.read()
            self.id = tail.last_id
    def note(self, event, **facts):
        self.id += 1
        line = {"id": self.id, "elapsed_s": time.monotonic(), "event": event, **facts}
        data = json.dumps(line).encode() + b"\\n"
        self.file.write(data[:9])
        self.file.write(data[9:])
        for listener in self.listeners:
            listener(line)

writer, operator = Writer(Path(sys.argv[1])), Unattended()
writer.listeners.append(operator.receive)
with serve_events(writer, operator.request):
    for raw in sys.stdin:
        line = json.loads(raw)
        writer.note(line.pop("event"), **line)
        wish = operator.command()
        if wish is not None:
            writer.note("note", said=f"the operator wishes: {wish.do}")
"""


class Capturing:
    """A process that writes a session's journal, line by line as it is told, and serves it."""

    def __init__(self, root):
        self.root = root
        self.process = subprocess.Popen(
            [sys.executable, "-c", CAPTURING, str(root)], stdin=subprocess.PIPE, text=True
        )
        self.journal = root / "journal.jsonl"
        self.wait(lambda: self.journal.exists() and "socket" in self.journal.read_text())

    def wait(self, done):
        until_s = time.monotonic() + 60
        while not done():
            assert time.monotonic() < until_s
            assert self.process.poll() is None
            time.sleep(0.01)

    def write(self, *lines):
        for line in lines:
            self.process.stdin.write(json.dumps(line) + "\n")
        self.process.stdin.flush()

    def end(self):
        self.process.stdin.close()
        self.process.wait(60)


@pytest.fixture
def capturing(tmp_path, runtime):
    started = []

    def start(root=tmp_path):
        started.append(Capturing(root))
        return started[-1]

    yield start
    for each in started:
        each.process.kill()
        each.process.wait()
        each.process.stdin.close()


def watch(*arguments):
    ended = run_program("lightstage", "watch", *arguments)
    return subprocess.CompletedProcess(arguments, ended.code, ended.out, ended.err)


def bare(lines):
    return [{k: v for k, v in line.items() if k not in ("id", "elapsed_s")} for line in lines]


def test_a_finished_capture_is_distinguished_from_its_journal(tmp_path, replay, written):
    written(tmp_path / "journal.jsonl", replay)
    done = watch(tmp_path)
    assert done.returncode == 0
    assert "63 of 63 photographs kept, 7 of 7 patterns done, complete" in done.stdout
    assert "cam4: no answer for 30 s" in done.stderr
    assert "\x1b" not in done.stderr
    facts = json.loads(watch(tmp_path, "--json").stdout.splitlines()[-1])
    assert facts["photographs"] == facts["wanted"] == 63
    assert facts["phase"] == "complete"
    assert facts["last_id"] == len(replay)


def test_a_running_capture_is_followed_live_to_its_end_and_each_line_comes_once(
    tmp_path, replay, capturing
):
    running = capturing()
    stated = [{k: v for k, v in line.items() if k not in ("id", "elapsed_s")} for line in replay]
    running.write(*stated[:20])
    got, followers = {}, []
    for number in range(4):
        followers.append(
            threading.Thread(target=lambda n=number: got.update({n: list(follow(tmp_path))}))
        )
        followers[-1].start()
        running.write(*stated[20 + number * 20 : 40 + number * 20])
    running.write(*stated[100:])
    running.end()
    for follower in followers:
        follower.join(60)
    for lines in got.values():
        assert [line["id"] for line in lines] == list(range(1, len(stated) + 2))
        assert bare(lines)[1:] == stated
    assert len(got) == 4


def test_a_capture_that_is_killed_is_reported_as_not_over(tmp_path, replay, capturing):
    running = capturing()
    running.write(*bare(replay[:30]))
    running.wait(lambda: running.journal.read_bytes().count(b"\n") == 31)
    got = []
    follower = threading.Thread(target=lambda: got.extend(follow(tmp_path)))
    follower.start()
    running.process.kill()
    follower.join(60)
    assert [line["id"] for line in got] == list(range(1, 32))
    done = watch(tmp_path)
    assert done.returncode == 0
    assert "not over at line 31, and no capture runs" in done.stdout
    assert f"To resume: lightstage capture --resume --out {tmp_path}" in done.stdout
    with pytest.raises(CaptureError, match="no capture that answers"):
        ask(tmp_path, "abort")


def test_a_resumed_capture_is_followed_by_its_new_socket(tmp_path, replay, capturing):
    first = capturing()
    first.write(*bare(replay[:10]))
    first.wait(lambda: first.journal.read_bytes().count(b"\n") == 11)
    first.process.kill()
    first.process.wait()
    second = capturing()
    second.wait(lambda: second.journal.read_text().count("socket") == 2)
    second.write({"event": "end"})
    second.end()
    assert [line["id"] for line in follow(tmp_path)] == list(range(1, 14))


def test_another_terminal_can_stop_a_capture(tmp_path, replay, capturing):
    running = capturing()
    running.write(*bare(replay[:2]))
    refused = watch(tmp_path, "--do", "retake")
    assert refused.returncode == 2
    assert "no pattern is done yet" in refused.stderr
    assert "Traceback" not in refused.stderr
    accepted = watch(tmp_path, "--do", "abort")
    assert accepted.returncode == 0
    assert "abort is accepted" in accepted.stdout
    running.write({"event": "lit", "pattern": "x+"})
    running.wait(lambda: "the operator wishes: abort" in running.journal.read_text())


def test_nobody_there_is_reported(tmp_path, replay, written):
    nothing = watch(tmp_path / "S", "--wait", 0)
    assert nothing.returncode == 2
    assert "no such file, expected the journal of a capture" in nothing.stderr
    with pytest.raises(FormatError):
        ask(tmp_path / "S", "abort")
    written(tmp_path / "journal.jsonl", replay)
    over = watch(tmp_path, "--do", "abort")
    assert over.returncode == 2
    assert "no capture that answers" in over.stderr


def test_a_session_that_is_not_there_yet_is_waited_for(tmp_path, replay, written):
    child = subprocess.Popen(
        [sys.executable, "-m", "lightstage", "watch", str(tmp_path / "S")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert "waiting for it. Ctrl-C ends." in child.stderr.readline()
    written(tmp_path / "whole.jsonl", replay)
    (tmp_path / "S").mkdir()
    (tmp_path / "whole.jsonl").rename(tmp_path / "S" / "journal.jsonl")
    assert "63 of 63 photographs kept" in child.communicate(timeout=60)[0]
    assert child.returncode == 0


def test_waiting_ends_by_ctrl_c_and_by_its_option(tmp_path):
    child = subprocess.Popen(
        [sys.executable, "-m", "lightstage", "watch", str(tmp_path / "S")],
        stderr=subprocess.PIPE,
        text=True,
    )
    child.stderr.readline()
    child.send_signal(signal.SIGINT)
    assert child.communicate(timeout=60)[1] == "Interrupted.\n"
    assert child.returncode == 130
    done = watch(tmp_path / "S", "--wait", 0.1)
    assert done.returncode == 2
    assert "no such file within 0.1 s, expected the journal of a capture" in done.stderr


def test_what_cannot_be_watched_or_asked_is_one_message(tmp_path, replay, written):
    journal = written(tmp_path / "journal.jsonl", replay)
    for more, message in (
        ((tmp_path, "--do", "dance"), "found 'dance', expected one of retake, accept, abort"),
        ((tmp_path / "no", "--do", "dance"), "found 'dance', expected one of retake"),
        ((journal,), f"{journal}: found a file, expected a session's folder"),
        ((journal, "--do", "abort"), f"{journal}: found a file, expected a session's folder"),
        ((tmp_path, "--wait", "-1"), "--wait: found -1.0, expected seconds"),
    ):
        done = watch(*more)
        assert done.returncode == 2
        assert message in done.stderr
        assert done.stderr.count("\n") == 1


def test_what_was_stopped_ends_with_the_line_that_goes_on(tmp_path, story, written):
    journal = story(2)
    journal.begin()
    journal.add("aborted", said="Stopped by the operator.", resume_with=["--leds", "socket://x:1"])
    written(tmp_path / "journal.jsonl", journal.lines)
    done = watch(tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith(
        f"To resume: lightstage capture --resume --out {tmp_path} --leds socket://x:1\n"
    )


def test_a_picture_of_any_moment_can_be_written(tmp_path, replay, written):
    written(tmp_path / "journal.jsonl", replay)
    failed = next(line["id"] for line in replay if line["event"] == "failed")
    path = tmp_path / "p.svg"
    done = watch(tmp_path, "--picture", path, "--until", failed, "--columns", 90)
    assert done.returncode == 0, done.stderr
    assert "FAILED" in path.read_text()
    assert watch(tmp_path, "--picture", path).returncode == 0
    assert "COMPLETE" in path.read_text()
    assert watch(tmp_path, "--picture", path, "--columns", 10).returncode == 2


@pytest.mark.parametrize("code", ["blur", "not-taken"])
def test_a_picture_of_a_question_shows_what_was_asked_and_could_be_answered(
    tmp_path, story, written, code
):
    journal = story(2)
    journal.begin()
    journal.light("full")
    journal.keep("full", "cam0")
    found = {
        "severity": "retake", "code": code, "where": "full by cam1", "found": "nothing sharp",
        "expected": "an eye", "hint": "", "pattern": "full", "camera": "cam1",
    }  # fmt: skip
    journal.add("asked", pattern="full", findings=[found])
    asked = journal.lines[-1]["id"]
    journal.add("answered", pattern="full", do="retake")
    written(tmp_path / "journal.jsonl", journal.lines)
    path = tmp_path / "p.svg"
    assert watch(tmp_path, "--picture", path, "--until", asked).returncode == 0
    text = " ".join(html.unescape(re.sub(r"<[^>]*>", " ", path.read_text())).split())
    for part in ("waiting for you", "full by cam1: nothing sharp", "What now?"):
        assert part in text
    assert "retake it" in text
    assert ("accept as it is" in text) == (code == "blur")
    assert watch(tmp_path, "--picture", path).returncode == 0
    assert "What now?" not in path.read_text().replace("&#160;", " ")


def test_a_watcher_at_a_terminal_sees_the_picture_and_leaves_by_q(
    tmp_path, replay, capturing, terminals
):
    running = capturing()
    running.write(*bare(replay[:60]))
    terminal = terminals("-m", "lightstage", "watch", str(tmp_path))
    terminal.wait_for("TAKING")
    seen = terminal.wait_for("leave (the capture continues)")
    running.write({"event": "finding", "severity": "warn", "where": "cam1", "found": "it is dim"})
    terminal.wait_for("it is dim", seen)
    terminal.press("q")
    assert terminal.end() == 0
    assert terminal.mode() == terminal.before
    assert running.process.poll() is None
    assert os.path.exists(running.journal)


@pytest.mark.parametrize(
    ("more", "message"),
    [(["--until", "3"], "--picture beside it"), (["--until", "999", "--picture"], "at most ")],
)
def test_a_moment_that_cannot_be_drawn_is_refused(tmp_path, replay, capturing, more, message):
    running = capturing()
    running.write(*bare(replay[:5]))
    running.wait(lambda: running.journal.read_bytes().count(b"\n") >= 5)
    picture = tmp_path / "p.svg"
    done = watch(tmp_path, *more, *([str(picture)] if "--picture" in more else []))
    assert done.returncode == 2
    assert message in done.stderr
    assert not picture.exists()
