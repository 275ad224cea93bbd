"""Compiled loops of the coarse method: readings to normals and what the albedo follows from.

A pixel is solved in registers from its readings, without any array between: chroma, normal,
irradiance, lobe, and the sums that the least squares of diffuse and specular albedo need. All
patterns of a pixel are one vector of the processor. Each row of blocks (some pixels square) is one
task, so that sums over blocks need no lock.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit, prange

from processing.lobe import GRAZING
from processing.methods.far_tables import CELLS, LOBE_SIDE, ROWS
from processing.methods.lanes import (
    LANES,
    as_float,
    at_least,
    every,
    largest,
    load,
    store,
    total,
)

RUN = 128
"""Pixels of a row that are loaded at once."""
SUMS = 7
"""Sums of a block: weighed, weight, lit (3), power, mirror times irradiance."""
LENGTH = 11
"""Place of |rho n| in what a pixel gives."""
COUNT = 7
"""Place of a block's number of solved pixels, behind its sums."""
SIDE = np.float32(CELLS)
LOBE = np.float32(LOBE_SIDE)
FAST = {"reassoc", "contract", "nsz"}
"""Sums may be taken in any order; NaN and infinities must still be seen."""


@njit(cache=True, fastmath=FAST)
def _octahedral(x: float, y: float, z: float) -> tuple[float, float]:
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


