"""A session through the devices' wires: `lightstage capture` between lamps and cameras."""

from __future__ import annotations

import contextlib
import hashlib
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from lightstage.formats.files import write_json, write_text
from lightstage.rig import Camera, save_rig
from sim.camera_device import CameraFolders
from sim.dng import dng_bytes
from sim.errors import SimError
from sim.led_device import LedDevice
from sim.sensor import Sensor, SensorConfig, calibrate_colour, make_sensor
from sim.world import World

SETTLE_TIMEOUT_S = 110.0
"""Lamps of the simulator settle when nine pictures are rendered; the driver waits that long."""
POLL_S = 0.05
STOP_S = 30.0


class Photographer:
    """Turns the lamps' state into each camera's next photograph.

    A photograph is a function of the levels, the camera and the seed alone: taken twice under one
    light it is the same to the byte.

    Args:
        world: the person in the rig.
        seed: of sensors and noise.
        config: of the sensors.
    """

    def __init__(self, world: World, seed: int, config: SensorConfig | None = None) -> None:
        self.world = world
        self.seed = seed
        peak = world.skin_peak()
        self.sensors: dict[str, Sensor] = {
            camera.id: make_sensor(config or SensorConfig(), peak, self._rng(camera.id, b"sensor"))
            for camera in world.rig.cameras
        }

    def photograph(self, camera: Camera, levels: np.ndarray) -> bytes:
        """One camera's DNG under (m,) levels."""
        return self._develop(camera, levels, self.world.photograph(camera.id, levels[None])[0])

    def photographs(self, levels: np.ndarray, folders: CameraFolders) -> None:
        """Put what every camera sees under (m,) levels into its folder."""
        with ThreadPoolExecutor(1) as pool:
            pending = []
            for camera in self.world.rig.cameras:
                # The next camera is shaded while this one's counts are drawn.
                light = self.world.photograph(camera.id, levels[None])[0]
                pending.append(pool.submit(self._put, camera, levels, light, folders))
            for job in pending:
                job.result()

    def colour_calibration(self) -> dict[str, object]:
        """FORMATS' colour calibration of all cameras, from simulated chart photographs."""
        cameras = {
            camera_id: {
                "linear_from_raw": calibrate_colour(sensor, self._rng(camera_id, b"chart")).tolist()
            }
            for camera_id, sensor in self.sensors.items()
        }
        return {"schema": "lightstage.colour/1", "cameras": cameras}

    def _put(
        self, camera: Camera, levels: np.ndarray, light: np.ndarray, folders: CameraFolders
    ) -> None:
        folders.put(camera.id, self._develop(camera, levels, light))

    def _develop(self, camera: Camera, levels: np.ndarray, light: np.ndarray) -> bytes:
        sensor = self.sensors[camera.id]
        state = np.round(np.asarray(levels) * 65535).astype("<u2").tobytes()
        return dng_bytes(sensor.expose(light, self._rng(camera.id, state)), sensor, camera.model)

    def _rng(self, camera_id: str, what: bytes) -> np.random.Generator:
        digest = hashlib.sha256(camera_id.encode() + b"\0" + what).digest()
        return np.random.default_rng([self.seed, *np.frombuffer(digest, "<u4").tolist()])


def capture_session(world: World, out: Path, seed: int, sequence: str) -> Path:
    """Let `lightstage capture` photograph a simulated person.

    The LED device stands behind a real pseudo-terminal; nine folders serve libgphoto2's virtual
    cameras. A camera's file changes only when the device's decoded state does, and the device
    acknowledges a state when all nine files are in place.

    Args:
        world: the person in the rig.
        out: session folder, written by `lightstage capture`.
        seed: of sensors and noise.
        sequence: as `lightstage capture` takes it; that command draws its own bar.

    Raises:
        SimError: the capture failed (it has said why on stderr).
    """
    photographer = Photographer(world, seed)
    with tempfile.TemporaryDirectory(prefix="lightstage-sim-") as name:
        desk = Path(name)
        folders = CameraFolders(desk / "cameras", [camera.id for camera in world.rig.cameras])
        photographer.photographs(np.zeros(len(world.rig.lights)), folders)
        save_rig(world.rig, desk / "rig.json")
        write_json(desk / "colour.json", photographer.colour_calibration())
        write_text(desk / "cameras.toml", folders.cameras_file())

        def show(levels: np.ndarray) -> None:
            photographer.photographs(levels, folders)

        with LedDevice(len(world.rig.lights), show) as device:
            command = [
                *(sys.executable, "-m", "lightstage", "capture"),
                *("--rig", str(desk / "rig.json"), "--sequence", sequence, "--out", str(out)),
                *("--leds", device.url(SETTLE_TIMEOUT_S), "--cameras", str(desk / "cameras.toml")),
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
    return out


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
