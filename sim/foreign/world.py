"""A subject in a rig, photographed with one of Mitsuba's materials under direct light.

Cameras, lamps and places on the surface are the reference's; what the surface does with light is
Mitsuba's alone. Each lamp is asked at each point, so that no noise comes from choosing among them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from lightstage.rig import Rig
from sim.errors import SimError
from sim.foreign.materials import WANDERING, material
from sim.foreign.wandering import wander
from sim.light.lamps import Lamps
from sim.people.subject import Subject
from sim.reference.config import ReferenceConfig
from sim.reference.direct import lamp_strength
from sim.reference.lobes import MIN_COSINE, SHORT
from sim.reference.points import Points
from sim.reference.rays import vectors
from sim.reference.variant import LLVM, mitsuba
from sim.reference.world import Inside, ReferenceWorld

CHUNK = 400_000
"""Pairs of point and lamp that are asked at once; it bounds memory."""
TEXEL_MM = 1.4
"""Patches that light wanders between."""
ALONG = (0.43, 0.85, 0.3)
"""Stretched mirrors lie across this direction: neither level nor upright, and no texture's."""

Effect = Callable[[str, np.ndarray], np.ndarray]
"""What a camera makes of its pictures: its id and (s, h, w, 3) to as many."""


def as_they_are(_: str, pictures: np.ndarray) -> np.ndarray:
    """A camera that does nothing to its (s, h, w, 3) pictures."""
    return pictures


