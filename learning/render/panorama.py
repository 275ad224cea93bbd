"""Latitude-longitude pictures of light: as a few lights, or as spherical harmonics.

Row 0 looks up (+y); the middle column looks along +z and columns grow toward +x:
direction = (sin t sin p, cos t, sin t cos p), t = pi row / h, p = 2 pi (column / w - 1/2).
A light's rgb is what a white diffuser that faces it reads: radiance times solid angle over pi.
Of an even sky a white diffuser reads a quarter of the sum of these, whatever it faces.
"""

from __future__ import annotations

import dataclasses
import heapq
import math
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from learning.errors import MapsError
from learning.render.environments import Environment
from learning.render.light_dome import harmonics
from lightstage.formats.panorama import read_panorama, require_panorama
from lightstage.formats.srgb import LUMINANCE

LOBE = (math.pi, 2 * math.pi / 3, math.pi / 4, 0.0, -math.pi / 24)
"""How a clamped cosine weighs each band of light [Ramamoorthi2001]."""
HEMISPHERE = 0.5
"""Length of the mean direction of an even hemisphere's light. What is shorter comes from farther
around than any lamp can replace, and an even sky's is 0."""
LEAST_SHARE = 1e-6
"""Of a rectangle's light: a smaller part with a direction is rounding."""


@dataclasses.dataclass(frozen=True)
class Panorama:
    """Light from everywhere.

    Attributes:
        radiance: (h, 2 h, 3) float64 linear, at least 0.
    """

    radiance: np.ndarray

    def __post_init__(self) -> None:
        """FormatError for another shape, NaN, infinite or negative light, or none at all."""
        require_panorama(self.radiance, "environment")


def load_panorama(path: Path) -> Panorama:
    """Read a picture of light, OpenEXR or Radiance HDR; FormatError where it is none."""
    return Panorama(read_panorama(path))


def directions(rows: int) -> np.ndarray:
    """(rows, 2 rows, 3) unit directions of the texels."""
    t = np.pi * (np.arange(rows) + 0.5) / rows
    p = 2 * np.pi * ((np.arange(2 * rows) + 0.5) / (2 * rows) - 0.5)
    flat = np.sin(t)[:, None]
    return np.stack(
        np.broadcast_arrays(flat * np.sin(p), np.cos(t)[:, None], flat * np.cos(p)), axis=-1
    )


def solid_angles(rows: int) -> np.ndarray:
    """(rows, 1) steradians of a texel in each row; exact, so that they sum to 4 pi."""
    edges = np.cos(np.pi * np.arange(rows + 1) / rows)
    return ((edges[:-1] - edges[1:]) * np.pi / rows)[:, None]


def median_cut(panorama: Panorama, count: int, camera_mm: np.ndarray) -> Environment:
    """Directional lights of about equal power, one a rectangle of the picture [Debevec2005].

    Light is kept per channel; each light stands at its rectangle's centre of light. A rectangle's
    light that comes from farther around than a hemisphere is taken for an even sky and an even
    hemisphere: the sky's part belongs to the ambient light, as it has no direction. With more than
    a few lights no rectangle is so large.

    Args:
        panorama: the light.
        count: lights, at most; fewer where texels with light are fewer; none of an even sky that
            one light should replace.
        camera_mm: (3,).
    """
    rows = len(panorama.radiance)
    power = panorama.radiance * solid_angles(rows)[..., None] / np.pi
    weight = power @ LUMINANCE
    # The order of cutting is by power; ties go to the rectangle that came first.
    heap = [(-float(weight.sum()), 0, (0, rows, 0, 2 * rows))]
    done: list[tuple[int, int, int, int]] = []
    serial = 1
    while heap and len(heap) + len(done) < count:
        _, _, box = heapq.heappop(heap)
        halves = _cut(weight, box)
        if halves is None:
            done.append(box)
            continue
        for half in halves:
            top, bottom, left, right = half
            share = float(weight[top:bottom, left:right].sum())
            if share > 0:
                heapq.heappush(heap, (-share, serial, half))
                serial += 1
    way = directions(rows)
    boxes = done + [box for _, _, box in heap]
    rgb, toward, ambient_rgb = [], [], np.zeros(3)
    for top, bottom, left, right in boxes:
        here = weight[top:bottom, left:right, None]
        light = power[top:bottom, left:right].sum(axis=(0, 1))
        centre = (here * way[top:bottom, left:right]).sum(axis=(0, 1)) / here.sum()
        share = min(1.0, float(np.linalg.norm(centre)) / HEMISPHERE)
        ambient_rgb += (1 - share) * light / 4
        if share > LEAST_SHARE:
            rgb.append(share * light)
            toward.append(centre)
    return _distant(np.reshape(toward, (-1, 3)), np.reshape(rgb, (-1, 3)), camera_mm, ambient_rgb)


