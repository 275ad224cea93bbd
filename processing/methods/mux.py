"""Method `mux`: two shots under coloured lights, three gradients at once in red, green and blue.

Where every light is red, green or blue, each colour channel of the two shots shows one gradient and
its complement: x in red, y in green, z in blue. A ratio within one channel needs no albedo, and
three of them determine a normal. Saturation says nothing here, since the colours are the lights',
so that the specular part is that of the lobe model which explains all six readings best.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from processing.albedo import Evidence, pooled, shrunk, specular_evidence
from processing.lights import OCTAHEDRON, PatternLights, far_field, octahedral_cell
from processing.methods.config import SeparateConfig
from processing.methods.lobe_table import LobeTable, lobe_table, table_lobe
from processing.methods.matte import cells_of
from processing.pixels import PixelMaps

ROUNDS = 4
"""Normals and specular albedo in turn."""


def separate_pixels(
    rgb: np.ndarray,
    valid: np.ndarray,
    views: np.ndarray,
    mask: np.ndarray,
    lights: PatternLights,
    px_per_mm: float,
    config: SeparateConfig,
) -> PixelMaps:
    """Separation of one view's two shots; arguments as of `colour.separate_pixels`.

    Returns:
        PixelMaps, one normal for both; confidence 0 and zeros where a pixel is clipped, dark in a
        channel or not finite.

    Source: [Kampouris2018] for the two shots.
    """
    rgb = np.array(rgb, np.float32)
    usable = valid & np.isfinite(rgb).all(axis=(1, 2)) & (rgb.sum(axis=1) > 0).all(axis=1)
    usable &= rgb.max(axis=1).mean(axis=1) > config.dark_level / 3
    rgb[~usable] = 0
    channels = [lights.channel(c) for c in range(3)]
    far = np.stack([far_field(each) for each in channels])  # (3, cells, P, 3)
    view = views[usable].mean(axis=0) if usable.any() else np.array([0.0, 0.0, 1.0])
    wide = (config.roughness, config.roughness + 0.1)
    tables = [lobe_table(each, view, wide) for each in channels]
    specular = np.where(usable, config.specular_prior, 0.0)
    normal = np.where(usable[:, None], views, 0.0)
    matte = rgb
    for turn in range(ROUNDS):
        if turn > 0:
            matte = rgb - _lobes(tables, normal, views, config.roughness) * specular[:, None, None]
        normal, gap = mux_normals(matte, far, np.where(usable[:, None], views, 0.0), 5)
        specular = _specular(rgb, far, tables, normal, views, mask, px_per_mm, config)
    lobe = _lobes(tables, normal, views, config.roughness)
    e = _irradiance(far, normal)
    power = (e * e).sum(axis=1)
    albedo = (e * (rgb - lobe * specular[:, None, None])).sum(axis=1)
    solved = (np.einsum("nk,nk->n", normal, normal) > 0.5) & (power > 0).all(axis=1)
    albedo = np.where(solved[:, None], albedo / np.where(power > 0, power, 1), 0)
    facing = np.clip(np.einsum("nk,nk->n", normal, views) / 0.3, 0, 1)
    confidence = np.where(solved, facing * np.clip(1 - gap / 0.2, 0, 1), 0)
    specular, roughness = (np.where(solved, x, 0) for x in (specular, config.roughness))
    return PixelMaps(normal, normal, np.maximum(albedo, 0), specular, roughness, confidence)


def mux_normals(
    rgb: np.ndarray, far: np.ndarray, start: np.ndarray, iterations: int
) -> tuple[np.ndarray, np.ndarray]:
    """Normals from the ratios of two patterns within each channel.

    I_1 / I_2 = E_1(n) / E_2(n) is linear in n while the horizon stays: (I_2 g_1 - I_1 g_2) . n = 0.
    Three channels give three such planes, and n is the direction nearest to lying in all of them.

    Args:
        rgb: (n, 2, 3) readings without mirror reflection.
        far: (3, cells, 2, 3) irradiance vectors of each channel's own lights.
        start: (n, 3) unit first normals, zero where there is nothing to solve.
        iterations: of the horizon.

    Returns:
        (n, 3) float64 unit normals, zero where unsolved; (n,) how far off the planes they lie: the
        root mean square of the sine of the angle to them.
    """
    normal = np.array(start, np.float64)
    gap = np.zeros(len(rgb))
    _mux(np.ascontiguousarray(rgb, np.float64), np.ascontiguousarray(far), iterations, normal, gap)
    return normal, gap


@njit(parallel=True, cache=True)
def _mux(
    rgb: np.ndarray, far: np.ndarray, iterations: int, normal: np.ndarray, gap: np.ndarray
) -> None:
    for i in prange(len(rgb)):
        n = normal[i]
        if not n[0] ** 2 + n[1] ** 2 + n[2] ** 2 > 0.5:
            continue
        system = np.zeros((3, 3))
        for _ in range(iterations):
            cell = octahedral_cell(n[0], n[1], n[2], OCTAHEDRON)
            system[:] = 0
            total = 0.0
            for c in range(3):
                p = rgb[i, 1, c] * far[c, cell, 0] - rgb[i, 0, c] * far[c, cell, 1]
                # Noise of the plane grows with the light, so every plane counts by its own length.
                length = np.sqrt(p[0] ** 2 + p[1] ** 2 + p[2] ** 2)
                total += length
                if not length > 0:
                    continue
                for a in range(3):
                    for b in range(3):
                        system[a, b] += p[a] * p[b] / (length * length)
            if not (total > 0 and np.isfinite(total)):
                n[:] = 0
                break
            values, vectors = np.linalg.eigh(system)
            if values[1] < 1e-6:  # all planes are one: two shots of one gradient
                n[:] = 0
                break
            side = vectors[0, 0] * n[0] + vectors[1, 0] * n[1] + vectors[2, 0] * n[2]
            for a in range(3):
                n[a] = vectors[a, 0] if side >= 0 else -vectors[a, 0]
            gap[i] = np.sqrt(max(values[0], 0.0) / 3)


def _irradiance(far: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """(n, P, 3) E of each channel."""
    cell = cells_of(normal)
    each = [np.einsum("npk,nk->np", table[cell], normal) for table in far]
    return np.stack(each, axis=2)


def _lobes(
    tables: list[LobeTable], normal: np.ndarray, views: np.ndarray, roughness: float
) -> np.ndarray:
    """(n, P, 3) B of each channel."""
    return np.stack([table_lobe(t, normal, views, roughness) for t in tables], axis=2)


def _specular(
    rgb: np.ndarray,
    far: np.ndarray,
    tables: list[LobeTable],
    normal: np.ndarray,
    views: np.ndarray,
    mask: np.ndarray,
    px_per_mm: float,
    config: SeparateConfig,
) -> np.ndarray:
    """(n,) specular albedo, each channel with a diffuse albedo of its own."""
    e, lobe = _irradiance(far, normal), _lobes(tables, normal, views, config.roughness)
    parts = [specular_evidence(rgb[:, :, c], e[:, :, c], lobe[:, :, c]) for c in range(3)]
    solved = np.einsum("nk,nk->n", normal, normal) > 0.5
    each = Evidence(*(np.where(solved, sum(x), 0) for x in zip(*map(_sums, parts), strict=True)))
    typical = float(np.median(each.weight[solved])) if solved.any() else 0.0
    sigma = config.mux.specular_pool_mm * px_per_mm
    found = shrunk(
        pooled(each.weighed, mask, sigma),
        pooled(each.weight, mask, sigma),
        config.specular_prior,
        config.mux.specular_prior_share * typical,
    )
    return np.where(solved, found, 0)


def _sums(evidence: Evidence) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return evidence.weighed, evidence.weight, evidence.power
