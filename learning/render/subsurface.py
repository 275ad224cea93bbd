"""Subsurface scattering in texture space: one Gaussian, wide as on the skin.

Energy-keeping for any translucency: S = U + a g(a U) - a U g(a), with a = sqrt(C' w) and g
diffusion on the surface, symmetric under the texels' area. What a texel gives to another is what
that one gets, so the sum over the surface stays; and S is a mean of U's around it, so nothing gets
brighter than its surroundings.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as functional
from torch import Tensor

from learning.render.diffusion import Diffusion
from learning.render.fused import can_fuse
from learning.render.scattering import FusedScatter

SCATTERED = (0.5, 0.15, 0.05)
"""w_SSS, the scattered share of red, green and blue [Lattas2021]."""
KEPT = (0.5, 0.85, 0.95)
"""w_D of the paper."""
SMALLEST = 1e-6
BLOCK_ROWS = 128
"""Rows that are blurred by one matrix product."""


def scatter(
    diffuse: Tensor,
    irradiance: Tensor,
    translucency: Tensor,
    area: Tensor,
    sigma_px: float,
    edges: Tensor | None = None,
    fused: bool = True,
) -> Tensor:
    """Spread diffuse light, keeping its sum over the surface.

    Args:
        diffuse: (B, 3, H, W) albedo times irradiance.
        irradiance: (B, 3, H, W); light scatters from where there is much to where there is little.
        translucency: (B, 1, H, W), 0..1; where it is 0 the light stays what it is.
        area: (B, 1, H, W) relative surface of a texel, 0 where there is none.
        sigma_px: the kernel's standard deviation in edges of a texel of area 1.
        edges: (B, 2, H, W) see `SkinMaps`.
        fused: take the compiled code on a processor.

    Returns:
        (B, 3, H, W); sum(area * result) = sum(area * diffuse).
    """
    batch = len(diffuse)
    if edges is not None:
        edges = edges.expand(batch, -1, -1, -1)
    diffusion = Diffusion(area.expand(batch, -1, -1, -1), edges, sigma_px)
    if fused and can_fuse(diffuse):
        same = [x.expand(batch, -1, -1, -1) for x in (irradiance, translucency)]
        return FusedScatter.apply(diffuse, *same, diffusion, SCATTERED, SMALLEST)
    weight = diffuse.new_tensor(SCATTERED).view(1, 3, 1, 1)
    # The square root, moved so that its gradient stays finite at 0; any root keeps the energy.
    share = (translucency * (1 - irradiance)).clamp(0.0, 1.0) * weight
    root = (share + SMALLEST).sqrt() - SMALLEST**0.5
    both = diffusion.spread_by_scans(torch.cat([root * diffuse, root], dim=1))
    return diffuse + root * (both[:, :3] - diffuse * both[:, 3:])


def scatter_paper(
    diffuse: Tensor, irradiance: Tensor, translucency: Tensor, area: Tensor, sigma_px: float
) -> Tensor:
    """The paper's S = (1 - C') w_D U + C' w_SSS g(U), as printed; it loses light where C' = 0.

    Arguments as `scatter`; `area` serves as the mask of the surface only.
    """
    kept = diffuse.new_tensor(KEPT).view(1, 3, 1, 1)
    scattered = diffuse.new_tensor(SCATTERED).view(1, 3, 1, 1)
    share = translucency * (1 - irradiance)
    spread = blur(diffuse * (area > 0), sigma_px) if sigma_px > 0 else diffuse
    return (1 - share) * kept * diffuse + share * scattered * spread


def blur(image: Tensor, sigma_px: float) -> Tensor:
    """Symmetric Gaussian, separable, cut at 3.5 sigma; nothing comes in over the borders.

    Args:
        image: (B, C, H, W).
        sigma_px: standard deviation in texels, positive.
    """
    planes = image.flatten(0, 1)
    planes = _blur_rows(planes, sigma_px)
    planes = _blur_rows(planes.mT, sigma_px).mT
    return planes.unflatten(0, image.shape[:2])


def _blur_rows(planes: Tensor, sigma_px: float) -> Tensor:
    """Blur (P, H, W) along H: products of a banded matrix with blocks of rows.

    On processors this is three to five times faster than a depthwise convolution, forward and
    backward.
    """
    height = planes.shape[1]
    block = min(BLOCK_ROWS, height)
    count = -(-height // block)
    radius = max(1, math.ceil(3.5 * sigma_px))
    taps = torch.arange(-radius, radius + 1, dtype=planes.dtype, device=planes.device)
    total = torch.exp(-0.5 * (taps / sigma_px) ** 2).sum()
    source = torch.arange(-radius, block + radius, dtype=planes.dtype, device=planes.device)
    distance = source[None] - source[radius : radius + block, None]
    band = torch.exp(-0.5 * (distance / sigma_px) ** 2) * (distance.abs() <= radius) / total
    padded = functional.pad(planes, (0, 0, radius, radius + count * block - height))
    blocks = padded.unfold(1, block + 2 * radius, block).mT  # (P, count, block + 2 radius, W)
    return (band @ blocks).flatten(1, 2)[:, :height]
