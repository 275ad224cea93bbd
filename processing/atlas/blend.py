"""Blending: what the views show of each texel, weighted so that no seam is left."""

from __future__ import annotations

import dataclasses

import cv2
import numba
import numpy as np

from lightstage.rig import Camera
from processing.atlas.visibility import depth_buffer, silhouette_distance

CHUNK_TEXELS = 1_000_000


@dataclasses.dataclass(frozen=True)
class BlendConfig:
    """How views are weighted and merged."""

    feather_mm: float = 6.0
    """A view's weight rises from 0 at its silhouettes to full at this distance from them."""
    jump_mm: float = 4.0
    """Neighbouring depths farther apart (and than eight pixels' width) are a silhouette."""
    bias_mm: float = 0.5
    """A texel this far (and than four pixels' width) behind the z-buffer still counts as seen."""
    least_cos: float = 0.15
    """Views from flatter than this show nothing usable."""
    doubt_deg: float = 25.0
    """Where a view's normal is farther than this from the mesh's, its maps count less ..."""
    disbelief_deg: float = 50.0
    """... and not at all from here on: it was solved on a wrong surface."""
    band_mm: float = 3.0
    """Gaussian sigma between the two bands: below it views are averaged widely, above narrowly."""
    detail_power: float = 4.0
    """Power on the weights of the fine band: the best view's detail is kept, not averaged away."""


@dataclasses.dataclass(frozen=True)
class ViewSamples:
    """What one view sees of the atlas; one entry a seen texel.

    Attributes:
        slot: (k,) int32, position in the list of covered texels.
        pixel: (k, 2) float32 where the texel lies in the picture (first pixel's centre at 0.5).
        weight: (k,) float32 in 0..1.
        usable: (h, w) bool, pixels that may be read.
        footprint_mm: width of a pixel on the surface.
    """

    slot: np.ndarray
    pixel: np.ndarray
    weight: np.ndarray
    usable: np.ndarray
    footprint_mm: float


def view_samples(
    camera: Camera,
    vertices: np.ndarray,
    triangles: np.ndarray,
    positions: np.ndarray,
    normals: np.ndarray,
    trust: np.ndarray,
    confidence: np.ndarray,
    mask: np.ndarray,
    measured: np.ndarray,
    config: BlendConfig,
) -> ViewSamples:
    """Which texels a view sees and with what weight.

    The weight is cos^2 of the viewing angle x the view's own confidence x the distance to its
    silhouettes x the trust in the surface there x the agreement of measured and mesh normal.

    Args:
        camera: the view.
        vertices: (n, 3) mm, the mesh that occludes.
        triangles: (t, 3).
        positions: (k, 3) float32, the texels' places.
        normals: (k, 3) float32, the mesh's there.
        trust: (k,) float32 in 0..1, how far the mesh may be believed there.
        confidence: (h, w) the view's.
        mask: (h, w) bool, the face.
        measured: (h, w, 3) the view's normals.
        config: settings.

    Returns:
        ViewSamples.
    """
    depth = depth_buffer(camera, vertices, triangles)
    usable = mask & (confidence > 0)
    seen = usable & np.isfinite(depth)
    distance_mm = float(np.median(depth[seen])) if seen.any() else 1.0
    footprint = distance_mm / camera.fx_px
    edge = silhouette_distance(depth, usable, max(config.jump_mm, 8 * footprint))
    bias = max(config.bias_mm, 4 * footprint)
    feather = np.clip(edge * (footprint / config.feather_mm), 0, 1)
    quality = (feather * feather * (3 - 2 * feather) * confidence).astype(np.float32)
    centre = camera.centre_mm.astype(np.float32)
    doubt, disbelief = np.cos(np.deg2rad([config.doubt_deg, config.disbelief_deg]))
    slots, pixels, weights = [], [], []
    for first in range(0, len(positions), CHUNK_TEXELS):
        part = slice(first, first + CHUNK_TEXELS)
        toward = centre - positions[part]
        toward /= np.linalg.norm(toward, axis=1, keepdims=True)
        cosine = np.einsum("kc,kc->k", toward, normals[part])
        facing = np.flatnonzero((cosine > config.least_cos) & (trust[part] > 0))
        pixel, own_depth = camera.project(positions[part][facing])
        column = np.floor(np.nan_to_num(pixel[:, 0], nan=-1.0)).astype(np.int64)
        row = np.floor(np.nan_to_num(pixel[:, 1], nan=-1.0)).astype(np.int64)
        inside = (row >= 0) & (column >= 0) & (row < depth.shape[0]) & (column < depth.shape[1])
        facing, pixel, row, column = facing[inside], pixel[inside], row[inside], column[inside]
        weight = cosine[facing] ** 2 * trust[part][facing] * quality[row, column]
        agreement = np.einsum("kc,kc->k", measured[row, column], normals[part][facing])
        weight *= np.clip((agreement - disbelief) / (doubt - disbelief), 0, 1)
        keep = (own_depth[inside] <= depth[row, column] + bias) & (weight > 1e-6)
        slots.append((first + facing[keep]).astype(np.int32))
        pixels.append(pixel[keep].astype(np.float32))
        weights.append(weight[keep].astype(np.float32))
    return ViewSamples(
        np.concatenate(slots) if slots else np.zeros(0, np.int32),
        np.concatenate(pixels) if pixels else np.zeros((0, 2), np.float32),
        np.concatenate(weights) if weights else np.zeros(0, np.float32),
        usable,
        footprint,
    )


