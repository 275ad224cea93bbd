"""Method `mux`: two shots under coloured lights, three gradients at once in red, green and blue.

Where every light is red, green or blue, each colour channel of the two shots shows one gradient and
its complement: x in red, y in green, z in blue. A ratio within one channel needs no albedo, and
three of them determine a normal. Saturation has no use here, since the colours are the lights',
so that the specular part is that of the lobe model which explains all six readings best.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from processing.albedo import pooled
from processing.lighting.lights import (
    OCTAHEDRON,
    PatternLights,
    cells_of,
    far_field,
    octahedral_cell,
)
from processing.readings import BRIGHTEST
from processing.separation.config import SeparateConfig
from processing.separation.lobe_table import (
    LobeTable,
    gain_over,
    lobe_at,
    lobe_table,
    mirrored_to,
    table_lobe,
)
from processing.separation.mirror import turn_by, two_across
from processing.separation.view_readings import Pixels
from processing.view_maps import PixelMaps

ROUNDS = 8
"""Steps of Gauss-Newton with the lobe, whose light turns with the normal."""
TURN = 0.01
"""Tangent of the turns by which derivatives are taken."""
ODD = 0.01
"""A ratio that is off by much more than this counts no more: it fits at no specular albedo."""
LONGEST_TURN = 0.1
"""A step turns the normal by at most this tangent."""
TRIALS = (0.0, 0.015, 0.03, 0.045, 0.06)
"""Specular albedos that are tried, evenly spaced."""
ONE_PLANE = 1e-6
"""Planes of ratios that are this near to one another determine no normal."""


def separate_pixels(pixels: Pixels, lights: PatternLights, config: SeparateConfig) -> PixelMaps:
    """Separation of one view's two shots.

    Args:
        pixels: of the view.
        lights: of the two patterns.
        config: see there.

    Returns:
        PixelMaps, one normal for both; confidence 0 and zeros where a pixel is clipped, dark in a
        channel or not finite.

    Source: [Kampouris2018] for the two shots.
    """
    views = pixels.views
    rgb = np.array(pixels.rgb, np.float32)
    # Comparisons with what is no number are false.
    usable = pixels.valid & (np.abs(rgb) < BRIGHTEST).all(axis=(1, 2))
    rgb[~usable] = 0
    usable &= (rgb.sum(axis=1) > 0).all(axis=1)
    usable &= rgb.max(axis=1).mean(axis=1) > config.dark_level
    rgb[~usable] = 0
    channels = [lights.channel(c) for c in range(3)]
    far = np.array([far_field(each) for each in channels], order="C")  # (3, cells, P, 3)
    view = views[usable].mean(axis=0) if usable.any() else np.array([0.0, 0.0, 1.0])
    wide = (config.roughness, config.roughness + 0.1)
    tables = [lobe_table(each, view, wide) for each in channels]
    points = np.ascontiguousarray(pixels.places_mm, np.float64)
    start = np.where(usable[:, None], views, 0.0)

    first, _ = mux_normals(rgb, far, start, config.iterations)
    # One width, and the channels as a table's layers: kernels take no list.
    layers = tables[0]._replace(values=np.stack([table.values[0] for table in tables]))
    exact = np.ascontiguousarray(rgb, np.float64)

    def with_gloss(specular: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        normal, gap = first.copy(), np.zeros(len(rgb))
        _descend(exact, specular, far, layers, points, views, ROUNDS, normal, gap)
        return normal, gap

    gaps = np.stack([with_gloss(np.full(len(rgb), s))[1] for s in TRIALS])
    specular = np.where(usable, _specular(rgb, gaps, pixels, config), 0)
    normal, gap = with_gloss(specular)
    lobe = _lobes(tables, points, normal, views, config.roughness)
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
        (n, 3) float64 unit normals, zero where unsolved; (n,) how far off the planes they are: the
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
        system, along = np.zeros((3, 3)), np.zeros(3)
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
            spread = _thinnest(system, along)
            if not spread > ONE_PLANE:  # all planes are one: two shots of one gradient
                n[:] = 0
                break
            side = along[0] * n[0] + along[1] * n[1] + along[2] * n[2]
            off = 0.0
            for a in range(3):
                n[a] = along[a] if side >= 0 else -along[a]
                for b in range(3):
                    off += along[a] * system[a, b] * along[b]
            gap[i] = np.sqrt(max(off, 0.0) / 3)


@njit(cache=True)
def _apart(
    rgb: np.ndarray,
    specular: float,
    far: np.ndarray,
    layers: LobeTable,
    place: np.ndarray,
    cell: int,
    n: np.ndarray,
    v: np.ndarray,
    lobe: np.ndarray,
    out: np.ndarray,
) -> None:
    """Fill (3,) `out`: how far each channel's ratio is off, as a share of its two readings."""
    facing = n[0] * v[0] + n[1] * v[1] + n[2] * v[2]
    x, y, z = mirrored_to(layers, place, n, v)
    specular *= gain_over(layers, layers.roughness[0], facing, x, y, z)
    for c in range(3):
        lobe_at(layers.values, c, 0.0, x, y, z, lobe)
        one, two = rgb[0, c] - specular * lobe[0], rgb[1, c] - specular * lobe[1]
        light_one = light_two = 0.0
        for k in range(3):
            light_one += far[c, cell, 0, k] * n[k]
            light_two += far[c, cell, 1, k] * n[k]
        light = math.sqrt(light_one * light_one + light_two * light_two)
        size = math.sqrt(rgb[0, c] ** 2 + rgb[1, c] ** 2)
        out[c] = (two * light_one - one * light_two) / max(size * light, 1e-30)


