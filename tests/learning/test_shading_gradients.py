"""Gradients of the whole picture for every input, against differences in float64."""

from __future__ import annotations

import dataclasses
from typing import TypeVar

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from learning.render.environments import Environment
from learning.render.occlusion_model import OcclusionConfig, bake_table
from learning.render.occlusion_network import OcclusionNetwork, OcclusionNetworkConfig
from learning.render.shading import ShadeOptions, SkinMaps, shade
from tests.learning.scenes import flat_skin, one_light, random_lights, random_skin, screen

MAPS = (
    "diffuse_albedo",
    "specular_albedo",
    "diffuse_normal",
    "specular_normal",
    "shininess",
    "translucency",
    "position_mm",
)
Source = TypeVar("Source", SkinMaps, Environment)
LIGHTS = ("position_mm", "rgb", "ambient_rgb", "camera_mm")
UNIT = {"position_mm": 1e3, "camera_mm": 1e3, "shininess": 10.0}
"""Inputs are varied in metres and tens, so that all gradients are of about one size."""
WAYS = [
    ("physical", "auto"),
    ("physical", "eager"),
    ("paper", "auto"),
    ("paper", "eager"),
    ("ggx", "auto"),
]


def maps_of(mode: str) -> tuple[str, ...]:
    """What a mode reads: as printed, nothing shades the ambient light."""
    return MAPS if mode == "paper" else (*MAPS, "ambient_occlusion")


def leaves_of(source: SkinMaps | Environment, names: tuple[str, ...]) -> list[Tensor]:
    found = [getattr(source, name) / UNIT.get(name, 1.0) for name in names]
    return [values.clone().requires_grad_() for values in found]


def with_leaves(source: Source, names: tuple[str, ...], leaves: tuple[Tensor, ...]) -> Source:
    pairs = zip(names, leaves, strict=True)
    return dataclasses.replace(source, **{n: UNIT.get(n, 1.0) * x for n, x in pairs})


@pytest.mark.parametrize(("mode", "engine"), WAYS)
def test_gradient_of_every_map_light_and_shadow_is_exact(mode: str, engine: str) -> None:
    # One light is distant; some texels lie beside the horizon of each.
    rng = np.random.default_rng(2)
    skin, lights = random_skin(rng, 2, 2), random_lights(rng, 2)
    options = ShadeOptions(mode=mode, engine=engine)
    seen = torch.tensor(rng.uniform(0.1, 1, (2, 2, 2, 2)))

    names = maps_of(mode)

    def render(seen: Tensor, *leaves: Tensor) -> Tensor:
        maps = with_leaves(skin, names, leaves[: len(names)])
        return shade(maps, with_leaves(lights, LIGHTS, leaves[len(names) :]), options, seen)

    leaves = [seen.requires_grad_(), *leaves_of(skin, names), *leaves_of(lights, LIGHTS)]
    assert torch.autograd.gradcheck(render, leaves, eps=1e-6, atol=1e-8)
    grads = torch.autograd.grad(render(*leaves).square().sum(), leaves)
    assert all(float(g.abs().max()) > 1e-5 for g in grads)


def test_gradient_of_the_tables_shadows_for_the_lights_is_exact() -> None:
    table = bake_table(screen(), OcclusionConfig(rows=12, directions=60))
    lights = torch.tensor([[50.0, 100, 1000], [400, -300, 700]]).double().requires_grad_()

    def shadows(metres: Tensor) -> Tensor:
        return table.for_lights(1e3 * metres, (12, 8))

    metres = (lights / 1e3).detach().requires_grad_()
    assert torch.autograd.gradcheck(shadows, (metres,), eps=1e-7, atol=1e-5)
    (grad,) = torch.autograd.grad(shadows(metres).sum(), [metres])
    assert float(grad.abs().max()) > 0.1


def test_gradient_of_the_networks_shadows_for_the_lights_is_exact() -> None:
    torch.manual_seed(0)
    network = OcclusionNetwork(OcclusionNetworkConfig(lights=2, order=3, features=5, connected=6))
    network.face.zero_()  # all of the texture shows a surface
    network = network.double().eval()
    rng = np.random.default_rng(3)
    toward = torch.tensor(rng.normal(size=(1, 2, 3)), requires_grad=True)
    share = torch.tensor([[0.7, 0.3]], dtype=torch.float64, requires_grad=True)

    def some_texels(toward: Tensor, share: Tensor) -> Tensor:
        return network.occlusion(toward, share)[:, ::29, ::23]

    assert torch.autograd.gradcheck(some_texels, (toward, share), eps=1e-6, atol=1e-9)
    grads = torch.autograd.grad(some_texels(toward, share).sum(), (toward, share))
    assert all(float(g.abs().max()) > 1e-6 for g in grads)


@settings(max_examples=60, deadline=None)
@given(
    normal=st.sampled_from(
        [(0, 0, 0), (1, 0, 0), (0, 0, 1), (0, 0, -1), (1e-9, 0, 0), (1e6, 0, 0), (1, 0, 1e-9)]
    ),
    albedo=st.sampled_from([0.0, 1e-6, 0.5, 1.0, 1e6]),
    exponent=st.one_of(st.sampled_from([1.0, 1000.0]), st.floats(1, 1000)),
    position=st.sampled_from([(0, 0, 1000), (1000, 0, 0), (1e6, 0, 1), (1e-3, 0, 0), (0, 0, -5)]),
    distant=st.booleans(),
    strength=st.sampled_from([0.0, 1e-6, 1.0, 1e6]),
    seen=st.sampled_from([0.0, 1.0]),
    way=st.sampled_from(WAYS),
)
def test_values_and_gradients_stay_finite_at_the_extremes(
    normal: tuple[float, float, float],
    albedo: float,
    exponent: float,
    position: tuple[float, float, float],
    distant: bool,
    strength: float,
    seen: float,
    way: tuple[str, str],
) -> None:
    skin = flat_skin(normal, albedo, shininess=torch.full((1, 1, 1, 1), exponent).double())
    skin = dataclasses.replace(skin, specular_albedo=torch.full((1, 1, 1, 1), albedo).double())
    lights = dataclasses.replace(one_light(position, strength), distant=torch.tensor([[distant]]))
    names = maps_of(way[0])
    maps, around = leaves_of(skin, names), leaves_of(lights, LIGHTS)
    shadow = torch.full((1, 1, 1, 1), seen, dtype=torch.float64, requires_grad=True)
    picture = shade(
        with_leaves(skin, names, tuple(maps)),
        with_leaves(lights, LIGHTS, tuple(around)),
        ShadeOptions(mode=way[0], engine=way[1]),
        shadow,
    )
    assert torch.isfinite(picture).all()
    picture.sum().backward()
    for name, leaf in zip((*names, *LIGHTS, "seen"), (*maps, *around, shadow), strict=True):
        assert leaf.grad is not None, name
        assert torch.isfinite(leaf.grad).all(), name
