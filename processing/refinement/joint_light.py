"""One point's light under each pattern and how it turns with the normal, for `joint`.

A lane of the processor's vectors is a lamp: eight lamps of one group, or eight neighbours where
lamps are driven one by one, are summed at once.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from processing.lanes import (
    LANES,
    at_least,
    at_most,
    between,
    every,
    largest,
    load,
    load_bytes,
    numbered,
    root,
    store,
    store_turned,
    totals,
    where_above,
)
from processing.lighting.facets import STEEPEST, horizontal, unmasked
from processing.lighting.interface import let_through, row_of
from processing.lighting.lights import OCTAHEDRON, octahedral_cell, off_axis
from processing.lighting.lobe import GRAZING

SUMS = 8
"""Numbers that are summed over lamps: the irradiance vector (3), B, its gradient (3), m dB/dm."""
EXPONENTIAL = (
    0.9999999781405312, 0.9999974165151123, 0.49994906235002134,
    0.1662915993400931, 0.04039209274846857, 0.006269626987928809,
)  # fmt: skip
"""Coefficients of exp from -9/16 to 0, off by 2e-8 of it: least squares."""
FLAT = np.float32(18)
"""Where exp(-x) is 1.5e-8, which is nothing beside a lobe."""
UNSHADOWED = np.float32(0.390625)
"""Facets whose slope squared times m squared stays below (.625 squared) hide nothing."""
UNMASKED = np.float32(1.6)
"""From this cosine over slope on Beckmann's facets hide nothing: the fit is 1 there."""
NARROWEST = np.float32(1e-6)
"""Smallest length of a half vector, and of its part along the normal, that is divided by."""

NEAREST2 = np.float32(1e-12)
"""Smallest squared distance to a light, mm^2, that is divided by."""


class Lamps(NamedTuple):
    """The stage's light as compiled code takes it: L lights in groups, P patterns, V vertices.

    L is at least `LANES`: lights that are missing have no weight.

    Attributes:
        visible: (V, L) uint8.
        position: (3, L) float32, mm.
        strength: (L,) float32, weight times squared radius of `PatternLights`.
        radius: (L,) float32.
        levels: (G, P) float32, as of `PatternLights`.
        chunks: (C, 4) int64, at most `LANES` lights that are summed at once: the first one that is
            loaded, the first and the end of those that count, and their group; -1 where they are
            of several.
        group: (L,) int64 of each light.
        exponent: as of `PatternLights`.
        diffuse: (cells, P) float32, as of `Place`.
        mirrored: (4, L) float32, as of `Place`.
        stray: (P, 3, 4) float32, as of `PatternLights`; (0, 3, 4) where there is none.
        bounced: (V, P, 3) float32 irradiance by light from other skin; (0, P, 3) where there is
            none.
        table: of `lobe.fresnel_table`.
        through, mean: of `Interface`.
        shape: of its `Facets`.
    """

    visible: np.ndarray
    position: np.ndarray
    strength: np.ndarray
    radius: np.ndarray
    levels: np.ndarray
    chunks: np.ndarray
    group: np.ndarray
    exponent: np.float32
    diffuse: np.ndarray
    mirrored: np.ndarray
    stray: np.ndarray
    bounced: np.ndarray
    table: np.ndarray
    through: np.ndarray
    mean: np.ndarray
    shape: np.ndarray


def chunks_of(group_end: np.ndarray) -> np.ndarray:
    """(C, 4) of `Lamps` for (G,) ends of groups of lights."""
    count = int(group_end[-1])
    last = max(count - LANES, 0)
    # Lanes of groups smaller than a vector would be empty.
    if count < len(group_end) * LANES:
        starts = np.arange(0, count, LANES)
        rows = [(min(at, last), at, min(at + LANES, count), -1) for at in starts.tolist()]
    else:
        rows = []
        first = 0
        for group, end in enumerate(group_end.tolist()):
            rows += [
                (min(at, last), at, min(at + LANES, end), group) for at in range(first, end, LANES)
            ]
            first = end
    return np.array(rows, np.int64).reshape(-1, 4)


@njit(cache=True, error_model="numpy", forceinline=True)
def _falling(x: Any) -> Any:
    """exp(-x) for Lanes from 0, off by less than 4e-6 of it; from `FLAT` on what it is there.

    The root of order 32 of it by a polynomial, five times squared.
    """
    y = at_most(x, every(FLAT)) * every(np.float32(-1 / 32))
    p = every(np.float32(EXPONENTIAL[5]))
    p = p * y + every(np.float32(EXPONENTIAL[4]))
    p = p * y + every(np.float32(EXPONENTIAL[3]))
    p = p * y + every(np.float32(EXPONENTIAL[2]))
    p = p * y + every(np.float32(EXPONENTIAL[1]))
    p = p * y + every(np.float32(EXPONENTIAL[0]))
    p = p * p
    p = p * p
    p = p * p
    p = p * p
    return p * p


