"""Many sessions at once: equal to `run`, whatever dies; one that fails stops no other."""

from __future__ import annotations

import functools
import json
import os
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from benchmarks.folders import differences, holder
from lightstage.errors import FormatError, MemoryLimitError
from lightstage.formats.lock import locked
from lightstage.formats.template import default_template_path
from processing.atlas.config import AtlasConfig
from processing.batch import needs, work
from processing.pipeline import run
from processing.pipeline_config import PipelineConfig
from processing.records import RUN_LOCK, code_version, hash_template
from tests.processing import lit_ball
from tests.processing.lit_ball import Ball

TEMPLATE = default_template_path()
IDS = ("ball-1", "ball-2", "ball-3")


@pytest.fixture(scope="module")
def sessions(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Three sessions of a ball, of two small cameras."""
    root = tmp_path_factory.mktemp("sessions")
    first = lit_ball.write_session(Ball(), lit_ball.small_rig(2, 0.015), root / IDS[0])
    for name in IDS[1:]:
        shutil.copytree(first, root / name)
    for name in IDS:
        change(root / name, id=name)
    return [root / name for name in IDS]


def change(session: Path, **values: object) -> None:
    file = session / "session.json"
    file.write_text(json.dumps({**json.loads(file.read_text()), **values}))


def order(session: Path, out: Path, **values: object) -> work.Order:
    known: dict[str, Any] = {
        "batch": "b",
        "session": str(session),
        "out": str(out),
        "template": str(TEMPLATE),
        "config": PipelineConfig(),
        "until": "separate",
        "peers": 1,
        "code": code_version(),
        "template_hash": hash_template(TEMPLATE),
    }
    return work.Order(**{**known, **values})


@pytest.fixture(autouse=True)
def own_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """What holds a worker's threads is put back after each test."""
    for name in (work.THREADS, *work.POOLS):
        monkeypatch.setenv(name, os.environ.get(name, "1"))


@pytest.fixture
def command(run_command: Callable[..., Any]) -> Callable[..., Any]:
    return functools.partial(run_command, "processing", "batch")


def test_workers_of_this_machine_beside_a_scheduler_are_refused(
    sessions: list[Path], tmp_path: Path, command: Callable[..., Any]
) -> None:
    words = ["--workers", "2", "--scheduler", "tcp://127.0.0.1:1"]
    done = command(*sessions, "--out", tmp_path / "out", *words)
    assert (done.code, (tmp_path / "out").exists()) == (2, False)
    assert "--workers: found it beside --scheduler" in done.err


def test_a_worker_runs_one_stage_at_a_time_until_all_is_as_run_leaves_it(
    sessions: list[Path], tmp_path: Path
) -> None:
    asked = order(sessions[0], tmp_path / "out")
    looked = work.look(asked)
    assert (looked.status, looked.left) == ("done", ("decode", "separate"))
    assert not (tmp_path / "out").exists()
    first = work.step(asked, True)
    assert (first.ran, first.left, first.reported) == ("decode", ("separate",), False)
    second = work.step(asked, False)
    assert (second.ran, second.left, second.reported) == ("separate", (), True)
    assert work.look(asked).left == ()
    run(sessions[0], tmp_path / "run", TEMPLATE, PipelineConfig(), until="separate")
    assert differences(tmp_path / "out", tmp_path / "run") == []


def test_a_report_that_a_kill_left_out_is_written(sessions: list[Path], tmp_path: Path) -> None:
    asked = order(sessions[0], tmp_path / "out", until="decode")
    assert work.step(asked, True).reported
    (tmp_path / "out" / "report.html").unlink()
    looked = work.look(asked)
    assert (looked.left, looked.reported) == ((), False)
    again = work.step(asked, False)
    assert (again.ran, again.reported) == (None, True)


def test_what_a_killed_stage_left_beside_its_files_goes(
    sessions: list[Path], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    for name in (".half.0123abcd.exr", "views/cam0/.mask.01234567.png", "work/.cam0.89abcdef/x"):
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_text("half")
    (out / ".notes.txt").write_text("mine")
    work.step(order(sessions[0], out, until="decode"), True)
    hidden = sorted(p.name for p in out.rglob(".*"))
    assert hidden == [".notes.txt"]


def test_a_folder_that_another_run_holds_is_busy_and_left_alone(
    sessions: list[Path], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    with locked(out / RUN_LOCK, FormatError("held")):
        assert work.step(order(sessions[0], out), True).status == "busy"
        assert sorted(p.name for p in out.iterdir()) == [RUN_LOCK]
    assert work.step(order(sessions[0], out), True).status == "done"


def test_a_worker_of_other_code_or_template_begins_nothing(
    sessions: list[Path], tmp_path: Path
) -> None:
    other = work.look(order(sessions[0], tmp_path / "out", code="another"))
    assert other.status == "unfit"
    assert "another version" in other.reason
    without = work.step(order(sessions[0], tmp_path / "out", template=str(tmp_path)), True)
    assert without.status == "unfit"
    assert "no template" in without.reason
    assert not (tmp_path / "out").exists()


def test_a_damaged_photograph_fails_its_session_in_words(
    sessions: list[Path], tmp_path: Path
) -> None:
    broken = shutil.copytree(sessions[0], tmp_path / "broken")
    (broken / "frames" / "x+" / "cam0.exr").write_bytes(b"no picture")
    answer = work.step(order(broken, tmp_path / "out"), True)
    assert answer.status == "failed"
    assert "sha256" in answer.reason
    assert not (tmp_path / "out").exists()


def test_a_stopped_batch_ends_its_stage_at_the_next_sign_of_progress(
    sessions: list[Path], tmp_path: Path
) -> None:
    work.stop("ended")
    assert work.step(order(sessions[0], tmp_path / "out", batch="ended"), True).status == "stopped"
    assert work.step(order(sessions[0], tmp_path / "out", batch="other"), True).status == "done"


def test_a_full_disk_and_full_memory_are_distinguished_from_bad_input(
    sessions: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(error: Exception) -> Callable[..., None]:
        def decode(*_: object) -> None:
            raise error

        return decode

    cases: list[tuple[Exception, str]] = [
        (OSError(28, "No space left on device"), "disk full"),
        (MemoryError(), "again"),
        (OSError(116, "Stale file handle"), "again"),
        (ZeroDivisionError("ours"), "failed"),
    ]
    for error, status in cases:
        monkeypatch.setattr("processing.pipeline.decode", fail(error))
        answer = work.step(order(sessions[0], tmp_path / "out"), True)
        assert answer.status == status
    assert "ZeroDivisionError" in answer.trace


def test_a_disk_that_fills_up_in_the_middle_stops_cleanly_and_goes_on_after(
    sessions: list[Path], tmp_path: Path, small_disk: Path
) -> None:
    out = small_disk / "out"
    asked = order(sessions[0], out)
    assert work.step(asked, True).status == "disk full"
    subprocess.run(["mount", "-o", "remount,size=8m", small_disk], check=True)
    assert work.step(asked, True).ran == "decode"
    filler = small_disk / "filler"
    filler.write_bytes(bytes(shutil.disk_usage(small_disk).free - 32_768))
    full = work.step(asked, False)
    assert (full.status, full.ran) == ("disk full", None)
    assert str(small_disk) in full.reason
    assert list(out.rglob(".*")) == []
    # What is done stays done, and nothing counts as done that is not.
    assert work.look(asked).left == ("separate",)
    filler.unlink()
    assert work.step(asked, False).left == ()
    run(sessions[0], tmp_path / "run", TEMPLATE, PipelineConfig(), until="separate")
    assert differences(out, tmp_path / "run") == []


def test_memory_decides_how_many_workers_there_are() -> None:
    gib, rows = needs.GIB, needs.MEASURED_ROWS
    assert AtlasConfig.rows == rows, "measure the memory again, and record it here"
    full = needs.peak_bytes(24.2, rows, "atlas")
    assert full == pytest.approx(6.55 * gib)
    assert needs.peak_bytes(0.0864, 96, "atlas") == int(1.73 * gib)
    assert needs.peak_bytes(24.2, rows, "decode") == int(0.76 * gib)
    cores = needs.worker_count(full, 10_000, 0.8, 10**15)
    assert needs.worker_count(full, 1400, 1.0, int(6.6 * gib)) == 1
    assert needs.worker_count(full, 1400, 1.0, int(13.2 * gib)) == min(2, cores)
    assert needs.worker_count(full, 1, 1.0, 10**15) == 1
    with pytest.raises(MemoryLimitError, match=r"--workers: found 3\.0 GiB.*expected 8\.2 GiB"):
        needs.worker_count(full, 10, 0.8, 3 * gib)


def test_an_atlas_needs_its_memory_however_small_the_photographs_are() -> None:
    """Of 240 x 360 pixels and 6144 rows it took 3.0 GiB of a half-empty tile (measured)."""
    small, gib = 0.0864, needs.GIB
    assert needs.peak_bytes(small, 6144, "atlas") == pytest.approx((0.98 + 3.6) * gib)
    assert needs.peak_bytes(small, 6144, "register") == int(1.73 * gib)
    # Four times the texels, four times their memory.
    assert needs.peak_bytes(small, 12288, "atlas") == pytest.approx(
        (0.98 + 4 * 3.6) * gib, rel=1e-3
    )


def test_what_is_no_session_and_an_id_twice_are_refused_before_any_work(
    sessions: list[Path], tmp_path: Path, command: Callable[..., Any]
) -> None:
    copy = shutil.copytree(sessions[0], tmp_path / "copy")
    (tmp_path / "empty").mkdir()
    done = command(*sessions, copy, tmp_path / "empty", "--out", tmp_path / "out")
    assert done.code == 2
    assert "2 problems" in done.err
    assert f"session {IDS[0]}, which {sessions[0]} is already" in done.err
    assert f"{tmp_path / 'empty'}: found no session.json" in done.err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("workers", ["0", "-1", "many", "1.5", "99999", ""])
def test_a_number_of_workers_that_is_none_is_refused(
    sessions: list[Path], tmp_path: Path, command: Callable[..., Any], workers: str
) -> None:
    done = command(sessions[0], "--out", tmp_path / "out", "--workers", workers)
    assert done.code == 2
    assert "--workers: found" in done.err
    assert not (tmp_path / "out").exists()


def test_a_scheduler_that_is_not_there_is_reported(
    sessions: list[Path], tmp_path: Path, command: Callable[..., Any]
) -> None:
    (tmp_path / "soon.toml").write_text("[batch]\nanswer_s = 0.3\n")
    for address in ("tcp://127.0.0.1:1", "nonsense", "tcp://no.such.host.invalid:8786"):
        words = [sessions[0], "--out", tmp_path / "out", "--config", tmp_path / "soon.toml"]
        done = command(*words, "--scheduler", address)
        assert done.code == 2
        assert f"--scheduler: found nothing that answers at {address}" in done.err


class Killer(threading.Thread):
    """Kills whoever holds the folder of a session, so often."""

    def __init__(self, lock: Path, times: int) -> None:
        super().__init__(daemon=True)
        self.lock, self.times, self.killed = lock, times, []
        self.ended = threading.Event()

    def run(self) -> None:
        while len(self.killed) < self.times and not self.ended.is_set():
            found = holder(self.lock)
            if found is not None and found != os.getpid() and found not in self.killed:
                os.kill(found, signal.SIGKILL)
                self.killed.append(found)
            time.sleep(0.0005)


def test_killed_workers_cost_nothing_and_a_hopeless_session_stops_no_other(
    sessions: list[Path], tmp_path: Path, command: Callable[..., Any]
) -> None:
    out = tmp_path / "out"
    broken = shutil.copytree(sessions[0], tmp_path / "broken")
    change(broken, id="broken")
    (broken / "frames" / "x+" / "cam0.exr").write_bytes(b"no picture")
    killer = Killer(out / IDS[1] / RUN_LOCK, 1)
    killer.start()
    words = (*sessions, broken, "--out", out, "--until", "separate", "--workers", 2)
    done = command(*words, "--json")
    killer.ended.set()
    assert done.code == 2, done.err
    assert len(killer.killed) == 1
    facts = json.loads(done.out.splitlines()[-2])
    assert (facts["sessions"], facts["done"]) == (4, 3), facts["failed"]
    assert list(facts["failed"]) == [str(broken)]
    assert "1 session not done" in done.err
    assert f"{broken} (ball, neutral)" in done.err
    assert "Traceback" not in done.err
    for session in sessions:
        alone = tmp_path / f"{session.name} alone"
        run(session, alone, TEMPLATE, PipelineConfig(), until="separate")
        assert differences(out / session.name, alone) == []
    open_to_others = [p for p in out.rglob("*") if p.stat().st_mode & 0o007]
    assert open_to_others == []
    page = (out / "batch.html").read_text()
    assert "1 session failed" in page
    assert page.count('report.html">ball-') == 3
    shutil.copy(sessions[0] / "frames" / "x+" / "cam0.exr", broken / "frames" / "x+" / "cam0.exr")
    again = command(*words[:-1], 1)
    assert again.code == 0, again.err
    assert "4 of 4 sessions done, 2 stages run" in again.out
