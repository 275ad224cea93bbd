"""From lamps' levels to light on the sensors: subject's sway, room, pulses and lens, in order."""

from __future__ import annotations

from typing import Any, Protocol

import cv2
import numpy as np

from lightstage.formats.config import as_dict
from lightstage.rig import Rig
from sim.camera.flaws import CaptureFlaws
from sim.camera.optics import Lens, make_lens, own_rng
from sim.camera.pulses import band_gain
from sim.camera.room import even_levels
from sim.camera.sway import moved, poses
from sim.light.lamps import Lamps
from sim.light.scene import Surface
from sim.people.subject import Subject

SCHEMA = "lightstage.sim-flaws/1"
SHOTS = 512
"""Poses are drawn for this many photographs at once; a longer session begins them again."""
STATES_AT_ONCE = 8
FINEST = 65535
"""Steps of a level, as the wire carries it."""
STEADY = 1e-9
"""A row's gain nearer to 1 is that of a steady lamp."""


class LitSubject(Protocol):
    """A subject in a rig that can be photographed: `World`, or the path-traced reference."""

    rig: Rig
    lamps: Lamps

    @property
    def surfaces(self) -> dict[str, Surface]:
        """What each camera's pixels see."""

    @property
    def subject(self) -> Subject:
        """Who sits in the stage."""

    def photograph(self, camera_id: str, levels: np.ndarray) -> np.ndarray:
        """Pictures (s, h, w, 3) under (s, m) levels, linear in them."""

    def skin_peak(self, quantile: float = 0.999, levels: np.ndarray | None = None) -> np.ndarray:
        """(3,) what the brightest skin reads under `full`, driven at these (m,) levels or at 1."""

    def with_subject(self, subject: Subject) -> LitSubject:
        """The same stage with another subject, or the same one elsewhere."""


