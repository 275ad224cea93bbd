"""Ten lights that heads are photographed in, and what `sim`'s own light transport makes of them.

The networks shade and refine by `learning`'s renderer. So that they are not judged by their own
formula, their input comes from `sim.light.render`: another hand's diffuse layer under a rough
dielectric with Fresnel, rays to every point of light, ambient light that is shadowed too.
"""

from __future__ import annotations

import dataclasses
import functools

import numpy as np

from lightstage.formats.environment import LightSet
from sim.light.lamps import point_lamps
from sim.light.olat import shade
from sim.light.relight import RelightConfig, environment_lights
from sim.light.render import Lobe
from sim.light.scene import START_MM, Scene

CAMERA_MM = np.array([0.0, 0.0, 1100.0])
"""From where highlights are seen, world."""
LEAST_COSINE = 0.35
"""What turns away farther is seen by a camera that is more to its side, as in an atlas."""
DOME_LAMPS = 64
STUDIO_LAMPS = 24
GROUPS = {
    "front": "front",
    "studio": "studio",
    "random": "random",
    "warm-cool": "coloured",
    "red-green": "coloured",
    "from-behind": "behind",
    "rim": "behind",
    "hard-oblique": "hard",
    "hard-side": "hard",
    "hard-above": "hard",
}
"""The group of each of the ten lights."""
HARD_AMBIENT = 0.03
"""Light from everywhere beside one hard lamp."""


def _lamps(
    name: str, places: list[list[float]], rgb: list[list[float]], ambient: float
) -> LightSet:
    return LightSet(name, np.array(places, float), np.array(rgb), np.full(3, ambient))


def light_of(name: str, seed: int) -> LightSet:
    """One of the ten lights.

    Args:
        name: of `GROUPS`.
        seed: of the light `random`, which differs from head to head.

    Returns:
        In the world, mm.
    """
    if name == "studio":
        return environment_lights("softbox", RelightConfig(STUDIO_LAMPS))
    if name == "rim":
        return environment_lights("rim", RelightConfig(2 * STUDIO_LAMPS))
    if name == "random":
        return random_light(np.random.default_rng([seed, 77]))
    return {
        "front": _lamps(name, [[400, 300, 1000], [-700, 200, 700]], [[0.45] * 3, [0.25] * 3], 0.2),
        "warm-cool": _lamps(
            name,
            [[700, 100, 700], [-700, 100, 700]],
            [[0.6, 0.45, 0.35], [0.25, 0.35, 0.5]],
            0.15,
        ),
        "red-green": _lamps(
            name,
            [[900, 300, 300], [-800, -300, 600]],
            [[0.8, 0.3, 0.25], [0.2, 0.5, 0.3]],
            0.1,
        ),
        "from-behind": _lamps(name, [[900, 300, -250]], [[1.2] * 3], 0.3),
        "hard-oblique": _lamps(name, [[800, 600, 600]], [[1.1] * 3], HARD_AMBIENT),
        "hard-side": _lamps(name, [[-1100, 100, 150]], [[1.2] * 3], HARD_AMBIENT),
        "hard-above": _lamps(name, [[100, 1000, 450]], [[1.1] * 3], HARD_AMBIENT),
    }[name]


def random_light(rng: np.random.Generator) -> LightSet:
    """One to three lamps of any place but straight behind, some colour, some light from all round.

    Args:
        rng: of all of it.
    """
    count = int(rng.integers(1, 4))
    azimuth = np.radians(rng.uniform(-110, 110, count))
    height = np.radians(rng.uniform(-30, 60, count))
    toward = np.stack(
        [np.sin(azimuth) * np.cos(height), np.sin(height), np.cos(azimuth) * np.cos(height)], axis=1
    )
    distance_mm = rng.uniform(700, 2500, (count, 1))
    level = rng.dirichlet(np.ones(count))[:, None] * rng.uniform(0.5, 1.1)
    rgb = level * np.exp(rng.normal(0, 0.12, (count, 3)))
    ambient = rng.uniform(0.03, 0.3) * np.exp(rng.normal(0, 0.08, 3))
    return LightSet("random", toward * distance_mm, rgb, ambient)


def new_lights() -> list[LightSet]:
    """Three lights that are none of the ten: a head's found maps are rendered in them."""
    low = LightSet(
        "low", np.array([[-600.0, -300.0, 900.0]]), np.full((1, 3), 0.8), np.full(3, 0.1)
    )
    return [
        environment_lights("clamshell", RelightConfig(STUDIO_LAMPS)),
        environment_lights("street", RelightConfig(STUDIO_LAMPS)),
        with_dome(low),
    ]


@functools.cache
def dome() -> LightSet:
    """White light from everywhere as lamps: a white diffuser anywhere reads 1."""
    return environment_lights("uniform", RelightConfig(DOME_LAMPS))


def with_dome(lights: LightSet) -> LightSet:
    """A light set whose ambient light comes from the dome's lamps."""
    around = dome()
    return LightSet(
        lights.name,
        np.concatenate([lights.position_mm, around.position_mm]),
        np.concatenate([lights.rgb, around.rgb * lights.ambient_rgb]),
        np.zeros(3),
    )


