"""Sessions in pairs of people on one standing stage, killed and troubled at random.

Nine simulated cameras and an LED device stand through the whole trial, and have every fault that
the simulator knows. Many second sessions begin with a camera that gives the last picture of the
person before. Each session is `lightstage capture --unattended`, killed (`kill -9`) at random
moments: the capture alone, a camera's process, or every process of it; an operator mends what an
operator can, and resumes it until it ends. Every photograph's pixels hold which camera took it
under which state of the lamps, and so in whose session.

``python -m benchmarks.capture_trials``: 100 sessions of three patterns; ``--sessions 10`` to try.
"""

from __future__ import annotations

import argparse
import collections
import dataclasses
import json
import random
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.acquisition_faults import CONFIG, trial_rig
from benchmarks.fault_story import faults_injected, operator_mends, trial_story
from benchmarks.record import record
from lightstage.formats.files import write_json, write_text
from lightstage.session import read_journal
from sim.devices.coded_stage import CodedStage
from sim.devices.processes import descendants, kill, wait_until

SEQUENCE = ("full", "x+", "x-")
MOST_TRIES = 25
"""A session that has not ended after so many captures is stuck."""
KILLED = 0.6
"""Share of the first captures of a session that are killed; half as many of those that resume."""
LATEST_KILL_S = 12.0
LONGEST_S = 180.0
DARK_S = 15.0
NEVER = 10**9
STALE = 0.5
"""Share of second sessions that begin with an old picture of one camera."""


@dataclasses.dataclass
class Sum:
    """What the sessions came to; names of photographs or sessions where something is wrong."""

    sessions: int = 0
    photographs: int = 0
    kills: int = 0
    resumes: int = 0
    old_pictures: int = 0
    lost: list[str] = dataclasses.field(default_factory=list)
    mislabelled: list[str] = dataclasses.field(default_factory=list)
    of_another: list[str] = dataclasses.field(default_factory=list)
    doubled: list[str] = dataclasses.field(default_factory=list)
    wrong_light: list[str] = dataclasses.field(default_factory=list)
    stuck: list[str] = dataclasses.field(default_factory=list)
    lit: list[str] = dataclasses.field(default_factory=list)


class CaptureTrials:
    """The trial.

    Args:
        desk: a new folder.
        seed: of faults and kills.
    """

    def __init__(self, desk: Path, seed: int) -> None:
        self.desk = desk
        self.sum = Sum()
        self._random = random.Random(seed)
        self._config = write_text(desk / "config.toml", CONFIG)

    def run(self, sessions: int, seed: int) -> Sum:
        """Take the sessions one after the other."""
        rig = trial_rig()
        story = trial_story(rig, sessions * len(SEQUENCE), seed)
        begun_s = time.monotonic()
        with CodedStage(self.desk / "sim", rig, story, seed, watchdog_s=2.0) as stage:
            for number in range(sessions):
                if number % 2 and self._random.random() < STALE:
                    self._give_old_picture(stage)
                self._session(stage, self.desk / "sessions" / f"session-{number:03d}")
                counts = (
                    f"{number + 1} sessions, {self.sum.kills} kills, {self.sum.resumes} resumes"
                )
                print(f"{counts}, {time.monotonic() - begun_s:.0f} s", file=sys.stderr, flush=True)
        return self.sum

    def _give_old_picture(self, stage: CodedStage) -> None:
        """Have a camera give, at its next shot, the last picture of the person before."""
        folder = stage.cameras.folder(self._random.choice(stage.cameras.camera_ids))
        at = json.loads((folder / "state.json").read_text())["shots"] + 1
        value = json.loads((folder / "camera.json").read_text())
        # Not at the end, where the operator looks for the camera that was exchanged.
        value["story"]["fault"].insert(-1, {"name": "stale", "at": at, "until": at})
        write_json(folder / "camera.json", value)
        self.sum.old_pictures += 1

    def _session(self, stage: CodedStage, root: Path) -> None:
        since = stage.lights
        self.sum.sessions += 1
        followed = 0
        for tried in range(MOST_TRIES):
            going_on = (root / "journal.jsonl").exists()
            share = KILLED if tried == 0 else KILLED / 2
            after_s = self._random.uniform(0.5, LATEST_KILL_S) if self._chance(share) else None
            ended = self._capture(stage, root, going_on, after_s) == 0
            if ended or _is_finished(root):  # it may be killed after its last line
                break
            self.sum.resumes += 1
            errors = [each for each in self._printed().splitlines() if "Error: " in each]
            print(f"{root.name}: {(errors or ['nothing'])[-1][:200]}", file=sys.stderr)
            operator_mends(stage)
            _put_cards_in(stage)
            advised = self._advised_retakes(root)
            if len(advised) > followed and self._run(advised[-1], None) == 0:
                break
            followed = len(advised)
        else:
            self.sum.stuck.append(root.name)
        if not wait_until(lambda: stage.device.dark, DARK_S):
            self.sum.lit.append(root.name)
        if root.name in self.sum.stuck:
            return
        labels = stage.labels(root, since)
        self.sum.photographs += len(SEQUENCE) * len(stage.rig.cameras)
        for into, found in (
            (self.sum.lost, (*labels.missing, *labels.unreadable)),
            (self.sum.mislabelled, labels.mislabelled),
            (self.sum.of_another, labels.of_another),
            (self.sum.doubled, labels.doubled),
            (self.sum.wrong_light, labels.wrong_light),
        ):
            into += [f"{root.name}: {each}" for each in found]

    def _advised_retakes(self, root: Path) -> list[list[str]]:
        """The commands that a session's captures advised, for taking other patterns again."""
        begins = f"lightstage retake {root} "
        lines = [line for line in self._printed().splitlines() if begins in line]
        words = [shlex.split(line[line.index(begins) :]) for line in lines]
        return [[sys.executable, "-m", *each] for each in words]

    def _printed(self) -> str:
        """What all captures have printed so far."""
        return (self.desk / "said.txt").read_text(errors="replace")

    def _chance(self, share: float) -> bool:
        return self._random.random() < share

    def _capture(self, stage: CodedStage, root: Path, going_on: bool, after_s: float | None) -> int:
        """Run the command; its exit code, or -9 where it was killed."""
        command = [
            *(sys.executable, "-m", "lightstage", "capture", "--out", str(root)),
            *("--leds", stage.device.url(0.5, 5), "--cameras", str(stage.cameras_path)),
            *("--config", str(self._config), "--unattended"),
        ]
        new = ["--rig", str(stage.rig_path), "--sequence", ",".join(SEQUENCE)]
        command += ["--resume"] if going_on else new
        return self._run(command, after_s)

    def _run(self, command: Sequence[str], after_s: float | None) -> int:
        """Run a command; its exit code, or -9 where it was killed."""
        with (self.desk / "said.txt").open("ab") as log:
            child = subprocess.Popen(command, stdout=log, stderr=log, start_new_session=True)
        try:
            if after_s is not None and not wait_until(lambda: child.poll() is not None, after_s):
                self._kill(child)
            return child.wait(LONGEST_S)
        except subprocess.TimeoutExpired:
            return -1
        finally:
            family = descendants(child.pid)
            for each in (child.pid, *(one.pid for one in family)):
                kill(each)
            child.wait()

    def _kill(self, child: subprocess.Popen[bytes]) -> None:
        """SIGKILL to the capture alone, to one camera's process, or to all of it."""
        family = descendants(child.pid)
        workers = [each.pid for each in family if "lightstage.cameras.worker" in each.command]
        who = self._random.choice(("capture", "camera", "all"))
        self.sum.kills += 1
        if who == "camera" and workers:
            kill(self._random.choice(workers))
            return
        kill(child.pid)
        if who == "all":
            for each in family:
                kill(each.pid)
        child.wait()
        time.sleep(0.1)  # the guardian's turn, which is not of the capture's family any more