@njit(parallel=True, cache=True)
def _descend(
    rgb: np.ndarray,
    specular: np.ndarray,
    far: np.ndarray,
    layers: LobeTable,
    points: np.ndarray,
    views: np.ndarray,
    rounds: int,
    normal: np.ndarray,
    gap: np.ndarray,
) -> None:
    """Turn normals in place until the ratios fit with the lobe taken off."""
    for i in prange(len(rgb)):
        n = normal[i]
        if not n[0] ** 2 + n[1] ** 2 + n[2] ** 2 > 0.5:
            continue
        across, up, turned = np.zeros(3), np.zeros(3), np.zeros(3)
        here, right, above, lobe = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(2)
        for _ in range(rounds + 1):
            two_across(n, across, up)
            cell = octahedral_cell(n[0], n[1], n[2], OCTAHEDRON)
            seen = (specular[i], far, layers, points[i], cell)
            _apart(rgb[i], *seen, n, views[i], lobe, here)
            turn_by(n, across, up, TURN, 0.0, turned)
            _apart(rgb[i], *seen, turned, views[i], lobe, right)
            turn_by(n, across, up, 0.0, TURN, turned)
            _apart(rgb[i], *seen, turned, views[i], lobe, above)
            aa = bb = 1e-12
            ab = ra = rb = off = 0.0
            for c in range(3):
                da, db = (right[c] - here[c]) / TURN, (above[c] - here[c]) / TURN
                aa += da * da
                ab += da * db
                bb += db * db
                ra -= da * here[c]
                rb -= db * here[c]
                off += here[c] * here[c]
            gap[i] = math.sqrt(off / 3)
            det = aa * bb - ab * ab
            a, b = (bb * ra - ab * rb) / det, (aa * rb - ab * ra) / det
            scale = min(1.0, LONGEST_TURN / max(math.sqrt(a * a + b * b), 1e-12))
            if not math.isfinite(a + b):
                n[:] = 0
                break
            turn_by(n, across, up, scale * a, scale * b, turned)
            n[:] = turned