class Shooting:
    """A subject's photographs as the lenses form them, before the sensors.

    The cost of sway is a new set of camera and shadow rays at each photograph; the other flaws
    keep the rays of `world`.

    Attributes:
        world: the subject at the first photograph.
        flaws: see there.
        seed: of lenses, pulses and sway.
        lenses: camera id to lens.
    """

    def __init__(self, world: LitSubject, flaws: CaptureFlaws, seed: int) -> None:
        self.world = world
        self.flaws = flaws
        self.seed = seed
        self.lenses: dict[str, Lens] = {
            camera.id: make_lens(camera, flaws.lens, seed) for camera in world.rig.cameras
        }
        self.sways = flaws.sway.sway_mm > 0 or flaws.sway.sway_deg > 0
        self._poses = poses(flaws.sway, SHOTS, seed) if self.sways else np.eye(4)[None, :3]
        self._at: tuple[int, LitSubject] = (0, world)

    def pose(self, shot: int) -> np.ndarray:
        """(3, 4) where the subject is at a photograph, against the first one."""
        return self._poses[shot % len(self._poses)]

    def at(self, shot: int) -> LitSubject:
        """The subject where it is at a photograph; the last one is kept."""
        if not self.sways or shot % SHOTS == 0:
            return self.world
        if self._at[0] != shot:
            subject = moved(self.world.subject, self.pose(shot))
            self._at = (shot, self.world.with_subject(subject))
        return self._at[1]

    def phase(self, camera_id: str, shot: int) -> float:
        """Share of a pulse's period that has passed when a photograph's first row opens."""
        return float(own_rng(self.seed, camera_id, b"pulse%d" % shot).random())

    def light(
        self,
        camera_id: str,
        levels: np.ndarray,
        shots: np.ndarray | list[int],
        exposure_s: float | None = None,
    ) -> np.ndarray:
        """Light on a camera's sensor.

        Args:
            camera_id: which.
            levels: (s, m) of the lamps in s photographs.
            shots: (s,) number of each photograph in its session; sway goes by it.
            exposure_s: of each row; None: no shutter, so no bands.

        Returns:
            (s, h, w, 3) float32.
        """
        levels = np.asarray(levels, float)
        if self.sways:
            parts = [
                self._seen(self.at(shot), camera_id, levels[k : k + 1], [shot], exposure_s)
                for k, shot in enumerate(shots)
            ]
            return np.concatenate(parts)
        return self._seen(self.world, camera_id, levels, list(shots), exposure_s)

    def record(self, shots: dict[str, int], exposure_s: float | None = None) -> dict[str, Any]:
        """What was done, for the truth beside a session: JSON-ready.

        Args:
            shots: pattern to the number of its photograph.
            exposure_s: as in `light`.
        """
        pulsed = exposure_s is not None and self.flaws.pulses.frequency_hz > 0
        return {
            "schema": SCHEMA,
            "seed": self.seed,
            "flaws": as_dict(self.flaws),
            "lenses": {
                camera_id: {
                    "f_number": lens.config.f_number,
                    "focal_mm": lens.focal_mm,
                    "focus_mm": lens.focus_mm,
                    "corner_loss": lens.corner_loss,
                    "blur_sigma_px": lens.sigma_px.tolist(),
                }
                for camera_id, lens in self.lenses.items()
            },
            "photographs": {
                pattern: {
                    "shot": shot,
                    "world_from_first": self.pose(shot).tolist(),
                    "pulse_phase": {c: self.phase(c, shot) for c in self.lenses} if pulsed else {},
                }
                for pattern, shot in shots.items()
            },
        }

    def _seen(
        self,
        world: LitSubject,
        camera_id: str,
        levels: np.ndarray,
        shots: list[int],
        exposure_s: float | None,
    ) -> np.ndarray:
        lens, flaws = self.lenses[camera_id], self.flaws
        steady = exposure_s is None or flaws.pulses.frequency_hz <= 0
        ambient = flaws.room.ambient * np.array(flaws.room.ambient_rgb, np.float32)
        room = even_levels(world.lamps)[None] if ambient.any() else levels[:0]
        if steady:
            light = world.photograph(camera_id, np.concatenate([levels, room]))
        else:
            assert exposure_s is not None
            pulsed = [
                self._pulsed(world, camera_id, level, shot, exposure_s)
                for level, shot in zip(levels, shots, strict=True)
            ]
            light = np.stack([*pulsed, *(world.photograph(camera_id, room) if len(room) else [])])
        if len(room):
            light = light[:-1] + light[-1] * ambient
        depth = None
        if lens.config.depth_of_field:
            depth = widened(depth_picture(world.surfaces[camera_id]))
        return np.stack([lens.form(picture, depth) for picture in light])

    def _pulsed(
        self, world: LitSubject, camera_id: str, level: np.ndarray, shot: int, exposure_s: float
    ) -> np.ndarray:
        """(h, w, 3) under lamps that pulse: those of one level flicker together."""
        rows = self.lenses[camera_id].camera.height_px
        phase = self.phase(camera_id, shot)
        states, gains = [np.zeros(len(level))], [np.ones(rows)]
        counts = np.round(level * FINEST)
        for count in np.unique(counts):
            gain = band_gain(count / FINEST, rows, exposure_s, phase, self.flaws.pulses)
            own = np.where(counts == count, level, 0.0)
            if np.abs(gain - 1).max() < STEADY:
                states[0] += own
            else:
                states.append(own)
                gains.append(gain)
        total = np.zeros(0, np.float32)
        for first in range(0, len(states), STATES_AT_ONCE):
            part = slice(first, first + STATES_AT_ONCE)
            light = world.photograph(camera_id, np.stack(states[part]))
            rows_gain = np.stack(gains[part]).astype(np.float32)
            added = np.einsum("shwc,sh->hwc", light, rows_gain)
            total = added if not total.size else total + added
        return total


def depth_picture(surface: Surface) -> np.ndarray:
    """(h, w) float32 depth along the camera's axis in mm, 0 where nothing is seen."""
    cam_from_world = surface.camera.cam_from_world
    depth = surface.position @ cam_from_world[2, :3] + cam_from_world[2, 3]
    return surface.picture(depth.astype(np.float32))


def widened(depth: np.ndarray) -> np.ndarray:
    """A (h, w) depth picture in which pixels beside the subject have the depth of its edge.

    They show a part of it where a photograph's pixels gather several rays; left without a depth
    they would stay sharp beside what blurs.
    """
    beside = cv2.dilate(depth, np.ones((3, 3), np.uint8))
    return np.where(depth > 0, depth, beside)