def _is_finished(root: Path) -> bool:
    """Whether a session's journal has its last line."""
    path = root / "journal.jsonl"
    return path.exists() and read_journal(path)[-1]["event"] == "end"


def _put_cards_in(stage: CodedStage) -> None:
    """An operator puts a larger card into each camera whose card is full now.

    The fault is put off for ever, not taken out: what is drawn depends on its place in the story.
    """
    for camera_id in stage.cameras.camera_ids:
        folder = stage.cameras.folder(camera_id)
        shot = json.loads((folder / "state.json").read_text())["shots"] + 1
        value = json.loads((folder / "camera.json").read_text())
        for fault in value["story"]["fault"]:
            if fault["name"] == "fill-up" and fault["at"] <= shot <= fault["until"]:
                fault |= {"at": NEVER, "until": NEVER}
                write_json(folder / "camera.json", value)


def rows(seconds: float, total: Sum) -> Sequence[Sequence[object]]:
    """The table's one line."""
    wrong = (
        total.lost, total.mislabelled, total.of_another, total.doubled, total.wrong_light,
        total.stuck, total.lit,
    )  # fmt: skip
    counts = (total.sessions, total.photographs, total.kills, total.resumes, total.old_pictures)
    return [[*counts, *map(len, wrong), f"{seconds:.0f}"]]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sessions", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1, help="of what goes wrong")
    given = parser.parse_args()
    begun_s = time.monotonic()
    with tempfile.TemporaryDirectory() as name:
        total = CaptureTrials(Path(name), given.seed).run(given.sessions, given.seed)
        happened = faults_injected(Path(name) / "sim" / "faults.jsonl")
        printed = (Path(name) / "said.txt").read_text(errors="replace")
    seconds = time.monotonic() - begun_s
    for field, value in dataclasses.asdict(total).items():
        for each in value if isinstance(value, list) else ():
            print(f"{field}: {each}", file=sys.stderr)
    ends = collections.Counter(line[:160] for line in printed.splitlines() if "Error: " in line)
    for line, count in ends.most_common(10):
        print(f"gave up {count} times: {line}", file=sys.stderr)
    if "Traceback" in printed:
        print(f"a traceback: {printed[printed.index('Traceback') :][:3000]}", file=sys.stderr)
    header = [
        *("sessions", "photographs", "kills", "resumes", "old pictures"),
        *("lost", "mislabelled", "of another person", "doubled", "wrong light"),
        *("stuck", "lit at the end", "s"),
    ]
    record(
        "Captures in pairs of people: killed and troubled at random",
        header,
        rows(seconds, total),
        f"Faults that happened: {', '.join(f'{k} {n}' for k, n in sorted(happened.items()))}. "
        "Old pictures: of the person before, at a session's first shot. "
        "Wrong light: a lamp that failed and reported that it had not. Tested with "
        "simulated cameras and lights.",
    )


if __name__ == "__main__":
    main()
