"""Compiled loops of the coarse method over a window of half-float frames.

Each row of blocks (some pixels square) is one task, so that sums over blocks need no lock. A run of
pixels is loaded eight at a time: eight patterns of eight readings each are turned by the processor,
so that a pixel's patterns are beside each other.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, prange

from lightstage.formats.half import as_float
from processing.lanes import LANES, every, load_row, store_turned
from processing.separation.coarse_given import Maps, Model, Window
from processing.separation.coarse_pixel import FAST, LENGTH, OUT, solve_pixel

RUN = 128
"""Pixels of a row that are loaded at once."""
SUMS = 7
"""Sums of a block: weighed, weight, lit (3), power, mirror times irradiance."""
COUNT = 7
"""Place of a block's number of solved pixels, behind its sums."""


@njit(cache=True, forceinline=True)
def _row(flat: np.ndarray, first: int, apart: int, k: int, patterns: int) -> Any:
    """Eight readings of pattern k, zeros of one that is not there."""
    return load_row(flat, first + k * apart) if k < patterns else every(np.float32(0))


@njit(cache=True, forceinline=True)
def _load_run(
    flat: np.ndarray, patterns: int, apart: int, first: int, count: int, rgb: np.ndarray
) -> None:
    """Readings of `count` pixels of a row to rgb (G, RUN, 3, LANES), flat.

    flat: (patterns, apart) readings; first: index of the run's first in the first pattern. The
    array must reach a pixel or two beyond the run, or the last eight readings are taken again.
    """
    last = apart - LANES
    numbers = 3 * count
    for group in range(-(-patterns // LANES)):
        k = group * LANES
        begin = group * RUN * 3 * LANES
        at = 0
        while at < numbers:
            # At the frame's very end eight readings that end there hold the rest.
            here = min(first + at, last)
            to = begin + (here - first) * LANES
            if to < begin:
                _load_few(flat, patterns, apart, first + at, numbers - at, k, begin, at, rgb)
                break
            store_turned(
                rgb,
                to,
                _row(flat, here, apart, k, patterns),
                _row(flat, here, apart, k + 1, patterns),
                _row(flat, here, apart, k + 2, patterns),
                _row(flat, here, apart, k + 3, patterns),
                _row(flat, here, apart, k + 4, patterns),
                _row(flat, here, apart, k + 5, patterns),
                _row(flat, here, apart, k + 6, patterns),
                _row(flat, here, apart, k + 7, patterns),
            )
            at += LANES


@njit(cache=True, forceinline=True)
def _load_few(
    flat: np.ndarray,
    patterns: int,
    apart: int,
    first: int,
    numbers: int,
    k: int,
    begin: int,
    at: int,
    rgb: np.ndarray,
) -> None:
    """The same, one by one: a run at the end of a frame smaller than eight readings."""
    for j in range(numbers):
        for pattern in range(k, min(patterns, k + LANES)):
            value = as_float(flat[pattern * apart + first + j])
            rgb[begin + (at + j) * LANES + pattern - k] = value


@njit(cache=True, fastmath=FAST, forceinline=True)
def blank(maps: Maps, at: int) -> None:
    """Keep nothing of one pixel."""
    maps.normal[at] = 0
    maps.albedo[at] = 0
    maps.specular[at] = maps.roughness[at] = maps.confidence[at] = 0


@njit(cache=True, fastmath=FAST, forceinline=True)
def put(
    found: bool,
    out: np.ndarray,
    at: int,
    sums: np.ndarray,
    maps: Maps,
) -> None:
    """Keep one pixel's flat result `out`, and add it to its block's (SUMS + 1,) sums."""
    if not found:
        out[LENGTH] = 0
        blank(maps, at)
        return
    for c in range(3):
        maps.normal[at, c] = out[c]
        maps.albedo[at, c] = out[6 + c]
    maps.confidence[at] = out[3]
    maps.roughness[at], maps.specular[at] = out[9], out[10]
    for c in range(SUMS):
        sums[c] += out[4 + c]
    sums[COUNT] += 1


@njit(parallel=True, cache=True, fastmath=FAST)
def solve_window(window: Window, model: Model, sums: np.ndarray, maps: Maps) -> None:
    """Solve the masked pixels of a window of half-float frames.

    Args:
        window: of P patterns.
        model: of its camera.
        sums: (bh, bw, SUMS + 1) of the window's blocks, added to.
        maps: by masked pixel, filled.
    """
    half, mask, valid, row_start = window.half, window.mask, window.valid, window.row_start
    origin, rays, step, camera = window.origin, window.rays, window.step, window.camera
    scale, block, groups = window.scale, window.block, model.groups
    patterns = len(half)
    stride = 3 * LANES
    beyond = RUN * stride
    apart = half.shape[1] * half.shape[2] * 3
    flat = half.reshape(half.size)
    one = np.float32(1)
    height, width = mask.shape
    for strip in prange(len(sums)):
        # A little longer: eight readings at a time reach beyond a run.
        rgb = np.zeros(groups * beyond + LANES * LANES, np.float32)
        signal = np.zeros(2 * groups * LANES, np.float32)
        line = np.zeros((rays.shape[1], 3), np.float32)
        out = np.zeros(OUT, np.float32)
        for y in range(strip * block, min(height, strip * block + block)):
            at = row_start[y]
            gy = (np.float32(y + origin[0])) / np.float32(step)
            iy = min(len(rays) - 2, int(gy))
            fy = gy - np.float32(iy)
            for i in range(rays.shape[1]):
                for c in range(3):
                    line[i, c] = (one - fy) * rays[iy, i, c] + fy * rays[iy + 1, i, c]
            x0 = 0
            while x0 < width:
                if not mask[y, x0]:
                    x0 += 1
                    continue
                x1 = x0
                while x1 < width and x1 < x0 + RUN and mask[y, x1]:
                    x1 += 1
                out[LENGTH] = 0
                _load_run(flat, patterns, apart, (y * width + x0) * 3, x1 - x0, rgb)
                for x in range(x0, x1):
                    gx = (np.float32(x + origin[1])) / np.float32(step)
                    ix = min(rays.shape[1] - 2, int(gx))
                    fx = gx - np.float32(ix)
                    back = one - fx
                    dx = back * line[ix, 0] + fx * line[ix + 1, 0]
                    dy = back * line[ix, 1] + fx * line[ix + 1, 1]
                    dz = back * line[ix, 2] + fx * line[ix + 1, 2]
                    away = camera[0] * dx + camera[1] * dy + camera[2] * dz
                    found = valid[y, x] and solve_pixel(
                        rgb,
                        (x - x0) * stride,
                        beyond,
                        scale,
                        (-dx, -dy, -dz),
                        (
                            camera[0] - away * dx,
                            camera[1] - away * dy,
                            camera[2] - away * dz,
                        ),
                        model,
                        signal,
                        out,
                    )
                    put(
                        found,
                        out,
                        at,
                        sums[strip, x // block],
                        maps,
                    )
                    at += 1
                x0 = x1


@njit(parallel=True, cache=True, fastmath=FAST)
def finish_window(
    window: Window,
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
    their centres; prior_power weighs the latter. The maps come one by one, as numba drops what a
    parallel loop itself writes to a tuple's field (its issue 7135).
    """
    mask, row_start, block = window.mask, window.row_start, window.block
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