def _cut(
    weight: np.ndarray, box: tuple[int, int, int, int]
) -> tuple[tuple[int, int, int, int], tuple[int, int, int, int]] | None:
    """Halve a rectangle's power across its longer side; None for a single texel."""
    top, bottom, left, right = box
    rows = len(weight)
    middle = np.sin(np.pi * (top + bottom) / 2 / rows)
    if (right - left) * middle > bottom - top and right - left > 1:
        at = left + _half(weight[top:bottom, left:right].sum(axis=0))
        return (top, bottom, left, at), (top, bottom, at, right)
    if bottom - top > 1:
        at = top + _half(weight[top:bottom, left:right].sum(axis=1))
        return (top, at, left, right), (at, bottom, left, right)
    if right - left > 1:
        at = left + _half(weight[top:bottom, left:right].sum(axis=0))
        return (top, bottom, left, at), (top, bottom, at, right)
    return None


def _half(power: np.ndarray) -> int:
    """Where the sum before is nearest to the half, with something on both sides."""
    before = np.cumsum(power)[:-1]
    return 1 + int(np.argmin(np.abs(before - power.sum() / 2)))


def importance(
    panorama: Panorama, count: int, camera_mm: np.ndarray, rng: np.random.Generator
) -> Environment:
    """Directional lights drawn by their power, one from each of `count` equal shares of it.

    The camera of the environment is at `camera_mm` (3,).

    Without bias: the mean over draws is the picture's light, whatever the count.
    """
    rows = len(panorama.radiance)
    power = (panorama.radiance * solid_angles(rows)[..., None] / np.pi).reshape(-1, 3)
    weight = power @ LUMINANCE
    cumulated = np.cumsum(weight)
    at = (np.arange(count) + rng.uniform(size=count)) / count * cumulated[-1]
    chosen = np.minimum(np.searchsorted(cumulated, at, side="right"), len(weight) - 1)
    rgb = power[chosen] * (cumulated[-1] / count / weight[chosen])[:, None]
    return _distant(directions(rows).reshape(-1, 3)[chosen], rgb, camera_mm)


def _distant(
    toward: np.ndarray,
    rgb: np.ndarray,
    camera_mm: np.ndarray,
    ambient_rgb: np.ndarray | None = None,
) -> Environment:
    toward = toward / np.linalg.norm(toward, axis=1, keepdims=True)
    around = np.zeros(3) if ambient_rgb is None else ambient_rgb
    return Environment(
        torch.from_numpy(toward.astype(np.float32))[None],
        torch.from_numpy(rgb.astype(np.float32))[None],
        torch.from_numpy(around.astype(np.float32))[None],
        torch.ones(1, len(toward), dtype=torch.bool),
        torch.from_numpy(np.asarray(camera_mm, np.float32))[None],
    )


def project(panorama: Panorama, order: int) -> Tensor:
    """(3, (order + 1)^2) float64: the light's spherical harmonics."""
    rows = len(panorama.radiance)
    basis = harmonics(torch.from_numpy(directions(rows)), order)
    power = torch.from_numpy(panorama.radiance * solid_angles(rows)[..., None])
    return torch.einsum("hwc,hwk->ck", power, basis)


def irradiance(light: Tensor, normal: Tensor) -> Tensor:
    """What a white diffuser reads under harmonics of light, without shadows [Ramamoorthi2001].

    Args:
        light: (3, k) of `project`, order 4 at most.
        normal: (B, 3, H, W) unit.

    Returns:
        (B, 3, H, W); differentiable in both. May fall below 0 by the light's higher bands.
    """
    order = math.isqrt(light.shape[1]) - 1
    if order >= len(LOBE):
        raise MapsError("harmonics", found=f"order {order}", expected=f"at most {len(LOBE) - 1}")
    bands = [LOBE[band] / math.pi for band in range(order + 1) for _ in range(2 * band + 1)]
    weighed = light * light.new_tensor(bands)
    basis = harmonics(normal.permute(0, 2, 3, 1), order)
    return torch.einsum("ck,bhwk->bchw", weighed.to(basis), basis)
