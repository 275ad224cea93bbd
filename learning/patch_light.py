"""Light of the patches of one scan: environments around a target, with the shadows that they cast.

The input's environment and those of the rendering loss all lie around one target environment
[Lattas2021]. Where their lights stand is drawn and baked once a scan, so that every one of them
has the shadows of its own lights; strengths, ambient light and camera are drawn at each step.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
import torch.nn.functional as functional
from torch import Tensor

from learning.maps import to_batch
from learning.render.environments import (
    Environment,
    RandomLightConfig,
    moved_lights,
    random_environment,
    random_lights,
    stack,
)
from learning.render.occlusion import DOME_MM, PositionGrid, bake_grid, openness, sharpened
from learning.render.shading import Mode
from learning.render.uv import spread_outside

Box = tuple[float, float, float, float]
"""Top, left, height and width of a part of a texture, 0..1."""


@dataclasses.dataclass(frozen=True)
class Scene:
    """An environment and what it casts.

    Attributes:
        environment: lights and camera.
        visibility: (B, L, h, w) share of each light that a texel sees.
    """

    environment: Environment
    visibility: Tensor


@dataclasses.dataclass(frozen=True)
class Group:
    """Sets of lights around one target.

    Attributes:
        target_mm: (n, 3) the target's lights.
        sets_mm: (n, 3) of each set.
    """

    target_mm: np.ndarray
    sets_mm: list[np.ndarray]


class ScanLight:
    """Sets of lights of one scan, the shadows that they cast, and its ambient occlusion."""

    def __init__(self, groups: list[Group], surface: PositionGrid | None) -> None:
        """Bake the shadows on a surface; without one nothing is shadowed."""
        self.groups = groups
        self.visibility: list[list[Tensor]] | None = None
        self.open: Tensor | None = None
        if surface is not None:
            sets = [lights for group in groups for lights in group.sets_mm]
            # All lights at once: the tree of the surface's triangles is built once.
            baked = bake_grid(surface, np.concatenate([*sets, DOME_MM])).astype(np.uint8)
            *parts, dome = np.split(baked, np.cumsum([len(lights) for lights in sets]))
            seen = iter(torch.from_numpy(part)[None] for part in parts)
            self.visibility = [[next(seen) for _ in group.sets_mm] for group in groups]
            share = openness(surface.normal, dome)
            self.open = to_batch(spread_outside(share, surface.covered))

    def draw(self, rng: np.random.Generator, count: int) -> tuple[int, list[int]]:
        """A group, and `count` of its sets; none twice as long as there are enough."""
        group = int(rng.integers(len(self.groups)))
        order = rng.permutation(len(self.groups[group].sets_mm))
        return group, np.resize(order, count).tolist()

    def shadows(self, group: int, index: int, box: Box, size: int, sharpness: float) -> Tensor:
        """(1, n, size, size) visibility of a set in a part of the texture; 1 where not baked.

        The grid is coarser than the texture; `sharpness` makes its blurred edges as hard as shadows
        of small lamps are.
        """
        if self.visibility is None:
            return torch.ones(1, len(self.groups[group].sets_mm[index]), size, size)
        values = sampled(self.visibility[group][index].float(), box, size)
        return sharpened(values, sharpness)

    def openness(self, box: Box, size: int) -> Tensor:
        """(1, 1, size, size) ambient occlusion of a part of the texture; 1 where not baked."""
        return torch.ones(1, 1, size, size) if self.open is None else sampled(self.open, box, size)


def groups_around(
    target: Environment | None,
    sets: int,
    draws: int,
    lights: RandomLightConfig,
    rng: np.random.Generator,
) -> list[Group]:
    """Sets of lights for one scan.

    Args:
        target: all sets lie around it; where None, each has a random target of its own.
        sets: around `target`, or targets.
        draws: sets beside the input's around each of many targets.
        lights: the ranges.
        rng: randomness.
    """
    targets = [random_lights(rng, lights) for _ in range(sets)]
    around = 1 + draws
    if target is not None:
        targets, around = [target.position_mm[0].double().numpy()], sets
    return [
        Group(at, [moved_lights(at, rng, lights.position_spread) for _ in range(around)])
        for at in targets
    ]


def target_environment(lights: RandomLightConfig, mode: Mode, seed: int) -> Environment:
    """The one target of a training: that of the configuration, else lights of the seed."""
    if lights.target is not None:
        return lights.target.environment(mode == "paper")
    rng = np.random.default_rng([seed, 5])
    places = random_lights(rng, lights, lights.lights)
    return random_environment(rng, lights, places, mode == "paper")


def join_scenes(scenes: list[Scene]) -> Scene:
    """Many scenes as one batch; lights that are not there are seen."""
    environment = stack([scene.environment for scene in scenes])
    most = environment.rgb.shape[1]
    seen = [
        functional.pad(s.visibility, (0, 0, 0, 0, 0, most - s.visibility.shape[1]), value=1.0)
        for s in scenes
    ]
    return Scene(environment, torch.cat(seen))


def sampled(image: Tensor, box: Box, size: int) -> Tensor:
    """(1, c, rows, columns) in a part of the picture, bilinearly: (1, c, size, size)."""
    top, left, height, width = box
    theta = image.new_tensor(
        [[[width, 0.0, 2 * left + width - 1], [0.0, height, 2 * top + height - 1]]]
    )
    where = functional.affine_grid(theta, [1, 1, size, size], align_corners=False)
    return functional.grid_sample(image, where, padding_mode="border", align_corners=False)
