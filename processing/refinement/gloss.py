"""Skin's gloss on the mesh: specular albedo and lobe width that explain all views together.

One pixel's seven readings hold too little of its mirror reflection to beat a constant. What the
pixels of all views show (`joint.gloss_evidence`) is summed at the mesh's vertices; a lobe width is
found over some millimetres, and with it the specular albedo over one.
"""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
from numba import njit, prange
from scipy import sparse

from processing.lighting.lobe import SKIN_F0
from processing.surface import LitSurface

ROUGHNESS_RANGE = (0.05, 0.45)
SPECULAR_RANGE = (0.0, 0.2)
"""Reflectances above .2 are metals, not faces."""
LONGEST_STEP = 0.05
"""Largest step of the roughness: beyond it the lobe is not linear in it."""
PAIR = 2
"""Columns that are averaged at once."""


@dataclasses.dataclass(frozen=True)
class Gloss:
    """Beckmann's m and the reflectance at normal incidence: (V,) each."""

    roughness: np.ndarray
    specular: np.ndarray


def skin_gloss(vertices: int, roughness: float) -> Gloss:
    """Gloss before anything was seen."""
    same = np.ones(vertices)
    return Gloss(roughness * same, SKIN_F0 * same)


def sum_at_vertices(
    evidence: np.ndarray, corners: np.ndarray, weights: np.ndarray, vertices: int
) -> np.ndarray:
    """(V, k) sums of n pixels' (n, k) values at the (n, 3) corners of their triangles."""
    columns = [
        np.bincount(corners.ravel(), (weights * values[:, None]).ravel(), minlength=vertices)
        for values in evidence.T
    ]
    return np.stack(columns, axis=1)


def better_gloss(
    gloss: Gloss,
    sums: np.ndarray,
    surface: LitSurface,
    *,
    roughness_pool_mm: float,
    specular_pool_mm: float,
    prior: float,
    spread: float,
    wrong: np.ndarray | float = 0.0,
) -> Gloss:
    """Gloss nearer to the pixels' evidence, by one step of Gauss-Newton.

    Args:
        gloss: about which the evidence was taken.
        sums: (V, 5) of `joint.gloss_evidence` over all views.
        surface: whose vertices these are.
        roughness_pool_mm, specular_pool_mm: sigma over which vertices share one.
        prior: the whole face's own answer counts as this share of a typical vertex's information.
        spread: standard deviation of the specular albedo over a face: where noise would make it
            larger, the whole face's answer counts instead.
        wrong: one or (V,) standard deviation of what all pixels of a place misjudge together, as
            the model of light is not quite right: their number does not make it less.

    Returns:
        Gloss, finite everywhere; the given one where there is no evidence at all.
    """
    total = sums.sum(axis=0)
    if not total[0] > 0:
        return gloss
    near = smooth(sums, surface.average, surface.rounds(specular_pool_mm))
    ss, sm, mm, s_left, m_left = near.T
    safe = np.where(ss > 0, ss, 1)
    # What is left for the roughness once each place has the specular albedo that suits it.
    wide = np.stack([mm - sm**2 / safe, m_left - sm * s_left / safe], axis=1)
    wide[~(ss > 0)] = 0
    whole = wide.sum(axis=0)
    wide = smooth(wide, surface.average, surface.rounds(roughness_pool_mm))
    wide += prior * whole / max(int((ss > 0).sum()), 1)
    step = np.divide(wide[:, 1], wide[:, 0], out=np.zeros(len(wide)), where=wide[:, 0] > 0)
    step = np.clip(step, -LONGEST_STEP, LONGEST_STEP)
    roughness = np.clip(gloss.roughness + step, *ROUGHNESS_RANGE)
    step = roughness - gloss.roughness
    found = s_left - sm * step + ss * gloss.specular
    level = found.sum() / ss.sum()
    # Averages stand for so many vertices of their own.
    together = max(4 * np.pi * (specular_pool_mm / surface.edge_mm) ** 2, 1.0)
    shrinkage = 1 / (1 + together * ss * wrong**2)
    found, ss = found * shrinkage, ss * shrinkage
    # The whole face's own level replaces that of a place with little evidence.
    typical = prior * ss.sum() / max(int((ss > 0).sum()), 1)
    typical += 1 / (together * spread**2)
    top = found + typical * level
    specular = np.clip(top / (ss + typical), *SPECULAR_RANGE)
    return Gloss(roughness, specular)


