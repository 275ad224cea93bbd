"""A thousand shots, one in ten with a fault of every kind: what is lost, what is mislabelled.

Nine simulated cameras and an LED device have every fault that the simulator knows; `lightstage
capture --unattended` takes the shots, and is resumed (`--resume`) whenever it gives up, as by an
operator who changes batteries and turns wheels back meanwhile. Every photograph's pixels hold
which camera took it under which light, and are read at the end. Beside it the gphoto2 command line
under those of the faults that libgphoto2's virtual cameras can have (benchmarks/gphoto2_faults.py).
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.fault_story import faults_injected, operator_mends, trial_story
from benchmarks.gphoto2_faults import cli_rows, require_cli
from benchmarks.record import record
from lightstage.formats.files import write_text
from lightstage.patterns.names import BINARY
from lightstage.rig import Rig, default_rig
from sim.devices.coded_photographer import EXPOSURE_S
from sim.devices.coded_stage import CodedStage, Labels
from sim.devices.faults import Story

WIDTH_PX, HEIGHT_PX = 48, 64
CONFIG = """
[deadlines]
open_s = 20.0
trigger_s = 4.0
download_s = 3.0
other_s = 5.0

# Nobody sits in the simulated stage: light may change as fast as it can.
[safety]
light_interval_s = 0.02
max_flashes_per_s = 30.0
max_light_on_s = 86400.0
max_heat = 1.0

# Pictures of 48 x 64 pixels have hardly any fine detail.
[checks]
min_sharpness = 0.0
warn_sharpness = 0.0

[operator]
retakes = 3
"""
MOST_RESUMES = 400
SAMPLE_S = 0.25


@dataclasses.dataclass
class Trial:
    """The outcome of a trial.

    Attributes:
        shots: patterns photographed by all cameras.
        photographs: that count.
        labels: of all sessions together.
        retakes: photographs taken again.
        resumes: captures that gave up and were resumed.
        reasons: the line with which each of them ended.
        seconds: of all captures, devices' connecting included.
        taking_s: of these, from the first light on.
        overhead_s: of these, beside lights, exposures and pauses (finished captures).
        memory: of each process, (shots done, MB) as sampled.
    """

    shots: int = 0
    photographs: int = 0
    labels: Labels = dataclasses.field(default_factory=Labels)
    retakes: int = 0
    resumes: int = 0
    reasons: list[str] = dataclasses.field(default_factory=list)
    seconds: float = 0.0
    taking_s: float = 0.0
    memory: list[np.ndarray] = dataclasses.field(default_factory=list)


def trial_rig() -> Rig:
    """The default rig with tiny pictures."""
    whole = default_rig()
    small = [
        dataclasses.replace(camera.scaled(0.01), width_px=WIDTH_PX, height_px=HEIGHT_PX)
        for camera in whole.cameras
    ]
    return Rig(whole.lights, tuple(small))


def sequences(rig: Rig, shots: int) -> list[list[str]]:
    """Patterns of sessions that come to so many shots together."""
    names = ["full", *BINARY, *(f"lin-{name}" for name in BINARY)]
    names += [f"olat-{light.id:03d}" for light in rig.lights]
    out = []
    while shots > 0:
        out.append(names[:shots])
        shots -= len(out[-1])
    return out


def run_trial(desk: Path, shots: int, story: Story | None, seed: int) -> Trial:
    """Take the shots, session after session."""
    rig = trial_rig()
    trial = Trial()
    config = write_text(desk / "config.toml", CONFIG)
    with CodedStage(desk / "sim", rig, story, seed) as stage:
        for number, patterns in enumerate(sequences(rig, shots)):
            root = desk / f"session-{number}"
            _take(stage, root, patterns, config, trial)
            trial.labels = _added(trial.labels, stage.labels(root))
            trial.shots += len(patterns)
            trial.photographs += len(patterns) * len(rig.cameras)
            print(
                f"{trial.shots} shots, {trial.resumes} resumes, {trial.retakes} retakes, "
                f"{trial.seconds:.0f} s",
                file=sys.stderr,
            )
    return trial


def _take(
    stage: CodedStage, root: Path, patterns: Sequence[str], config: Path, trial: Trial
) -> None:
    """One session to its end, resumed as often as it must be."""
    common = [
        *(sys.executable, "-m", "lightstage", "capture", "--out", str(root)),
        *("--leds", stage.device.url(0.5, 5), "--cameras", str(stage.cameras_path)),
        *("--config", str(config), "--unattended", "--json"),
    ]
    first = ["--rig", str(stage.rig_path), "--sequence", ",".join(patterns)]
    more = first
    for _ in range(MOST_RESUMES):
        done = _watched([*common, *more], root, trial)
        if done.returncode == 0:
            break
        errors = [line for line in done.stderr.splitlines() if "Error: " in line]
        trial.reasons.append((errors or ["nothing"])[-1][:300])
        print(f"gave up: {trial.reasons[-1]}", file=sys.stderr)
        if done.returncode != 2 or "Traceback" in done.stderr:
            raise SystemExit(f"exit code {done.returncode}:\n{done.stderr}")
        trial.resumes += 1
        operator_mends(stage)
        more = ["--resume"] if (root / "journal.jsonl").exists() else first
    else:
        raise SystemExit(f"given up after {MOST_RESUMES} resumes: {trial.reasons[-1]}")
    lines = [json.loads(line) for line in (root / "journal.jsonl").read_text().splitlines()]
    triggers = sum(len(line["takes"]) for line in lines if line["event"] == "trigger")
    trial.retakes += triggers - len(patterns) * len(stage.rig.cameras)


def _watched(command: Sequence[str], root: Path, trial: Trial) -> subprocess.CompletedProcess[str]:
    """Run a capture, and sample its own memory over the shots that are done."""
    begun = time.monotonic()
    samples: list[tuple[int, float]] = []
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        child = subprocess.Popen(command, stdout=out, stderr=err, text=True)
        while child.poll() is None:
            samples.append((_shots_done(root), _memory_mb(child.pid)))
            time.sleep(SAMPLE_S)
        out.seek(0)
        err.seek(0)
        done = subprocess.CompletedProcess(command, child.returncode, out.read(), err.read())
    trial.seconds += time.monotonic() - begun
    if done.returncode == 0:
        trial.taking_s += float(json.loads(done.stdout.splitlines()[-1])["seconds"])
    trial.memory.append(np.array([each for each in samples if each[1] > 0], float).reshape(-1, 2))
    return done


def _shots_done(root: Path) -> int:
    """Shots that a session's journal reports as done."""
    path = root / "journal.jsonl"
    return path.read_bytes().count(b'"event": "shot"') if path.exists() else 0


