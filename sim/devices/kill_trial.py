"""A real capture that is stopped at a named step, killed, and resumed; what must hold then.

`lightstage capture` runs as a user runs it, with its camera processes and the process that puts
the lights out. A stop file (lightstage.steps) lets one of them stop itself at a step; then whoever
shall die gets SIGKILL. LED device and cards outlive that, as they would on a table.
"""

from __future__ import annotations

import collections
import contextlib
import dataclasses
import functools
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.checks import check_session
from lightstage.errors import LightstageError
from lightstage.formats.files import sha256_file, write_text
from lightstage.formats.session import changed_frames, load_session, missing_frames
from lightstage.rig import Camera, Light, Rig, look_at
from lightstage.session import read_journal
from sim.devices.coded_stage import CodedStage
from sim.devices.kills import CAMERA_STEPS, CAMERAS, SEQUENCE, Kill
from sim.devices.processes import Process, descendants, is_gone, kill, process, wait_until
from sim.errors import SimError

CONFIG = """
trigger_lead_s = 0.0
[safety]
light_interval_s = 0.0
max_flashes_per_s = 30.0
"""
STOP_S = 60.0
END_S = 120.0
DARK_S = 10.0


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What a trial showed.

    Attributes:
        faults: what does not hold, in words; none where all is well.
        killed: of the kills asked for, those that happened (a resume may not come to a step).
        takes: photographs exposed, those that were taken again among them.
        recovered: files of uncertain light.
        dark_after_s: from the kill until no light shone, the longest.
    """

    faults: tuple[str, ...]
    killed: int
    takes: int
    recovered: int
    dark_after_s: float


def small_rig() -> Rig:
    """Eight lights at a cube's corners, three cameras of 48 x 48 pixels."""
    corners = [(x, y, z) for x in (-700.0, 700.0) for y in (-700.0, 700.0) for z in (-700.0, 700.0)]
    lights = tuple(
        Light(i, f"corner{i}", place, "horizontal" if i % 2 else "vertical")
        for i, place in enumerate(corners)
    )
    angles = np.radians(20.0 * np.arange(CAMERAS) - 20.0)
    places = 1100 * np.stack([np.sin(angles), 0 * angles, np.cos(angles)], axis=1)
    return Rig(
        lights,
        tuple(
            Camera(
                f"cam{i}", f"60{i}", "Nikon DSC D750", 48, 48, 140.0, 140.0, 24.0, 24.0,
                (0.0, 0.0, 0.0, 0.0, 0.0), look_at(place, np.zeros(3)),
            )
            for i, place in enumerate(places)
        ),
    )  # fmt: skip


