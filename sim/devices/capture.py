"""A session through the devices' wires: `lightstage capture` between lamps and cameras."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.errors import PatternError
from lightstage.formats.environment import white_reading
from lightstage.formats.files import write_json, write_text
from lightstage.patterns import Drive, drive_levels, sequence_patterns
from lightstage.rig import Camera, save_rig
from sim.camera.chart import calibrate_colour
from sim.camera.dng import Exif, dng_bytes
from sim.camera.flaws import CaptureFlaws
from sim.camera.optics import own_rng
from sim.camera.sensor import Sensor, make_sensor
from sim.camera.shooting import LitSubject, Shooting
from sim.devices.camera_device import CameraFolders
from sim.devices.faults import FaultLog, Story
from sim.devices.led_device import LedDevice
from sim.devices.story_cameras import ATTEMPTS, TIMEOUT_S, Lens, StoryCameras
from sim.errors import SimError
from sim.light.polarised import seen_through
from sim.session import faults_path, flaws_path

SETTLE_TIMEOUT_S = 110.0
"""Lamps of the simulator settle when nine pictures are rendered; the driver waits that long."""
POLL_S = 0.05
STOP_S = 30.0


class Photographer:
    """Turns the lamps' state into each camera's next photograph.

    A photograph is a function of the levels, the camera and the seed alone: taken twice under one
    light it is the same to the byte. Where the subject sways, its pose goes with the state's place
    in `sequence`.

    Args:
        world: the person in the rig.
        seed: of lenses, sensors, sway and noise.
        flaws: what the apparatus does to the light; the default adds the sensor's noise alone.
        sequence: patterns that will be shot, in order; other states are taken as the first of them.
        drive: how the stage drives its lamps; cameras are exposed for its `full`.
    """

    def __init__(
        self,
        world: LitSubject,
        seed: int,
        flaws: CaptureFlaws | None = None,
        sequence: Sequence[str] = (),
        drive: Drive = "solid-angle",
    ) -> None:
        self.world = world
        self.seed = seed
        flaws = flaws or CaptureFlaws()
        self.shooting = Shooting(world, flaws, seed)
        self._shots: dict[bytes, int] = {}
        for shot, name in enumerate(sequence):
            # An unknown name is refused by `lightstage capture`, in its own words.
            with contextlib.suppress(PatternError):
                self._shots.setdefault(_state(drive_levels(name, world.rig, drive)), shot)
        self.drive = drive
        self.full = drive_levels("full", world.rig, drive)
        peak = world.skin_peak(levels=self.full)
        self.sensors: dict[str, Sensor] = {
            camera.id: make_sensor(flaws.sensor, peak, own_rng(seed, camera.id, b"sensor"))
            for camera in world.rig.cameras
        }

    def photograph(self, camera: Camera, levels: np.ndarray) -> bytes:
        """One camera's DNG under (m,) levels."""
        return self._develop(camera, levels, self._light(camera, levels))

    def photographs(self, levels: np.ndarray, folders: Lens) -> None:
        """Put what every camera sees under (m,) levels into its folder."""
        with ThreadPoolExecutor(1) as pool:
            pending = []
            for camera in self.world.rig.cameras:
                # The next camera is shaded while this one's counts are drawn.
                light = self._light(camera, levels)
                pending.append(pool.submit(self._put, camera, levels, light, folders))
            for job in pending:
                job.result()

    def colour_calibration(self) -> dict[str, object]:
        """FORMATS' colour calibration of all cameras, from simulated chart photographs."""
        white = white_reading(self.world.rig, self.full)
        cameras = {
            camera_id: {
                "linear_from_raw": calibrate_colour(
                    sensor, own_rng(self.seed, camera_id, b"chart"), white
                ).tolist()
            }
            for camera_id, sensor in self.sensors.items()
        }
        levels = self.full.tolist()
        return {"schema": "lightstage.colour/1", "cameras": cameras, "full_levels": levels}

    def record(self, sequence: Sequence[str]) -> dict[str, Any]:
        """What was done to the light of a sequence's photographs, for the truth."""
        shots = {
            name: self._shots.get(_state(drive_levels(name, self.world.rig, self.drive)), 0)
            for name in sequence
        }
        sensors = {
            camera_id: {
                "raw_from_linear": sensor.raw_from_linear.tolist(),
                "exposure_s": sensor.exposure_s,
                "iso": sensor.config.iso,
                "electrons_per_dn": sensor.config.gain_e_per_dn,
                "read_noise_e": sensor.config.noise_e,
            }
            for camera_id, sensor in self.sensors.items()
        }
        return self.shooting.record(shots, self._exposure_s) | {"sensors": sensors}

    @property
    def _exposure_s(self) -> float:
        return next(iter(self.sensors.values())).exposure_s

    def _light(self, camera: Camera, levels: np.ndarray) -> np.ndarray:
        shot = self._shots.get(_state(levels), 0)
        return self.shooting.light(camera.id, levels[None], [shot], self._exposure_s)[0]

    def _put(self, camera: Camera, levels: np.ndarray, light: np.ndarray, folders: Lens) -> None:
        folders.put(camera.id, self._develop(camera, levels, light))

    def _develop(self, camera: Camera, levels: np.ndarray, light: np.ndarray) -> bytes:
        sensor, lens = self.sensors[camera.id], self.shooting.lenses[camera.id]
        counts = sensor.expose(light, own_rng(self.seed, camera.id, _state(levels)))
        exif = Exif(camera.model, camera.serial, lens.config.f_number, lens.focal_mm)
        return dng_bytes(counts, sensor, exif)


