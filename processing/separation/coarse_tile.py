"""What the coarse method does with one tile of pixels, eight at a time; see `coarse_tiles`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from processing.lanes import LANES, at_least, every, lane, load, store, totals
from processing.lighting.lobe import GRAZING
from processing.separation.coarse_given import Maps
from processing.separation.coarse_kernels import blank
from processing.separation.coarse_pixel import FAST
from processing.separation.far_tables import ROWS
from processing.separation.triples import load_triples, over_root, store_triples

TILE_ROWS = 8
TILE = TILE_ROWS * LANES
"""Pixels of a tile."""
NEAR = 0.99
"""A normal whose cosine to its tile's is below this is solved by itself (8 degrees)."""
HELD = 6
"""Rows of what a tile's pixels share: solver (3), irradiance vectors (3)."""
KEPT = 8
"""Rows of what a pixel gives: normal (3), lit (3), power, mirror times irradiance."""


@njit(cache=True, fastmath=FAST, forceinline=True)
def read_eight(
    flat: np.ndarray,
    patterns: int,
    apart: int,
    first: int,
    row: int,
    read: np.ndarray,
    looks: np.ndarray,
) -> None:
    """Eight pixels' readings to read (TILE_ROWS, G LANES, 3, LANES), and looks (4, TILE): their
    sums over patterns of red, green and blue, and the brightest pattern's sum of colours.
    """
    none = every(np.float32(0))
    reds, greens, blues, brightest = none, none, none, none
    beyond = len(read) // TILE_ROWS
    for k in range(patterns):
        red, green, blue = load_triples(flat, first + k * apart)
        to = row * beyond + k * 3 * LANES
        store(read, to, red)
        store(read, to + LANES, green)
        store(read, to + 2 * LANES, blue)
        reds, greens, blues = reds + red, greens + green, blues + blue
        brightest = at_least(red + green + blue, brightest)
    at = row * LANES
    store(looks, at, reds)
    store(looks, at + TILE, greens)
    store(looks, at + 2 * TILE, blues)
    store(looks, at + 3 * TILE, brightest)


@njit(cache=True, fastmath=FAST, forceinline=True, error_model="numpy")
def usable(
    looks: np.ndarray, scale: float, white: np.ndarray, limits: np.ndarray, good: np.ndarray
) -> int:
    """Take from good (TILE,) what `solve_pixel` would refuse; returns how many are left."""
    ux, uy, uz = white[3], white[4], white[5]
    least = limits[1] * limits[1]
    zero = np.float32(0)
    left = 0
    for i in range(TILE):
        r, g, b = looks[i], looks[TILE + i], looks[2 * TILE + i]
        total = r + g + b
        per = np.float32(3) / total
        r, g, b = r * per, g * per, b * per
        along = r * ux + g * uy + b * uz
        x, y, z = r - along * ux, g - along * uy, b - along * uz
        colour = x * x + y * y + z * z
        # False for NaN and for infinities, whose difference to themselves is none.
        fine = (r > zero) & (g > zero) & (b > zero) & (total - total == zero)
        fine &= (total > zero) & (colour > least) & (looks[3 * TILE + i] * scale > limits[0])
        good[i] &= np.uint8(fine)
        left += good[i]
    return left


@njit(cache=True, fastmath=FAST, forceinline=True)
def _down(read: np.ndarray, at: int, beyond: int) -> Any:
    """The sum of a tile's rows."""
    out = load(read, at)
    for row in range(1, TILE_ROWS):
        out = out + load(read, at + row * beyond)
    return out


