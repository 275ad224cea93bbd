"""Environments: where the lights and the camera of a rendering are, and random ones for training.

Light's unit: `rgb` is what a perfect white diffuser at the origin, facing the light, reads because
of this light alone; it falls off with the square of the distance from there.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from torch import Tensor

from lightstage.formats.environment import LightSet


@dataclasses.dataclass(frozen=True)
class Environment:
    """Lights, ambient light and camera of a batch of renderings.

    Attributes:
        position_mm: (B, L, 3) lights; of a distant one only the direction matters.
        rgb: (B, L, 3).
        ambient_rgb: (B, 3) what a white diffuser reads from everywhere.
        distant: (B, L) bool, directional lights: no fall-off, the same direction everywhere.
        camera_mm: (B, 3) the camera's centre.
    """

    position_mm: Tensor
    rgb: Tensor
    ambient_rgb: Tensor
    distant: Tensor
    camera_mm: Tensor


@dataclasses.dataclass(frozen=True)
class TargetLight:
    """One environment in numbers, as a training's configuration keeps it; head frame.

    Attributes:
        position_mm: of each lamp.
        rgb: of each lamp, see `Environment`.
        ambient_rgb: of the light from everywhere.
        camera_mm: where the camera stands.
    """

    position_mm: tuple[tuple[float, float, float], ...]
    rgb: tuple[tuple[float, float, float], ...]
    ambient_rgb: tuple[float, float, float] = (0.0, 0.0, 0.0)
    camera_mm: tuple[float, float, float] = (0.0, 0.0, 1100.0)

    def environment(self, ambient_multiplies: bool = False) -> Environment:
        """As a batch of one; see `random_environment` for `ambient_multiplies`.

        Where the ambient light multiplies, the lamps give a white diffuser that faces the camera
        what both give it otherwise.
        """
        places, around = np.array(self.position_mm), np.array(self.ambient_rgb)
        lights = LightSet("target", places, np.array(self.rgb), around)
        found = from_light_set(lights, np.array(self.camera_mm))
        if not ambient_multiplies:
            return found
        toward = places / np.linalg.norm(places, axis=1, keepdims=True)
        facing = np.array(self.camera_mm) / np.linalg.norm(self.camera_mm)
        given = np.maximum(toward @ facing, 0) @ np.array(self.rgb)
        more = np.divide(given + around, given, out=np.ones(3), where=given > 0)
        rgb = found.rgb * torch.from_numpy(more).to(found.rgb)
        return dataclasses.replace(found, rgb=rgb, ambient_rgb=torch.ones(1, 3))


@dataclasses.dataclass(frozen=True)
class RandomLightConfig:
    """How random environments are drawn, in the head frame.

    Attributes:
        lights: number of point lights, at most; at least one.
        distance_mm: distances of the nearest and the farthest light.
        exposure: darkest and brightest sum of what the lights and the ambient light give a white
            diffuser that faces the camera.
        ambient_share: smallest and largest share of the ambient light in that sum.
        tint: standard deviation of the logarithm of each light's red, green and blue.
        ambient_tint: standard deviation of the logarithm of the red, green and blue of the ambient
            light.
        behind: how far behind the face lights may be: largest cosine of the angle to straight
            behind.
        backlit_share: share of the environments whose lights are all behind the face's plane, so
            that their light grazes it.
        unfilled_share: share of the environments without ambient light.
        camera_mm: distance of the camera in front of the face.
        position_spread: largest change of a light's distance, as a share, in the environments
            around a target.
        camera_spread: largest change of the camera's distance there, as a share.
        intensity_spread: largest change of a light's intensity there, as a share.
        target: the light of a source of textures, around which all environments are drawn; where
            None, whatever the other numbers allow.
    """

    lights: int = 3
    distance_mm: tuple[float, float] = (700.0, 2000.0)
    exposure: tuple[float, float] = (0.6, 1.1)
    ambient_share: tuple[float, float] = (0.0, 0.5)
    tint: float = 0.1
    ambient_tint: float = 0.0
    behind: float = 0.2
    backlit_share: float = 0.0
    unfilled_share: float = 0.0
    camera_mm: float = 1100.0
    position_spread: float = 0.5
    camera_spread: float = 0.25
    intensity_spread: float = 0.25
    target: TargetLight | None = None


def from_light_set(lights: LightSet, camera_mm: np.ndarray) -> Environment:
    """A light set seen from a (3,) point, mm, as a batch of one (float32)."""

    def batch(values: np.ndarray) -> Tensor:
        return torch.from_numpy(np.asarray(values, np.float32))[None]

    return Environment(
        batch(lights.position_mm),
        batch(lights.rgb),
        batch(lights.ambient_rgb),
        torch.zeros(1, len(lights.position_mm), dtype=torch.bool),
        batch(camera_mm),
    )


def stack(environments: list[Environment]) -> Environment:
    """One batch of several; sets of fewer lights are filled up with black ones."""
    most = max(e.rgb.shape[1] for e in environments)

    def padded(values: Tensor, fill: float) -> Tensor:
        missing = most - values.shape[1]
        shape = (values.shape[0], missing, *values.shape[2:])
        return torch.cat([values, values.new_full(shape, fill)], dim=1)

    return Environment(
        torch.cat([padded(e.position_mm, 1000.0) for e in environments]),
        torch.cat([padded(e.rgb, 0.0) for e in environments]),
        torch.cat([e.ambient_rgb for e in environments]),
        torch.cat([padded(e.distant, False) for e in environments]),
        torch.cat([e.camera_mm for e in environments]),
    )


def random_lights(
    rng: np.random.Generator, config: RandomLightConfig, count: int | None = None
) -> np.ndarray:
    """Places of `count`, or one to `lights`, point lights: (n, 3) mm.

    Directions are uniform over the sphere's part with z > -`behind`, so that some light comes from
    slightly behind, as in a room. With a target the lights are its own, moved.
    """
    if config.target is not None:
        places = np.array(config.target.position_mm)
        return moved_lights(places, rng, config.position_spread)
    if count is None:
        count = int(rng.integers(1, config.lights + 1))
    # Where a share is 0 nothing is drawn for it, so that trainings of before stay as they were.
    backlit = config.backlit_share > 0 and rng.random() < config.backlit_share
    height = rng.uniform(-config.behind, 0.0 if backlit else 1.0, count)
    turn = rng.uniform(0, 2 * np.pi, count)
    flat = np.sqrt(1 - height**2)
    direction = np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1)
    return direction * rng.uniform(*config.distance_mm, (count, 1))


def random_environment(
    rng: np.random.Generator,
    config: RandomLightConfig,
    position_mm: np.ndarray,
    ambient_multiplies: bool = False,
) -> Environment:
    """Lights at given places with random strength and colour, and ambient light; a batch of one.

    Args:
        rng: randomness.
        config: the ranges.
        position_mm: (n, 3) lights.
        ambient_multiplies: for mode `paper`, where the ambient intensity multiplies the lights' sum
            as printed: the lights give the whole exposure, and the intensity is 1.
    """
    if config.target is not None:
        return around(config.target.environment(ambient_multiplies), rng, config, position_mm)
    distance = np.linalg.norm(position_mm, axis=1)
    exposure = rng.uniform(*config.exposure)
    ambient = exposure * rng.uniform(*config.ambient_share)
    unfilled = config.unfilled_share > 0 and rng.random() < config.unfilled_share
    if ambient_multiplies or unfilled:
        ambient = 0.0
    share = rng.uniform(0.3, 1.0, len(position_mm))
    # A face turned half to a light still receives light, so grazing ones count as 0.3: rims
    # do not become arbitrarily bright to reach the exposure.
    facing = np.maximum(position_mm[:, 2] / distance, 0.3)
    strength = (exposure - ambient) * share / float((share * facing).sum())
    rgb = strength[:, None] * np.exp(rng.normal(0, config.tint, (len(position_mm), 3)))
    everywhere = ambient * np.exp(rng.normal(0, config.ambient_tint, 3))
    return Environment(
        torch.from_numpy(position_mm.astype(np.float32))[None],
        torch.from_numpy(rgb.astype(np.float32))[None],
        torch.ones(1, 3)
        if ambient_multiplies
        else torch.from_numpy(everywhere.astype(np.float32))[None],
        torch.zeros(1, len(position_mm), dtype=torch.bool),
        torch.tensor([[0.0, 0.0, config.camera_mm]]),
    )


def around(
    target: Environment,
    rng: np.random.Generator,
    config: RandomLightConfig,
    position_mm: np.ndarray | None = None,
) -> Environment:
    """An environment near another one [Lattas2021].

    Draws are Gaussian around the target, two standard deviations being the published "up to"
    (50 % of a light's distance, 25 % of the camera's and of the intensity). The bound holds for the
    length of the whole move; a draw beyond it is drawn again.

    Args:
        target: a batch of one, or of more where no places are given.
        rng: randomness.
        config: how far.
        position_mm: (L, 3) places of the lights, as `moved_lights` drew it before.
    """

    def gain(count: tuple[int, ...]) -> Tensor:
        moves = _within(rng, (*count, 1), config.intensity_spread)
        return 1 + torch.from_numpy(moves.astype(np.float32)).to(target.rgb)

    def moved(points: Tensor, most: float) -> Tensor:
        places = moved_lights(points.detach().cpu().double().numpy(), rng, most)
        return torch.from_numpy(places.astype(np.float32)).to(points)

    if position_mm is None:
        position = moved(target.position_mm, config.position_spread)
    else:
        position = torch.from_numpy(position_mm.astype(np.float32))[None].to(target.rgb)
    return Environment(
        position,
        target.rgb * gain(tuple(target.rgb.shape[:2])),
        target.ambient_rgb * gain((len(target.rgb),)),
        target.distant,
        moved(target.camera_mm, config.camera_spread),
    )


def moved_lights(position_mm: np.ndarray, rng: np.random.Generator, most: float) -> np.ndarray:
    """(..., 3) places moved at random by at most `most` of their distance from the origin."""
    distance = np.linalg.norm(position_mm, axis=-1, keepdims=True)
    found: np.ndarray = position_mm + distance * _within(rng, position_mm.shape, most)
    return found


def _within(rng: np.random.Generator, shape: tuple[int, ...], most: float) -> np.ndarray:
    """Gaussian moves, half of `most` their deviation, whose length is at most `most`."""
    values = rng.normal(0, 0.5 * most, shape)
    while (beyond := np.linalg.norm(values, axis=-1) > most).any():
        values[beyond] = rng.normal(0, 0.5 * most, (int(beyond.sum()), shape[-1]))
    return values
