"""A subject in a rig, ready to be photographed under any light state."""

from __future__ import annotations

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.rig import Rig
from sim.errors import SimError
from sim.lamps import light_weights
from sim.render import shade
from sim.scene import Scene, Surface
from sim.subject import Subject

EVERY = slice(None)


class World:
    """What every camera sees and which lights each of its pixels sees, computed once.

    Attributes:
        rig: lights and cameras.
        scene: the subject prepared for rays.
        surfaces: camera id to what its pixels see.
    """

    def __init__(self, subject: Subject, rig: Rig, progress: ProgressCallback = quiet) -> None:
        """Cast all rays; `progress` counts cameras."""
        self.rig = rig
        self.scene = Scene(subject)
        self.surfaces: dict[str, Surface] = {}
        self._bits: dict[str, np.ndarray] = {}
        self._full = light_weights(rig)
        for done, camera in enumerate(rig.cameras, 1):
            surface = self.scene.surface(camera)
            self.surfaces[camera.id] = surface
            self._bits[camera.id] = self.scene.visible_lights(surface, rig.positions_mm)
            progress(done, len(rig.cameras))

    @property
    def subject(self) -> Subject:
        """Who sits in the stage."""
        return self.scene.subject

    def with_subject(self, subject: Subject) -> World:
        """The same stage with another subject, or the same one elsewhere."""
        return World(subject, self.rig)

    def pixels(
        self, camera_id: str, weights: np.ndarray, chosen: np.ndarray | slice = EVERY
    ) -> np.ndarray:
        """Light of the pixels that see the subject.

        Args:
            camera_id: the view.
            weights: (s, m, 3) what a white diffuser at the origin facing each light would read.
            chosen: which of the n pixels of `surfaces[camera_id]`.

        Returns:
            (s, n, 3) float32.
        """
        surface = self.surfaces[camera_id]
        diffuse, specular = shade(
            surface.position[chosen],
            surface.geometric[chosen],
            surface.normal[chosen],
            surface.view[chosen],
            surface.albedo[chosen],
            surface.specular[chosen],
            surface.roughness[chosen],
            self._bits[camera_id][chosen],
            self.rig.positions_mm,
            weights,
        )
        return diffuse + specular

    def photograph(self, camera_id: str, levels: np.ndarray) -> np.ndarray:
        """Scene-linear pictures under light states; the background is black.

        Args:
            camera_id: the view.
            levels: (s, m) drive levels of s states.

        Returns:
            (s, h, w, 3) float32.
        """
        light = self.pixels(camera_id, np.asarray(levels)[:, :, None] * self._full)
        return np.stack([self.surfaces[camera_id].picture(state) for state in light])

    def skin_peak(self, quantile: float = 0.999) -> np.ndarray:
        """(3,) what the brightest skin reads under `full`, of every 16th pixel of all cameras."""
        light = []
        for camera_id, surface in self.surfaces.items():
            chosen = np.flatnonzero(surface.skin)[::16]
            light.append(self.pixels(camera_id, self._full[None], chosen)[0])
        seen = np.concatenate(light)
        if not len(seen):
            raise SimError(
                f"subject {self.subject.name}",
                found="no skin in any camera",
                expected="a face",
                hint="Do the rig's cameras look at the sphere's centre?",
            )
        return np.quantile(seen, quantile, axis=0)

    def relit(self, camera_id: str, weights: np.ndarray) -> np.ndarray:
        """(h, w, 3) float32 under coloured lights; `weights` (m, 3) as in `pixels`."""
        light = self.pixels(camera_id, np.asarray(weights)[None])
        return self.surfaces[camera_id].picture(light[0])
