"""A stage whose photographs say what they are, and real captures on it under bad conditions."""

from __future__ import annotations

import contextlib
import ctypes
import dataclasses
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest

from lightstage.rig import Rig, default_rig
from sim.devices.coded_stage import CodedStage

CONFIG = """
# Nobody sits in the simulated stage: light may change as fast as it can.
[safety]
light_interval_s = 0.02
max_flashes_per_s = 30.0
max_light_on_s = 86400.0
max_heat = 1.0

# Pictures of 48 x 64 pixels have no fine detail to speak of.
[checks]
min_sharpness = 0.0
warn_sharpness = 0.0
"""
PATIENCE_S = 120.0
SEQUENCE = "full,x+,x-,y+,y-,z+,z-"
DAC_OVERRIDE, DAC_READ_SEARCH = 1, 2
PR_CAPBSET_DROP = 24


def small_rig(cameras: int = 2) -> Rig:
    """The default rig's lights, and some of its cameras with tiny pictures."""
    whole = default_rig()
    small = [dataclasses.replace(c.scaled(0.01), width_px=48, height_px=64) for c in whole.cameras]
    return Rig(whole.lights, tuple(small[:cameras]))


def obey_permissions() -> None:
    """Let permission bits bind this process although it is root's: for what it runs next."""
    if os.geteuid() == 0:
        libc = ctypes.CDLL(None, use_errno=True)
        for capability in (DAC_OVERRIDE, DAC_READ_SEARCH):
            if libc.prctl(PR_CAPBSET_DROP, capability, 0, 0, 0) != 0:
                raise OSError(ctypes.get_errno(), "prctl")


class Bench:
    """Captures on one stage.

    Attributes:
        stage: with its devices.
        desk: for everything.
        out: where sessions go by default.
    """

    def __init__(self, stage: CodedStage, desk: Path) -> None:
        self.stage = stage
        self.desk = desk
        self.out = desk / "S"
        (desk / "config.toml").write_text(CONFIG)

    def arguments(
        self,
        *more: str,
        out: Path | None = None,
        resume: bool = False,
        sequence: str = SEQUENCE,
    ) -> list[str]:
        """The command line, without the interpreter's part."""
        first = ["--rig", str(self.stage.rig_path), "--sequence", sequence]
        return [
            *("capture", "--out", str(out or self.out), "--leds", self.stage.device.url(5.0, 2)),
            *("--cameras", str(self.stage.cameras_path)),
            *("--config", str(self.desk / "config.toml"), "--unattended"),
            *(["--resume"] if resume else first),
            *more,
        ]

    def start(
        self,
        *more: str,
        out: Path | None = None,
        resume: bool = False,
        sequence: str = SEQUENCE,
        launcher: Sequence[str] = ("-m", "lightstage"),
        before: Callable[[], None] | None = None,
    ) -> subprocess.Popen[str]:
        """A capture in a process of its own."""
        arguments = self.arguments(*more, out=out, resume=resume, sequence=sequence)
        return subprocess.Popen(
            [sys.executable, *launcher, *arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=before,
        )

    def run(self, *more: str, **how: object) -> subprocess.CompletedProcess[str]:
        """A capture to its end."""
        return ended(self.start(*more, **how))

    def wait_for(self, child: subprocess.Popen[str], pattern: str, count: int = 1) -> None:
        """Until so many of the session's files match, while the capture runs."""
        deadline = time.monotonic() + PATIENCE_S
        while len(list(self.out.glob(pattern))) < count:
            assert child.poll() is None, child.stderr.read()
            assert time.monotonic() < deadline
            time.sleep(0.005)

    def photographs(self, out: Path | None = None) -> dict[Path, bytes]:
        """Every photograph that has its name, with its bytes."""
        return {path: path.read_bytes() for path in (out or self.out).glob("frames/*/cam*.dng")}

    def require_whole(self, out: Path | None = None) -> None:
        """A finished session: every photograph there, and what it is called."""
        labels = self.stage.labels(out or self.out)
        count = len(SEQUENCE.split(",")) * len(self.stage.rig.cameras)
        assert labels == dataclasses.replace(type(labels)(), right=count)
        assert self.stage.device.dark


def ended(child: subprocess.Popen[str]) -> subprocess.CompletedProcess[str]:
    """What a capture said at its end."""
    try:
        out, err = child.communicate(timeout=PATIENCE_S)
    except subprocess.TimeoutExpired:
        child.kill()
        raise
    return subprocess.CompletedProcess(child.args, child.returncode, out, err)


def message(done: subprocess.CompletedProcess[str], kind: str) -> str:
    """The one error of a capture that was refused or failed; no traceback, exit code 2."""
    assert done.returncode == 2, (done.returncode, done.stderr)
    assert "Traceback" not in done.stderr, done.stderr
    assert done.stdout == ""
    lines = done.stderr.splitlines()
    starts = [i for i, line in enumerate(lines) if line.startswith(f"{kind}: ")]
    assert len(starts) == 1, done.stderr
    return "\n".join(lines[starts[0] :])


def journal_of(out: Path) -> list[dict]:
    """Lines of a session's journal."""
    return [json.loads(line) for line in (out / "journal.jsonl").read_text().splitlines()]


@contextlib.contextmanager
def small_disk(folder: Path, size: str) -> Iterator[bool]:
    """Mount a disk of its own on a folder; False where this machine does not let us."""
    folder.mkdir(parents=True)
    command = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)]
    mounted = subprocess.run(command, capture_output=True).returncode == 0
    try:
        yield mounted
    finally:
        if mounted:
            subprocess.run(["umount", "-l", str(folder)], check=True)


@contextlib.contextmanager
def bench_of(desk: Path, rig: Rig) -> Iterator[Bench]:
    """A stage of its own."""
    with CodedStage(desk / "sim", rig) as stage:
        yield Bench(stage, desk)


@pytest.fixture
def bench(tmp_path) -> Iterator[Bench]:
    """Two cameras, 168 lights."""
    with bench_of(tmp_path, small_rig()) as made:
        yield made


@pytest.fixture
def tools():
    """What tests need that cannot import this file."""

    class Tools:
        pass

    for each in (small_rig, obey_permissions, ended, message, journal_of, small_disk, bench_of):
        setattr(Tools, each.__name__, staticmethod(each))
    return Tools


@pytest.fixture(autouse=True)
def captures_are_forked(forked: None) -> None:
    """Every file here starts dozens of captures."""
