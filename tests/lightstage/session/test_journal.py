"""The journal: on the disk before it counts, in one order, readable after any crash."""

import errno
import itertools
import json
import os
import resource
import shutil
import subprocess
import sys
import threading
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.errors import CaptureError, FormatError
from lightstage.session import journal as module
from lightstage.session.journal import Journal
from lightstage.session.reading import read_journal

THREADS, LINES = 9, 20
BEGIN = {
    "session": "s",
    "created_utc": "2026-01-02T03:04:05+00:00",
    "subject": "p-1",
    "expression": "neutral",
    "sequence": ["full"],
    "cameras": ["cam0"],
}
"""What every session's first line holds."""


def nothing():
    """Prepares nothing."""


@pytest.fixture
def path(tmp_path):
    return tmp_path / "journal.jsonl"


@pytest.fixture
def journal(path):
    made, _ = Journal.new(path, nothing, plan=7, **BEGIN)
    yield made
    made.close()


def test_lines_have_ids_times_and_events_and_begin_with_begin(journal, path):
    written = [journal.write("note", said=str(number)) for number in range(3)]
    lines = read_journal(path)
    assert [line["id"] for line in lines] == [1, 2, 3, 4]
    assert lines[0] == lines[0] | {"event": "begin", "schema": "lightstage.journal/2", "plan": 7}
    assert lines[1:] == written
    assert lines[1]["elapsed_s"] <= lines[2]["elapsed_s"] <= lines[3]["elapsed_s"]


