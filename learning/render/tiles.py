"""Large textures in bands, so that memory is the maps' own and a little more. No gradients."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import torch
from torch import Tensor

from learning.render.environments import Environment
from learning.render.shading import shade
from learning.render.skin import ShadeOptions, SkinMaps

ROWS = 512
"""Rows of a band."""
REACH = 5.0
"""A band sees so many of the kernel's standard deviations beyond its edges: texels further away
give a texel less than 1e-4 of its light."""


def shade_in_bands(
    maps: SkinMaps,
    environment: Environment,
    options: ShadeOptions | None = None,
    visibility: Tensor | None = None,
    rows: int = ROWS,
) -> Tensor:
    """As `shading.shade`, band after band of rows, each with a margin for light inside the skin.

    Args:
        maps: the skin.
        environment: lights and camera.
        options: of the shading.
        visibility: (B, L, H, W) or None.
        rows: of a band.

    Returns:
        (B, 3, H, W), without a graph.
    """
    chosen = options or ShadeOptions()
    height, width = maps.diffuse_albedo.shape[-2:]
    margin = math.ceil(REACH * chosen.subsurface_mm / maps.texel_mm * _squeezed(maps))
    batch = max(maps.diffuse_albedo.shape[0], environment.rgb.shape[0])
    out = maps.diffuse_albedo.new_empty((batch, 3, height, width))
    with torch.no_grad():
        for top in range(0, height, rows):
            bottom = min(height, top + rows)
            first, last = max(0, top - margin), min(height, bottom + margin)
            seen = None if visibility is None else visibility[:, :, first:last]
            lit = shade(band(maps, first, last), environment, chosen, seen)
            out[:, :, top:bottom] = lit[:, :, top - first : bottom - first]
    return out


def band(maps: SkinMaps, first: int, last: int) -> SkinMaps:
    """Rows of the maps, as views of the same memory."""
    cut: dict[str, Any] = {f.name: getattr(maps, f.name) for f in dataclasses.fields(maps)}
    for name, values in cut.items():
        if isinstance(values, Tensor):
            cut[name] = values[..., first:last, :]
    return SkinMaps(**cut)


def _squeezed(maps: SkinMaps) -> float:
    """How many more rows than usual a millimetre takes where the texture is densest."""
    if maps.edges is None:
        return 1.0
    down = maps.edges[:, 1][maps.area[:, 0] > 0]
    if not down.numel():
        return 1.0
    # The densest thousandth is left to the kernel's tails.
    least = float(down[:: max(1, down.numel() // 100_000)].quantile(0.001))
    return min(8.0, max(1.0, 1.0 / max(least, 1e-3)))
