"""A subject in a rig, ready to be photographed under any light state."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.rig import Rig
from sim.errors import SimError
from sim.light.lamps import Lamps, lamps_of, point_lamps
from sim.light.olat import Optics, states
from sim.light.scene import Scene, Surface
from sim.people.subject import Subject

EVERY = slice(None)
SINGLE_LIGHTS = 8
"""Pictures of single lights that are made, and held, at a time."""


class World:
    """What every camera sees and which lights each of its pixels sees, computed once.

    Attributes:
        rig: lights and cameras.
        lamps: what the rig's lights really shine.
        scene: the subject prepared for rays.
        surfaces: camera id to what the centres of its pixels see.
    """

    def __init__(
        self,
        subject: Subject,
        rig: Rig,
        progress: ProgressCallback = quiet,
        *,
        lamps: Lamps | None = None,
        samples: int = 1,
    ) -> None:
        """Cast all rays.

        Args:
            subject: who sits in the stage.
            rig: lights and cameras.
            progress: counts cameras.
            lamps: in the rig's order; the rig's own data of them where absent.
            samples: rays a pixel and side at silhouettes and depth edges: 1 draws them in steps,
                3 casts nine rays in every such pixel of a photograph, which then shows the mean.
        """
        self.rig = rig
        self.lamps = lamps_of(rig) if lamps is None else lamps
        self.scene = Scene(subject)
        self.surfaces: dict[str, Surface] = {}
        self._bits: dict[str, np.ndarray] = {}
        self._samples = samples
        self._edges: dict[str, tuple[np.ndarray, Surface, np.ndarray]] = {}
        for done, camera in enumerate(rig.cameras, 1):
            surface = self.scene.surface(camera)
            self.surfaces[camera.id] = surface
            self._bits[camera.id] = self.scene.visible_lights(surface, rig.positions_mm)
            if samples > 1:
                edge, fine = self.scene.edge_samples(surface, samples)
                bits = self.scene.visible_lights(fine, rig.positions_mm, coarse_px=1)
                self._edges[camera.id] = edge, fine, bits
            progress(done, len(rig.cameras))

    @property
    def subject(self) -> Subject:
        """Who sits in the stage."""
        return self.scene.subject

    def with_subject(self, subject: Subject) -> World:
        """The same stage with another subject, or the same one elsewhere."""
        return World(subject, self.rig, lamps=self.lamps, samples=self._samples)

    def pixels(
        self, camera_id: str, weights: np.ndarray, chosen: np.ndarray | slice = EVERY
    ) -> np.ndarray:
        """Light of the pixels that see the subject, one ray each.

        Args:
            camera_id: the view.
            weights: (s, m, 3) what a white diffuser at the origin facing each light would read.
            chosen: a slice or (k,) indices of the pixels of `surfaces[camera_id]`.

        Returns:
            (s, n, 3) float32.
        """
        diffuse, specular = self.parts(camera_id, weights, chosen)
        diffuse += specular
        return diffuse

    def parts(
        self, camera_id: str, weights: np.ndarray, chosen: np.ndarray | slice = EVERY
    ) -> tuple[np.ndarray, np.ndarray]:
        """As `pixels`, with its shapes, the diffuse and the specular part apart."""
        surface, bits = self.surfaces[camera_id], self._bits[camera_id]
        shape = (len(weights), len(surface.pixel[chosen]), 3)
        diffuse, specular = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        for tile, body, mirror in _states(surface, bits, self.lamps, weights, chosen):
            diffuse[:, tile], specular[:, tile] = body, mirror
        return diffuse, specular

    def photograph(self, camera_id: str, levels: np.ndarray) -> np.ndarray:
        """Scene-linear pictures under light states; the background is black.

        Args:
            camera_id: the view.
            levels: (s, m) drive levels of s states, or (s, m, 3) of coloured lights.

        Returns:
            (s, h, w, 3) float32.
        """
        levels = np.asarray(levels)
        weights = (levels if levels.ndim == 3 else levels[:, :, None]) * self.lamps.weights
        return self.pictures(camera_id, weights, self.lamps)

    def single_lights(self, camera_id: str) -> Iterator[tuple[int, np.ndarray]]:
        """One picture per light, each at level 1: the basis of all photographs.

        Args:
            camera_id: the view.

        Yields:
            A light's id, and its picture (h, w, 3) float32. A photograph under any levels is the
            sum of these pictures times the levels.
        """
        count = len(self.rig.lights)
        for first in range(0, count, SINGLE_LIGHTS):
            some = self.rig.lights[first : first + SINGLE_LIGHTS]
            pictures = self.photograph(camera_id, np.eye(count)[first : first + len(some)])
            for light, picture in zip(some, pictures, strict=True):
                yield light.id, picture

    def relit(self, camera_id: str, weights: np.ndarray) -> np.ndarray:
        """(h, w, 3) float32 under coloured lights at the lamps' places; `weights` (m, 3).

        They are a light set's points (formats.environment), which shine alike in all directions.
        """
        points = point_lamps(self.rig.positions_mm)
        return self.pictures(camera_id, np.asarray(weights)[None], points)[0]

    def skin_peak(self, quantile: float = 0.999, levels: np.ndarray | None = None) -> np.ndarray:
        """(3,) what the brightest skin reads under `full`, of all cameras.

        Every 16th pixel counts, of small pictures more.

        `full` is driven at these (m,) levels, or with every lamp at level 1.
        """
        light = []
        full = self.lamps.weights if levels is None else self.lamps.weights * levels[:, None]
        for camera_id, surface in self.surfaces.items():
            light.append(self.pixels(camera_id, full[None], some_skin(surface))[0])
        return brightest(light, self.subject.name, quantile)

    def pictures(
        self, camera_id: str, weights: np.ndarray, lamps: Lamps, optics: Optics | None = None
    ) -> np.ndarray:
        """(s, h, w, 3) under weights (s, m, 3) of lamps that stand where the rig's do."""
        surface = self.surfaces[camera_id]
        camera = surface.camera
        out = np.zeros((len(weights), camera.height_px * camera.width_px, 3), np.float32)
        for tile, body, mirror in _states(
            surface, self._bits[camera_id], lamps, weights, optics=optics
        ):
            out[:, surface.pixel[tile]] = body + mirror
        if camera_id in self._edges:
            edge, fine, bits = self._edges[camera_id]
            out[:, edge] = 0
            share = np.float32(1 / self._samples**2)
            for tile, body, mirror in _states(fine, bits, lamps, weights, optics=optics):
                for picture, light in zip(out, (body + mirror) * share, strict=True):
                    np.add.at(picture, fine.pixel[tile], light)
        return out.reshape(len(weights), camera.height_px, camera.width_px, 3)


