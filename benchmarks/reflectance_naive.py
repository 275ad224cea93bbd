"""What a straightforward implementation does: rawpy's linear demosaic and the printed formula.

The formula is compiled, one loop over pixels on all cores, without any array between; it is as fast
as a reader of the paper could make it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import rawpy
from numba import njit, prange


def developed(path: Path) -> np.ndarray:
    """(h, w, 3) uint16 by LibRaw: linear demosaic, the camera's own white, no curve."""
    with rawpy.imread(str(path)) as raw:
        return np.asarray(
            raw.postprocess(
                demosaic_algorithm=rawpy.DemosaicAlgorithm.LINEAR,
                output_bps=16,
                gamma=(1, 1),
                no_auto_bright=True,
                use_camera_wb=True,
                output_color=rawpy.ColorSpace.raw,
            )
        )


def all_developed(paths: Sequence[Path], threads: int) -> list[np.ndarray]:
    """Pictures one after the other, or in as many threads at once."""
    if threads == 1:
        return [developed(path) for path in paths]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(developed, paths))


def printed_formula(
    pictures: Sequence[np.ndarray], patterns: Sequence[str], mask: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normals from ratios of complements, specular by the median of saturation's deltas.

    Args:
        pictures: P of (h, w, 3) uint16.
        patterns: their names, `full` and the six half spheres among them.
        mask: (h, w) bool, which pixels.

    Returns:
        (h, w, 3) normals, (h, w, 3) diffuse and (h, w) specular albedo, float32, zero outside.

    Source: [Kampouris2018].
    """
    place = {name: k for k, name in enumerate(patterns)}
    pairs = [(pictures[place[a + "+"]], pictures[place[a + "-"]]) for a in "xyz"]
    shape = mask.shape
    normal, albedo = np.zeros((*shape, 3), np.float32), np.zeros((*shape, 3), np.float32)
    specular = np.zeros(shape, np.float32)
    _formula(
        pictures[place["full"]],
        *(p for pair in pairs for p in pair),
        mask,
        normal,
        albedo,
        specular,
    )
    return normal, albedo, specular


@njit(cache=True)
def _delta(p: np.ndarray, m: np.ndarray) -> tuple[np.float32, np.float32]:
    """Specular part of the brighter of a pair, and the ratio along their axis."""
    plus = np.float32(p[0]) + np.float32(p[1]) + np.float32(p[2])
    minus = np.float32(m[0]) + np.float32(m[1]) + np.float32(m[2])
    g, c = (p, m) if plus >= minus else (m, p)
    most, dark = np.float32(max(g[0], g[1], g[2])), np.float32(max(c[0], c[1], c[2]))
    chroma = most - np.float32(min(g[0], g[1], g[2]))
    pale = dark - np.float32(min(c[0], c[1], c[2]))
    total = plus + minus
    ratio = (plus - minus) / total if total > 0 else np.float32(0)
    if pale <= 0:
        return np.float32(0), ratio
    return most - chroma * dark / pale, ratio


@njit(parallel=True, cache=True)
def _formula(
    full: np.ndarray,
    xp: np.ndarray,
    xm: np.ndarray,
    yp: np.ndarray,
    ym: np.ndarray,
    zp: np.ndarray,
    zm: np.ndarray,
    mask: np.ndarray,
    normal: np.ndarray,
    albedo: np.ndarray,
    specular: np.ndarray,
) -> None:
    white = np.float32(65535)
    for y in prange(mask.shape[0]):
        for x in range(mask.shape[1]):
            if not mask[y, x]:
                continue
            a, nx = _delta(xp[y, x], xm[y, x])
            b, ny = _delta(yp[y, x], ym[y, x])
            c, nz = _delta(zp[y, x], zm[y, x])
            s = max(min(a, b), min(max(a, b), c))
            s = min(max(s / white, np.float32(0)), np.float32(0.2))
            length = math.sqrt(nx * nx + ny * ny + nz * nz)
            if length > 0:
                normal[y, x, 0], normal[y, x, 1] = nx / length, ny / length
                normal[y, x, 2] = nz / length
            specular[y, x] = s
            for k in range(3):
                albedo[y, x, k] = max(np.float32(full[y, x, k]) / white - s, np.float32(0))
