"""The texels of a template's eyes, filled from where a photograph shows the eyes open.

A fitted shape has its eyes some millimetres beside the person's: its texels would show lids.
"""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np

from learning.photo.eyes import EYES
from learning.photo.unwrap import GRAZING, Unwrapped
from learning.render.uv import UvRaster
from learning.render.view import sample_bilinear
from lightstage.formats.template import Template


@dataclasses.dataclass(frozen=True)
class EyeTexels:
    """The texels of a template's eyes.

    Attributes:
        texels: (2, rows, columns) bool, of the person's right and left eye.
        place: (rows, columns, 2) in their eye: from 0 to 1 to the face's left, and down.
    """

    texels: np.ndarray
    place: np.ndarray


def eye_texels(template: Template, raster: UvRaster) -> EyeTexels | None:
    """Where a template's eyes are in its texture; None where it names no region `eyes`."""
    vertices = template.mesh.vertices
    region = template.regions.get("eyes", np.zeros(0, int))
    if not len(region):
        return None
    middles = np.array([vertices[template.landmarks[each]].mean(axis=0) for each in EYES])
    nearest = np.linalg.norm(vertices[region, None] - middles, axis=2).argmin(axis=1)
    texels = np.zeros((2, *raster.covered.shape), bool)
    place = np.zeros((*raster.covered.shape, 2))
    position = raster.interpolate(vertices)
    for index in range(2):
        own = region[nearest == index]
        if not len(own):
            continue
        inside = np.zeros((len(vertices), 1))
        inside[own] = 1
        texels[index] = raster.covered & (raster.interpolate(inside)[..., 0] > 0.5)
        low, high = vertices[own].min(axis=0), vertices[own].max(axis=0)
        # A texel that is half the region's may lie a little beyond its vertices.
        share = np.clip((position[texels[index]] - low) / np.maximum(high - low, 1e-6), 0, 1)
        place[texels[index]] = np.column_stack([share[:, 0], 1 - share[:, 1]])
    return EyeTexels(texels, place)


def with_eyes(
    unwrapped: Unwrapped, rgb_linear: np.ndarray, openings_px: np.ndarray, eyes: EyeTexels
) -> tuple[Unwrapped, np.ndarray]:
    """A photograph in texels whose eyes are filled from where it shows them open.

    Args:
        unwrapped: by the fitted shape.
        rgb_linear: (h, w, 3).
        openings_px: of `openings`.
        eyes: texels of the template.

    Returns:
        The photograph, and (rows, columns) bool, the texels that were filled.
    """
    filled = np.zeros_like(unwrapped.seen)
    texture, seen = unwrapped.texture.copy(), unwrapped.seen.copy()
    facing = unwrapped.facing.copy()
    for here, (corner, *sides) in zip(eyes.texels, openings_px, strict=True):
        if not here.any() or not np.isfinite([corner, *sides]).all():
            continue
        place = corner + eyes.place[here] @ np.array(sides)
        # Where a texel holds several pixels it shows their mean.
        area = float(np.prod(np.linalg.norm(sides, axis=1))) / here.sum()
        texture[here] = _blurred_at(rgb_linear, place, 0.5 * np.sqrt(area))
        filled |= here
    seen |= filled
    facing[filled] = np.maximum(facing[filled], GRAZING)
    return Unwrapped(texture, seen, facing), filled


def _blurred_at(rgb: np.ndarray, place_px: np.ndarray, sigma: float) -> np.ndarray:
    """(n, 3) of a picture at (n, 2) places, blurred."""
    margin = int(np.ceil(4 * sigma)) + 2
    size = np.array(rgb.shape[1::-1])
    low = np.clip(np.floor(place_px.min(axis=0)).astype(int) - margin, 0, size - 1)
    high = np.clip(np.ceil(place_px.max(axis=0)).astype(int) + margin, low + 1, size)
    part: np.ndarray = rgb[low[1] : high[1], low[0] : high[0]].astype(np.float32)
    if sigma > 0.5:
        part = cv2.GaussianBlur(part, (0, 0), sigma)
    across, down = ((place_px - low) / (high - low)).T
    return sample_bilinear(part, np.column_stack([across, 1 - down]))