def _states(
    surface: Surface,
    bits: np.ndarray,
    lamps: Lamps,
    weights: np.ndarray,
    chosen: np.ndarray | slice = EVERY,
    *,
    optics: Optics | None = None,
) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
    """`sim.light.olat.states` of a surface's chosen points."""
    return states(
        surface.position[chosen],
        surface.geometric[chosen],
        surface.normal[chosen],
        surface.view[chosen],
        surface.albedo[chosen],
        surface.specular[chosen],
        surface.roughness[chosen],
        bits[chosen],
        lamps,
        weights,
        surface.lobe.of(chosen),
        optics,
    )


def some_skin(surface: Surface) -> np.ndarray:
    """(k,) pixels of the skin that are asked how bright it is: every 16th, of few more."""
    skin = np.flatnonzero(surface.skin)
    return skin[:: int(np.clip(len(skin) // 4000, 1, 16))]


def brightest(light: list[np.ndarray], name: str, quantile: float) -> np.ndarray:
    """(3,) the quantile of light (n, 3) of all cameras; SimError where none sees any skin."""
    seen = np.concatenate(light)
    if not len(seen):
        raise SimError(
            f"subject {name}",
            found="no skin in any camera",
            expected="a face",
            hint="Are the rig's cameras aimed at the sphere's centre?",
        )
    return np.quantile(seen, quantile, axis=0)