def _state(levels: np.ndarray) -> bytes:
    """Lamps' levels as the wire carries them."""
    return np.round(np.asarray(levels) * 65535).astype("<u2").tobytes()


def capture_session(
    world: LitSubject,
    out: Path,
    seed: int,
    sequence: str,
    flaws: CaptureFlaws | None = None,
    story: Story | None = None,
) -> Path:
    """Let `lightstage capture` photograph a simulated person.

    The LED device stands behind a real pseudo-terminal; nine folders serve libgphoto2's virtual
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

    Raises:
        SimError: the capture failed (it has said why on stderr).
    """
    patterns = sequence_patterns(sequence, world.rig)
    world = seen_through(world, patterns)
    photographer = Photographer(world, seed, flaws, patterns)
    with tempfile.TemporaryDirectory(prefix="lightstage-sim-") as name:
        desk = Path(name)
        dark = np.zeros(len(world.rig.lights))
        folders: CameraFolders | StoryCameras
        log, timeout_s, attempts = FaultLog(), SETTLE_TIMEOUT_S, 1
        if story is None:
            folders = CameraFolders(desk / "cameras", [camera.id for camera in world.rig.cameras])
        else:
            log, timeout_s, attempts = _new_log(faults_path(out)), TIMEOUT_S, ATTEMPTS
            folders = StoryCameras(desk / "cameras", world.rig, story, log)
            for pattern in patterns:
                levels = drive_levels(pattern, world.rig)
                photographer.photographs(levels, folders.shelf(levels))
            photographer.photographs(dark, folders.shelf(dark))

        def show(levels: np.ndarray) -> None:
            if not (isinstance(folders, StoryCameras) and folders.recall(levels)):
                photographer.photographs(levels, folders)

        show(dark)
        save_rig(world.rig, desk / "rig.json")
        write_json(desk / "colour.json", photographer.colour_calibration())
        write_text(desk / "cameras.toml", folders.cameras_file())
        banks = [light.bank for light in world.rig.lights]
        with LedDevice(len(banks), show, 1, story, log, banks) as device:
            command = [
                *(sys.executable, "-m", "lightstage", "capture"),
                *("--rig", str(desk / "rig.json"), "--sequence", sequence, "--out", str(out)),
                *("--leds", device.url(timeout_s, attempts)),
                *("--cameras", str(desk / "cameras.toml")),
                *("--subject", world.subject.name, "--expression", world.subject.expression),
                *("--colour", str(desk / "colour.json")),
            ]
            with _running(command) as process:
                while process.poll() is None and device.failure is None:
                    time.sleep(POLL_S)
                if device.failure is not None:
                    process.kill()  # it would wait long for lamps that no longer answer
            if device.failure is not None:
                raise device.failure
    if process.returncode != 0:
        raise SimError(
            "lightstage capture",
            found=f"exit code {process.returncode}",
            expected="0",
            hint="Its own message is above.",
        )
    write_json(flaws_path(out), photographer.record(patterns))
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