@njit(cache=True)
def _thinnest(a: np.ndarray, out: np.ndarray) -> float:
    """Unit eigenvector of the least eigenvalue of a (3, 3) symmetric matrix of trace up to 3.

    The adjugate has the same eigenvectors and the products of two eigenvalues each, so that the
    least one's is the largest; powers of it leave that one alone.

    Returns:
        The adjugate's trace: about the product of the other two eigenvalues; 0 where they vanish.
    """
    m = np.empty((3, 3))
    m[0, 0] = a[1, 1] * a[2, 2] - a[1, 2] * a[1, 2]
    m[1, 1] = a[0, 0] * a[2, 2] - a[0, 2] * a[0, 2]
    m[2, 2] = a[0, 0] * a[1, 1] - a[0, 1] * a[0, 1]
    m[0, 1] = m[1, 0] = a[0, 2] * a[1, 2] - a[0, 1] * a[2, 2]
    m[0, 2] = m[2, 0] = a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1]
    m[1, 2] = m[2, 1] = a[0, 1] * a[0, 2] - a[1, 2] * a[0, 0]
    spread = m[0, 0] + m[1, 1] + m[2, 2]
    if not spread > 0:
        return 0.0
    square = np.empty((3, 3))
    for _ in range(5):
        trace = m[0, 0] + m[1, 1] + m[2, 2]
        for i in range(3):
            for j in range(3):
                square[i, j] = 0.0
                for k in range(3):
                    square[i, j] += m[i, k] / trace * m[k, j] / trace
        m[:] = square
    best = 0
    for i in range(1, 3):
        if m[i, i] > m[best, best]:
            best = i
    length = np.sqrt(m[0, best] ** 2 + m[1, best] ** 2 + m[2, best] ** 2)
    for i in range(3):
        out[i] = m[i, best] / length
    return spread


def _irradiance(far: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """(n, P, 3) E of each channel."""
    cell = cells_of(normal)
    each = [np.einsum("npk,nk->np", table[cell], normal) for table in far]
    return np.stack(each, axis=2)


def _lobes(
    tables: list[LobeTable],
    points: np.ndarray,
    normal: np.ndarray,
    views: np.ndarray,
    roughness: float,
) -> np.ndarray:
    """(n, P, 3) B of each channel."""
    return np.stack([table_lobe(t, points, normal, views, roughness) for t in tables], axis=2)


def _specular(
    rgb: np.ndarray, gaps: np.ndarray, pixels: Pixels, config: SeparateConfig
) -> np.ndarray:
    """(n,) specular albedo that leaves the planes the least apart, over a neighbourhood.

    A normal's distance off its planes grows with the error of the specular part; a parabola
    through the squares around the smallest gives where between the trials they vanish.

    Args:
        rgb: (n, P, 3) readings.
        gaps: (trials, n) of `mux_normals`, the specular albedo of TRIALS taken off.
        pixels: of the view.
        config: see there.
    """
    bright = rgb.astype(np.float64).sum(axis=(1, 2))
    sigma = config.mux.specular_pool_mm * pixels.px_per_mm
    lost = gaps**2 / (gaps**2 + ODD**2) * np.minimum(bright, 1)
    misfit = np.stack([pooled(each, pixels.mask, sigma) for each in lost])
    grid = np.array(TRIALS)
    step = grid[1] - grid[0]
    bend = misfit[2:] - 2 * misfit[1:-1] + misfit[:-2]
    typical = float(np.median(np.abs(bend[:, bright > 0]))) if (bright > 0).any() else 0.0
    share = config.mux.specular_prior_share * typical / 2
    misfit = misfit + share * ((grid - config.specular_prior) / step)[:, None] ** 2
    middle = np.clip(np.argmin(misfit, axis=0), 1, len(grid) - 2)
    at = np.arange(len(rgb))
    low, here, high = (misfit[middle + k, at] for k in (-1, 0, 1))
    curve = low - 2 * here + high
    turn = np.where(curve > 0, (low - high) / np.where(curve > 0, 2 * curve, 1), 0)
    return np.clip(grid[middle] + step * np.clip(turn, -1, 1), 0, None)