@njit(cache=True, fastmath=FAST)
def _pixel(
    rgb: np.ndarray,
    first: int,
    view: tuple[float, float, float],
    place: tuple[float, float, float],
    diffuse: np.ndarray,
    lobe: np.ndarray,
    leaving: np.ndarray,
    groups: int,
    radius: float,
    white: np.ndarray,
    part: np.ndarray,
    limits: np.ndarray,
    signal: np.ndarray,
    out: np.ndarray,
) -> bool:
    """Solve one pixel; false when nothing can be told.

    rgb: flat readings, (G, 3, LANES) from index `first` on; view toward the camera; place in mm;
    diffuse, lobe, leaving: tables of FarTables, the first two flat; white (3,) the lights' colour; part (3,): the weights of
    R G B that normals are solved from, zeros for chroma; limits: three times the dark level, grey
    saturation, solves at most, when to stop, noise squared, and the normal's deviation squared
    that halves the confidence; signal (G * LANES,) is scratch. out: normal (3), confidence, weighed, weight, lit (3), power, mirror times irradiance, and |rho n|,
    0 where the pixel before was not solved.
    """
    one, zero = np.float32(1), np.float32(0)
    vx, vy, vz = view
    px, py, pz = place
    r = g = b = brightest = zero
    for k in range(groups):
        at = first + k * 3 * LANES
        red, green, blue = load(rgb, at), load(rgb, at + LANES), load(rgb, at + 2 * LANES)
        r += total(red)
        g += total(green)
        b += total(blue)
        brightest = max(brightest, largest(red + green + blue))
    everything = r + g + b
    # A mirror reflection feeds every channel: one that reads nothing is dead, not dark.
    if not (r > 0 and g > 0 and b > 0 and np.isfinite(everything)):
        return False
    if not brightest > limits[0]:
        return False
    norm = one / math.sqrt(white[0] * white[0] + white[1] * white[1] + white[2] * white[2])
    ux, uy, uz = white[0] * norm, white[1] * norm, white[2] * norm
    # Chroma of the sum over patterns, relative to it: free of the readings' scale.
    per = np.float32(3) / everything
    r, g, b = r * per, g * per, b * per
    along = r * ux + g * uy + b * uz
    x, y, z = r - along * ux, g - along * uy, b - along * uz
    saturation = math.sqrt(x * x + y * y + z * z)
    colourful = min(one, max(zero, saturation / limits[1] - one))
    if not (colourful > 0 and np.isfinite(saturation)):
        return False
    x, y, z = x / saturation, y / saturation, z / saturation
    if part[0] + part[1] + part[2] > 0:
        x, y, z = part[0], part[1], part[2]
    across_r, across_g, across_b = every(x * per), every(y * per), every(z * per)
    ss = zero
    for k in range(groups):
        at = first + k * 3 * LANES
        s = across_r * load(rgb, at) + across_g * load(rgb, at + LANES)
        s = s + across_b * load(rgb, at + 2 * LANES)
        store(signal, k * LANES, s)
        ss += total(s * s)

    # From where the pixel before it ended: most lie in the same cell.
    nx, ny, nz, length = out[0], out[1], out[2], out[LENGTH]
    if length == zero:
        nx, ny, nz = vx, vy, vz
    out[LENGTH] = zero
    cell = -1
    for _ in range(int(limits[2])):
        u, v = _octahedral(nx, ny, nz)
        last = cell
        cell = min(CELLS - 1, int(u * SIDE)) * CELLS + min(CELLS - 1, int(v * SIDE))
        lx, ly, lz = nx * length, ny * length, nz * length
        bx = by = bz = zero
        for k in range(groups):
            row = (cell * groups + k) * ROWS * LANES
            s = load(signal, k * LANES) - _moved(diffuse, row, lx, ly, lz, px, py, pz)
            bx += total(load(diffuse, row) * s)
            by += total(load(diffuse, row + LANES) * s)
            bz += total(load(diffuse, row + 2 * LANES) * s)
        step = (bx - lx) * (bx - lx) + (by - ly) * (by - ly) + (bz - lz) * (bz - lz)
        square = bx * bx + by * by + bz * bz
        if not (square > 0 and np.isfinite(square)):
            return False
        length = math.sqrt(square)
        inverse = one / length
        nx, ny, nz = bx * inverse, by * inverse, bz * inverse
        if cell == last and step < limits[3] * square:
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
    near = radius / reach
    near = near * near / max(nv, np.float32(GRAZING))
    w00, w01 = every((one - u) * (one - v) * near), every((one - u) * v * near)
    w10, w11 = every(u * (one - v) * near), every(u * v * near)
    corner = (i * (LOBE_SIDE + 1) + j) * groups * LANES
    below = corner + (LOBE_SIDE + 1) * groups * LANES
    beyond = groups * LANES
    noise = zero
    ee = eb = bb = es = lit_r = lit_g = lit_b = mirrored = zero
    third, quarter = one / np.float32(3), np.float32(0.25)
    to_r, to_g, to_b = one / white[0], one / white[1], one / white[2]
    for k in range(groups):
        row = (cell * groups + k) * ROWS * LANES
        e = every(nx) * load(diffuse, row + 3 * LANES) + every(ny) * load(diffuse, row + 4 * LANES)
        e = e + every(nz) * load(diffuse, row + 5 * LANES)
        e = at_least(e + _moved(diffuse, row, nx, ny, nz, px, py, pz), every(zero)) * leaves
        at = k * LANES
        m = w00 * load(lobe, corner + at) + w01 * load(lobe, corner + beyond + at)
        m = m + w10 * load(lobe, below + at) + w11 * load(lobe, below + beyond + at)
        at = first + k * 3 * LANES
        red, green, blue = load(rgb, at), load(rgb, at + LANES), load(rgb, at + 2 * LANES)
        ee += total(e * e)
        eb += total(e * m)
        bb += total(m * m)
        es += total(e * load(signal, k * LANES))
        lit_r += total(e * red) * to_r
        lit_g += total(e * green) * to_g
        lit_b += total(e * blue) * to_b
        # What a reading's noise, which grows with its light, turns the normal by: not along it.
        sx, sy = load(diffuse, row), load(diffuse, row + LANES)
        sz = load(diffuse, row + 2 * LANES)
        along_n = every(nx) * sx + every(ny) * sy + every(nz) * sz
        turns = sx * sx + sy * sy + sz * sz - along_n * along_n
        bright = at_least(red + green + blue, every(zero)) * every(third) + every(quarter)
        noise += total(turns * bright)
        mirrored += total(m * (every(to_r) * red + every(to_g) * green + every(to_b) * blue))
    if not (ee > 0 and ss > 0):
        return False
    share = eb / ee
    misfit = math.sqrt(max(zero, one - (es / ee) * (es / ss)))
    fits = min(one, max(zero, (np.float32(0.4) - misfit) / np.float32(0.3)))
    facing = min(one, max(zero, nv / np.float32(0.3)))
    out[0], out[1], out[2] = nx, ny, nz
    noise *= limits[4] * (x * x + y * y + z * z) * per * per / (length * length)
    out[3] = colourful * facing * fits / (one + noise / limits[5])
    out[4] = (mirrored - share * (lit_r + lit_g + lit_b)) * third
    out[5] = max(zero, bb - share * eb)
    out[6], out[7], out[8] = lit_r, lit_g, lit_b
    out[9], out[10] = ee, eb
    out[LENGTH] = length
    return bool(np.isfinite(out[4] + out[5] + out[9]))