def test_nine_threads_at_once_share_flushes_and_each_line_is_flushed_before_write_returns(
    journal, path, monkeypatch
):
    flushed, flushes = [0], itertools.count()
    real = os.fsync

    def slow(handle):
        size = os.fstat(handle).st_size
        time.sleep(0.004)  # a disk's flush: others hand in meanwhile
        real(handle)
        flushed[0] = size
        next(flushes)

    monkeypatch.setattr(os, "fsync", slow)
    late = []

    def write(camera):
        for number in range(LINES):
            line = journal.write("failed", camera=camera, number=number)
            text = path.read_bytes()[: flushed[0]]
            if f'"id": {line["id"]},'.encode() not in text:
                late.append(line)

    threads = [threading.Thread(target=write, args=(f"cam{n}",)) for n in range(THREADS)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert late == []
    lines = read_journal(path)[1:]
    assert [line["id"] for line in lines] == list(range(2, 2 + THREADS * LINES))
    for camera in range(THREADS):
        own = [line["number"] for line in lines if line["camera"] == f"cam{camera}"]
        assert own == list(range(LINES))
    assert next(flushes) < THREADS * LINES / 3


def test_listeners_hear_every_line_in_order_when_it_is_on_the_disk(journal, path):
    heard, on_disk = [], []

    def hear(line):
        heard.append(line["id"])
        on_disk.append(path.read_text().splitlines()[-1].find('"event"') > 0)

    def broken(line):
        raise ZeroDivisionError

    journal.listeners += [broken, hear]
    threads = [
        threading.Thread(target=lambda: [journal.write("note") for _ in range(10)])
        for _ in range(4)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert heard == list(range(2, 42))
    assert all(on_disk)
    assert [(each, type(error)) for each, error in journal.broken_listeners] == [
        (broken, ZeroDivisionError)
    ]


def test_a_listener_that_writes_is_reported_and_not_waited_for_ever(journal):
    journal.listeners.append(lambda _: journal.write("note"))
    journal.write("note")
    assert isinstance(journal.broken_listeners[0][1], RuntimeError)


def test_a_clock_set_back_leaves_the_order_as_it_was(journal, path, monkeypatch):
    clock = iter(["2031-01-01T00:00:02+00:00", "2031-01-01T00:00:01+00:00", "1970-01-01T00:00:00Z"])
    monkeypatch.setattr(module, "utc_now", lambda: next(clock))
    for number in range(3):
        journal.write("note", number=number)
    lines = read_journal(path)[1:]
    assert [line["number"] for line in lines] == [0, 1, 2]
    assert [line["id"] for line in lines] == [2, 3, 4]
    assert [line["time_utc"] for line in lines] != sorted(line["time_utc"] for line in lines)
    assert lines[0]["elapsed_s"] <= lines[1]["elapsed_s"] <= lines[2]["elapsed_s"]


def test_nan_is_refused_before_it_is_in_the_journal(journal, path):
    before = path.read_bytes()
    with pytest.raises(ValueError, match="JSON"):
        journal.write("note", value=float("nan"))
    assert path.read_bytes() == before
    assert journal.write("note")["id"] == 2


def test_a_second_process_is_refused_while_the_first_writes(journal, path):
    script = (
        "import sys; from pathlib import Path; from lightstage.session.journal import Journal\n"
        "try: Journal.resumed(Path(sys.argv[1]))\n"
        "except Exception as error: print(error)\n"
    )
    command = [sys.executable, "-c", script, str(path)]
    second = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert "another capture that is writing to this session" in second.stdout
    with pytest.raises(CaptureError, match=r"found a journal, expected none yet.*--resume"):
        Journal.new(path, nothing, **BEGIN)
    journal.close()
    third = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert third.stdout == ""


def test_a_closed_journal_takes_no_line(journal):
    journal.close()
    journal.close()
    with pytest.raises(CaptureError, match="closed"):
        journal.write("late")


def written(path):
    journal, _ = Journal.new(path, nothing, **BEGIN)
    journal.write("failed", pattern="x+", camera="cam0", said="Ω" * 5)
    journal.close()
    return path.read_bytes()


@pytest.mark.parametrize("share", [0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99])
def test_a_journal_cut_anywhere_in_its_last_line_is_read_up_to_it_and_goes_on(path, share):
    data = written(path)
    last = data.rindex(b"\n", 0, -1) + 1
    path.write_bytes(data[: last + max(1, round(share * (len(data) - last - 2)))])
    assert [line["event"] for line in read_journal(path)] == ["begin"]
    journal, lines = Journal.resumed(path)
    assert (journal.torn, len(lines)) == (True, 1)
    journal.write("resume")
    journal.write("note")
    journal.close()
    assert [line["event"] for line in read_journal(path)] == ["begin", "resume", "note"]
    assert [line["id"] for line in read_journal(path)] == [1, 2, 3]


def test_a_line_that_lacks_only_its_end_counts_before_and_after_a_resume(path):
    path.write_bytes(written(path)[:-1])
    assert [line["event"] for line in read_journal(path)] == ["begin", "failed"]
    journal, _ = Journal.resumed(path)
    journal.write("resume")
    journal.close()
    assert [line["event"] for line in read_journal(path)] == ["begin", "failed", "resume"]


@given(cuts=st.lists(st.floats(0.01, 0.98), max_size=4))
def test_resumes_that_are_cut_one_after_another_do_no_harm(tmp_path_factory, cuts):
    path = tmp_path_factory.mktemp("j") / "journal.jsonl"
    written(path)
    for cut in cuts:
        before = len(path.read_bytes())
        journal, _ = Journal.resumed(path)
        journal.write("resume", said="x" * 30)
        journal.close()
        data = path.read_bytes()
        path.write_bytes(data[: before + max(2, int(cut * (len(data) - before - 2)))])
    journal, _ = Journal.resumed(path)
    journal.write("resume")
    journal.close()
    assert [line["event"] for line in read_journal(path)] == ["begin", "failed", "resume"]


@pytest.mark.parametrize(
    "damage",
    [
        lambda lines: [lines[0], lines[1][:20], *lines[2:]],
        lambda lines: [lines[0], b"[1, 2]", *lines[2:]],
        lambda lines: [lines[0], lines[2], lines[1]],
        lambda lines: [lines[0], lines[1], lines[1]],
        lambda lines: [lines[0], lines[1].replace(b'"id": 2', b'"id": "2"'), lines[2]],
        lambda lines: lines[1:],
        lambda _: [],
        lambda lines: [lines[0].replace(b"journal/2", b"journal/3"), *lines[1:]],
        lambda lines: [lines[0].replace(b"journal/2", b"rig/1"), *lines[1:]],
        lambda lines: [lines[0].replace(b'"p-1"', b'"../p-1"'), *lines[1:]],
    ],
)
def test_a_journal_that_was_changed_is_refused(path, damage):
    journal, _ = Journal.new(path, nothing, **BEGIN)
    journal.write("note")
    journal.write("note")
    journal.close()
    lines = path.read_bytes().splitlines()
    path.write_bytes(b"\n".join(damage(lines)) + b"\n")
    with pytest.raises(FormatError, match=str(path)):
        read_journal(path)


def test_no_journal_is_reported_so(path):
    with pytest.raises(FormatError, match="no such file"):
        read_journal(path)
    with pytest.raises(FormatError, match="capture without --resume"):
        Journal.resumed(path)


FULL = """
import os, resource, signal, sys
from pathlib import Path
from lightstage.errors import CaptureError
from lightstage.session.journal import Journal
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
journal, _ = Journal.new(
    Path(sys.argv[1]), lambda: None, session="s", created_utc="", subject="p", expression="n",
    sequence=["full"], cameras=["cam0"],
)
resource.setrlimit(resource.RLIMIT_FSIZE, (700, 700))
try:
    for number in range(100):
        journal.write("note", number=number)
except CaptureError as error:
    print(number, error)
try:
    journal.write("note")
except CaptureError as error:
    print("again", error)
"""


def test_where_the_disk_takes_only_a_part_of_a_line_none_of_it_stays(path):
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(path)], capture_output=True, text=True, timeout=60
    )
    first, second = done.stdout.splitlines()
    number = int(first.split()[0])
    assert "expected a disk that can be written" in first
    assert second.startswith("again")
    assert len(path.read_bytes()) <= 700
    assert path.read_bytes().endswith(b"\n")
    lines = read_journal(path)[1:]
    assert [line["number"] for line in lines] == list(range(number))
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] != 700