def smooth(values: np.ndarray, average: sparse.csr_array, rounds: int) -> np.ndarray:
    """(V, k) values after so many rounds of averaging over neighbours."""
    values = np.ascontiguousarray(values, np.float64)
    if not rounds:
        return values
    # Signed numbers would be tested for counting from the end.
    start, near = (
        each.astype(np.int32, copy=False).view(np.uint32)
        for each in (average.indptr, average.indices)
    )
    means = bool(_are_means(start, average.data))
    smoothed = np.empty_like(values)
    for first in range(0, values.shape[1], PAIR):
        pair = slice(first, first + PAIR)
        now = np.zeros((len(values), PAIR))
        now[:, : values[:, pair].shape[1]] = values[:, pair]
        after = np.empty_like(now)
        for _ in range(rounds):
            _multiply(start, near, average.data, means, now, after)
            now, after = after, now
        smoothed[:, pair] = now[:, : values[:, pair].shape[1]]
    return smoothed


@njit(parallel=True, cache=True)
def _are_means(start: np.ndarray, weights: np.ndarray) -> int:
    """1 if all weights of every row are one over their number, to rounding."""
    others = 0
    for i in prange(len(start) - 1):
        count = start[i + 1] - start[i]
        for at in range(start[i], start[i + 1]):
            others += abs(weights[at] * count - 1) > 1e-14
    return others == 0


@njit(parallel=True, cache=True)
def _multiply(
    start: np.ndarray, near: np.ndarray, weights: np.ndarray, means: bool,
    values: np.ndarray, out: np.ndarray,
) -> None:  # fmt: skip
    """Sparse times dense (V, PAIR) on all cores: scipy's own takes one.

    Nearly every vertex of a closed mesh has six neighbours, and an average has equal weights: with
    itself a mean of seven, written out, takes a quarter of the time.

    Args:
        start, near: (V + 1,) and (nnz,) uint32 of a sparse matrix's rows.
        weights: (nnz,) its numbers.
        means: whether each row is a mean.
        values, out: (V, PAIR).
    """
    for i in prange(len(out)):
        at = start[i]
        if means and start[i + 1] - at == 7:
            a, b, c, d = near[at], near[at + 1], near[at + 2], near[at + 3]
            e, f, g = near[at + 4], near[at + 5], near[at + 6]
            for k in range(PAIR):
                first = (values[a, k] + values[b, k]) + (values[c, k] + values[d, k])
                second = (values[e, k] + values[f, k]) + values[g, k]
                out[i, k] = (first + second) * (1 / 7)
        else:
            for k in range(PAIR):
                total = 0.0
                for j in range(at, start[i + 1]):
                    total += weights[j] * values[near[j], k]
                out[i, k] = total


def local_specular(
    evidence: np.ndarray,
    specular: np.ndarray,
    mask: np.ndarray,
    sigma_px: float,
    spread: float,
    pool_px: float,
    trusted: np.ndarray | float = 1.0,
) -> np.ndarray:
    """Specular albedo of one view's pixels, finer than the mesh holds.

    Args:
        evidence: (n, 5) of `joint.gloss_evidence` about `specular`.
        specular: (n,) what all views gave on the mesh.
        mask: (h, w) bool with n true pixels, in row order.
        sigma_px: over which pixels share one.
        spread: standard deviation of the truth about the mesh's.
        pool_px: sigma of the mesh's pool, more than `sigma_px`.
        trusted: one or (n,) 0..1: how far the pixels' joint evidence over the mesh's own pool
            counts.

    Returns:
        (n,).
    """
    image = np.zeros((*mask.shape, 2), np.float32)
    image[mask] = evidence[:, [0, 3]]
    # Sums over the Gaussian's own weight: so many pixels count as independent.
    count = max(4 * np.pi * sigma_px**2, 1.0)
    near, far = (
        cv2.GaussianBlur(image, (0, 0), max(sigma, 0.3), borderType=cv2.BORDER_CONSTANT)[mask]
        for sigma in (sigma_px, pool_px)
    )
    information, left = (near * count).T
    wide = np.divide(far[:, 1], far[:, 0], out=np.zeros_like(left), where=far[:, 0] > 0)
    every = float(evidence[:, 0].sum(dtype=float))
    level = float(evidence[:, 3].sum(dtype=float)) / every if every > 0 else 0.0
    left -= information * (1 - trusted) * (wide - level)
    return np.clip(specular + left / (information + 1 / spread**2), *SPECULAR_RANGE)
