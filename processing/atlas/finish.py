"""What becomes of blended values: guesses where nothing was seen, the gutter, the picture."""

from __future__ import annotations

import cv2
import numba
import numpy as np

from lightstage.formats.half import half_bits
from processing.atlas.raster import Raster

FILL_WEIGHT = 0.02
"""The guess for unseen texels counts like a view of this weight, which feathers its rim."""


def towards(
    values: np.ndarray,
    guess: np.ndarray,
    raster: Raster,
    triangles: np.ndarray,
    texels: np.ndarray,
    best: np.ndarray,
) -> None:
    """Lean blended values, in place, to a guess where little was seen.

    Args:
        values: (k, c) float32.
        guess: (n, c) per vertex.
        raster: of the atlas.
        triangles: (t, 3).
        texels: (k,) flat indices.
        best: (k,) float32, the largest weight that any view has there.
    """
    _towards(
        values,
        np.ascontiguousarray(guess, np.float64),
        raster.face.ravel(),
        raster.barycentric.reshape(-1, 2),
        np.ascontiguousarray(triangles, np.int32),
        texels,
        best,
    )


def picture(
    values: np.ndarray,
    shape: tuple[int, int],
    texels: np.ndarray,
    gutter: tuple[np.ndarray, np.ndarray],
    outside: float,
    half: bool,
) -> np.ndarray:
    """Texels' values as a picture; what half floats cannot hold becomes infinite.

    Args:
        values: (k,) or (k, c).
        shape: of the atlas, rows and columns.
        texels: (k,) flat indices.
        gutter: (g,) flat indices of the gutter's texels and (g,) of those they copy.
        outside: value of all others.
        half: in half floats.

    Returns:
        (rows, columns, c) float16 or float32.
    """
    flat = np.asarray(values.reshape(len(values), -1), np.float32)
    kind = np.float16 if half else np.float32
    image = np.full((shape[0] * shape[1], flat.shape[1]), outside, kind)
    if half:
        _place_half(flat, texels, image.view(np.uint16))
        _copy(gutter[0], gutter[1], image.view(np.uint16))
    else:
        _place(flat, texels, image)
        _copy(gutter[0], gutter[1], image)
    return image.reshape(*shape, -1)


def gutter_sources(covered: np.ndarray, gutter_px: int) -> tuple[np.ndarray, np.ndarray]:
    """For each texel near an island, the nearest covered one.

    Args:
        covered: (rows, columns) bool.
        gutter_px: how far the gutter reaches.

    Returns:
        (g,) flat indices of gutter texels and (g,) of the texels they copy.
    """
    if covered.all() or not covered.any():
        none = np.zeros(0, np.int32)
        return none, none
    distance, labels = cv2.distanceTransformWithLabels(
        (~covered).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    distance, labels = np.asarray(distance).ravel(), np.asarray(labels).ravel()
    gutter = np.flatnonzero((distance > 0) & (distance <= gutter_px)).astype(np.int32)
    # Labels count the covered pixels in row order, from 1.
    source = np.full(int(labels.max()) + 1, -1, np.int32)
    _sources(covered.ravel(), labels, source)
    return gutter, source[labels[gutter]]


@numba.njit(cache=True)
def _sources(covered: np.ndarray, labels: np.ndarray, source: np.ndarray) -> None:
    for texel in range(len(labels)):
        if covered[texel]:
            source[labels[texel]] = texel


@numba.njit(cache=True, parallel=True)
def unit_towards(values: np.ndarray, normals: np.ndarray, best: np.ndarray) -> None:
    """Make blended normals unit, in place; where little was seen they lean to the mesh's.

    Args:
        values: (k, 3) float32.
        normals: (k, 3) float32 unit, the mesh's.
        best: (k,) float32, the largest weight that any view has there.
    """
    for k in numba.prange(len(values)):
        share = best[k] / (best[k] + FILL_WEIGHT)
        for turn in range(2):
            x, y, z = values[k, 0], values[k, 1], values[k, 2]
            length = np.sqrt(x * x + y * y + z * z)
            scale = 1 / length if length > 1e-9 else 0.0
            for c in range(3):
                value = values[k, c] * scale
                if turn == 0:
                    value = value * share + normals[k, c] * (1 - share)
                values[k, c] = value


@numba.njit(cache=True, parallel=True)
def _towards(
    values: np.ndarray,
    guess: np.ndarray,
    face: np.ndarray,
    barycentric: np.ndarray,
    triangles: np.ndarray,
    texels: np.ndarray,
    best: np.ndarray,
) -> None:
    for k in numba.prange(len(values)):
        texel = texels[k]
        share = best[k] / (best[k] + FILL_WEIGHT)
        t = face[texel]
        b1, b2 = barycentric[texel, 0], barycentric[texel, 1]
        b0 = 1.0 - b1 - b2
        i, j, m = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        for c in range(values.shape[1]):
            around = b0 * guess[i, c] + b1 * guess[j, c] + b2 * guess[m, c]
            values[k, c] = share * values[k, c] + (1 - share) * around


@numba.njit(cache=True, parallel=True)
def _place(values: np.ndarray, texels: np.ndarray, image: np.ndarray) -> None:
    for k in numba.prange(len(texels)):
        for c in range(values.shape[1]):
            image[texels[k], c] = values[k, c]


@numba.njit(cache=True, parallel=True)
def _place_half(values: np.ndarray, texels: np.ndarray, image: np.ndarray) -> None:
    for k in numba.prange(len(texels)):
        for c in range(values.shape[1]):
            image[texels[k], c] = half_bits(values[k, c])


@numba.njit(cache=True, parallel=True)
def _copy(gutter: np.ndarray, source: np.ndarray, image: np.ndarray) -> None:
    for k in numba.prange(len(gutter)):
        for c in range(image.shape[1]):
            image[gutter[k], c] = image[source[k], c]