def test_a_full_disk_is_reported_to_all_who_wait_and_what_was_before_stays(
    journal, path, monkeypatch
):
    journal.write("note")
    before = path.read_bytes()
    real, written_bytes = os.write, itertools.count()

    def full(handle, data):
        if next(written_bytes) == 0:
            return real(handle, data[:5])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "write", full)
    lines = []

    def write():
        try:
            journal.write("failed")
        except CaptureError as error:
            lines.append(str(error))

    threads = [threading.Thread(target=write) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(10)
    assert len(lines) == 3
    assert all("no space left on the disk" in each and "Free some space" in each for each in lines)
    assert path.read_bytes() == before


def test_a_folder_removed_or_a_journal_replaced_meanwhile_is_noticed(tmp_path):
    for name in ("removed", "replaced"):
        path = tmp_path / name / "journal.jsonl"
        path.parent.mkdir()
        journal, _ = Journal.new(path, nothing, **BEGIN)
        data = path.read_bytes()
        shutil.rmtree(path.parent)
        if name == "replaced":
            path.parent.mkdir()
            path.write_bytes(data)
        with pytest.raises(CaptureError, match=r"is gone|another file in the journal's place"):
            journal.write("failed")
        journal.close()


def test_half_a_first_line_is_no_journal(path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "write", full)
        with pytest.raises(CaptureError, match="no space left"):
            Journal.new(path, nothing, **BEGIN)
    assert not path.exists()
    Journal.new(path, nothing, **BEGIN)[0].close()
    assert len(json.loads(path.read_text())) == 5 + len(BEGIN)
