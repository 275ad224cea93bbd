"""Light at nodes: how each pattern's light turns with the normal, as polynomials of its turn.

About a node's normal N, with two directions T and U across it, a normal is N + t T + u U over its
length. E times that length, which for a fixed horizon is linear in (t, u), and the mirror lobe B
are polynomials of the second degree. Shadows change within tenths of a millimetre, the way light
bends with the normal does not: so light is gathered for a ring of normals at the pixels of a coarse
grid, where least squares give what the polynomials hold beyond light's own slopes; nodes between
these need light and its slopes alone, gathered once.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from processing.lanes import LANES
from processing.refinement.joint_light import Lamps, gather

TERMS = 6
"""1, t, u, t t, t u, u u."""
OF_PATTERN = 18
"""Numbers of a node for each pattern: terms of E and of B, light from other skin in R G B, and
what wanders here from neighbours."""
NORMAL, SPECULAR, MIDDLE, PRIOR, ROUGHNESS, OF_GRID = 0, 3, 4, 7, 10, 11
"""Places, after the patterns', of what a grid's pixel gives the nodes around: its normal, specular
albedo, the mean normal nearby, the neighbours' albedo, and roughness."""
TURN, GLOSS, FRAME, OTHERS, OF_PLACE = 0, 2, 3, 12, 24
"""Places, after the patterns', of what a node gives its pixels: t and u to start from, specular
albedo, N T U, and then mesh normal, facing, neighbours' albedo, roughness, ambient occlusion, and
the direction to the camera."""
RING = 7
"""Normals around a pixel's own: the fewest that determine all terms and their error."""
RING_TAN = 0.08
"""Tangent of the ring's angle, 4.6 deg."""
WIDEST_TAN = 0.2
"""Turns beyond this tangent, 11 deg, are not interpolated."""
NARROWEST_LOBE = np.float32(0.12)
"""A lobe of smaller m changes within the ring by more than a polynomial holds: each pixel sums its
own light there."""
AWAY = -0.5
"""Directions across normals turn smoothly unless these point away from the camera."""