@njit(cache=True, fastmath=FAST)
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


@njit(cache=True, fastmath=FAST)
def _put(
    found: bool,
    out: np.ndarray,
    at: int,
    sums: np.ndarray,
    normal: np.ndarray,
    albedo: np.ndarray,
    specular: np.ndarray,
    roughness: np.ndarray,
    confidence: np.ndarray,
) -> None:
    """Keep one pixel's result, and add it to its block's sums (SUMS + 1)."""
    if not found:
        out[LENGTH] = 0
        normal[at] = 0
        albedo[at] = 0
        specular[at] = roughness[at] = confidence[at] = 0
        return
    for c in range(3):
        normal[at, c] = out[c]
        albedo[at, c] = out[6 + c]
    confidence[at] = out[3]
    roughness[at], specular[at] = out[9], out[10]
    for c in range(SUMS):
        sums[c] += out[4 + c]
    sums[COUNT] += 1


@njit(parallel=True, cache=True, fastmath=FAST)
def solve_window(
    half: np.ndarray,
    scale: float,
    mask: np.ndarray,
    valid: np.ndarray,
    row_start: np.ndarray,
    origin: np.ndarray,
    rays: np.ndarray,
    step: int,
    camera: np.ndarray,
    diffuse: np.ndarray,
    lobe: np.ndarray,
    leaving: np.ndarray,
    groups: int,
    radius: float,
    white: np.ndarray,
    part: np.ndarray,
    limits: np.ndarray,
    block: int,
    sums: np.ndarray,
    normal: np.ndarray,
    albedo: np.ndarray,
    specular: np.ndarray,
    roughness: np.ndarray,
    confidence: np.ndarray,
) -> None:
    """Solve the masked pixels of a window of half-float frames.

    half (P, h, w, 3) uint16 bits of the window, times scale; mask, valid (h, w) of the window;
    row_start (h,) of a row's first pixel in the maps; origin: the window's top and left; rays
    (gh, gw, 3) unit directions from the camera at every `step` pixels of the picture; camera (3,)
    mm; block in pixels, counted from the window's corner; sums (bh, bw, SUMS + 1); maps by pixel.
    """
    patterns = len(half)
    stride = groups * 3 * LANES
    one = np.float32(1)
    height, width = mask.shape
    for strip in prange(len(sums)):
        rgb = np.zeros(RUN * stride, np.float32)
        signal = np.zeros(groups * LANES, np.float32)
        out = np.zeros(LENGTH + 1, np.float32)
        for y in range(strip * block, min(height, strip * block + block)):
            at = row_start[y]
            gy = (np.float32(y + origin[0])) / np.float32(step)
            iy = min(len(rays) - 2, int(gy))
            fy = gy - np.float32(iy)
            x0 = 0
            while x0 < width:
                if not mask[y, x0]:
                    x0 += 1
                    continue
                x1 = x0
                while x1 < width and x1 < x0 + RUN and mask[y, x1]:
                    x1 += 1
                out[LENGTH] = 0
                for k in range(patterns):
                    lane = k // LANES * 3 * LANES + k % LANES
                    for x in range(x0, x1):
                        for c in range(3):
                            to = (x - x0) * stride + lane + c * LANES
                            rgb[to] = as_float(half[k, y, x, c]) * scale
                for x in range(x0, x1):
                    gx = (np.float32(x + origin[1])) / np.float32(step)
                    ix = min(rays.shape[1] - 2, int(gx))
                    fx = gx - np.float32(ix)
                    w00 = (one - fy) * (one - fx)
                    w01, w10, w11 = (one - fy) * fx, fy * (one - fx), fy * fx
                    a, b = rays[iy, ix], rays[iy, ix + 1]
                    c_, d = rays[iy + 1, ix], rays[iy + 1, ix + 1]
                    dx = w00 * a[0] + w01 * b[0] + w10 * c_[0] + w11 * d[0]
                    dy = w00 * a[1] + w01 * b[1] + w10 * c_[1] + w11 * d[1]
                    dz = w00 * a[2] + w01 * b[2] + w10 * c_[2] + w11 * d[2]
                    shrink = one / math.sqrt(dx * dx + dy * dy + dz * dz)
                    dx, dy, dz = dx * shrink, dy * shrink, dz * shrink
                    away = camera[0] * dx + camera[1] * dy + camera[2] * dz
                    found = valid[y, x] and _pixel(
                        rgb,
                        (x - x0) * stride,
                        (-dx, -dy, -dz),
                        (
                            camera[0] - away * dx,
                            camera[1] - away * dy,
                            camera[2] - away * dz,
                        ),
                        diffuse,
                        lobe,
                        leaving,
                        groups,
                        radius,
                        white,
                        part,
                        limits,
                        signal,
                        out,
                    )
                    _put(
                        found,
                        out,
                        at,
                        sums[strip, x // block],
                        normal,
                        albedo,
                        specular,
                        roughness,
                        confidence,
                    )
                    at += 1
                x0 = x1


@njit(parallel=True, cache=True, fastmath=FAST)
def finish_window(
    mask: np.ndarray,
    row_start: np.ndarray,
    block: int,
    gloss: np.ndarray,
    prior: np.ndarray,
    prior_power: float,
    roughness_found: float,
    albedo: np.ndarray,
    specular: np.ndarray,
    roughness: np.ndarray,
) -> None:
    """Turn lit and power into albedo with the blocks' specular albedo, in place.

    gloss (bh, bw) specular albedo and prior (bh, bw, 3) diffuse albedo of the blocks, read between
    their centres; prior_power weighs the latter.
    """
    height, width = mask.shape
    rows, columns = gloss.shape
    half, one = np.float32(0.5), np.float32(1)
    per = one / np.float32(block)
    for y in prange(height):
        at = row_start[y]
        gy = max(np.float32(0), (np.float32(y) + half) * per - half)
        iy = min(rows - 1, int(gy))
        jy = min(rows - 1, iy + 1)
        fy = gy - np.float32(iy)
        for x in range(width):
            if not mask[y, x]:
                continue
            power = roughness[at]
            if power > 0:
                gx = max(np.float32(0), (np.float32(x) + half) * per - half)
                ix = min(columns - 1, int(gx))
                jx = min(columns - 1, ix + 1)
                fx = gx - np.float32(ix)
                w00, w01 = (one - fy) * (one - fx), (one - fy) * fx
                w10, w11 = fy * (one - fx), fy * fx
                s = w00 * gloss[iy, ix] + w01 * gloss[iy, jx]
                s += w10 * gloss[jy, ix] + w11 * gloss[jy, jx]
                taken = s * specular[at]
                for c in range(3):
                    near = w00 * prior[iy, ix, c] + w01 * prior[iy, jx, c]
                    near += w10 * prior[jy, ix, c] + w11 * prior[jy, jx, c]
                    value = albedo[at, c] - taken + prior_power * near
                    albedo[at, c] = max(np.float32(0), value / (power + prior_power))
                specular[at] = s
                roughness[at] = roughness_found
            at += 1
