"""Commands that end before they are done: by Ctrl-C in the middle, or by a disk that fills up.

Every command that this machine can run in a second is run whole first, into a folder whose name
has spaces and umlauts.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal

import pytest

from lightstage.commands import progress

LEFT_BYTES = 8192
"""Free on the disk that fills up: what is tried before work fits, most results do not."""


@contextlib.contextmanager
def ctrl_c_at(report):
    """Send Ctrl-C when a command reports its progress so many times; yields what it reported."""
    lines = []

    def look(done, total):
        lines.append((done, total))
        if len(lines) == report:
            os.kill(os.getpid(), signal.SIGINT)
        stop_where_interrupted(done, total)

    stop_where_interrupted = progress._stop_where_interrupted
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(progress, "_stop_where_interrupted", look)
        yield lines


def bytes_below(folder):
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def test_a_command_in_the_middle_is_stopped_by_ctrl_c_or_a_full_disk(
    command, tmp_path, small_disk, run_command
):
    folder = tmp_path / "Jörgs neuer Ordner & mehr"
    folder.mkdir()
    with ctrl_c_at(None) as caught:
        ended = run_command(*command(folder / "ganz"))
    reports = len(caught)
    assert ended.code == 0, ended
    needed = bytes_below(folder)
    assert needed > 0

    for at in sorted({min(1, reports), reports // 2, reports} - {0}):
        shutil.rmtree(folder)
        folder.mkdir()
        with ctrl_c_at(at):
            ended = run_command(*command(folder / "halb"))
        assert ended.code == 130, ended
        assert "Traceback" not in ended.err
        hidden = [p for p in folder.rglob(".*") if p.name != ".lock"]
        assert hidden == [], hidden

    (small_disk / "filler").write_bytes(bytes(65536 - LEFT_BYTES))
    before = sorted(small_disk.rglob("*"))
    ended = run_command(*command(small_disk / "voll"))
    if needed <= LEFT_BYTES:
        assert ended.code == 0, ended
        return
    assert ended.code == 2, ended
    assert "Traceback" not in ended.err
    assert "found a full disk" in ended.err or "found no space left" in ended.err
    assert [p for p in small_disk.rglob("*") if p.name.startswith(".")] == []
    left = [p for p in small_disk.rglob("*") if p.is_file() and p not in before]
    # A lock is an empty file by purpose.
    assert all(p.stat().st_size > 0 or p.name == "run.lock" for p in left), left
