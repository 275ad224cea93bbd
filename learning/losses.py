"""Losses of the patch networks' generator beside the adversarial ones.

Those of whole faces are in whole/train.py.
"""

from __future__ import annotations

import dataclasses
from typing import Literal

import torch
from torch import Tensor

from learning.data import Batch
from learning.encoding import OWN_CHANNELS, decode_maps
from learning.patch_light import Scene
from learning.render.shading import shade

RenderNorm = Literal["patch", "texel"]


def rendering_loss(found: Tensor, batch: Batch, norm: RenderNorm = "patch") -> Tensor:
    """How different the found skin looks from the true one, in some environments [Lattas2021].

    The sum runs over the input's own environment and the batch's draws, all around one target and
    each with the shadows of its lights, and is divided by the number of draws; the norm is not
    squared. Light is linear. The found normals' light fades where they are shorter than 1, so that
    the gradient is bounded.

    Args:
        found: (B, 13, h, w), the generator's output.
        batch: the truth.
        norm: of the difference: over the whole `patch`, a picture's root of the sum of squares; or
            the mean over `texel`s of a texel's root of the sum of squares. That is smaller by about
            the square root of the number of texels.
    """
    skin = decode_maps(found, batch.reference).on(batch.skin)
    total = found.new_zeros(())
    of_truth, of_found = batch.options, dataclasses.replace(batch.options, fade_normals=True)
    for scene in (Scene(batch.environment, batch.visibility), *batch.draws):
        with torch.no_grad():
            truth = shade(batch.skin, scene.environment, of_truth, scene.visibility)
        rendered = shade(skin, scene.environment, of_found, scene.visibility)
        square = (rendered - truth).square() * batch.covered
        # The square root's gradient at 0 is infinite; 1e-4 is far below what a texel shows.
        if norm == "texel":
            each = (square.sum(dim=1, keepdim=True) + 1e-8).sqrt()
            total = total + masked_mean(each, batch.covered)
        else:
            total = total + (square.sum(dim=(1, 2, 3)) + 1e-8).sqrt().mean()
    return total / max(1, len(batch.draws))


def maps_loss(found: Tensor, batch: Batch) -> Tensor:
    """L1 of the patch's own maps on the surface.

    Not of the whole albedo: its eyes and brows have more contrast than a patch of skin, and a short
    training would spend itself on drawing them, into the patch's maps too.

    Args:
        found: (B, 13, h, w), the generator's output.
        batch: the truth.
    """
    own = slice(0, OWN_CHANNELS)
    return masked_mean((found[:, own] - batch.target[:, own]).abs(), batch.covered)


def masked_mean(values: Tensor, covered: Tensor) -> Tensor:
    """Mean of (B, c, h, w) over channels and the texels of (B, 1, h, w) that are 1."""
    channels = values.shape[1]
    return (values * covered).sum() / (covered.sum() * channels).clamp_min(1.0)
