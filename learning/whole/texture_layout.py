"""Whether textures have one layout: the same texel is about the same place of every head."""

from __future__ import annotations

import torch
from torch import Tensor

FARTHEST_MM = 20.0
"""Mean distance of a head's texels from those of the mean person. Our people have 3 to 9 once they
are aligned, a texture that is flipped or turned has 78 to 99, one in our layout of before 32."""
FRONT_Z_MM, CHIN_Y_MM, FOREHEAD_Y_MM = 40.0, -110.0, 40.0
"""Where brows, eyes and lips are, in the head frame. Hair begins elsewhere on each person."""


def brows_to_lips(position_mm: Tensor) -> Tensor:
    """(n, 1, h, w) bool, where brows, eyes and lips are, of (n, 3, h, w) in the head frame."""
    _, height, depth = position_mm.split(1, dim=1)
    return (depth > FRONT_Z_MM) & (height > CHIN_Y_MM) & (height < FOREHEAD_Y_MM)


def known_of_both(position_mm: Tensor, mean_mm: Tensor) -> Tensor:
    """(h, w) bool, texels of which both (1, 3, h, w) positions are known: not all zero."""
    return ((position_mm != 0).any(dim=1) & (mean_mm != 0).any(dim=1))[0]


def apart_mm(position_mm: Tensor, mean_mm: Tensor) -> float:
    """Mean distance of two (1, 3, h, w) positions where both are known; NaN where none is."""
    known = known_of_both(position_mm, mean_mm)
    return float((position_mm - mean_mm).norm(dim=1)[0][known].mean())


def of_another_layout(positions_mm: Tensor) -> list[int]:
    """Which of several heads have another layout than most.

    Args:
        positions_mm: (n, 3, h, w) in the head frame, zero without surface.
    """
    usual = torch.nanmedian(positions_mm, dim=0, keepdim=True).values
    return [
        index
        for index in range(len(positions_mm))
        if not apart_mm(positions_mm[index : index + 1], usual) <= FARTHEST_MM
    ]
