"""Small skins, lights and a shadow for tests of the renderer."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch

from learning.render.environments import Environment, from_light_set
from learning.render.skin import SkinMaps
from lightstage.formats.environment import LightSet
from lightstage.formats.mesh import Mesh


def random_skin(
    rng: np.random.Generator, height: int = 5, width: int = 4, dtype: torch.dtype = torch.float64
) -> SkinMaps:
    def values(channels: int, low: float, high: float) -> torch.Tensor:
        return torch.tensor(rng.uniform(low, high, (2, channels, height, width)), dtype=dtype)

    return SkinMaps(
        diffuse_albedo=values(3, 0.05, 0.9),
        specular_albedo=values(1, 0.01, 0.1),
        diffuse_normal=values(3, -1, 1),
        specular_normal=values(3, -1, 1),
        shininess=values(1, 2, 80),
        translucency=values(1, 0.1, 0.9),
        position_mm=values(3, -80, 80),
        area=values(1, 0.5, 1.5),
        texel_mm=1.0,
        ambient_occlusion=values(1, 0.3, 1),
    )


def random_lights(rng: np.random.Generator, count: int = 3) -> Environment:
    def tensor(values: np.ndarray) -> torch.Tensor:
        return torch.tensor(values, dtype=torch.float64)

    direction = rng.normal(size=(2, count, 3))
    direction /= np.linalg.norm(direction, axis=2, keepdims=True)
    return Environment(
        tensor(direction * rng.uniform(400, 1500, (2, count, 1))),
        tensor(rng.uniform(0.05, 0.4, (2, count, 3))),
        tensor(rng.uniform(0, 0.3, (2, 3))),
        torch.tensor([[i % 2 == 1 for i in range(count)]] * 2),
        tensor(np.array([[50.0, -30.0, 1000.0], [0.0, 0.0, 900.0]])),
    )


def flat_skin(
    normal: tuple[float, float, float] = (0, 0, 1), albedo: float = 1.0, **changes: torch.Tensor
) -> SkinMaps:
    one = torch.ones(1, 1, 1, 1, dtype=torch.float64)
    up = torch.tensor(normal, dtype=torch.float64).view(1, 3, 1, 1)
    skin = SkinMaps(
        albedo * one.repeat(1, 3, 1, 1), 0 * one, up, up, 32 * one, 0 * one, 0 * up, one, 1.0, one
    )
    return dataclasses.replace(skin, **changes)


def one_light(
    position: tuple[float, float, float], rgb: float = 0.7, ambient: float = 0.0
) -> Environment:
    lights = LightSet("one", np.array([position]), np.full((1, 3), rgb), np.full(3, ambient))
    environment = from_light_set(lights, np.array([0, 0, 1000.0]))
    fields = dataclasses.fields(environment)
    values = {f.name: getattr(environment, f.name) for f in fields}
    return Environment(**{k: v if v.dtype == torch.bool else v.double() for k, v in values.items()})


def screen() -> Mesh:
    """A floor that fills the texture, and a wall over its middle that has one texel."""
    floor = np.array([[-50, -50, 0], [50, -50, 0], [50, 50, 0], [-50, 50, 0]], float)
    wall = np.array([[-10, -10, 30], [10, -10, 30], [10, 10, 30], [-10, 10, 30]], float)
    faces = np.array([[0, 1, 2, 3], [4, 5, 6, 7]], np.int32)
    uvs = np.concatenate([(floor[:, :2] + 50) / 100, np.full((4, 2), 0.001)])
    return Mesh(np.concatenate([floor, wall]), faces, uvs, faces)