@njit(cache=True, fastmath=FAST, forceinline=True)
def mean_reading(
    read: np.ndarray, patterns: int, good: np.ndarray, left: int, mean: np.ndarray
) -> None:
    """The mean reading of a tile's good pixels to mean (G, 3, LANES), as `solve_pixel` takes it."""
    beyond = len(read) // TILE_ROWS
    share = np.float32(1) / np.float32(left)
    if left == TILE:
        part = every(share)
        for group in range(len(mean) // (3 * LANES)):
            for c in range(3):
                at = (group * LANES * 3 + c) * LANES
                step = 3 * LANES
                found = totals(
                    _down(read, at, beyond),
                    _down(read, at + step, beyond),
                    _down(read, at + 2 * step, beyond),
                    _down(read, at + 3 * step, beyond),
                    _down(read, at + 4 * step, beyond),
                    _down(read, at + 5 * step, beyond),
                    _down(read, at + 6 * step, beyond),
                    _down(read, at + 7 * step, beyond),
                )
                store(mean, (group * 3 + c) * LANES, found * part)
        return
    for k in range(patterns):
        for c in range(3):
            total = np.float32(0)
            for i in range(TILE):
                if good[i]:
                    at = (i // LANES) * beyond + (k * 3 + c) * LANES
                    total += read[at + i % LANES]
            mean[((k // LANES) * 3 + c) * LANES + k % LANES] = total * share


@njit(cache=True, fastmath=FAST, forceinline=True)
def share(
    diffuse: np.ndarray,
    cell: int,
    groups: int,
    place: tuple[float, float, float],
    held: np.ndarray,
) -> None:
    """What a tile's pixels share to held (HELD, G LANES): at the tile's place, not the centre.

    With J the change of the irradiance vectors G from the centre to the place and S the centre's
    solver, signals s = (G + J) b are solved by b = S s - S J b, three times put into itself.
    """
    px, py, pz = every(place[0]), every(place[1]), every(place[2])
    width = groups * LANES
    none = every(np.float32(0))
    xx, xy, xz, yx, yy, yz, zx, zy, zz = none, none, none, none, none, none, none, none, none
    for k in range(groups):
        row, at = (cell * groups + k) * ROWS * LANES, k * LANES
        moved = row + 6 * LANES
        jxx, jyy = load(diffuse, moved), load(diffuse, moved + LANES)
        jzz, jxy = load(diffuse, moved + 2 * LANES), load(diffuse, moved + 3 * LANES)
        jxz, jyz = load(diffuse, moved + 4 * LANES), load(diffuse, moved + 5 * LANES)
        jx = jxx * px + jxy * py + jxz * pz
        jy = jxy * px + jyy * py + jyz * pz
        jz = jxz * px + jyz * py + jzz * pz
        sx, sy, sz = load(diffuse, row), load(diffuse, row + LANES), load(diffuse, row + 2 * LANES)
        store(held, at, sx)
        store(held, at + width, sy)
        store(held, at + 2 * width, sz)
        store(held, at + 3 * width, load(diffuse, row + 3 * LANES) + jx)
        store(held, at + 4 * width, load(diffuse, row + 4 * LANES) + jy)
        store(held, at + 5 * width, load(diffuse, row + 5 * LANES) + jz)
        xx, xy, xz = xx + sx * jx, xy + sx * jy, xz + sx * jz
        yx, yy, yz = yx + sy * jx, yy + sy * jy, yz + sy * jz
        zx, zy, zz = zx + sz * jx, zy + sz * jy, zz + sz * jz
    found = totals(xx, xy, xz, yx, yy, yz, zx, zy)
    xx, xy, xz = every(lane(found, 0)), every(lane(found, 1)), every(lane(found, 2))
    yx, yy, yz = every(lane(found, 3)), every(lane(found, 4)), every(lane(found, 5))
    zx, zy = every(lane(found, 6)), every(lane(found, 7))
    zz = every(lane(totals(zz, none, none, none, none, none, none, none), 0))
    for k in range(groups):
        row, at = (cell * groups + k) * ROWS * LANES, k * LANES
        sx, sy, sz = load(diffuse, row), load(diffuse, row + LANES), load(diffuse, row + 2 * LANES)
        x, y, z = sx, sy, sz
        for _ in range(3):
            x, y, z = (
                sx - (xx * x + xy * y + xz * z),
                sy - (yx * x + yy * y + yz * z),
                sz - (zx * x + zy * y + zz * z),
            )
        store(held, at, x)
        store(held, at + width, y)
        store(held, at + 2 * width, z)


@njit(cache=True, fastmath=FAST, forceinline=True)
def solve_eight(
    read: np.ndarray,
    first: int,
    patterns: int,
    width: int,
    held: np.ndarray,
    lobe: np.ndarray,
    across: tuple[float, float, float],
    view: tuple[float, float, float],
    leaves: tuple[float, float],
    balance: tuple[float, float, float],
    kept: np.ndarray,
    at: int,
) -> None:
    """Eight pixels' normals, lit and power to kept (KEPT, TILE)."""
    none = every(np.float32(0))
    to_r, to_g, to_b = every(across[0]), every(across[1]), every(across[2])
    bx, by, bz = none, none, none
    for k in range(patterns):
        place = first + k * 3 * LANES
        s = to_r * load(read, place) + to_g * load(read, place + LANES)
        s = s + to_b * load(read, place + 2 * LANES)
        bx = bx + every(held[k]) * s
        by = by + every(held[width + k]) * s
        bz = bz + every(held[2 * width + k]) * s
    square = bx * bx + by * by + bz * bz
    shorter = over_root(square)
    nx, ny, nz = bx * shorter, by * shorter, bz * shorter
    nv = nx * every(view[0]) + ny * every(view[1]) + nz * every(view[2])
    leaving = every(leaves[0]) + every(leaves[1]) * nv
    power, both, reds, greens, blues = none, none, none, none, none
    for k in range(patterns):
        e = nx * every(held[3 * width + k]) + ny * every(held[4 * width + k])
        e = at_least(e + nz * every(held[5 * width + k]), none) * leaving
        place = first + k * 3 * LANES
        reds = reds + e * load(read, place)
        greens = greens + e * load(read, place + LANES)
        blues = blues + e * load(read, place + 2 * LANES)
        power = power + e * e
        both = both + e * every(lobe[k])
    store(kept, at, nx)
    store(kept, at + TILE, ny)
    store(kept, at + 2 * TILE, nz)
    store(kept, at + 3 * TILE, reds * every(balance[0]))
    store(kept, at + 4 * TILE, greens * every(balance[1]))
    store(kept, at + 5 * TILE, blues * every(balance[2]))
    store(kept, at + 6 * TILE, power)
    store(kept, at + 7 * TILE, both)


@njit(cache=True, fastmath=FAST, forceinline=True)
def near_tile(
    kept: np.ndarray, good: np.ndarray, x: float, y: float, z: float, own: np.ndarray
) -> int:
    """Find the good pixels of a tile that its shared solution does not fit.

    Args:
        kept: (KEPT * TILE,), of `solve_eight`.
        good: (TILE,) uint8, 1 for pixels that can be used.
        x, y, z: the tile's unit normal.
        own: (TILE,) uint8, filled in: 1 for good pixels that must be solved by themselves.

    Returns:
        For how many good pixels the tile's solution holds.
    """
    zero = np.float32(0)
    done = 0
    for i in range(TILE):
        cosine = kept[i] * x + kept[TILE + i] * y + kept[2 * TILE + i] * z
        power = kept[6 * TILE + i]
        lit = kept[3 * TILE + i] + kept[4 * TILE + i] + kept[5 * TILE + i] + power
        # False for NaN, and where what was read is too large for float32.
        fine = (cosine > NEAR) & (power > zero) & (lit - lit == zero)
        own[i] = good[i] & np.uint8(not fine)
        done += good[i] & np.uint8(fine)
    return done


@njit(cache=True, fastmath=FAST, forceinline=True)
def leaves(leaving: np.ndarray, facing: Any) -> tuple[float, float]:
    """What leaves the skin near a cosine to the camera, by a (k,) table: at 0, and its slope."""
    steps = np.float32(len(leaving) - 1)
    place = min(np.float32(1), max(facing, np.float32(GRAZING))) * steps
    below = min(len(leaving) - 2, int(place))
    slope = leaving[below + 1] - leaving[below]
    return leaving[below] - slope * np.float32(below), slope * steps


@njit(cache=True, fastmath=FAST, forceinline=True)
def store_eight(
    kept: np.ndarray,
    base: int,
    trust: float,
    at: int,
    maps: Maps,
) -> None:
    """Write eight pixels that are beside each other to the maps.

    Args:
        kept: (KEPT * TILE,), rows of a tile: normal, albedo, roughness, specular albedo.
        base: first of the eight in a row.
        trust: their confidence.
        at: first of the eight in the maps.
        maps: are filled in.
    """
    red, green = load(kept, base), load(kept, base + TILE)
    store_triples(
        maps.normal.reshape(maps.normal.size), 3 * at, red, green, load(kept, base + 2 * TILE)
    )
    red, green = load(kept, base + 3 * TILE), load(kept, base + 4 * TILE)
    store_triples(
        maps.albedo.reshape(maps.albedo.size), 3 * at, red, green, load(kept, base + 5 * TILE)
    )
    store(maps.roughness, at, load(kept, base + 6 * TILE))
    store(maps.specular, at, load(kept, base + 7 * TILE))
    store(maps.confidence, at, every(trust))


@njit(cache=True, fastmath=FAST)
def keep_one(
    good: bool,
    kept: np.ndarray,
    i: int,
    trust: float,
    at: int,
    maps: Maps,
) -> None:
    """Write one pixel of a tile to the maps; zeros where it cannot be used.

    Args:
        good: whether it can be used.
        kept: (KEPT * TILE,), as of `store_eight`.
        i: the pixel in a row.
        trust: its confidence.
        at: the pixel in the maps.
        maps: are filled in.
    """
    if not good:
        blank(maps, at)
        return
    for c in range(3):
        maps.normal[at, c] = kept[c * TILE + i]
        maps.albedo[at, c] = kept[(3 + c) * TILE + i]
    maps.roughness[at], maps.specular[at] = kept[6 * TILE + i], kept[7 * TILE + i]
    maps.confidence[at] = trust


@njit(cache=True, fastmath=FAST)
def lone_reading(read: np.ndarray, first: int, patterns: int, pixel: int, mean: np.ndarray) -> None:
    """Copy one pixel's readings to mean, as `solve_pixel` takes them.

    Args:
        read: (TILE_ROWS * G * LANES * 3 * LANES,), of `read_eight`.
        first: where the pixel's row of the tile begins in it.
        patterns: P.
        pixel: the pixel's lane.
        mean: (G * 3 * LANES,), filled in.
    """
    mean[:] = 0
    for k in range(patterns):
        for c in range(3):
            place = first + (k * 3 + c) * LANES + pixel
            mean[((k // LANES) * 3 + c) * LANES + k % LANES] = read[place]
