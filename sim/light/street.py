"""A street of our own: sky, a low sun between house fronts, and ground, seen at head height.

Rays from the head meet two rows of houses of different height and colour along the street, the
ground between them, or the sky of `sim.light.sky`. Walls and ground are diffusers lit by the sun,
where no house of the opposite row is in its way, and by the sky they see; windows mirror the
sky on the other side. One bounce, no more: a picture to light a face with, not a picture of a
street.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from sim.errors import SimError
from sim.light.environments import Panorama, add_sun, directions
from sim.light.sky import SkyConfig, clear_sky, sun_direction, sun_irradiance

OVERSAMPLE = 3
"""Rays a side of each texel, so that windows do not alias."""


@dataclasses.dataclass(frozen=True)
class StreetConfig:
    """The street.

    Attributes:
        half_width_m: from its middle to the fronts.
        head_m: height of the head above the ground.
        house_m: mean width of a house along the street.
        height_m: lowest and highest house.
        azimuth_deg: in which direction the street runs, from +z toward +x.
        sky: sun and air; the sun shines along the street, a little to one side.
        rows: of the picture.
    """

    half_width_m: float = 8.0
    head_m: float = 1.6
    house_m: float = 9.0
    height_m: tuple[float, float] = (9.0, 17.0)
    azimuth_deg: float = 25.0
    sky: SkyConfig = dataclasses.field(
        default_factory=lambda: SkyConfig(elevation_deg=20.0, azimuth_deg=35.0, haze=0.1)
    )
    rows: int = 256

    def __post_init__(self) -> None:
        """SimError when a length is not positive."""
        for name in ("half_width_m", "head_m", "house_m", "rows"):
            if not getattr(self, name) > 0:
                raise SimError(
                    "street", field=name, found=str(getattr(self, name)), expected="above 0"
                )
        if not 0 < self.height_m[0] <= self.height_m[1]:
            raise SimError(
                "street", field="height_m", found=str(self.height_m), expected="0 < low <= high"
            )


def street(seed: int = 0, config: StreetConfig | None = None) -> Panorama:
    """A street's light; the same seed gives the same houses."""
    config = config or StreetConfig()
    rows = config.rows
    fine = directions(rows * OVERSAMPLE)
    houses = _Houses(config, np.random.default_rng([seed, 5]))
    light = houses.seen(fine.reshape(-1, 3)).reshape(rows, OVERSAMPLE, 2 * rows, OVERSAMPLE, 3)
    radiance = light.mean(axis=(1, 3))
    sun = sun_direction(config.sky)
    if houses.sky_in(np.zeros((1, 3)), sun)[0]:
        add_sun(radiance, sun, sun_irradiance(config.sky))
    return Panorama("street", radiance)


