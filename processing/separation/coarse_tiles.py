"""The coarse method where pixels are finer than what skin mirrors: tiles of 8 x 8 pixels.

A tile's mean is solved as one pixel is (`coarse_pixel`): it gives which lights its normals see, how
they mirror and how far they can be trusted. With these its pixels' own normals and albedo are sums
over patterns, eight pixels at a time. A pixel whose normal is far from its tile's is solved by
itself.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from processing.lanes import LANES
from processing.separation.coarse_given import Maps, Model, Window
from processing.separation.coarse_kernels import COUNT, SUMS, put
from processing.separation.coarse_pixel import ACROSS, CELL, FAST, LENGTH, OUT, solve_pixel
from processing.separation.coarse_tile import (
    HELD,
    KEPT,
    TILE,
    TILE_ROWS,
    keep_one,
    leaves,
    lone_reading,
    mean_reading,
    near_tile,
    read_eight,
    share,
    solve_eight,
    store_eight,
    usable,
)


@njit(cache=True, fastmath=FAST, forceinline=True)
def _ray(
    rays: np.ndarray, step: int, y: float, x: float, camera: np.ndarray
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Toward the camera at a pixel of the picture, and where its ray passes the centre, mm."""
    one = np.float32(1)
    gy, gx = y / np.float32(step), x / np.float32(step)
    iy, ix = min(len(rays) - 2, int(gy)), min(rays.shape[1] - 2, int(gx))
    fy, fx = gy - np.float32(iy), gx - np.float32(ix)
    a, b = (one - fy) * (one - fx), (one - fy) * fx
    c, d = fy * (one - fx), fy * fx
    over, under = rays[iy], rays[iy + 1]
    dx = a * over[ix, 0] + b * over[ix + 1, 0] + c * under[ix, 0] + d * under[ix + 1, 0]
    dy = a * over[ix, 1] + b * over[ix + 1, 1] + c * under[ix, 1] + d * under[ix + 1, 1]
    dz = a * over[ix, 2] + b * over[ix + 1, 2] + c * under[ix, 2] + d * under[ix + 1, 2]
    away = camera[0] * dx + camera[1] * dy + camera[2] * dz
    place = (camera[0] - away * dx, camera[1] - away * dy, camera[2] - away * dz)
    return (-dx, -dy, -dz), place


@njit(parallel=True, cache=True, fastmath=FAST)
def solve_tiles(window: Window, model: Model, sums: np.ndarray, maps: Maps) -> None:
    """What `solve_window` does, and takes (shapes too), by tiles; block is a multiple of a side.

    The window is at least eight pixels wide.
    """
    half, mask, valid, row_start = window.half, window.mask, window.valid, window.row_start
    origin, rays, step, camera = window.origin, window.rays, window.step, window.camera
    scale, block, groups, white = window.scale, window.block, model.groups, model.white
    patterns, height, width = len(half), mask.shape[0], mask.shape[1]
    apart = half.shape[1] * half.shape[2] * 3
    flat = half.reshape(half.size)
    beyond = groups * LANES * 3 * LANES
    across = groups * LANES
    for strip in prange(len(sums)):
        read = np.zeros(TILE_ROWS * beyond, np.float32)
        looks, kept = np.zeros(4 * TILE, np.float32), np.zeros(KEPT * TILE, np.float32)
        mean = np.zeros(groups * 3 * LANES, np.float32)
        signal = np.zeros(2 * across, np.float32)
        held = np.zeros(HELD * across, np.float32)
        out, single = np.zeros(OUT, np.float32), np.zeros(OUT, np.float32)
        good, own = np.zeros(TILE, np.uint8), np.zeros(TILE, np.uint8)
        shown, at = np.zeros(TILE, np.uint8), np.zeros(TILE_ROWS, np.int64)
        for y0 in range(strip * block, min(height, strip * block + block), TILE_ROWS):
            rows = min(TILE_ROWS, height - y0)
            for row in range(rows):
                at[row] = row_start[y0 + row]
            out[LENGTH] = 0
            good[:] = 0
            shown[:] = 0
            looks[:] = 0
            for x0 in range(0, width, LANES):
                # The last tile of a row overlaps the one before, whose pixels it leaves out.
                left = min(x0, width - LANES)
                seen = 0
                for row in range(rows):
                    for i in range(LANES):
                        inside = mask[y0 + row, left + i] & (left + i >= x0)
                        shown[row * LANES + i] = inside
                        good[row * LANES + i] = inside & valid[y0 + row, left + i]
                        seen += inside
                if seen == 0:
                    out[LENGTH] = 0
                    continue
                for row in range(rows):
                    first = ((y0 + row) * width + left) * 3
                    read_eight(flat, patterns, apart, first, row, read, looks)
                count = usable(looks, scale, white, model.limits, good)
                done = 0
                view, place = _ray(
                    rays,
                    step,
                    np.float32(y0 + origin[0]) + np.float32(0.5 * (TILE_ROWS - 1)),
                    np.float32(left + origin[1]) + np.float32(0.5 * (LANES - 1)),
                    camera,
                )
                own[:] = good
                if count > 0:
                    mean_reading(read, patterns, good, count, mean)
                    if solve_pixel(
                        mean,
                        np.int64(0),
                        3 * LANES,
                        scale,
                        view,
                        place,
                        model,
                        signal,
                        out,
                    ):
                        share(model.diffuse, int(out[CELL]), groups, place, held)
                        facing = out[0] * view[0] + out[1] * view[1] + out[2] * view[2]
                        for row in range(rows):
                            solve_eight(
                                read,
                                row * beyond,
                                patterns,
                                across,
                                held,
                                signal[across:],
                                (out[ACROSS], out[ACROSS + 1], out[ACROSS + 2]),
                                view,
                                leaves(model.leaving, facing),
                                (scale / white[0], scale / white[1], scale / white[2]),
                                kept,
                                row * LANES,
                            )
                        done = near_tile(kept, good, out[0], out[1], out[2], own)
                        total = sums[strip, x0 // block]
                        for c in range(SUMS):
                            total[c] += np.float32(done) * out[4 + c]
                        total[COUNT] += np.float32(done)
                for row in range(rows):
                    base = row * LANES
                    if done == TILE:
                        store_eight(
                            kept,
                            base,
                            out[3],
                            at[row],
                            maps,
                        )
                        at[row] += LANES
                        continue
                    for i in range(base, base + LANES):
                        if not shown[i]:
                            continue
                        if own[i]:
                            lone_reading(read, row * beyond, patterns, i - base, mean)
                            single[LENGTH] = 0
                            found = solve_pixel(
                                mean,
                                np.int64(0),
                                3 * LANES,
                                scale,
                                view,
                                place,
                                model,
                                signal,
                                single,
                            )
                            put(
                                found,
                                single,
                                at[row],
                                sums[strip, x0 // block],
                                maps,
                            )
                        else:
                            keep_one(
                                good[i],
                                kept,
                                i,
                                out[3],
                                at[row],
                                maps,
                            )
                        at[row] += 1
