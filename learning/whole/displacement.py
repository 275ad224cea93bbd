"""Textures whose texels show other places of a face than their own.

A photograph is brought into a texture by the shape that was fitted to it. Where this is not quite
the person's, a texel shows what is beside its place.
"""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as functional
from torch import Tensor

from learning import augment
from learning.render.skin import SkinMaps

SMALLEST_AREA = 0.1
"""Area, over that of a typical texel, below which a texel is displaced as one of this area."""


def displacement(rng: np.random.Generator, deviation_mm: float) -> Tensor:
    """(1, 2, rows, columns) right and down in mm, a smooth field's values at a few places.

    A fit misses coarse shape more than fine: most of the variance is that of `augment.PATCHES`,
    a third that of places half as far apart. How far a face is displaced differs from face to
    face, so that one in place is among them.
    """
    rows, columns = augment.PATCHES
    coarse = torch.from_numpy(rng.normal(size=(1, 2, rows, columns)))
    fine = torch.from_numpy(rng.normal(size=(1, 2, 2 * rows, 2 * columns)))
    enlarged = functional.interpolate(coarse, fine.shape[2:], mode="bicubic", align_corners=False)
    amount = deviation_mm * abs(float(rng.normal()))
    return (amount * ((2 / 3) ** 0.5 * enlarged + (1 / 3) ** 0.5 * fine)).float()


def displaced(image: Tensor, shift_mm: Tensor, texel_mm: Tensor) -> Tensor:
    """An image each of whose texels shows what is beside its own place; zero beyond the border.

    Args:
        image: (B, c, h, w).
        shift_mm: (B, 2, rows, columns), how far right and down of a texel its value comes from.
        texel_mm: (B, 1, h, w), edge of each texel on the surface.
    """
    rows, columns = image.shape[2:]
    shift_mm = shift_mm.to(image)
    shift = functional.interpolate(shift_mm, (rows, columns), mode="bicubic", align_corners=False)
    right, down = (shift / texel_mm).unbind(dim=1)
    x = torch.arange(columns, device=image.device) + 0.5
    y = torch.arange(rows, device=image.device) + 0.5
    at = torch.stack([2 * (x + right) / columns - 1, 2 * (y[:, None] + down) / rows - 1], dim=3)
    return functional.grid_sample(image, at, mode="bilinear", align_corners=False)


def edges_mm(skin: SkinMaps) -> Tensor:
    """(B, 1, h, w) edge of each texel on the surface."""
    return skin.texel_mm * skin.area.clamp_min(SMALLEST_AREA).sqrt()
