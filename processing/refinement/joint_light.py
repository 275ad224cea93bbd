"""One point's light under each pattern and how it turns with the normal, for `joint`."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from processing.lighting.facets import STEEPEST, horizontal, unmasked
from processing.lighting.interface import let_through, row_of
from processing.lighting.lights import off_axis
from processing.lighting.lobe import GRAZING

FAST = {"reassoc", "contract", "nsz", "arcp"}
"""Sums may be taken in any order; NaN and infinities must still be seen."""
UNSHADOWED = np.float32(0.390625)
"""Facets whose slope squared times m squared stays below (.625 squared) hide nothing."""


class Lamps(NamedTuple):
    """The stage's light as compiled code takes it: L lights in groups, P patterns, V vertices.

    Fields of `SeenLights` stand here again: numba's parallel loops take no tuple within a tuple.

    Attributes:
        visible: (V, L) uint8.
        position, radius, weight, levels, group_end, exponent, diffuse_share: as of `PatternLights`,
            in float32.
        mirrored: (L,) float32 share of each lamp's mirror reflection that reaches the camera.
        stray: (P, 3, 4) float32, what a camera's polariser leaves of it.
        bounced: (V, P, 3) float32 irradiance by light from other skin.
        table: of `lobe.fresnel_table`.
        through, mean: of `Interface`.
        shape: of its `Facets`.
    """

    visible: np.ndarray
    position: np.ndarray
    radius: np.ndarray
    weight: np.ndarray
    levels: np.ndarray
    group_end: np.ndarray
    exponent: np.float32
    diffuse_share: np.ndarray
    mirrored: np.ndarray
    stray: np.ndarray
    bounced: np.ndarray
    table: np.ndarray
    through: np.ndarray
    mean: np.ndarray
    shape: np.ndarray


@njit(cache=True, error_model="numpy", fastmath=FAST)
def gather(
    point: np.ndarray,
    n: np.ndarray,
    view: np.ndarray,
    roughness: float,
    corners: np.ndarray,
    weights: np.ndarray,
    lamps: Lamps,
    out: np.ndarray,
) -> None:
    """Fill out (P, 12): E, its gradient (3), B, its gradient (3), B's slope over m, bounced rgb."""
    visible, position, radius, weight = lamps.visible, lamps.position, lamps.radius, lamps.weight
    levels, group_end, exponent, stray = lamps.levels, lamps.group_end, lamps.exponent, lamps.stray
    diffuse_share, mirrored = lamps.diffuse_share, lamps.mirrored
    bounced, table, through, mean = lamps.bounced, lamps.table, lamps.through, lamps.mean
    shape = lamps.shape
    out[:] = 0
    # Whole numbers would make every float32 beside them a float64, which takes twice as long.
    zero, one, two, four = np.float32(0), np.float32(1), np.float32(2), np.float32(4)
    steps, columns = len(table) - 1, through.shape[1] - 1
    most, widest = np.float32(steps), np.float32(columns)
    m2 = roughness * roughness
    tails, stretched = shape[0] > zero, shape[1] != one
    mu2, mv2 = m2 * shape[1] * shape[1], m2 / (shape[1] * shape[1])
    widest2 = max(mu2, mv2)
    # Tails end nowhere.
    farthest = np.float32(np.inf) if tails else np.float32(STEEPEST) * widest2
    nx, ny, nz = n[0], n[1], n[2]
    vx, vy, vz = view[0], view[1], view[2]
    nv = max(nx * vx + ny * vy + nz * vz, np.float32(GRAZING))
    tx, tz = horizontal(nx, nz)
    ux, uy, uz = ny * tz, nz * tx - nx * tz, -ny * tx
    aside = tx * vx + tz * vz
    around2 = max(zero, one - nv * nv - aside * aside)
    slope = np.float32(math.sqrt(mu2 * aside * aside + mv2 * around2))
    shadow_v = np.float32(unmasked(nv, slope, tails))
    row, between = row_of(roughness, len(through))
    part = np.float32(between)
    inside = np.float32(let_through(through, row, part, nv))
    leaving = inside / (mean[row] * (one - part) + mean[row + 1] * part)
    quarter = shadow_v / (four * m2 * nv)
    c0, c1, c2 = corners[0], corners[1], corners[2]
    w0, w1, w2 = weights[0], weights[1], weights[2]
    first = 0
    for group in range(len(group_end)):
        gx = gy = gz = zero
        b = bx = by = bz = bm = zero
        for j in range(first, group_end[group]):
            lx, ly, lz = (
                position[j, 0] - point[0],
                position[j, 1] - point[1],
                position[j, 2] - point[2],
            )
            nl = nx * lx + ny * ly + nz * lz
            if nl <= zero:
                continue
            seen = (
                w0 * np.float32(visible[c0, j])
                + w1 * np.float32(visible[c1, j])
                + w2 * np.float32(visible[c2, j])
            )
            if seen <= zero:
                continue
            inverse = one / math.sqrt(lx * lx + ly * ly + lz * lz)
            lx, ly, lz, nl = lx * inverse, ly * inverse, lz * inverse, nl * inverse
            fall = radius[j] * inverse
            seen *= weight[j] * fall * fall
            if exponent != zero:
                aside = position[j, 0] * lx + position[j, 1] * ly + position[j, 2] * lz
                seen *= np.float32(off_axis(exponent, aside / radius[j]))
            place = min(nl, one) * widest
            below = min(columns - 1, int(place))
            rest = place - np.float32(below)
            low = through[row, below] * (one - rest) + through[row, below + 1] * rest
            high = through[row + 1, below] * (one - rest) + through[row + 1, below + 1] * rest
            entered = seen * leaving * (low + part * (high - low))
            gx += entered * lx
            gy += entered * ly
            gz += entered * lz
            hx, hy, hz = lx + vx, ly + vy, lz + vz
            length2 = hx * hx + hy * hy + hz * hz
            along = nx * hx + ny * hy + nz * hz
            along2 = along * along
            # Far from the lobe nothing is mirrored; known without a root or a division.
            if along <= zero or length2 - along2 > farthest * along2:
                continue
            scale = one / math.sqrt(length2)
            hx, hy, hz = hx * scale, hy * scale, hz * scale
            nh = along * scale
            nh2 = nh * nh
            per = one / nh2
            if stretched:
                # How the squared tilt over m_u^2 and m_v^2 turns with the normal, by half.
                aside, above = tx * hx + tz * hz, ux * hx + uy * hy + uz * hz
                wx, wz = aside / mu2, above / mv2
                steep = (aside * wx + above * wz) * per
                wx, wy, wz = wx * tx + wz * ux, wz * uy, wx * tz + wz * uz
            else:
                steep = (one - nh2) * per / m2
            # The distribution's fall over the steepness, as a share of it.
            if tails:
                fall = one / (one + steep)
                lobe = quarter * fall * fall * per * per
                fall *= two
            else:
                fall = one
                lobe = quarter * math.exp(-steep) * per * per
            place = min(one, vx * hx + vy * hy + vz * hz) * most
            below = min(steps - 1, int(place))
            rest = place - np.float32(below)
            lobe *= seen * mirrored[j]
            if tails or widest2 * (one - nl * nl) > UNSHADOWED * nl * nl:
                aside = tx * lx + tz * lz
                around2 = max(zero, one - nl * nl - aside * aside)
                slope = np.float32(math.sqrt(mu2 * aside * aside + mv2 * around2))
                lobe *= np.float32(unmasked(nl, slope, tails))
            lobe *= table[below] * (one - rest) + table[below + 1] * rest
            bm += lobe * (two * fall * steep - two)
            if stretched:
                slope = lobe * two * fall / nh
                bx += slope * wx
                by += slope * wy
                bz += slope * wz
                slope = lobe * (two * fall * steep - four) / nh
            else:
                slope = lobe * (two * fall * per / m2 - four) / nh
            bx += slope * hx
            by += slope * hy
            bz += slope * hz
            b += lobe
        first = group_end[group]
        bx -= b * vx / nv
        by -= b * vy / nv
        bz -= b * vz / nv
        e = gx * nx + gy * ny + gz * nz
        for k in range(levels.shape[1]):
            level = levels[group, k]
            if level == zero:
                continue
            out[k, 0] += level * e
            out[k, 1] += level * gx
            out[k, 2] += level * gy
            out[k, 3] += level * gz
            out[k, 4] += level * b
            out[k, 5] += level * bx
            out[k, 6] += level * by
            out[k, 7] += level * bz
            out[k, 8] += level * bm / roughness
    for k in range(levels.shape[1]):
        matte = diffuse_share[k]
        for x in range(4):
            out[k, x] *= matte
        for x in range(3):
            beside = stray[k, x, 3]
            for y in range(3):
                beside += stray[k, x, y] * n[y]
            out[k, 1 + x] += beside
            out[k, 0] += beside * n[x]
        for c in range(3):
            from_skin = (
                weights[0] * bounced[c0, k, c]
                + weights[1] * bounced[c1, k, c]
                + weights[2] * bounced[c2, k, c]
            )
            out[k, 9 + c] = matte * inside * from_skin
