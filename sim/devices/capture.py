"""A session through the devices' wires: `lightstage capture` between lamps and cameras."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from lightstage.formats.files import write_json, write_text
from lightstage.patterns import sequence_patterns
from sim.camera.flaws import CaptureFlaws
from sim.camera.shooting import LitSubject
from sim.devices.faults import FaultLog, Story
from sim.devices.standing_stage import standing_stage
from sim.errors import SimError
from sim.session import faults_path, flaws_path

POLL_S = 0.05
STOP_S = 30.0


def capture_session(
    world: LitSubject,
    out: Path,
    seed: int,
    sequence: str,
    flaws: CaptureFlaws | None = None,
    story: Story | None = None,
    config: Path | None = None,
    consent: str | None = None,
) -> Path:
    """Let `lightstage capture` photograph a simulated person.

    The LED device is behind a real pseudo-terminal; nine folders serve libgphoto2's virtual
    cameras. A camera's file changes only when the device's decoded state does, and the device
    acknowledges a state when all nine files are in place.

    Args:
        world: the person in the rig.
        out: session folder, written by `lightstage capture`.
        seed: of sensors and noise.
        sequence: as `lightstage capture` takes it; that command draws its own bar.
        flaws: as in `Photographer`. What was done is written into the truth's folder.
        story: what goes wrong with the devices; what happened is written beside that. The cameras
            are simulated ones then, which can have every fault.
        config: of `lightstage capture`; its defaults where absent.
        consent: id of a consent record, None for none.

    Raises:
        SimError: the capture failed (it has printed why on stderr).
    """
    patterns = sequence_patterns(sequence, world.rig)
    log = None if story is None else _new_log(faults_path(out))
    with (
        tempfile.TemporaryDirectory(prefix="lightstage-sim-") as name,
        standing_stage(world, Path(name), seed, patterns, flaws, story, log) as stage,
    ):
        command = [sys.executable, "-m", "lightstage", *stage.command(out), "--sequence", sequence]
        command += [] if config is None else ["--config", str(config)]
        command += [] if consent is None else ["--consent", consent]
        with _running(command) as process:
            while process.poll() is None and stage.device.failure is None:
                time.sleep(POLL_S)
            if stage.device.failure is not None:
                process.kill()  # it would wait long for lamps that no longer answer
        if stage.device.failure is not None:
            raise stage.device.failure
    if process.returncode != 0:
        raise SimError(
            "lightstage capture",
            found=f"exit code {process.returncode}",
            expected="0",
            hint="Its own message is above.",
        )
    write_json(flaws_path(out), stage.photographer.record(patterns))
    return out


def _new_log(path: Path) -> FaultLog:
    """A log in an empty file: also where nothing happens, it is there to be read."""
    write_text(path, "")
    return FaultLog(path)


@contextlib.contextmanager
def _running(command: list[str]) -> Iterator[subprocess.Popen[bytes]]:
    """A child process that is asked to end, and waited for, on every way out."""
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=sys.stderr)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.terminate()
            try:
                process.wait(STOP_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
