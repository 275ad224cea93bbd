"""One pixel of the coarse method, in the processor's registers: readings to what its maps need.

Chroma, normal, irradiance, lobe, and the sums that the least squares of diffuse and specular albedo
need, without any array between. All patterns of a pixel are one vector of the processor.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from processing.lanes import (
    LANES,
    at_least,
    every,
    lane,
    largest,
    load,
    store,
    totals,
)
from processing.lighting.lobe import GRAZING
from processing.separation.coarse_given import Model
from processing.separation.far_tables import CELLS, LOBE_SIDE, ROWS

LENGTH = 11
"""Place of |rho n| in what a pixel gives."""
CELL, ACROSS = 12, 13
"""Places of the cell of its normal, and of the three weights of R G B that made its signal."""
OUT = 16
"""Length of what a pixel gives."""
SIDE = np.float32(CELLS)
LOBE = np.float32(LOBE_SIDE)
FAST = {"reassoc", "contract", "nsz"}
"""Sums may be taken in any order; NaN and infinities must still be seen."""


@njit(cache=True, fastmath=FAST, forceinline=True)
def _octahedral(x: float, y: float, z: float) -> tuple[Any, Any]:
    """0..1 coordinates of a direction on the octahedral square; (.5, .5) for no direction."""
    total = abs(x) + abs(y) + abs(z)
    if not total > 0:
        return np.float32(0.5), np.float32(0.5)
    inverse = np.float32(1) / total
    u, v = x * inverse, y * inverse
    if z < 0:
        folded = (np.float32(1) - abs(v)) * (np.float32(1) if u >= 0 else np.float32(-1))
        v = (np.float32(1) - abs(u)) * (np.float32(1) if v >= 0 else np.float32(-1))
        u = folded
    half = np.float32(0.5)
    return u * half + half, v * half + half


@njit(cache=True, fastmath=FAST, forceinline=True)
def solve_pixel(
    rgb: np.ndarray,
    first: int,
    beyond: int,
    scale: float,
    view: tuple[float, float, float],
    place: tuple[float, float, float],
    model: Model,
    signal: np.ndarray,
    out: np.ndarray,
) -> bool:
    """Solve one pixel; false when it is not determined.

    Args:
        rgb: flat readings over `scale`: (3, LANES) of the first eight patterns from `first` on, and
            of every eight more after `beyond` numbers.
        first, beyond, scale: see there.
        view: toward the camera.
        place: of the pixel, mm.
        model: that it is solved against.
        signal: (2, groups * LANES) flat: what was solved, and the lobe of the normal found.
        out: flat: normal (3,), confidence, weighed, weight, lit (3), power, mirror times
            irradiance, |rho n|, which is 0 where the pixel before was not solved, cell, and weights
            (3).
    """
    diffuse, lobe, leaving, groups = model.diffuse, model.lobe, model.leaving, model.groups
    radius, white, part, limits = model.radius, model.white, model.part, model.limits
    one, zero = np.float32(1), np.float32(0)
    vx, vy, vz = view
    px, py, pz = place
    none = every(zero)
    reds, greens, blues, brightest = none, none, none, zero
    for k in range(groups):
        at = first + k * beyond
        red, green, blue = load(rgb, at), load(rgb, at + LANES), load(rgb, at + 2 * LANES)
        reds, greens, blues = reds + red, greens + green, blues + blue
        brightest = max(brightest, largest(red + green + blue))
    found = totals(reds, greens, blues, none, none, none, none, none)
    r, g, b = lane(found, 0), lane(found, 1), lane(found, 2)
    everything = r + g + b
    # A mirror reflection feeds every channel: one that reads nothing is dead, not dark.
    if not (r > 0 and g > 0 and b > 0 and np.isfinite(everything)):
        return False
    if not brightest * scale > limits[0]:
        return False
    ux, uy, uz = white[3], white[4], white[5]
    # Chroma of the sum over patterns, relative to it: free of the readings' scale.
    per = np.float32(3) / everything
    r, g, b = r * per, g * per, b * per
    along = r * ux + g * uy + b * uz
    x, y, z = r - along * ux, g - along * uy, b - along * uz
    saturation = math.sqrt(x * x + y * y + z * z)
    colourful = min(one, max(zero, saturation / limits[1] - one))
    if not (colourful > 0 and np.isfinite(saturation)):
        return False
    shorter = one / saturation
    x, y, z = x * shorter, y * shorter, z * shorter
    if part[0] + part[1] + part[2] > 0:
        x, y, z = part[0], part[1], part[2]
    across_r, across_g, across_b = every(x * per), every(y * per), every(z * per)
    ss = none
    for k in range(groups):
        at = first + k * beyond
        s = across_r * load(rgb, at) + across_g * load(rgb, at + LANES)
        s = s + across_b * load(rgb, at + 2 * LANES)
        store(signal, k * LANES, s)
        ss = ss + s * s

    # From where the pixel before it ended: most are in the same cell.
    nx, ny, nz, length = out[0], out[1], out[2], out[LENGTH]
    if length == zero:
        nx, ny, nz = vx, vy, vz
    out[LENGTH] = zero
    cell = last = -1
    for _ in range(int(limits[2])):
        u, v = _octahedral(nx, ny, nz)
        older, last = last, cell
        cell = min(CELLS - 1, int(u * SIDE)) * CELLS + min(CELLS - 1, int(v * SIDE))
        lx, ly, lz = nx * length, ny * length, nz * length
        to_x, to_y, to_z = none, none, none
        for k in range(groups):
            row = (cell * groups + k) * ROWS * LANES
            s = load(signal, k * LANES) - _moved(diffuse, row, lx, ly, lz, px, py, pz)
            to_x = to_x + load(diffuse, row) * s
            to_y = to_y + load(diffuse, row + LANES) * s
            to_z = to_z + load(diffuse, row + 2 * LANES) * s
        found = totals(to_x, to_y, to_z, none, none, none, none, none)
        bx, by, bz = lane(found, 0), lane(found, 1), lane(found, 2)
        step = (bx - lx) * (bx - lx) + (by - ly) * (by - ly) + (bz - lz) * (bz - lz)
        square = bx * bx + by * by + bz * bz
        if not (square > 0 and np.isfinite(square)):
            return False
        length = math.sqrt(square)
        inverse = one / length
        nx, ny, nz = bx * inverse, by * inverse, bz * inverse
        # Settled, or to and fro across the border of two cells.
        if (cell == last and step < limits[3] * square) or (cell == older and cell != last):
            break

    nv = nx * vx + ny * vy + nz * vz
    across = min(one, max(nv, np.float32(GRAZING))) * np.float32(len(leaving) - 1)
    step_out = min(len(leaving) - 2, int(across))
    across -= np.float32(step_out)
    leaves = every(leaving[step_out] * (one - across) + leaving[step_out + 1] * across)

    # Where the mirrored ray meets the lights' sphere, between four corners of the lobe's table.
    twice = nv + nv
    rx, ry, rz = twice * nx - vx, twice * ny - vy, twice * nz - vz
    beside = rx * px + ry * py + rz * pz
    reach = math.sqrt(beside * beside + radius * radius - px * px - py * py - pz * pz) - beside
    u, v = _octahedral(px + reach * rx, py + reach * ry, pz + reach * rz)
    u, v = u * LOBE, v * LOBE
    i, j = min(LOBE_SIDE - 1, int(u)), min(LOBE_SIDE - 1, int(v))
    u, v = u - np.float32(i), v - np.float32(j)
    # Lights farther along the ray are dimmer and stand closer together: the one undoes the other.
    near = one / max(nv, np.float32(GRAZING))
    w00, w01 = every((one - u) * (one - v) * near), every((one - u) * v * near)
    w10, w11 = every(u * (one - v) * near), every(u * v * near)
    corner = (i * (LOBE_SIDE + 1) + j) * groups * LANES
    below = corner + (LOBE_SIDE + 1) * groups * LANES
    beside_it = groups * LANES
    ee, eb, bb, es, noise = none, none, none, none, none
    lit_r, lit_g, lit_b, mirrored = none, none, none, none
    third, quarter = one / np.float32(3), np.float32(0.25)
    to_r, to_g, to_b = scale / white[0], scale / white[1], scale / white[2]
    balance_r, balance_g, balance_b = every(to_r), every(to_g), every(to_b)
    for k in range(groups):
        row = (cell * groups + k) * ROWS * LANES
        e = every(nx) * load(diffuse, row + 3 * LANES) + every(ny) * load(diffuse, row + 4 * LANES)
        e = e + every(nz) * load(diffuse, row + 5 * LANES)
        e = at_least(e + _moved(diffuse, row, nx, ny, nz, px, py, pz), none) * leaves
        at = k * LANES
        m = w00 * load(lobe, corner + at) + w01 * load(lobe, corner + beside_it + at)
        m = m + w10 * load(lobe, below + at) + w11 * load(lobe, below + beside_it + at)
        store(signal, (groups + k) * LANES, m)
        at = first + k * beyond
        red, green, blue = load(rgb, at), load(rgb, at + LANES), load(rgb, at + 2 * LANES)
        ee, eb, bb = ee + e * e, eb + e * m, bb + m * m
        es = es + e * load(signal, k * LANES)
        lit_r, lit_g, lit_b = lit_r + e * red, lit_g + e * green, lit_b + e * blue
        # What a reading's noise, which grows with its light, turns the normal by: not along it.
        sx, sy = load(diffuse, row), load(diffuse, row + LANES)
        sz = load(diffuse, row + 2 * LANES)
        along_n = every(nx) * sx + every(ny) * sy + every(nz) * sz
        turns = sx * sx + sy * sy + sz * sz - along_n * along_n
        bright = at_least(red + green + blue, none) * every(third * scale) + every(quarter)
        noise = noise + turns * bright
        mirrored = mirrored + m * (balance_r * red + balance_g * green + balance_b * blue)
    found = totals(ee, eb, bb, es, lit_r, lit_g, lit_b, mirrored)
    glossy = lane(found, 7)
    power, both, own, explained = lane(found, 0), lane(found, 1), lane(found, 2), lane(found, 3)
    r, g, b = lane(found, 4) * to_r, lane(found, 5) * to_g, lane(found, 6) * to_b
    found = totals(ss, noise, none, none, none, none, none, none)
    read = lane(found, 0)
    if not (power > 0 and read > 0):
        return False
    per_power = one / power
    share = both * per_power
    misfit = math.sqrt(max(zero, one - explained * per_power * (explained / read)))
    fits = min(one, max(zero, (np.float32(0.4) - misfit) / np.float32(0.3)))
    facing = min(one, max(zero, nv / np.float32(0.3)))
    out[0], out[1], out[2] = nx, ny, nz
    # `per` goes with stored readings, noise with the light that they stand for.
    per_light = per / scale
    variance = lane(found, 1) * limits[4] * (x * x + y * y + z * z) * per_light * per_light
    out[3] = colourful * facing * fits / (one + variance / (length * length * limits[5]))
    out[4] = (glossy - share * (r + g + b)) * third
    out[5] = max(zero, own - share * both)
    out[6], out[7], out[8] = r, g, b
    out[9], out[10] = power, both
    out[LENGTH], out[CELL] = length, np.float32(cell)
    out[ACROSS], out[ACROSS + 1], out[ACROSS + 2] = x * per, y * per, z * per
    return bool(np.isfinite(out[4] + out[5] + out[9]))


@njit(cache=True, fastmath=FAST, forceinline=True)
def _moved(
    diffuse: np.ndarray, row: int, x: float, y: float, z: float, px: float, py: float, pz: float
) -> Any:
    """How much more light than at the centre (x, y, z) receives at p: Lanes of n' J p."""
    row += 6 * LANES
    out = every(x * px) * load(diffuse, row) + every(y * py) * load(diffuse, row + LANES)
    out = out + every(z * pz) * load(diffuse, row + 2 * LANES)
    out = out + every(x * py + y * px) * load(diffuse, row + 3 * LANES)
    out = out + every(x * pz + z * px) * load(diffuse, row + 4 * LANES)
    return out + every(y * pz + z * py) * load(diffuse, row + 5 * LANES)