class Blender:
    """Sums of one map over the views: a low band widely averaged, a fine band narrowly."""

    def __init__(self, texels: int, channels: int, config: BlendConfig) -> None:
        self._config = config
        self._low = np.zeros((texels, channels), np.float32)
        self._fine = np.zeros((texels, channels), np.float32)
        self._weight = np.zeros((texels, 2), np.float32)

    def add(self, samples: ViewSamples, image: np.ndarray) -> None:
        """Add one view's (h, w, c) float32 map."""
        sigma = max(self._config.band_mm / samples.footprint_mm, 0.5)
        low = masked_blur(image, samples.usable, sigma)
        _accumulate(
            np.ascontiguousarray(image, np.float32),
            low,
            samples.usable,
            samples.slot,
            samples.pixel,
            samples.weight,
            self._config.detail_power,
            self._low,
            self._fine,
            self._weight,
        )

    def result(self) -> np.ndarray:
        """(k, c) float32 blended values; 0 where no view sees the texel."""
        least = np.finfo(np.float32).tiny
        self._low /= np.maximum(self._weight[:, :1], least)
        self._fine /= np.maximum(self._weight[:, 1:], least)
        self._low += self._fine
        return self._low


def masked_blur(image: np.ndarray, mask: np.ndarray, sigma_px: float) -> np.ndarray:
    """Gaussian blur of the masked part alone.

    Args:
        image: (h, w, c) float32.
        mask: (h, w) bool.
        sigma_px: of the Gaussian.

    Returns:
        (h, w, c) float32; 0 outside the mask.
    """
    weight = mask.astype(np.float32)
    size = 2 * int(np.ceil(3 * sigma_px)) + 1
    border = cv2.BORDER_CONSTANT
    near = np.asarray(cv2.GaussianBlur(weight, (size, size), sigma_px, borderType=border))
    near = np.where(mask, near, 1.0).astype(np.float32)
    out = np.empty(image.shape, np.float32)
    for channel in range(image.shape[2]):
        masked = np.where(mask, image[:, :, channel], 0).astype(np.float32)
        blurred = np.asarray(cv2.GaussianBlur(masked, (size, size), sigma_px, borderType=border))
        out[:, :, channel] = np.where(mask, blurred / near, 0)
    return out


@numba.njit(cache=True, parallel=True)
def _accumulate(
    image: np.ndarray,
    low: np.ndarray,
    usable: np.ndarray,
    slot: np.ndarray,
    pixel: np.ndarray,
    weight: np.ndarray,
    power: float,
    sum_low: np.ndarray,
    sum_fine: np.ndarray,
    sum_weight: np.ndarray,
) -> None:
    """Bilinear samples of usable pixels, added with their weights; a slot occurs once a view."""
    height, width, channels = image.shape
    for k in numba.prange(len(slot)):
        x, y = pixel[k, 0] - 0.5, pixel[k, 1] - 0.5
        left, top = int(np.floor(x)), int(np.floor(y))
        right_share, low_share = x - left, y - top
        covered = 0.0
        for dy in range(2):
            for dx in range(2):
                row, column = top + dy, left + dx
                if 0 <= row < height and 0 <= column < width and usable[row, column]:
                    covered += (right_share if dx else 1 - right_share) * (
                        low_share if dy else 1 - low_share
                    )
        if covered < 0.25:
            continue
        s = slot[k]
        coarse_weight = weight[k]
        fine_weight = coarse_weight**power
        sum_weight[s, 0] += coarse_weight
        sum_weight[s, 1] += fine_weight
        for c in range(channels):
            coarse, value = 0.0, 0.0
            for dy in range(2):
                for dx in range(2):
                    row, column = top + dy, left + dx
                    if 0 <= row < height and 0 <= column < width and usable[row, column]:
                        share = (right_share if dx else 1 - right_share) * (
                            low_share if dy else 1 - low_share
                        )
                        coarse += share * low[row, column, c]
                        value += share * image[row, column, c]
            sum_low[s, c] += coarse_weight * coarse / covered
            sum_fine[s, c] += fine_weight * (value - coarse) / covered
