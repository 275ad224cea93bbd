"""Normals that a network is unsure of are short: their gradient stays bounded and right."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from learning.data import Batch
from learning.encoding import absolute_reference, covered_channels, encode_maps
from learning.losses import rendering_loss
from learning.patch_light import Scene
from learning.render.environments import Environment
from learning.render.shading import ShadeOptions, shade, unit
from tests.learning.scenes import random_lights, random_skin

LENGTHS = (1.0, 0.5, 0.1, 1e-2, 1e-3, 1e-4, 1e-7, 0.0)
NORMALS = slice(4, 10)
FEW = 5.0
"""The gradient at length 1 is up to about 1.3."""


def scene(kind: torch.dtype) -> tuple[Batch, Tensor]:
    """A batch of random skin, and a guess at its thirteen channels whose normals are unit."""
    rng = np.random.default_rng(5)
    skin, lights = random_skin(rng, 6, 6, kind), random_lights(rng)
    lights = Environment(
        lights.position_mm.to(kind),
        lights.rgb.to(kind),
        lights.ambient_rgb.to(kind),
        lights.distant,
        lights.camera_mm.to(kind),
    )
    flat = torch.zeros_like(skin.diffuse_normal)
    reference = absolute_reference(flat, "head")
    covered = torch.ones_like(skin.area)
    channels = covered_channels(covered, covered)
    target = encode_maps(skin, skin.diffuse_albedo, channels, reference)
    guess = target + 0.3 * torch.tensor(rng.uniform(-1, 1, target.shape)).to(kind)
    guess = torch.cat(
        [guess[:, :4].clamp(-0.9, 0.9), unit(guess[:, 4:7]), unit(guess[:, 7:10]), guess[:, 10:]],
        dim=1,
    )
    inputs = target.new_zeros(2, 9, 6, 6)
    options, texture = ShadeOptions(), skin.diffuse_albedo
    seen = torch.ones(1, 1, 6, 6, dtype=kind)
    lit = (lights, seen, (Scene(lights, seen),), texture, reference, flat)
    return Batch(inputs, target, covered, channels, skin, *lit, options, []), guess


def shortened(guess: Tensor, length: float, only: tuple[int, int] | None = None) -> Tensor:
    """Normals of a length: everywhere, or of one texel amid unit ones."""
    short = guess.clone()
    at = (...,) if only is None else (..., *only)
    short[:, NORMALS][at] *= length
    return short


def loss_of(batch: Batch, channels: Tensor) -> Tensor:
    """As a sum over texels, so that a texel's gradient does not shrink with their count."""
    return rendering_loss(channels, batch, "texel") * batch.covered.sum()


def gradient_of(batch: Batch, channels: Tensor) -> Tensor:
    leaf = channels.clone().requires_grad_()
    (found,) = torch.autograd.grad(loss_of(batch, leaf), leaf)
    return found


@pytest.mark.parametrize("only", [None, (2, 3)])
def test_the_rendering_losss_gradient_is_bounded_at_any_length(
    only: tuple[int, int] | None,
) -> None:
    batch, guess = scene(torch.float64)
    most = float(gradient_of(batch, guess)[:, NORMALS].abs().max())
    assert most > 0.1
    for length in LENGTHS:
        found = gradient_of(batch, shortened(guess, length, only))
        assert float(found.abs().max()) < FEW * max(1.0, most), length


@pytest.mark.parametrize("length", [0.9, 0.1, 1e-3])
def test_the_gradient_of_short_normals_is_that_of_differences(length: float) -> None:
    batch, guess = scene(torch.float64)
    short = shortened(guess, length)
    found = gradient_of(batch, short)
    rng = np.random.default_rng(1)
    for _ in range(5):
        way = torch.zeros_like(short)
        way[:, NORMALS] = torch.tensor(rng.normal(size=way[:, NORMALS].shape))
        step = 1e-5 * length * way
        slope = (loss_of(batch, short + step) - loss_of(batch, short - step)) / (2e-5 * length)
        assert float((found * way).sum()) == pytest.approx(float(slope), rel=1e-4, abs=1e-4)


@pytest.mark.parametrize("length", LENGTHS)
def test_the_gradient_in_single_precision_is_that_in_double(length: float) -> None:
    batch, guess = scene(torch.float64)
    exact = gradient_of(batch, shortened(guess, length))
    single, guess = scene(torch.float32)
    found = gradient_of(single, shortened(guess, length)).double()
    torch.testing.assert_close(found, exact, atol=2e-3, rtol=1e-2)


@pytest.mark.parametrize("mode", ["physical", "paper", "ggx"])
@pytest.mark.parametrize("engine", ["auto", "eager"])
def test_unit_normals_are_shaded_as_ever_and_zero_is_black(mode: str, engine: str) -> None:
    batch, guess = scene(torch.float64)
    skin = batch.skin
    for length in (1.0, 0.0):
        normals = {
            "diffuse_normal": length * guess[:, 4:7],
            "specular_normal": length * guess[:, 7:10],
        }
        fields = {**{k: getattr(skin, k) for k in skin.__dataclass_fields__}, **normals}
        short = type(skin)(**fields)
        fading = ShadeOptions(mode=mode, engine=engine, fade_normals=True)
        found = shade(short, batch.environment, fading)
        if length:
            plain = shade(short, batch.environment, ShadeOptions(mode=mode, engine=engine))
            torch.testing.assert_close(found, plain, rtol=1e-12, atol=1e-12)
        else:
            assert not found.any()
