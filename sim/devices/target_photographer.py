"""Calibration targets before the simulated cameras, held pose after pose as an operator does."""

from __future__ import annotations

from typing import Any

import numpy as np

from lightstage.calibrations.config import KIND_NAMES, CalibrationConfig
from lightstage.calibrations.kinds import KINDS
from lightstage.rig import Camera, Rig
from sim.camera.dng import Exif, dng_bytes
from sim.camera.flaws import CaptureFlaws
from sim.camera.optics import make_lens, own_rng
from sim.camera.sensor import Sensor, make_sensor
from sim.devices.camera_settings import exposed_with
from sim.devices.photographer import lab_white
from sim.errors import SimError
from sim.light.lamps import lamps_of
from sim.targets.ball import Ball, photograph_grey, photograph_mirror
from sim.targets.boards import board_poses, chart_plane, facing
from sim.targets.plane import Plane, photograph_plane
from sim.targets.target_session import LONGEST, SHORTEST, TargetsConfig

AS_SESSIONS = ("chart", "dark")
"""Kinds that hold only for sessions of the same exposure: taken as `lightstage-sim stage` does."""
EVEN = 0.5
"""What a card close before a lens reads of `full`, white being 1."""
ROOM_LEFT = 0.8
"""Exposed for the first pose, so much lower than the sensor bears: later ones are brighter."""

Picture = tuple[np.ndarray, np.ndarray]


class TargetPhotographer:
    """Turns the lamps' state into each camera's photograph of a target.

    Args:
        rig: the stage.
        kind: of KIND_NAMES; ``nothing`` is an empty stage, where the target was forgotten.
        seed: of poses, lenses, sensors and noise.
        flaws: what lamps, lens, room and sensor do.
        config: size and looks of the targets.
        poses: how many poses of a board there are; as many as a lab is asked for by default.

    Attributes:
        pose: which one is held, from 0; set by whoever holds the target.

    Raises:
        SimError: no such kind.
    """

    def __init__(
        self,
        rig: Rig,
        kind: str,
        seed: int,
        flaws: CaptureFlaws | None = None,
        config: TargetsConfig | None = None,
        poses: int | None = None,
    ) -> None:
        if kind not in (*KIND_NAMES, "nothing"):
            raise SimError("target", found=repr(kind), expected=f"one of {', '.join(KIND_NAMES)}")
        flaws = flaws or CaptureFlaws()
        self.rig = rig
        self.kind = kind
        self.pose = 0
        self._seed = seed
        self._taken = 0
        self._config = config or TargetsConfig()
        self._ambient = flaws.room.ambient * np.array(flaws.room.ambient_rgb)
        self._lamps = lamps_of(rig, flaws.lamps, seed)
        count = poses or KINDS["charuco"].poses(rig, CalibrationConfig())
        self._boards = board_poses(rig, self._config.board, count, seed)
        self._lenses = {c.id: make_lens(c, flaws.lens, seed) for c in rig.cameras}
        white = lab_white(rig)
        self._sensors = {
            c.id: make_sensor(flaws.sensor, white, own_rng(seed, c.id, b"sensor"))
            for c in rig.cameras
        }
        if kind not in AS_SESSIONS:
            factor = self._exposure(flaws.sensor.headroom)
            self._sensors = {key: sensor.exposed(factor) for key, sensor in self._sensors.items()}

    def settings(self) -> dict[str, dict[str, Any]]:
        """Each camera's settings as its photographs will have them (CameraSettings' names)."""
        return exposed_with(self._sensors, self._lenses)

    def photograph(self, camera: Camera, levels: np.ndarray) -> bytes:
        """One camera's DNG of the pose that is held, under (m,) levels; its noise is its own."""
        sensor, lens = self._sensors[camera.id], self._lenses[camera.id]
        light = lens.form(*self._picture(camera, np.asarray(levels, float)))
        self._taken += 1
        rng = own_rng(self._seed, camera.id, b"target %d" % self._taken)
        exif = Exif(camera.model, camera.serial, lens.config.f_number, lens.focal_mm)
        return dng_bytes(sensor.expose(light, rng), sensor, exif)

    def _exposure(self, headroom: float) -> float:
        """How much longer than the session the first pose is exposed, all cameras alike."""
        full = np.ones(len(self.rig.lights))
        brightest = max(
            _raw(self._sensors[c.id], self._lenses[c.id].form(*self._picture(c, full)))
            for c in self.rig.cameras
        )
        if brightest <= 0:
            return 1.0
        return float(np.clip(ROOM_LEFT * headroom / brightest, SHORTEST, LONGEST))

    def _picture(self, camera: Camera, levels: np.ndarray) -> Picture:
        if self.kind in ("dark", "nothing") or not (levels.any() or self._ambient.any()):
            return _even(camera, 0.0)
        if self.kind == "flat":
            return _even(camera, EVEN * float(levels.mean()))
        if self.kind in ("mirror", "grey"):
            photograph = photograph_mirror if self.kind == "mirror" else photograph_grey
            return photograph(self._ball(), camera, self._lamps, levels, self._ambient)
        return photograph_plane(self._plane(), camera, self._lamps, levels, self._ambient)

    def _plane(self) -> Plane:
        if self.kind == "charuco":
            return self._config.board.plane(self._boards[self.pose % len(self._boards)])
        faced = self.rig.cameras[self.pose % len(self.rig.cameras)]
        size = np.array([1.0, 11.25 / 16.75]) * self._config.chart_width_mm
        pose = facing(faced.centre_mm, np.zeros(3), size)
        return chart_plane(self._config.chart_width_mm, pose)

    def _ball(self) -> Ball:
        places = self._config.mirror_places_mm if self.kind == "mirror" else ((0.0, 0.0, 0.0),)
        reflectance = (
            self._config.mirror_reflectance
            if self.kind == "mirror"
            else self._config.grey_reflectance
        )
        place = np.array(places[self.pose % len(places)], float)
        return Ball(place, self._config.ball_radius_mm, reflectance)


def _raw(sensor: Sensor, light: np.ndarray) -> float:
    """The brightest reading of a picture, as a share of white."""
    return float((sensor.raw_from_linear @ light.max(axis=(0, 1))).max())


def _even(camera: Camera, level: float) -> Picture:
    """An even light over the whole picture, before the lens."""
    shape = (camera.height_px, camera.width_px)
    return np.full((*shape, 3), level, np.float32), np.zeros(shape, np.float32)