def table_of(nodes: int, patterns: int) -> np.ndarray:
    """(nodes, P OF_PATTERN + OF_PLACE and more) float32 of zeros: rows of whole vectors."""
    width = patterns * OF_PATTERN + OF_PLACE
    return np.zeros((nodes, -(-width // LANES) * LANES), np.float32)


def turns() -> np.ndarray:
    """(1 + RING, 2) float32 the places (t, u) that light is gathered for; the first is (0, 0)."""
    angle = 2 * np.pi * np.arange(RING) / RING
    ring = RING_TAN * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.concatenate([np.zeros((1, 2)), ring]).astype(np.float32)


def terms(turn: np.ndarray) -> np.ndarray:
    """(n, TERMS) of (n, 2) places."""
    t, u = turn.T.astype(float)
    return np.stack([np.ones_like(t), t, u, t * t, t * u, u * u], axis=1)


@njit(cache=True, error_model="numpy")
def across(normal: np.ndarray, axis: np.ndarray, out: np.ndarray) -> bool:
    """Fill out (2, 3) with the directions across a unit normal that turn as little as it does.

    They are the last two rows of (3, 3) unit `axis`, turned the shortest way that takes its first
    row to the normal; false where that is far.
    """
    a, n = axis[0], normal
    along = a[0] * n[0] + a[1] * n[1] + a[2] * n[2]
    if not along > AWAY:
        return False
    x, y, z = a[1] * n[2] - a[2] * n[1], a[2] * n[0] - a[0] * n[2], a[0] * n[1] - a[1] * n[0]
    per = np.float32(1) / (np.float32(1) + along)
    for c in range(2):
        s = axis[1 + c]
        p, q, r = y * s[2] - z * s[1], z * s[0] - x * s[2], x * s[1] - y * s[0]
        out[c, 0] = s[0] + p + per * (y * r - z * q)
        out[c, 1] = s[1] + q + per * (z * p - x * r)
        out[c, 2] = s[2] + r + per * (x * q - y * p)
    return True


@njit(cache=True, error_model="numpy")
def _sloped(
    light: np.ndarray, k: int, sides: np.ndarray, sign: float, row: np.ndarray, at: int
) -> None:
    """Add a pattern's light and its slopes along both sides to a node's first terms."""
    row[at] += sign * light[k, 0]
    row[at + TERMS] += sign * light[k, 4]
    for c in range(2):
        for x in range(3):
            row[at + 1 + c] += sign * light[k, 1 + x] * sides[c, x]
            row[at + TERMS + 1 + c] += sign * light[k, 5 + x] * sides[c, x]


@njit(parallel=True, cache=True, error_model="numpy")
def grid_kernel(
    points: np.ndarray,
    views: np.ndarray,
    corners: np.ndarray,
    weights: np.ndarray,
    lamps: Lamps,
    axis: np.ndarray,
    turn: np.ndarray,
    fit: np.ndarray,
    good: np.ndarray,
    out: np.ndarray,
) -> None:
    """Fill in what the polynomials of a grid's pixels hold beyond light and its slopes.

    Args:
        points: (n, 3) float32, mm, world.
        views: (n, 3) float32, unit, toward the camera.
        corners, weights: (n, 3) int32 and float32, of `Shadows`.
        lamps: the stage.
        axis: (3, 3) float32, see `across`.
        turn: (s, 2) float32 of `turns`.
        fit: (TERMS, s) float32, least squares.
        good: (n,) bool, cleared where it is not determined.
        out: (n, P OF_PATTERN + OF_GRID) float32, all but the polynomials filled in.
    """
    patterns = lamps.levels.shape[1]
    for i in prange(len(points)):
        own = out[i, patterns * OF_PATTERN :]
        sides = np.zeros((2, 3), np.float32)
        good[i] = good[i] and own[ROUGHNESS] > 0 and across(own[MIDDLE : MIDDLE + 3], axis, sides)
        if not good[i]:
            continue
        light = np.zeros((patterns, 12), np.float32)
        n = np.zeros(3, np.float32)
        for s in range(len(turn)):
            square = np.float32(0)
            for x in range(3):
                n[x] = own[MIDDLE + x] + turn[s, 0] * sides[0, x] + turn[s, 1] * sides[1, x]
                square += n[x] * n[x]
            length = np.float32(math.sqrt(square))
            for x in range(3):
                n[x] /= length
            gather(points[i], n, views[i], own[ROUGHNESS], corners[i], weights[i], lamps, light)
            for k in range(patterns):
                at = k * OF_PATTERN
                if s == 0:
                    _sloped(light, k, sides, np.float32(-1), out[i], at)
                for j in range(TERMS):
                    out[i, at + j] += fit[j, s] * light[k, 0] * length
                    out[i, at + TERMS + j] += fit[j, s] * light[k, 4]


@njit(parallel=True, cache=True, error_model="numpy")
def node_kernel(
    rows: np.ndarray,
    columns: np.ndarray,
    step: int,
    number: np.ndarray,
    table: np.ndarray,
    points: np.ndarray,
    views: np.ndarray,
    mesh: np.ndarray,
    others: np.ndarray,
    corners: np.ndarray,
    weights: np.ndarray,
    lamps: Lamps,
    axis: np.ndarray,
    good: np.ndarray,
    out: np.ndarray,
) -> None:
    """Fill in nodes from the grid around them and from light gathered at each.

    Args:
        rows, columns: (n,) pixels of the nodes.
        step: pixels between the grid's.
        number: (h, w) int32 row of `table` for the grid's pixels, -1 where there is none.
        table: (m, P OF_PATTERN + OF_GRID) float32 of `grid_kernel`.
        points: (n, 3) float32, mm, world.
        views: (n, 3) float32, unit, toward the camera.
        mesh: (n, 3) float32, the mesh's unit normals.
        others: (n, 2) float32 facing and ambient occlusion.
        corners, weights: (n, 3) int32 and float32, of `Shadows`.
        lamps: the stage.
        axis: (3, 3) float32, see `across`.
        good: (n,) bool, set where a node has light.
        out: (n, P OF_PATTERN + OF_PLACE or more) float32.
    """
    patterns = lamps.levels.shape[1]
    first = patterns * OF_PATTERN
    for i in prange(len(points)):
        top, left = rows[i] // step, columns[i] // step
        down = np.float32(rows[i] - top * step) / np.float32(step)
        right = np.float32(columns[i] - left * step) / np.float32(step)
        shares, around = np.zeros(4, np.float32), np.zeros(4, np.int64)
        total, some = np.float32(0), -1
        for k in range(4):
            y, x = k // 2, k % 2
            # A whole number beside them would make all products here float64.
            share = (down if y else np.float32(1) - down) * (right if x else np.float32(1) - right)
            inside = top + y < number.shape[0] and left + x < number.shape[1]
            if share == 0 or not inside or number[top + y, left + x] < 0:
                continue
            some = number[top + y, left + x]
            shares[k], around[k] = share, some
            total += share
        if not total > 1e-3:
            continue
        for k in range(4):
            if shares[k] == 0:
                around[k] = some
            shares[k] /= total
        near = np.empty(table.shape[1], np.float32)
        a, b, c, d = around[0], around[1], around[2], around[3]
        wa, wb, wc, wd = shares[0], shares[1], shares[2], shares[3]
        for j in range(len(near)):
            upper = wa * table[a, j] + wb * table[b, j]
            near[j] = upper + (wc * table[c, j] + wd * table[d, j])
        own, row = near[first:], out[i]
        n = own[MIDDLE : MIDDLE + 3].copy()
        n /= np.float32(math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]))
        sides = np.zeros((2, 3), np.float32)
        if not across(n, axis, sides):
            continue
        light = np.zeros((patterns, 12), np.float32)
        gather(points[i], n, views[i], own[ROUGHNESS], corners[i], weights[i], lamps, light)
        for j in range(first):
            row[j] = near[j]
        for k in range(patterns):
            at = k * OF_PATTERN
            _sloped(light, k, sides, np.float32(1), row, at)
            for c in range(3):
                row[at + 2 * TERMS + c] = light[k, 9 + c]
        along = np.float32(0)
        to = row[first:]
        for x in range(3):
            along += own[NORMAL + x] * n[x]
            to[TURN] += own[NORMAL + x] * sides[0, x]
            to[TURN + 1] += own[NORMAL + x] * sides[1, x]
            to[FRAME + x] = n[x]
            to[FRAME + 3 + x], to[FRAME + 6 + x] = sides[0, x], sides[1, x]
            to[OTHERS + x], to[OTHERS + 4 + x] = mesh[i, x], own[PRIOR + x]
            to[OTHERS + 9 + x] = views[i, x]
        to[TURN] /= along
        to[TURN + 1] /= along
        to[GLOSS] = own[SPECULAR]
        to[OTHERS + 3], to[OTHERS + 8] = others[i, 0], others[i, 1]
        to[OTHERS + 7] = own[ROUGHNESS]
        turn2 = to[TURN] * to[TURN] + to[TURN + 1] * to[TURN + 1]
        holds = own[ROUGHNESS] >= NARROWEST_LOBE
        good[i] = holds and along > 0.5 and turn2 < WIDEST_TAN**2
