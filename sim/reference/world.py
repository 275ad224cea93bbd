"""A subject photographed by the reference, which answers what `sim.light.world.World` does."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.rig import Camera, Rig
from sim.light.lamps import Lamps, lamps_of
from sim.light.scene import Scene, Surface
from sim.light.world import brightest, some_skin
from sim.people.subject import Subject
from sim.reference.basis import combine, independent
from sim.reference.bounces import bounced_light, exits
from sim.reference.config import ReferenceConfig
from sim.reference.direct import direct_light
from sim.reference.points import Points, Skin
from sim.reference.rays import Rays
from sim.reference.subsurface import diffuse_inside
from sim.reference.texels import Texels
from sim.reference.variant import find_variant


@dataclasses.dataclass(frozen=True)
class Inside:
    """What texels give beside the light that comes straight from the lamps.

    Attributes:
        kept: (n, 3) share of the entered light that leaves where it entered.
        added: (n, s, 3) light that leaves here after it bounced or wandered.
    """

    kept: np.ndarray
    added: np.ndarray


class ReferenceWorld:
    """A subject in a rig under path-traced light.

    Direct light falls on every pixel from every lit lamp, by Mitsuba's rays and reflectance; light
    from skin to skin and inside the skin is solved once on the surface for all cameras. Left out:
    mirrored light after a bounce, and what fine relief does to light from other skin.

    Args:
        subject: who sits in the stage.
        rig: cameras, and lights where `lamps` is None.
        lamps: what really shines.
        config: see there.

    Attributes:
        rig: lights and cameras.
        scene: the subject, for truth and landmarks.
        lamps: what shines.
        variant: of Mitsuba.
    """

    def __init__(
        self,
        subject: Subject,
        rig: Rig,
        lamps: Lamps | None = None,
        config: ReferenceConfig | None = None,
    ) -> None:
        """SimError when Mitsuba is absent or cannot hold this skin or these cameras."""
        self.config = config or ReferenceConfig()
        self.rig = rig
        self.lamps = lamps_of(rig) if lamps is None else lamps
        self.skin = Skin(subject)
        self.variant = find_variant(self.config.variant)
        self.scene = Scene(subject)
        self._rays = Rays(self.skin.vertices, self.skin.triangles, self.variant)
        self._solved: tuple[np.ndarray, Inside | None] | None = None
        self._taken: dict[str, tuple[np.ndarray, np.ndarray]] = {}

    @property
    def subject(self) -> Subject:
        """Who sits in the stage."""
        return self.skin.subject

    @functools.cached_property
    def surfaces(self) -> dict[str, Surface]:
        """What each camera's pixel centres see, for the truth beside a session."""
        return {camera.id: self.scene.surface(camera) for camera in self.rig.cameras}

    @functools.cached_property
    def texels(self) -> Texels:
        """The surface in patches."""
        return Texels(self.skin, self.config.texel_mm)

    def with_subject(self, subject: Subject) -> ReferenceWorld:
        """The same stage with another subject, or the same one elsewhere; nothing is prepared."""
        return ReferenceWorld(subject, self.rig, self.lamps, self.config)

    def prepare(self, levels: np.ndarray, progress: ProgressCallback = quiet) -> None:
        """Take all cameras' pictures of the states that these (s, m) levels are sums of.

        `photograph` then answers at once for any sum of them.
        """
        weights = self._weights(levels)
        flat = weights.reshape(len(weights), -1)
        chosen, _ = independent(flat)
        for done, camera in enumerate(self.rig.cameras, 1):
            pictures = self._pictures(camera, weights[chosen])
            self._taken[camera.id] = (flat[chosen], pictures)
            progress(done, len(self.rig.cameras))

    def photograph(self, camera_id: str, levels: np.ndarray) -> np.ndarray:
        """Scene-linear pictures under light states; the background is black.

        Args:
            camera_id: the view.
            levels: (s, m) drive levels of s states. Those that are sums of others are made so.

        Returns:
            (s, h, w, 3) float32.
        """
        return self._relight(camera_id, self._weights(levels))

    def relit(self, camera_id: str, weights: np.ndarray) -> np.ndarray:
        """(h, w, 3) float32 under lamps of other (m, 3) weights."""
        return self._relight(camera_id, np.asarray(weights, float)[None])[0]

    def pixels(self, camera_id: str, weights: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        """(s, n, 3) light of the chosen entries of `surfaces[camera_id]`, at pixel centres."""
        surface = self.surfaces[camera_id]
        points = self.skin.points(
            surface.face[chosen], surface.barycentric[chosen], surface.view[chosen]
        )
        return self.light_at(points, np.asarray(weights, float))

    def skin_peak(self, quantile: float = 0.999, levels: np.ndarray | None = None) -> np.ndarray:
        """(3,) what the brightest skin reads under `full`, of all cameras.

        `full` is driven at these (m,) levels, or with every lamp at level 1.
        """
        full = self.lamps.weights if levels is None else self.lamps.weights * levels[:, None]
        light = [
            self.pixels(camera_id, full[None], some_skin(surface))[0]
            for camera_id, surface in self.surfaces.items()
        ]
        return brightest(light, self.subject.name, quantile)

    def light_at(self, points: Points, weights: np.ndarray) -> np.ndarray:
        """(s, n, 3) float32 light leaving n points toward their view, under (s, m, 3) weights."""
        inside = self._inside(weights)
        body, mirror = self._direct(points, weights)
        if inside is None:
            return body * points.albedo + mirror
        states = len(weights)
        both = np.concatenate([inside.kept, inside.added.reshape(len(inside.kept), -1)], axis=1)
        found = self.texels.sample(both, points.uv)
        leaves = exits(self.subject.distribution, points) / np.pi
        added = np.moveaxis(found[:, 3:].reshape(-1, states, 3), 1, 0)
        body = body * found[:, :3] + added * leaves[:, None].astype(np.float32)
        return body * points.albedo + mirror

    def _relight(self, camera_id: str, weights: np.ndarray) -> np.ndarray:
        flat = weights.reshape(len(weights), -1)
        if camera_id in self._taken:
            known, pictures = self._taken[camera_id]
            shares = combine(flat, known)
            if not np.isnan(shares).any():
                return _sum(shares, pictures)
        chosen, shares = independent(flat)
        pictures = self._pictures(self.rig.camera(camera_id), weights[chosen])
        return _sum(shares, pictures)

    def _pictures(self, camera: Camera, weights: np.ndarray) -> np.ndarray:
        """(s, h, w, 3) float32, each pixel the mean over its samples."""
        out = np.zeros((len(weights), camera.height_px * camera.width_px, 3), np.float32)
        side = round(self.config.samples**0.5)
        rng = np.random.default_rng([self.config.seed, 3])
        for index in range(self.config.samples if len(weights) else 0):
            # A grid over the pixel, moved at random within its own cell; its centre when alone.
            moved = (np.array(divmod(index, side)) + 0.5) / side - 0.5
            if side > 1:
                moved += (rng.random(2) - 0.5) / side
            shifted = dataclasses.replace(
                camera, cx_px=camera.cx_px - moved[0], cy_px=camera.cy_px - moved[1]
            )
            pixel, points = self._seen(shifted)
            out[:, pixel] += self.light_at(points, weights) / self.config.samples
        return out.reshape(len(weights), camera.height_px, camera.width_px, 3)

    def _seen(self, camera: Camera) -> tuple[np.ndarray, Points]:
        """(n,) pixels in row order whose rays meet skin, and where."""
        origin, directions = camera.pixel_rays()
        near, depth = camera.project(self.skin.vertices)
        box = np.zeros((camera.height_px, camera.width_px), bool)
        if (depth > 0).all():
            low = np.clip(np.floor(near.min(axis=0)).astype(int) - 1, 0, None)
            high = np.ceil(near.max(axis=0)).astype(int) + 1
            box[low[1] : max(high[1], 0), low[0] : max(high[0], 0)] = True
        else:
            box[:] = True
        inside = np.flatnonzero(box)
        flat = directions.reshape(-1, 3)[inside]
        face, weights = self._rays.hit(origin, flat)
        corners = self.skin.vertices[self.skin.triangles[np.maximum(face, 0)]]
        outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        # The inside of an open mesh is no skin.
        hit = np.flatnonzero((face >= 0) & (np.einsum("nk,nk->n", outward, flat) < 0))
        return inside[hit], self.skin.points(face[hit], weights[hit], -flat[hit])

    def _inside(self, weights: np.ndarray) -> Inside | None:
        """The surface solved for these states; kept until other states are asked for."""
        if self._solved is None or not np.array_equal(self._solved[0], weights):
            self._solved = (weights.copy(), self._solve(weights))
        return self._solved[1]

    def _solve(self, weights: np.ndarray) -> Inside | None:
        config = self.config
        if not (config.subsurface or config.bounces):
            return None
        points, states = self.texels.points, len(weights)
        body, _ = self._direct(points, weights)
        leaves = exits(self.subject.distribution, points) / np.pi
        entered = np.moveaxis(body, 0, 1) / leaves[:, None, None].astype(np.float32)
        kept = np.ones((len(points), 3), np.float32)
        added = np.zeros((len(points), states, 3), np.float32)
        if config.bounces:
            added = bounced_light(
                self.skin, self._rays, self.texels, self.lamps, weights, entered, config
            )
        if config.subsurface:
            arrived, kept = diffuse_inside(self.texels, entered + added, points.translucency)
            added = added * kept[:, None] + arrived
        return Inside(kept, added)

    def _direct(self, points: Points, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return direct_light(
            self._rays,
            points,
            self.lamps,
            weights,
            self.subject.distribution,
            self.config.seed,
        )

    def _weights(self, levels: np.ndarray) -> np.ndarray:
        return np.asarray(levels, float)[:, :, None] * self.lamps.weights


def _sum(shares: np.ndarray, pictures: np.ndarray) -> np.ndarray:
    """Sums of pictures; a difference may fall below zero by rounding and is cut there."""
    summed = np.einsum("sb,bhwc->shwc", shares, pictures, optimize=True)
    return np.maximum(summed, 0.0).astype(np.float32)
