"""Every pixel between four nodes: half floats to maps in one pass, eight pixels at a time."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit, prange

from lightstage.formats.half import as_float
from processing.lanes import LANES, every, load, store_turned
from processing.readings import BRIGHTEST
from processing.refinement import finish
from processing.refinement.finish import GIVEN, Limits, Maps, finish_pixel
from processing.refinement.joint_equations import Spread
from processing.refinement.node_light import (
    FRAME,
    GLOSS,
    OF_PATTERN,
    OTHERS,
    TURN,
)
from processing.refinement.node_solve import OF_STATE, RESULTS, solve_eight


class Photos(NamedTuple):
    """A camera's half floats and what is to be known to read them.

    Attributes:
        bits: (P, h, w, 3) uint16 of the window.
        clipped: (h, w) uint8 of the window, 0 where all is well.
        scale: of `Frames`.
        top, left: of the window.
        white: (6,) float32 the lights' colour, and its direction.
        dark_level: of `RefineConfig`.
    """

    bits: np.ndarray
    clipped: np.ndarray
    scale: np.float32
    top: int
    left: int
    white: np.ndarray
    dark_level: float


class Nodes(NamedTuple):
    """Some rows of nodes.

    Attributes:
        number: (h, w) int32 row of `table`, -1 where there is no node.
        safe: (h - 1, w - 1) bool: between these four nodes light may be interpolated.
        table: (n, P OF_PATTERN + OF_PLACE and more) float32, as `table_of` makes it.
        step: pixels between nodes.
        top: the first row's number among all rows of nodes.
        widest2: squared tangent of the turn from the nodes' normals up to which light is known.
    """

    number: np.ndarray
    safe: np.ndarray
    table: np.ndarray
    step: int
    top: int
    widest2: float


class Picture(NamedTuple):
    """Which pixels there are.

    Attributes:
        mask: (h, w) bool.
        first: (h,) number of the mask's pixels above each row.
        inside: (h, w) uint8 distance to the nearest edge in quarter pixels, at most 255.
    """

    mask: np.ndarray
    first: np.ndarray
    inside: np.ndarray


@njit(cache=True, error_model="numpy")
def read_pixel(photos: Photos, y: int, x: int, ws: np.ndarray, at: int) -> tuple[bool, float]:
    """Put one pixel's readings into a lane of the flat workspace `ws`, from `at` on.

    Returns whether they can be used, and their saturation.

    The same as `readings.read_pixels` and division by the lights' colour.
    """
    patterns = photos.bits.shape[0]
    row, column = y - photos.top, x - photos.left
    there = 0 <= row < photos.bits.shape[1] and 0 <= column < photos.bits.shape[2]
    usable = there and photos.clipped[row, column] == 0
    r = g = b = np.float32(0)
    peak_r = peak_g = peak_b = np.float32(-np.inf)
    if usable:
        for k in range(patterns):
            red = as_float(photos.bits[k, row, column, 0]) * photos.scale
            green = as_float(photos.bits[k, row, column, 1]) * photos.scale
            blue = as_float(photos.bits[k, row, column, 2]) * photos.scale
            r, g, b = r + red, g + green, b + blue
            peak_r, peak_g, peak_b = max(peak_r, red), max(peak_g, green), max(peak_b, blue)
            to = at + 3 * k * LANES
            ws[to] = red / photos.white[0]
            ws[to + LANES] = green / photos.white[1]
            ws[to + 2 * LANES] = blue / photos.white[2]
        brightest = (peak_r + peak_g + peak_b) / np.float32(3)
        usable = min(r, g, b) > 0 and brightest < BRIGHTEST and brightest > photos.dark_level
        usable = usable and math.isfinite(r + g + b)
    if not usable:
        for i in range(3 * patterns):
            ws[at + i * LANES] = 0
        return False, 0.0
    mean = (r + g + b) / 3
    along = r * photos.white[3] + g * photos.white[4] + b * photos.white[5]
    r, g, b = r - along * photos.white[3], g - along * photos.white[4], b - along * photos.white[5]
    return True, float(math.sqrt(r * r + g * g + b * b) / mean)


@njit(cache=True, error_model="numpy", forceinline=True)
def _at_place(table: np.ndarray, corners: np.ndarray, shares: np.ndarray, j: int, i: int) -> Any:
    """Eight numbers from `i` on at the place of lane j between its four nodes."""
    first = corners[j]
    found = every(shares[j, 0]) * load(table, first[0] + i)
    found = found + every(shares[j, 1]) * load(table, first[1] + i)
    found = found + every(shares[j, 2]) * load(table, first[2] + i)
    return found + every(shares[j, 3]) * load(table, first[3] + i)


@njit(cache=True, error_model="numpy")
def _mixed(
    table: np.ndarray, corners: np.ndarray, shares: np.ndarray, ws: np.ndarray, to: int
) -> None:
    """Interpolate all numbers of eight places into rows of `ws`.

    Args:
        table: of `Nodes`.
        corners: (LANES, 4) where each place's four nodes begin in the flat table.
        shares: (LANES, 4) float32 of them.
        ws: flat float32, rows of LANES numbers.
        to: first of the rows.
    """
    for i in range(0, table.shape[1], LANES):
        store_turned(
            ws, (to + i) * LANES,
            _at_place(table, corners, shares, 0, i), _at_place(table, corners, shares, 1, i),
            _at_place(table, corners, shares, 2, i), _at_place(table, corners, shares, 3, i),
            _at_place(table, corners, shares, 4, i), _at_place(table, corners, shares, 5, i),
            _at_place(table, corners, shares, 6, i), _at_place(table, corners, shares, 7, i),
        )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _give(ws: np.ndarray, place: int, results: int, j: int, given: np.ndarray) -> None:
    """Lane j's results and its node's numbers in the order of `finish_pixel`."""
    t, u = ws[results * LANES + j], ws[(results + 1) * LANES + j]
    frame = (place + FRAME) * LANES + j
    normal2 = matte2 = np.float32(0)
    bt, bu = ws[(results + 2) * LANES + j], ws[(results + 3) * LANES + j]
    bn = ws[(results + 4) * LANES + j]
    for x in range(3):
        along = ws[frame + x * LANES]
        first, second = ws[frame + (3 + x) * LANES], ws[frame + (6 + x) * LANES]
        n = along + t * first + u * second
        m = bn * along + bt * first + bu * second
        given[finish.NORMAL + x], given[finish.MATTE + x] = n, m
        normal2 += n * n
        matte2 += m * m
    for x in range(3):
        given[finish.NORMAL + x] /= math.sqrt(normal2)
        if matte2 > 0:
            given[finish.MATTE + x] /= math.sqrt(matte2)
    for i in range(8):
        given[finish.ALBEDO + i] = ws[(results + 5 + i) * LANES + j]
    others = (place + OTHERS) * LANES + j
    length2 = np.float32(0)
    for x in range(3):
        given[finish.MESH + x] = ws[others + x * LANES]
        length2 += given[finish.MESH + x] ** 2
    for x in range(3):
        given[finish.MESH + x] /= math.sqrt(length2)
    given[finish.FACING] = ws[others + 3 * LANES]
    for c in range(3):
        given[finish.PRIOR + c] = ws[others + (4 + c) * LANES]
        given[finish.VIEW + c] = ws[others + (9 + c) * LANES]
    given[finish.ROUGHNESS] = ws[others + 7 * LANES]
    given[finish.MATTE_TURN2] = ws[(results + 14) * LANES + j]
    given[finish.OPEN] = ws[others + 8 * LANES]
    given[finish.SPECULAR] = ws[(place + GLOSS) * LANES + j]


@njit(parallel=True, cache=True, error_model="numpy")
def pixel_kernel(
    photos: Photos,
    nodes: Nodes,
    picture: Picture,
    spread: Spread,
    rounds: int,
    limits: Limits,
    maps: Maps,
    done: np.ndarray,
) -> None:
    """Solve and finish the mask's pixels between safe nodes; (n,) `done` marks them.

    A cell has few pixels, nine where nodes are three apart: lanes are filled from one cell to the
    next of a row.
    """
    patterns, width = photos.bits.shape[0], nodes.table.shape[1]
    height, across = picture.mask.shape
    step = nodes.step
    state = 6 * patterns + width
    results = state + OF_STATE * patterns
    for r in prange(nodes.safe.shape[0]):
        ws = np.zeros((results + RESULTS) * LANES, np.float32)
        given = np.zeros(GIVEN, np.float32)
        corners, shares = np.zeros((LANES, 4), np.int64), np.zeros((LANES, 4), np.float32)
        saturation = np.zeros(LANES, np.float32)
        usable = np.zeros(LANES, np.bool_)
        at, near = np.zeros(LANES, np.int64), np.zeros(LANES, np.uint8)
        begin = (nodes.top + r) * step
        end = min(height, begin + step)
        first = picture.first[begin:end].copy()
        filled = 0
        for c in range(nodes.safe.shape[1]):
            beyond = min(across, (c + 1) * step)
            safe = nodes.safe[r, c]
            for y in range(begin, end):
                for x in range(c * step, beyond):
                    if not picture.mask[y, x]:
                        continue
                    number = first[y - begin]
                    first[y - begin] += 1
                    if not safe:
                        continue
                    down = np.float32(y - begin) / np.float32(step)
                    right = np.float32(x - c * step) / np.float32(step)
                    for i in range(2):
                        for j in range(2):
                            corners[filled, 2 * i + j] = width * nodes.number[r + i, c + j]
                            share = (down if i else 1 - down) * (right if j else 1 - right)
                            shares[filled, 2 * i + j] = share
                    usable[filled], saturation[filled] = read_pixel(photos, y, x, ws, filled)
                    at[filled], near[filled] = number, picture.inside[y, x]
                    filled += 1
                    if filled == LANES:
                        _solve_and_finish(
                            nodes.table, nodes.widest2, ws, corners, shares, usable, saturation,
                            at, near, filled, patterns, rounds, spread, limits, given, maps, done,
                        )  # fmt: skip
                        filled = 0
        if filled:
            _solve_and_finish(
                nodes.table, nodes.widest2, ws, corners, shares, usable, saturation,
                at, near, filled, patterns, rounds, spread, limits, given, maps, done,
            )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _solve_and_finish(
    table: np.ndarray, widest2: float, ws: np.ndarray, corners: np.ndarray, shares: np.ndarray,
    usable: np.ndarray, saturation: np.ndarray, at: np.ndarray, near: np.ndarray, filled: int,
    patterns: int, rounds: int, spread: Spread, limits: Limits, given: np.ndarray, maps: Maps,
    done: np.ndarray,
) -> None:  # fmt: skip
    """Solve the pixels that wait in lanes of `ws`, and write their maps."""
    node = 6 * patterns
    place = node + OF_PATTERN * patterns
    state = node + table.shape[1]
    results = state + OF_STATE * patterns
    _mixed(table, corners, shares, ws, node)
    solve_eight(
        ws, np.int64(0), node, state, place + TURN, results, patterns, rounds,
        spread.read2, spread.shot2, spread.model2, spread.shade2, spread.kept, widest2,
    )  # fmt: skip
    for j in range(filled):
        # A lane that is not sound may hold NaN, of which nothing is above 0.
        holds = ws[(results + 13) * LANES + j] > 0
        if usable[j] and not holds:
            continue
        _give(ws, place, results, j, given)
        given[finish.SATURATION] = saturation[j]
        given[finish.USABLE] = usable[j]
        given[finish.INSIDE] = np.float32(near[j]) / np.float32(4)
        finish_pixel(given, at[j], limits, maps)
        done[at[j]] = True