class KillTrial:
    """One session, from its first light to its end, through any number of kills.

    Args:
        desk: a new folder.
        delete: whether photographs are deleted on the cameras once they are kept.
    """

    def __init__(self, desk: Path, delete: bool = False) -> None:
        desk.mkdir(parents=True, exist_ok=True)
        self.desk = desk
        self.root = desk / "session"
        self.rig = small_rig()
        self.delete = delete
        self._faults: list[str] = []
        self._stop_file = desk / "stop"
        self._config = write_text(desk / "config.toml", CONFIG)

    def run(self, kills: Sequence[Kill], retake: str = "") -> Outcome:
        """Capture; die as ordered, each time in the capture that resumes; then end in peace.

        Args:
            kills: who dies when.
            retake: a pattern that `lightstage retake` takes again of the finished session; then the
                kills meet that command, and its second call ends in peace.

        Raises:
            SimError: the first step did not come, or a capture did not end.
        """
        self._faults = []
        happened, dark_s = 0, 0.0
        with CodedStage(self.desk / "stage", self.rig) as stage:
            if retake:
                with self._capture(stage) as capture:
                    self._end(capture)
            for number, each in enumerate(kills):
                with self._capture(stage, retake, stopping=True) as capture:
                    stopped = self._stopped(capture, each)
                    if stopped is None:
                        if number == 0:
                            raise SimError(
                                str(each), found=self._output(capture), expected="its step"
                            )
                        continue
                    happened += 1
                    dark_s = max(dark_s, self._kill(capture, stopped, each, stage))
            if retake or not self._finished():
                with self._capture(stage, retake) as capture:
                    self._end(capture)
                    if capture.returncode != 0:
                        self._faults.append(
                            f"the capture did not end well: {self._output(capture)}"
                        )
            recovered = self._verify(stage)
            takes = sum(1 for line in self._journal() if line["event"] == "exposed")
        return Outcome(tuple(self._faults), happened, takes, recovered, dark_s)

    @contextlib.contextmanager
    def _capture(
        self, stage: CodedStage, retake: str = "", stopping: bool = False
    ) -> Iterator[subprocess.Popen[bytes]]:
        """The command, new or going on; ended with all that is its own on every way out."""
        does = (
            ["retake", str(self.root), retake] if retake else ["capture", "--out", str(self.root)]
        )
        command = [
            *(sys.executable, "-m", "lightstage", *does),
            *("--leds", stage.device.url(2.0, 3), "--cameras", str(stage.cameras_path)),
            *("--config", str(self._config), "--unattended"),
        ]
        if self.delete:
            command.append("--delete-from-cameras")
        if (self.root / "journal.jsonl").exists():
            command += [] if retake else ["--resume"]
        else:
            command += ["--rig", str(stage.rig_path), "--sequence", ",".join(SEQUENCE)]
            # At a cube's corners all weights are 1: to find that takes longer than to capture.
            command += ["--drive", "on-off"]
        environment = dict(os.environ)
        environment.pop("LIGHTSTAGE_STOP_FILE", None)
        if stopping:
            environment["LIGHTSTAGE_STOP_FILE"] = str(self._stop_file)
        with (self.desk / "said.txt").open("ab") as log:
            capture = subprocess.Popen(
                command, stdout=log, stderr=log, env=environment, start_new_session=True
            )
        family: list[Process] = []
        try:
            yield capture
        finally:
            self._stop_file.unlink(missing_ok=True)
            family += descendants(capture.pid)
            capture.kill()
            capture.wait()
            for each in family:
                kill(each.pid)

    def _stopped(self, capture: subprocess.Popen[bytes], wanted: Kill) -> Process | None:
        """Wait until a process has stopped at the step; None where the capture ended before."""
        stop = f"{wanted.step} {wanted.pattern} {wanted.camera}\n"
        write_text(self._stop_file, stop)
        while True:
            found: list[Process] = []
            if not wait_until(functools.partial(self._stands, capture, found), STOP_S):
                raise SimError(str(wanted), found="nothing stopped", expected="a stopped process")
            if not found:
                return None
            if wanted.event in ("", self._half_line()):
                return found[0]
            write_text(self._stop_file, stop)  # before it continues: the next one may come at once
            os.kill(found[0].pid, signal.SIGCONT)

    def _stands(self, capture: subprocess.Popen[bytes], found: list[Process]) -> bool:
        """Whether one of the capture's processes is stopped (put into `found`), or it ended."""
        if capture.poll() is not None:
            return True
        if not self._stop_file.exists():
            family = [process(capture.pid), *descendants(capture.pid)]
            found[:] = [each for each in family if each is not None and each.state == "T"]
        return bool(found)

    def _half_line(self) -> str:
        """The event of the line that is half on the disk."""
        journal = self.root / "journal.jsonl"
        path = journal if journal.exists() else journal.with_name(".journal.jsonl.begun")
        half = path.read_bytes().rpartition(b"\n")[2].decode()
        return half.partition('"event": "')[2].partition('"')[0]

    def _kill(
        self, capture: subprocess.Popen[bytes], stopped: Process, wanted: Kill, stage: CodedStage
    ) -> float:
        """SIGKILL to whom it is meant for; returns after how long the lights were dark."""
        family = descendants(capture.pid)
        if wanted.who == "camera":
            victim = stopped
            if wanted.step not in CAMERA_STEPS:
                victim = self._camera_process(family, wanted.camera)
                kill(victim.pid)
                os.kill(stopped.pid, signal.SIGCONT)
            kill(victim.pid)
            self._end(capture)  # by itself: the camera is started again
            if capture.returncode != 0:
                self._faults.append(
                    f"{wanted}: the capture did not outlive it: {self._output(capture)}"
                )
        elif wanted.who == "capture":
            kill(capture.pid)
            capture.wait()
        else:
            for each in family:
                os.kill(each.pid, signal.SIGSTOP)  # nobody may act on another's death
            for pid in (capture.pid, *(each.pid for each in family)):
                kill(pid)
            capture.wait()
        dark_s = self._dark_after_s(stage)
        if not wait_until(lambda: all(is_gone(each.pid) for each in family), DARK_S):
            left = [" ".join(each.command) for each in family if not is_gone(each.pid)]
            self._faults.append(f"{wanted}: processes outlive the capture: {'; '.join(left)}")
        return dark_s

    def _camera_process(self, family: Sequence[Process], camera: str) -> Process:
        for each in family:
            if "lightstage.cameras.worker" in each.command and camera in each.command:
                return each
        raise SimError(f"camera {camera}", found="no process of its own", expected="one")

    def _dark_after_s(self, stage: CodedStage) -> float:
        begun_s = time.monotonic()
        if not wait_until(lambda: stage.device.dark, DARK_S):
            self._faults.append(f"the lights are still on {DARK_S:g} s after the kill")
        return time.monotonic() - begun_s

    def _end(self, capture: subprocess.Popen[bytes]) -> None:
        try:
            capture.wait(END_S)
        except subprocess.TimeoutExpired:
            raise SimError("lightstage capture", found="no end", expected="one") from None

    def _finished(self) -> bool:
        lines = self._journal()
        return bool(lines) and lines[-1]["event"] == "end"

    def _journal(self) -> list[dict[str, Any]]:
        path = self.root / "journal.jsonl"
        return read_journal(path) if path.exists() else []

    def _output(self, capture: subprocess.Popen[bytes]) -> str:
        text = (self.desk / "said.txt").read_text(errors="replace")
        return f"exit code {capture.poll()}; {text[-2000:]}"

    # -- what must hold

    def _verify(self, stage: CodedStage) -> int:
        """Note what does not hold for the finished session; returns how many files recovered."""
        try:
            session = load_session(self.root)
            problems = [*missing_frames(session), *changed_frames(session)]
            labels = stage.labels(self.root)
            check_session(self.root)
        except LightstageError as error:
            self._faults.append(str(error))
            return 0
        self._faults += [str(problem) for problem in problems]
        if labels.right != len(SEQUENCE) * CAMERAS:
            self._faults.append(f"labels: {labels}")
        if not self._finished():
            self._faults.append("the journal has no end")
        if not (self.root / "manifest.json").is_file():
            self._faults.append("no manifest.json")
        if not stage.device.dark:
            self._faults.append("the lights are on")
        return self._verify_files(stage)

    def _verify_files(self, stage: CodedStage) -> int:
        """Every file of every card once on the disk, as in the journal; nothing left over."""
        files = [p for f in ("frames", "recovered") for p in (self.root / f).rglob("*")]
        there = [path for path in files if path.is_file()]
        hashes = collections.Counter(sha256_file(path) for path in there)
        for path in there:
            if path.name.startswith("."):
                self._faults.append(f"left over: {path}")
        for camera in self.rig.cameras:
            cards = sorted((stage.cameras.folder(camera.id) / "card").glob("*.DNG"))
            for file in cards:
                if (count := hashes[sha256_file(file)]) != 1:
                    self._faults.append(f"{camera.id}, {file.name}: {count} times on the disk")
        recorded = {line.get("path"): line.get("sha256") for line in self._journal()}
        for path in there:
            if recorded.get(path.relative_to(self.root).as_posix()) != sha256_file(path):
                self._faults.append(f"{path}: the journal does not know these bytes")
        return sum(1 for path in there if "recovered" in path.relative_to(self.root).parts)
