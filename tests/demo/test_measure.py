"""A command's cost is measured over all its processes, and an interrupt reaches it once."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from demo.measure import run_measured, tree_rss_kb
from tests.waiting import until

HOLD = "import time; block = bytearray(120_000_000); time.sleep(1.2)"


def test_exit_status_is_passed_on() -> None:
    assert run_measured([sys.executable, "-c", "raise SystemExit(7)"]).code == 7
    assert run_measured(["sh", "-c", "kill -9 $$"]).code == 137


def test_seconds_are_wall_time() -> None:
    assert run_measured(["sleep", "0.5"]).seconds >= 0.5


def test_memory_is_that_of_all_processes_under_the_command() -> None:
    one = run_measured([sys.executable, "-c", HOLD]).peak_mb
    assert one > 114
    script = f"import subprocess, sys; p = [subprocess.Popen([sys.executable, '-c', {HOLD!r}])"
    script += " for _ in range(3)]; [q.wait() for q in p]"
    assert run_measured([sys.executable, "-c", script]).peak_mb > 343


def test_own_memory_is_seen() -> None:
    assert tree_rss_kb(os.getpid()) > 10_000


def test_an_interrupt_is_sent_once_and_waited_for(tmp_path: Path) -> None:
    child = (
        "import pathlib, time\n"
        "seen = pathlib.Path('seen')\n"
        "pathlib.Path('ready').touch()\n"
        "try:\n    time.sleep(60)\n"
        "except KeyboardInterrupt:\n    time.sleep(0.5); seen.write_text('once')\n"
    )
    outer = (
        "import sys\nfrom demo.measure import run_measured\n"
        f"try:\n    run_measured([sys.executable, '-c', {child!r}])\n"
        "except KeyboardInterrupt:\n    raise SystemExit(130)\n"
    )
    root = Path(__file__).parents[2]
    process = subprocess.Popen(
        [sys.executable, "-c", outer], cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(root)}
    )
    until((tmp_path / "ready").exists, 30)
    process.send_signal(signal.SIGINT)
    assert process.wait(30) == 130
    assert (tmp_path / "seen").read_text() == "once"


@pytest.mark.parametrize("name", ["a b) c", "x"])
def test_odd_process_names_do_not_confuse_the_count(tmp_path: Path, name: str) -> None:
    link = tmp_path / name
    link.symlink_to("/bin/sleep")
    process = subprocess.Popen([str(link), "5"])
    try:
        # Right after it began, a process may have no page yet.
        until(lambda: tree_rss_kb(process.pid) > 100, 10)
    finally:
        process.kill()
        process.wait()
