"""What cameras see of a simulated person under any state of the lamps."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from lightstage.errors import PatternError
from lightstage.formats.environment import white_reading
from lightstage.patterns import Drive, drive_levels
from lightstage.rig import Camera, Rig
from sim.camera.chart import calibrate_colour
from sim.camera.dng import Exif, dng_bytes
from sim.camera.flaws import CaptureFlaws
from sim.camera.optics import own_rng
from sim.camera.sensor import Sensor, make_sensor
from sim.camera.shooting import LitSubject, Shooting
from sim.devices.camera_settings import exposed_with
from sim.devices.story_cameras import Lens


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
        peak: (3,) what just does not clip; the brightest skin of this person where absent.
    """

    def __init__(
        self,
        world: LitSubject,
        seed: int,
        flaws: CaptureFlaws | None = None,
        sequence: Sequence[str] = (),
        drive: Drive = "solid-angle",
        peak: np.ndarray | None = None,
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
        if peak is None:
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

    def settings(self) -> dict[str, dict[str, Any]]:
        """Each camera's settings as its photographs will have them (CameraSettings' names)."""
        return exposed_with(self.sensors, self.shooting.lenses)

    def colour_calibration(self) -> dict[str, object]:
        """The value of colour.json of all cameras, from simulated chart photographs."""
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


def lab_white(rig: Rig) -> np.ndarray:
    """(3,) what a perfect white reads under a session's `full`.

    Cameras of a lab are exposed for it once, and photograph its chart and every person alike: no
    skin is brighter.
    """
    return np.full(3, white_reading(rig, drive_levels("full", rig)))


def _state(levels: np.ndarray) -> bytes:
    """Lamps' levels as the wire carries them."""
    return np.round(np.asarray(levels) * 65535).astype("<u2").tobytes()
