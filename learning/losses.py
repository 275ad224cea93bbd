"""Losses of the generator beside the adversarial ones."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from learning.data import Batch
from learning.encoding import OWN_CHANNELS, decode_maps
from learning.render.environments import RandomLightConfig, apart, around, stack
from learning.render.shading import shade


def rendering_loss(
    found: Tensor,
    batch: Batch,
    environments: int,
    lights: RandomLightConfig,
    rng: np.random.Generator | Sequence[np.random.Generator],
) -> Tensor:
    """How different the found skin looks from the true one, in some environments [Lattas2021].

    The sum runs over the input's own environment and `environments` ones drawn around it, and is
    divided by `environments`; the norm is not squared. It is the Euclidean norm of a texel's rgb
    difference, averaged over the surface, in linear light. The found normals' light fades where
    they are shorter than 1, so that the gradient is bounded.

    Args:
        found: (B, 13, h, w), the generator's output.
        batch: the truth.
        environments: n_L.
        lights: how far the draws go.
        rng: randomness; or one for each patch, so that its lights do not depend on the others'.
    """
    skin = decode_maps(found, batch.reference).on(batch.skin)
    total = found.new_zeros(())
    of_truth, of_found = batch.options, dataclasses.replace(batch.options, fade_normals=True)
    rngs = rng.spawn(len(found)) if isinstance(rng, np.random.Generator) else rng
    targets = list(zip(apart(batch.environment), rngs, strict=True)) if environments else []
    for index in range(environments + 1):
        environment = batch.environment
        if index:
            environment = stack([around(target, own, lights) for target, own in targets])
        with torch.no_grad():
            truth = shade(batch.skin, environment, of_truth)
        difference = shade(skin, environment, of_found) - truth
        # The square root's gradient at 0 is infinite; 1e-4 is far below what a texel shows.
        norm = (difference.square().sum(dim=1, keepdim=True) + 1e-8).sqrt()
        total = total + masked_mean(norm, batch.covered)
    return total / environments


def maps_loss(found: Tensor, batch: Batch) -> Tensor:
    """L1 of the patch's own maps on the surface.

    Not of the whole albedo: its eyes and brows have more contrast than a patch of skin, and a short
    training would spend itself on drawing them, into the patch's maps too.
    """
    own = slice(0, OWN_CHANNELS)
    return masked_mean((found[:, own] - batch.target[:, own]).abs(), batch.covered)


def masked_mean(values: Tensor, covered: Tensor) -> Tensor:
    """Mean of (B, c, h, w) over channels and the texels of (B, 1, h, w) that are 1."""
    channels = values.shape[1]
    return (values * covered).sum() / (covered.sum() * channels).clamp_min(1.0)