@dataclasses.dataclass(frozen=True)
class Points:
    """Places of a subject's surface, one for each of n texels: what `sim` shades.

    Attributes:
        position: (n, 3) mm, world.
        start: (n, 3) where shadow rays start.
        geometric: (n, 3) unit normals of the smooth surface.
        normal: (n, 3) unit, that shade.
        albedo: (n, 3).
        specular: (n,).
        roughness: (n,).
        distribution: of the facets.
    """

    position: np.ndarray
    start: np.ndarray
    geometric: np.ndarray
    normal: np.ndarray
    albedo: np.ndarray
    specular: np.ndarray
    roughness: np.ndarray
    distribution: str

    def of(self, chosen: np.ndarray) -> Points:
        """Some of them."""
        arrays = {
            field.name: getattr(self, field.name)[chosen]
            for field in dataclasses.fields(self)
            if field.name != "distribution"
        }
        return Points(**arrays, distribution=self.distribution)


def starts(scene: Scene, face: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(n, 3) starts of shadow rays, on the surface that the vertex normals describe [Hanika2021].

    Args:
        scene: the subject.
        face: (n,) triangles.
        weights: (n, 3) of their corners.
    """
    corners = scene.triangles[face]
    points, normals = scene.vertices[corners], scene.normals[corners]
    position = np.einsum("nck,nc->nk", points, weights)
    below = np.einsum("nck,nck->nc", position[:, None] - points, normals)
    raised = np.einsum("nck,nc->nk", np.minimum(below, 0.0)[..., None] * normals, weights)
    flat = unit(np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]))
    return position - raised + START_MM * flat


class LitPoints:
    """Points under lights, with rays cast once for each lamp."""

    def __init__(self, scene: Scene, points: Points, view: np.ndarray | None = None) -> None:
        """The subject, which places of it, and from where they are seen.

        Args:
            scene: the subject.
            points: n places of it.
            view: (n, 3) unit directions to the camera; those of an atlas, `views`, where None.
        """
        self.scene, self.points = scene, points
        self._view = views(points.position, points.geometric) if view is None else view
        self._bits: dict[bytes, np.ndarray] = {}
        self._around: np.ndarray | None = None

    def under(self, lights: LightSet) -> np.ndarray:
        """(n, 3) light toward the camera, linear."""
        out = self.relit(lights, self.points)
        if lights.ambient_rgb.any():
            if self._around is None:
                self._around = self.relit(dome(), self.points)
            out = out + self._around * lights.ambient_rgb
        return out

    def relit(
        self, lights: LightSet, maps: Points, specular_normal: np.ndarray | None = None
    ) -> np.ndarray:
        """(n, 3) light of lamps alone, with other albedo and normals at the same places.

        Args:
            lights: without ambient light.
            maps: what reflects; places and shadows stay this object's own.
            specular_normal: (n, 3), where highlights have normals of their own.
        """
        if not len(lights.rgb):
            return np.zeros_like(self.points.position)
        bits = self._seen(lights)
        lamps = point_lamps(lights.position_mm)

        def parts(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return shade(
                self.points.position,
                self.points.geometric,
                normal,
                self._view,
                maps.albedo,
                maps.specular,
                maps.roughness,
                bits,
                lamps,
                lights.rgb[None],
                Lobe(maps.distribution),
            )

        body, mirror = parts(maps.normal)
        if specular_normal is not None and not np.array_equal(specular_normal, maps.normal):
            mirror = parts(specular_normal)[1]
        found: np.ndarray = (body + mirror)[0]
        return found

    def openness(self) -> np.ndarray:
        """(n,) share of even light from all round that reaches a place, weighted by the cosine."""
        bits, around = self._seen(dome()), dome().position_mm
        toward = around / np.linalg.norm(around, axis=1, keepdims=True)
        got = np.zeros(len(bits))
        whole = np.zeros(len(bits))
        for index, direction in enumerate(toward):
            cosine = np.clip(self.points.geometric @ direction, 0, None)
            whole += cosine
            got += cosine * ((bits[:, index >> 3] >> (index & 7)) & 1)
        return got / np.maximum(whole, 1e-6)

    def kept(self, chosen: np.ndarray) -> LitPoints:
        """Some of the places, with the rays that were cast for them."""
        other = LitPoints(self.scene, self.points.of(chosen), self._view[chosen])
        other._bits = {lamps: bits[chosen] for lamps, bits in self._bits.items()}
        return other

    def _seen(self, lights: LightSet) -> np.ndarray:
        """(n, bytes) bits of the lamps that each place sees."""
        key = lights.position_mm.tobytes()
        if key in self._bits:
            return self._bits[key]
        count = len(self.points.position)
        bits = np.zeros((count, (len(lights.rgb) + 7) // 8), np.uint8)
        for index, lamp in enumerate(lights.position_mm.astype(np.float32)):
            toward = lamp - self.points.position
            above = np.flatnonzero((toward * self.points.geometric).sum(axis=1) > 0)
            target = np.broadcast_to(lamp, (len(above), 3))
            free = ~self.scene.blocked(self.points.start[above], target)
            bits[above[free], index >> 3] |= np.uint8(1 << (index & 7))
        self._bits[key] = bits
        return bits


def views(position: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """(n, 3) unit directions to the camera, or to one that goes round the head with the surface.

    An atlas shows each place as a camera saw it that faced it; so that no border shows, the
    direction is the frontal camera's down to `LEAST_COSINE`, and is held at that beyond.
    """
    toward = unit(CAMERA_MM - position)
    cosine = (toward * normal).sum(axis=1, keepdims=True)
    along = unit(toward - cosine * normal)
    held = unit(LEAST_COSINE * normal + np.sqrt(1 - LEAST_COSINE**2) * along)
    return np.where(cosine >= LEAST_COSINE, toward, held).astype(np.float32)


def unit(vectors: np.ndarray) -> np.ndarray:
    """Of length 1; zero stays zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 1e-12)
