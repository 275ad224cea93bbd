"""A subject in a rig, photographed with one of Mitsuba's materials under direct light.

Cameras, lamps and places on the surface are the reference's; what the surface does with light is
Mitsuba's alone. Each lamp is asked at each point, so that no noise comes from choosing among them.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from lightstage.rig import Rig
from sim.errors import SimError
from sim.foreign.materials import material
from sim.light.lamps import Lamps
from sim.people.subject import Subject
from sim.reference.config import ReferenceConfig
from sim.reference.direct import lamp_strength
from sim.reference.lobes import MIN_COSINE, SHORT
from sim.reference.points import Points
from sim.reference.rays import vectors
from sim.reference.variant import LLVM, mitsuba
from sim.reference.world import ReferenceWorld

CHUNK = 400_000
"""Points that are lit at once; it bounds memory."""


class ForeignWorld(ReferenceWorld):
    """As `ReferenceWorld`, with a material of Mitsuba's.

    Args:
        subject: who sits in the stage.
        rig: cameras, and lights where `lamps` is None.
        kind: of `materials.MATERIALS`.
        lamps: what really shines, from their centres.
        samples: places of a pixel that are averaged, a square number; 1 is its centre.
        variant: of Mitsuba; see `ReferenceConfig`.
    """

    def __init__(
        self,
        subject: Subject,
        rig: Rig,
        kind: str,
        lamps: Lamps | None = None,
        samples: int = 4,
        variant: str = "auto",
    ) -> None:
        """SimError where Mitsuba is absent or has no LLVM."""
        config = ReferenceConfig(bounces=0, subsurface=False, samples=samples, variant=variant)
        super().__init__(subject, rig, lamps, config)
        if self.variant != LLVM:
            raise SimError(
                "foreign", found=f"Mitsuba's {self.variant}", expected=LLVM, hint="Install libLLVM."
            )
        self.kind = kind
        mi = mitsuba(LLVM)
        self._bsdf: Any = mi.load_dict(material(kind, subject))

    def with_subject(self, subject: Subject) -> ForeignWorld:
        """The same stage with another subject, or the same one elsewhere."""
        config = self.config
        return ForeignWorld(
            subject, self.rig, self.kind, self.lamps, config.samples, config.variant
        )

    def light_at(self, points: Points, weights: np.ndarray) -> np.ndarray:
        """(s, n, 3) float32 light leaving n points toward their view, under (s, m, 3) weights."""
        weights = np.asarray(weights, float)
        out = np.zeros((len(weights), len(points), 3), np.float32)
        for first in range(0, len(points), CHUNK):
            part = slice(first, first + CHUNK)
            self._add(points.part(part), weights, out[:, part])
        return out

    def _add(self, points: Points, weights: np.ndarray, out: np.ndarray) -> None:
        mi = mitsuba(LLVM)
        import drjit

        lamps, strength = self.lamps, lamp_strength(self.lamps)
        si = drjit.zeros(mi.SurfaceInteraction3f, len(points))
        si.p, si.n = vectors(mi.Point3f, points.position), vectors(mi.Normal3f, points.normal)
        si.sh_frame = mi.Frame3f(vectors(mi.Vector3f, points.normal))
        # Mitsuba's textures begin at the top.
        u, v = points.uv.T.astype(np.float32)
        si.uv = mi.Point2f(u, 1 - v)
        local = si.to_local(vectors(mi.Vector3f, points.view))
        si.wi = drjit.normalize(mi.Vector3f(local.x, local.y, drjit.maximum(local.z, MIN_COSINE)))
        start, context = vectors(mi.Point3f, points.start), mi.BSDFContext()
        for lamp in np.flatnonzero(weights.any(axis=(0, 2))):
            # A constant of the code would be compiled anew for each lamp.
            place, axis = (
                mi.Vector3f(*(drjit.opaque(mi.Float, x) for x in values[lamp].tolist()))
                for values in (lamps.positions_mm, lamps.axes)
            )
            toward = place - si.p
            far = drjit.norm(toward)
            toward /= far
            facing = drjit.maximum(-drjit.dot(toward, axis), 0)
            arrives = drjit.power(facing, lamps.exponent) / (far * far)
            path = place - start
            length = drjit.norm(path)
            ray = mi.Ray3f(start, path / length, length * SHORT, 0.0, [])
            given = self._bsdf.eval(context, si, si.to_local(toward)) * arrives
            given = drjit.select(self._rays.scene.ray_test(ray), 0.0, given)
            leaves = np.array(given).T
            for state in np.flatnonzero(weights[:, lamp].any(axis=1)):
                out[state] += leaves * (weights[state, lamp] * strength[lamp]).astype(np.float32)