class ForeignWorld(ReferenceWorld):
    """As `ReferenceWorld`, with a material of Mitsuba's.

    Args:
        subject: who sits in the stage.
        rig: cameras, and lights where `lamps` is None.
        kind: of `materials.MATERIALS`.
        lamps: what really shines; each ray goes to a place on the lamp's disc.
        samples: places of a pixel that are averaged, a square number; 1 is its centre.
        variant: of Mitsuba; see `ReferenceConfig`.
        stretch: of the mirror, see `materials.material`.
        effect: what each camera does to its pictures.
    """

    def __init__(
        self,
        subject: Subject,
        rig: Rig,
        kind: str,
        lamps: Lamps | None = None,
        samples: int = 4,
        variant: str = "auto",
        stretch: float = 1.0,
        effect: Effect = as_they_are,
    ) -> None:
        """SimError where Mitsuba is absent or has no LLVM."""
        config = ReferenceConfig(
            bounces=0,
            subsurface=kind == WANDERING,
            samples=samples,
            variant=variant,
            texel_mm=TEXEL_MM,
        )
        super().__init__(subject, rig, lamps, config)
        if self.variant != LLVM:
            raise SimError(
                "foreign", found=f"Mitsuba's {self.variant}", expected=LLVM, hint="Install libLLVM."
            )
        self.kind, self.stretch, self.effect = kind, stretch, effect
        mi = mitsuba(LLVM)
        self._bsdf: Any = mi.load_dict(material(kind, subject, stretch))
        self._white: Any = mi.load_dict(
            {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}}
        )
        self._rng = np.random.default_rng([config.seed, 40])

    def with_subject(self, subject: Subject) -> ForeignWorld:
        """The same stage with another subject, or the same one elsewhere."""
        config = self.config
        return ForeignWorld(
            subject,
            self.rig,
            self.kind,
            self.lamps,
            config.samples,
            config.variant,
            self.stretch,
            self.effect,
        )

    def photograph(self, camera_id: str, levels: np.ndarray) -> np.ndarray:
        """As `ReferenceWorld`'s, with its shapes, through the camera's effect."""
        return self.effect(camera_id, super().photograph(camera_id, levels))

    def light_at(self, points: Points, weights: np.ndarray) -> np.ndarray:
        """(s, n, 3) float32 light leaving n points toward their view, under (s, m, 3) weights."""
        weights = np.asarray(weights, float)
        out = self._leaving(points, weights, self._bsdf)
        inside = self._inside(weights)
        if inside is None:
            return out
        body = self._leaving(points, weights, self._white)
        count = len(inside.kept)
        found = self.texels.sample(
            np.concatenate([inside.kept, inside.added.reshape(count, -1)], axis=1), points.uv
        )
        # In cloth and hair, which are no skin, nothing wanders.
        skin = (points.translucency > 0)[:, None]
        kept = np.where(skin, found[:, :3], 1)
        added = np.where(skin, found[:, 3:], 0).reshape(-1, len(weights), 3)
        body = body * kept + np.moveaxis(added, 1, 0)
        return out + body * points.albedo * (1 - points.specular)[:, None]

    def _solve(self, weights: np.ndarray) -> Inside | None:
        if not self.config.subsurface:
            return None
        points = self.texels.points
        entered = np.moveaxis(self._leaving(points, weights, self._white), 0, 1)
        albedo = self.subject.diffuse_albedo[self.subject.skin].mean(axis=0)
        added, kept = wander(self.texels, entered, albedo)
        return Inside(kept, added)

    def _leaving(self, points: Points, weights: np.ndarray, bsdf: Any) -> np.ndarray:
        """(s, n, 3) light that a material sends toward the points' view."""
        out = np.zeros((len(weights), len(points), 3), np.float32)
        lit = np.flatnonzero(weights.any(axis=(0, 2)))
        strength = lamp_strength(self.lamps)
        for first in range(0, len(points), CHUNK):
            part = slice(first, first + CHUNK)
            some = points.part(part)
            # Few wide calls: each costs some milliseconds, however narrow it is.
            together = max(1, CHUNK // max(len(some), 1))
            for start in range(0, len(lit), together):
                group = lit[start : start + together]
                leaves = self._evaluated(some, group, bsdf)
                shares = (weights[:, group] * strength[group, None]).astype(np.float32)
                for channel in range(3):
                    out[:, part, channel] += shares[:, :, channel] @ leaves[channel]
        return out

    def _evaluated(self, points: Points, group: np.ndarray, bsdf: Any) -> np.ndarray:
        """(3, k, n) light of n points under each of k lamps by itself, of unit intensity."""
        mi = mitsuba(LLVM)
        import drjit

        lamps, count = self.lamps, len(points)

        def tiled(kind: Any, values: np.ndarray) -> Any:
            return vectors(kind, np.tile(values, (len(group), 1)))

        def lamps_own(values: np.ndarray) -> np.ndarray:
            return np.repeat(values[group], count, axis=0)

        si = drjit.zeros(mi.SurfaceInteraction3f, count * len(group))
        si.p, si.n = tiled(mi.Point3f, points.position), tiled(mi.Normal3f, points.normal)
        along = np.cross(ALONG, points.normal)
        along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-6)
        across = np.cross(points.normal, along)
        si.sh_frame = mi.Frame3f(
            *(tiled(mi.Vector3f, axis) for axis in (along, across, points.normal))
        )
        # Mitsuba's textures begin at the top.
        u, v = np.tile(points.uv.T.astype(np.float32), len(group))
        si.uv = mi.Point2f(u, 1 - v)
        local = si.to_local(tiled(mi.Vector3f, points.view))
        si.wi = drjit.normalize(mi.Vector3f(local.x, local.y, drjit.maximum(local.z, MIN_COSINE)))
        start = tiled(mi.Point3f, points.start)
        axis = vectors(mi.Vector3f, lamps_own(lamps.axes))
        at = lamps_own(lamps.positions_mm)
        if lamps.radius_mm > 0:
            at = at + self._on_disc(lamps_own(lamps.axes))
        place = vectors(mi.Vector3f, at)
        toward = place - si.p
        far = drjit.norm(toward)
        toward /= far
        facing = drjit.maximum(-drjit.dot(toward, axis), 0)
        # A constant of the code would be compiled anew for each of its values.
        exponent = drjit.opaque(mi.Float, lamps.exponent)
        arrives = drjit.power(facing, exponent) / (far * far)
        path = place - start
        length = drjit.norm(path)
        ray = mi.Ray3f(start, path / length, length * SHORT, 0.0, [])
        given = bsdf.eval(mi.BSDFContext(), si, si.to_local(toward)) * arrives
        given = drjit.select(self._rays.scene.ray_test(ray), 0.0, given)
        return np.array(given).reshape(3, len(group), count)

    def _on_disc(self, axes: np.ndarray) -> np.ndarray:
        """(n, 3) random places on the discs of lamps of these axes, from their centres."""
        first = np.cross(axes, (0.3, 0.5, 0.8))
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        radius = self.lamps.radius_mm * np.sqrt(self._rng.random(len(axes), np.float32))
        turn = 2 * np.pi * self._rng.random(len(axes), np.float32)
        x, y = (radius * part for part in (np.cos(turn), np.sin(turn)))
        return np.asarray(x[:, None] * first + y[:, None] * np.cross(axes, first))