def _memory_mb(pid: int) -> float:
    """Resident memory of a process; 0 when it has ended."""
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return 0.0
    lines = [line for line in status.splitlines() if line.startswith("VmRSS")]
    return float(lines[0].split()[1]) / 1000 if lines else 0.0


def _added(one: Labels, other: Labels) -> Labels:
    """The labels of two sessions together."""
    names = [field.name for field in dataclasses.fields(Labels)]
    return Labels(**{name: getattr(one, name) + getattr(other, name) for name in names})


def slope_mb(memory: Sequence[np.ndarray], settled: int = 20) -> float:
    """MB that the capture's process grows by in 1,000 shots; NaN where too few are sampled.

    Each process's own mean is taken off, and its first shots are left out.
    """
    parts = []
    for samples in memory:
        first = samples[0, 0] if len(samples) else 0
        kept = samples[samples[:, 0] >= first + settled]
        if len(kept) > 3:
            parts.append(kept - kept.mean(axis=0))
    if not parts:
        return float("nan")
    x, y = np.concatenate(parts).T
    return float(1000 * (x @ y) / (x @ x)) if x @ x > 0 else float("nan")


def row(name: str, trial: Trial) -> list[object]:
    """A trial as a line of the table."""
    labels = trial.labels
    overhead_s = (trial.seconds - trial.shots * EXPOSURE_S) / trial.shots
    return [
        name,
        trial.shots,
        trial.photographs,
        len(labels.missing),
        len(labels.mislabelled),
        len(labels.unreadable),
        len(labels.doubled),
        len(labels.wrong_light),
        trial.retakes,
        trial.resumes,
        f"{trial.seconds:.0f}",
        f"{overhead_s:.3f}",
        f"{slope_mb(trial.memory):.1f}",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--shots", type=int, default=1000, help="of nine photographs each")
    parser.add_argument("--cli-shots", type=int, default=100, help="of the gphoto2 command line")
    parser.add_argument("--seed", type=int, default=1, help="of what goes wrong")
    parser.add_argument("--keep", type=Path, help="folder to keep everything in")
    given = parser.parse_args()
    require_cli()
    rig = trial_rig()
    with tempfile.TemporaryDirectory() as name:
        desk = given.keep or Path(name)
        story = trial_story(rig, given.shots, given.seed)
        faulty = run_trial(desk / "faults", given.shots, story, given.seed)
        happened = faults_injected(desk / "faults" / "sim" / "faults.jsonl")
        calm_shots = min(given.shots, len(sequences(rig, 10_000)[0]))
        calm = run_trial(desk / "calm", calm_shots, None, given.seed)
        peers = cli_rows(desk / "cli", rig, given.cli_shots, given.seed)
    for each in dataclasses.fields(Labels)[1:]:
        for reason in getattr(faulty.labels, each.name)[:10]:
            print(f"{each.name}: {reason}", file=sys.stderr)
    for reason in sorted(set(faulty.reasons)):
        print(f"gave up {faulty.reasons.count(reason)} times: {reason}", file=sys.stderr)
    record(
        "Acquisition under faults: 1,000 shots",
        [
            "run",
            "shots",
            "photographs",
            "lost",
            "mislabelled",
            "unreadable",
            "doubled",
            "wrong light",
            "retakes",
            "resumes",
            "s",
            "overhead s a shot",
            "MB per 1,000 shots",
        ],
        [row("with faults", faulty), row("without", calm)],
        f"Faults that happened: {', '.join(f'{k} {n}' for k, n in sorted(happened.items()))}. "
        "Overhead: all time beside the exposures, resuming included. Wrong light: a lamp that "
        "failed and reported that it had not. Tested with simulated cameras and lights.",
    )
    record(
        "Acquisition under faults: the gphoto2 command line",
        [
            "how",
            "photographs",
            "faults",
            "said to be done",
            "lost",
            "of these deleted on the camera",
            "of another light",
            "cut",
            "s a shot",
        ],
        peers,
        "One process a camera and shot, as a script does: taken again once when it fails. Faults "
        "that libgphoto2's virtual camera can have, and disks: 5 % of photographs.",
    )


if __name__ == "__main__":
    main()