@njit(cache=True, error_model="numpy", forceinline=True)
def _hidden(nl: Any, slope: Any, tails: bool) -> Any:
    """Lanes of `facets.unmasked`."""
    one = every(np.float32(1))
    if tails:
        a = slope / nl
        return every(np.float32(2)) / (one + root(one + a * a))
    a = at_most(nl / slope, every(UNMASKED))
    a2 = a * a
    above = every(np.float32(3.535)) * a + every(np.float32(2.181)) * a2
    return above / (one + every(np.float32(2.276)) * a + every(np.float32(2.577)) * a2)


@njit(cache=True, error_model="numpy", forceinline=True)
def _add(levels: np.ndarray, group: int, row: Any, ws: np.ndarray, sums: int) -> None:
    """Add eight numbers of a group, or of a lamp of it, to the P patterns' sums from there on."""
    for k in range(levels.shape[1]):
        level = levels[group, k]
        if level != np.float32(0):
            at = sums + k * SUMS
            store(ws, at, load(ws, at) + every(level) * row)


@njit(cache=True, error_model="numpy")
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
    visible, position, strength = lamps.visible, lamps.position, lamps.strength
    levels, chunks, mirrored = lamps.levels, lamps.chunks, lamps.mirrored
    table, through, mean, shape = lamps.table, lamps.through, lamps.mean, lamps.shape
    lights, patterns = position.shape[1], levels.shape[1]
    # Whole numbers would make every float32 beside them a float64, which takes twice as long.
    zero, one, two, four = np.float32(0), np.float32(1), np.float32(2), np.float32(4)
    steps, columns = len(table) - 1, through.shape[1] - 1
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
    row, part = row_of(roughness, len(through))
    part = np.float32(part)
    inside = np.float32(let_through(through, row, part, nv))
    leaving = inside / (mean[row] * (one - part) + mean[row + 1] * part)
    quarter = shadow_v / (four * m2 * nv)
    c0, c1, c2 = corners[0] * lights, corners[1] * lights, corners[2] * lights
    w0, w1, w2 = weights[0], weights[1], weights[2]
    # The light that enters over the cosine, at this roughness; eight lamps; the patterns' sums.
    each = columns + 1
    sums = each + SUMS * LANES
    ws = np.empty(sums + patterns * SUMS, np.float32)
    for k in range(columns + 1):
        low, high = through[row, k], through[row + 1, k]
        ws[k] = leaving * (low + part * (high - low))
    ws[sums:] = 0
    zeros, ones, twos = every(zero), every(one), every(two)
    wide, most, m2s = every(np.float32(columns)), every(np.float32(steps)), every(m2)
    whole, before = zeros, chunks[0, 3]
    for chunk in range(len(chunks)):
        at, first, end, group = chunks[chunk]
        px, py, pz = (
            load(position, at),
            load(position, lights + at),
            load(position, 2 * lights + at),
        )
        lx, ly, lz = px - every(point[0]), py - every(point[1]), pz - every(point[2])
        nl = every(nx) * lx + every(ny) * ly + every(nz) * lz
        seen = (
            every(w0) * load_bytes(visible, c0 + at)
            + every(w1) * load_bytes(visible, c1 + at)
            + every(w2) * load_bytes(visible, c2 + at)
        ) * load(strength, at)  # fmt: skip
        seen = where_above(nl, zeros, seen, zeros)
        if end - at != LANES or first != at:
            lanes = numbered()
            seen = where_above(lanes, every(np.float32(first - at) - np.float32(0.5)), seen, zeros)
            seen = where_above(every(np.float32(end - at) - np.float32(0.5)), lanes, seen, zeros)
        if group != before:
            if before >= 0:
                _add(levels, before, whole, ws, sums)
            whole, before = zeros, group
        if not largest(seen) > zero:
            continue
        # A light that is missing may be where the point is.
        inverse = ones / root(at_least(lx * lx + ly * ly + lz * lz, every(NEAREST2)))
        lx, ly, lz, nl = lx * inverse, ly * inverse, lz * inverse, nl * inverse
        seen = seen * inverse * inverse
        if lamps.exponent != zero:
            store(ws, each, px * lx + py * ly + pz * lz)
            for j in range(first, end):
                lane = each + j - at
                ws[lane] = off_axis(lamps.exponent, ws[lane] / lamps.radius[j])
            seen = seen * load(ws, each)
        entered = seen * between(ws, at_most(at_least(nl, zeros), ones) * wide, columns)
        gx, gy, gz = entered * lx, entered * ly, entered * lz
        bx, by, bz, b, bm = zeros, zeros, zeros, zeros, zeros
        hx, hy, hz = lx + every(vx), ly + every(vy), lz + every(vz)
        length2 = hx * hx + hy * hy + hz * hz
        along = every(nx) * hx + every(ny) * hy + every(nz) * hz
        along2 = along * along
        # Far from the lobe nothing is mirrored; known without a root or a division.
        seen = where_above(along, zeros, seen, zeros)
        seen = where_above(length2 - along2, every(farthest) * along2, zeros, seen)
        if largest(seen) > zero:
            per_along = ones / at_least(along, every(NARROWEST))
            # One over the squared cosine of the half vector to the normal.
            per = length2 * per_along * per_along
            length = root(length2)
            if stretched:
                # How the squared tilt over m_u^2 and m_v^2 turns with the normal, by half.
                per_length = ones / at_least(length, every(NARROWEST))
                sx, sy, sz = hx * per_length, hy * per_length, hz * per_length
                wx = (every(tx) * sx + every(tz) * sz) * every(one / mu2)
                wz = (every(ux) * sx + every(uy) * sy + every(uz) * sz) * every(one / mv2)
                steep = wx * wx * every(mu2) + wz * wz * every(mv2)
                steep = steep * per
                wx, wy, wz = (
                    wx * every(tx) + wz * every(ux),
                    wz * every(uy),
                    wx * every(tz) + wz * every(uz),
                )
            else:
                steep = at_least(per - ones, zeros) / m2s
                wx = wy = wz = zeros
            # The distribution's fall over the steepness, as a share of it.
            if tails:
                fall = ones / (ones + steep)
                lobe = every(quarter) * (fall * per) * (fall * per)
                fall = fall * twos
            else:
                fall = ones
                lobe = every(quarter) * _falling(steep) * per * per
            # Half of the half vector's length is its cosine to the camera.
            cosine = at_most(every(np.float32(0.5)) * length, ones)
            passed = (
                load(mirrored, at)
                + every(point[0]) * load(mirrored, lights + at)
                + every(point[1]) * load(mirrored, 2 * lights + at)
                + every(point[2]) * load(mirrored, 3 * lights + at)
            )
            lobe = lobe * passed * passed * between(table, cosine * most, steps)
            steepness = every(widest2) * (ones - nl * nl) - every(UNSHADOWED) * nl * nl
            if tails or largest(where_above(seen, zeros, steepness, zeros)) > zero:
                sideways = every(tx) * lx + every(tz) * lz
                around = at_least(ones - nl * nl - sideways * sideways, zeros)
                slopes = root(every(mu2) * sideways * sideways + every(mv2) * around)
                lobe = lobe * _hidden(nl, slopes, tails)
            b = where_above(seen, zeros, lobe * seen, zeros)
            bm = b * (twos * fall * steep - twos)
            turned = b * per_along
            if stretched:
                slopes = twos * fall * turned * length
                bx, by, bz = slopes * wx, slopes * wy, slopes * wz
                turned = turned * (twos * fall * steep - every(four))
            else:
                turned = turned * (twos * fall * per / m2s - every(four))
            bx, by, bz = bx + turned * hx, by + turned * hy, bz + turned * hz
        if group >= 0:
            whole = whole + totals(gx, gy, gz, b, bx, by, bz, bm)
        else:
            store_turned(ws, each, gx, gy, gz, b, bx, by, bz, bm)
            for j in range(first, end):
                _add(levels, lamps.group[j], load(ws, each + (j - at) * LANES), ws, sums)
    if before >= 0:
        _add(levels, before, whole, ws, sums)
    # Polarisers change diffuse light as the normal turns, and what is mirrored lamp by lamp.
    side = OCTAHEDRON if len(lamps.diffuse) > 1 else 1
    reaching = lamps.diffuse[octahedral_cell(nx, ny, nz, side)]
    for k in range(patterns):
        own = sums + k * SUMS
        matte = reaching[k]
        b = ws[own + 3]
        out[k, 0] = matte * (ws[own] * nx + ws[own + 1] * ny + ws[own + 2] * nz)
        out[k, 4] = b
        for x in range(3):
            out[k, 1 + x] = matte * ws[own + x]
            out[k, 5 + x] = ws[own + 4 + x] - b * view[x] / nv
            out[k, 9 + x] = 0
        out[k, 8] = ws[own + 7] / roughness
    for k in range(len(lamps.stray)):
        for x in range(3):
            beside = lamps.stray[k, x, 3]
            for y in range(3):
                beside += lamps.stray[k, x, y] * n[y]
            beside *= reaching[k]
            out[k, 1 + x] += beside
            out[k, 0] += beside * n[x]
    if len(lamps.bounced) > 0:
        for k in range(patterns):
            for c in range(3):
                from_skin = (
                    w0 * lamps.bounced[corners[0], k, c]
                    + w1 * lamps.bounced[corners[1], k, c]
                    + w2 * lamps.bounced[corners[2], k, c]
                )
                out[k, 9 + c] = reaching[k] * inside * from_skin