class _Houses:
    """Two rows of house fronts; street axes are across, up, along, in metres from the head."""

    def __init__(self, config: StreetConfig, rng: np.random.Generator) -> None:
        self.config = config
        count = 200
        self.first = -0.5 * count * config.house_m
        self.heights = rng.uniform(*config.height_m, size=(2, count)) - config.head_m
        brick, plaster = np.array([0.42, 0.24, 0.17]), np.array([0.68, 0.63, 0.54])
        mix = rng.uniform(0, 1, size=(2, count, 1))
        self.colours = (mix * plaster + (1 - mix) * brick) * rng.uniform(0.8, 1.1, (2, count, 1))
        self.sun = self._to_street(sun_direction(config.sky))
        self.light = sun_irradiance(config.sky)

    def _to_street(self, vectors: np.ndarray) -> np.ndarray:
        """World directions in street axes."""
        a = np.radians(self.config.azimuth_deg)
        across = np.array([np.cos(a), 0.0, -np.sin(a)])
        along = np.array([np.sin(a), 0.0, np.cos(a)])
        return np.stack([vectors @ across, vectors[..., 1], vectors @ along], axis=-1)

    def _to_world(self, vectors: np.ndarray) -> np.ndarray:
        a = np.radians(self.config.azimuth_deg)
        across = np.array([np.cos(a), 0.0, -np.sin(a)])
        along = np.array([np.sin(a), 0.0, np.cos(a)])
        up = np.array([0.0, 1.0, 0.0])
        return vectors[..., :1] * across + vectors[..., 1:2] * up + vectors[..., 2:] * along

    def _house(self, along: np.ndarray) -> np.ndarray:
        place = np.floor((along - self.first) / self.config.house_m)
        return np.clip(np.nan_to_num(place), 0, self.heights.shape[1] - 1).astype(int)

    def fronts(self, start: np.ndarray, ray: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances (n,) to the front that each ray meets (inf for none), and which row (n,)."""
        side = (ray[:, 0] > 0).astype(int)
        wall = np.where(side == 1, self.config.half_width_m, -self.config.half_width_m)
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = (wall - start[:, 0]) / ray[:, 0]
            hit = start + distance[:, None] * ray
        far = distance * np.linalg.norm(ray, axis=1) > 400.0
        good = (distance > 1e-6) & ~far & (hit[:, 1] > -self.config.head_m)
        good &= hit[:, 1] < self.heights[side, self._house(hit[:, 2])]
        return np.where(good, distance, np.inf), side

    def sky_in(self, start: np.ndarray, toward: np.ndarray) -> np.ndarray:
        """(n,) bool: whether places (n, 3), street axes, see the sky in a world direction."""
        ray = np.broadcast_to(self._to_street(toward), start.shape)
        return ~np.isfinite(self.fronts(start, ray)[0]) & (ray[:, 1] > 0)

    def seen(self, toward: np.ndarray) -> np.ndarray:
        """(n, 3) radiance from world directions (n, 3)."""
        ray = self._to_street(toward)
        start = np.zeros_like(ray)
        distance, side = self.fronts(start, ray)
        out = clear_sky(self.config.sky, toward)
        with np.errstate(divide="ignore", invalid="ignore"):
            down = np.where(ray[:, 1] < 0, -self.config.head_m / ray[:, 1], np.inf)
        ground = (down < distance) & (down < 400.0)
        rim = (ray[:, 1] < 0) & ~ground & ~np.isfinite(distance)
        wall = np.isfinite(distance) & ~ground
        out[ground] = self._ground(down[ground, None] * ray[ground])
        out[rim] = self._ground(400.0 * ray[rim])
        out[wall] = self._wall(distance[wall, None] * ray[wall], ray[wall], side[wall])
        return out

    def _lit(self, place: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """(n, 3) irradiance by the sun, where no front hides it."""
        cosine = np.maximum(normal @ self.sun, 0.0)
        ray = np.broadcast_to(self.sun, place.shape)
        free = ~np.isfinite(self.fronts(place, ray)[0])
        return (cosine * free)[:, None] * self.light

    def _sky_light(self) -> np.ndarray:
        """(3,) radiance of the strip of sky between the roofs."""
        strip = self._to_world(np.array([[0.0, 1.0, 0.0], [0.3, 0.9, 0.3], [-0.3, 0.9, -0.3]]))
        strip /= np.linalg.norm(strip, axis=1, keepdims=True)
        return clear_sky(self.config.sky, strip).mean(axis=0)

    def _ground(self, place: np.ndarray) -> np.ndarray:
        across = np.abs(place[:, 0]) / self.config.half_width_m
        # Asphalt in the middle, pavement before the houses.
        albedo = np.where(across < 0.65, 0.11, 0.26)[:, None] * np.array([1.0, 0.97, 0.92])
        normal = np.broadcast_to([0.0, 1.0, 0.0], place.shape)
        return albedo / np.pi * (self._lit(place, normal) + 0.5 * np.pi * self._sky_light())

    def _wall(self, place: np.ndarray, ray: np.ndarray, side: np.ndarray) -> np.ndarray:
        normal = np.zeros_like(place)
        normal[:, 0] = np.where(side == 1, -1.0, 1.0)
        inside = place - 1e-3 * ray
        high = place[:, 1] + self.config.head_m
        # A front sees the sky above the opposite roofs: more of it the higher.
        top = float(np.mean(self.heights)) + self.config.head_m
        open_ = 0.5 * (
            1 - np.cos(np.arctan2(2 * self.config.half_width_m, np.maximum(top - high, 0.1)))
        )
        fill = (0.15 + open_)[:, None] * np.pi * self._sky_light()
        albedo = self.colours[side, self._house(place[:, 2])]
        out = albedo / np.pi * (self._lit(inside, normal) + fill)
        floor, bay = high / 3.2, place[:, 2] / 2.4
        glass = (np.abs(floor % 1 - 0.55) < 0.27) & (np.abs(bay % 1 - 0.5) < 0.24)
        mirrored = (
            ray[glass]
            - 2 * np.sum(ray[glass] * normal[glass], axis=1, keepdims=True) * (normal[glass])
        )
        mirrored[:, 1] = np.maximum(mirrored[:, 1], 0.05)
        mirrored /= np.linalg.norm(mirrored, axis=1, keepdims=True)
        sky = clear_sky(self.config.sky, self._to_world(mirrored))
        out[glass] = 0.1 * out[glass] + 0.12 * sky
        return out
