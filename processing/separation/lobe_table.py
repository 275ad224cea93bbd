"""Skin's mirror lobe under each pattern, tabulated by the direction that is mirrored.

Far from the lights what a lobe gives depends on the direction r that the surface mirrors into the
camera, and hardly on how the view is inclined beside it. So the sum over all lights is made once
for a grid of r and of lobe widths, and each pixel looks it up.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numba import njit, prange

from processing.lighting.lights import PatternLights, no_shadows, octahedral_normals
from processing.lighting.lobe import transport

SIDE = 96
ALONG_VIEW = 1e-3
"""A mirrored direction this near to straight away from the camera has no facet."""


@dataclasses.dataclass(frozen=True)
class LobeTable:
    """What a lobe of specular albedo 1 gives.

    Attributes:
        roughness: (M,) Beckmann's m, ascending, at least two.
        values: (M, (SIDE + 2)^2, P) float32 at the octahedral grid of mirrored directions, with the
            cells beyond its edges around it.
    """

    roughness: np.ndarray
    values: np.ndarray


def lobe_table(lights: PatternLights, view: np.ndarray, roughness: tuple[float, ...]) -> LobeTable:
    """The lobe at the stage's centre as a camera there sees it.

    Args:
        lights: of P patterns.
        view: (3,) toward the camera, the middle of its views.
        roughness: M widths, ascending.
    """
    mirrored = octahedral_normals(SIDE)
    half = mirrored + view / np.linalg.norm(view)
    length = np.linalg.norm(half, axis=1, keepdims=True)
    known = length > ALONG_VIEW
    normals = np.where(known, half / np.where(known, length, 1), 0)
    count = len(normals)
    views = np.broadcast_to(view / np.linalg.norm(view), (count, 3))
    sky = no_shadows(count, lights)
    layers = [transport(lights, np.zeros((count, 3)), normals, views, m, sky)[1] for m in roughness]
    return LobeTable(np.array(roughness), np.stack(layers)[:, _with_border()])


def _with_border() -> np.ndarray:
    """((SIDE + 2)^2,) cells of the grid and those across its edges, which fold onto themselves."""
    i, j = np.meshgrid(np.arange(-1, SIDE + 1), np.arange(-1, SIDE + 1), indexing="ij")
    for _ in range(2):
        over = (i < 0) | (i >= SIDE)
        i, j = np.clip(i, 0, SIDE - 1), np.where(over, SIDE - 1 - j, j)
        i, j = j, i
    return np.asarray((i * SIDE + j).ravel())


def table_lobe(
    table: LobeTable, normals: np.ndarray, views: np.ndarray, roughness: np.ndarray | float
) -> np.ndarray:
    """B_k of pixels by the table.

    Args:
        table: of P patterns.
        normals: (n, 3) unit; 0 where there is none, whose lobe is 0.
        views: (n, 3) unit, toward the camera.
        roughness: Beckmann's m, one or (n,).

    Returns:
        (n, P) float32.
    """
    count = len(normals)
    out = np.zeros((count, table.values.shape[2]), np.float32)
    _look_up(
        table.values,
        table.roughness,
        np.ascontiguousarray(normals, np.float64),
        np.ascontiguousarray(views, np.float64),
        np.full(count, roughness, np.float64),
        out,
    )
    return out


@njit(cache=True)
def width_place(grid: np.ndarray, m: float) -> tuple[int, float]:
    """Layer of a (k,) grid of lobe widths below m, and part of the way to the next."""
    layer = 0
    while layer < len(grid) - 2 and m > grid[layer + 1]:
        layer += 1
    return layer, min(max((m - grid[layer]) / (grid[layer + 1] - grid[layer]), 0.0), 1.0)


@njit(cache=True)
def lobe_at(
    values: np.ndarray, layer: int, part: float, x: float, y: float, z: float, out: np.ndarray
) -> None:
    """Fill (P,) `out` with the lobe of a mirrored direction, bilinear in the octahedral grid."""
    total = abs(x) + abs(y) + abs(z)
    if not (total > 0 and total < math.inf):  # no number, or no direction
        out[:] = 0
        return
    u, v = x / total, y / total
    if z < 0:
        u, v = (
            (1 - abs(v)) * (1.0 if u >= 0 else -1.0),
            (1 - abs(u)) * (1.0 if v >= 0 else -1.0),
        )
    row, column = (u + 1) / 2 * SIDE + 0.5, (v + 1) / 2 * SIDE + 0.5
    i, j = min(SIDE, int(row)), min(SIDE, int(column))
    down, across = row - i, column - j
    cell = i * (SIDE + 2) + j
    for k in range(len(out)):
        out[k] = 0
    for m in range(2):
        share = part if m == 1 else 1 - part
        if share == 0:
            continue
        layer_values = values[layer + m]
        a, b = share * (1 - down) * (1 - across), share * (1 - down) * across
        c, d = share * down * (1 - across), share * down * across
        for k in range(len(out)):
            out[k] += (
                a * layer_values[cell, k]
                + b * layer_values[cell + 1, k]
                + c * layer_values[cell + SIDE + 2, k]
                + d * layer_values[cell + SIDE + 3, k]
            )


@njit(parallel=True, cache=True)
def _look_up(
    values: np.ndarray,
    grid: np.ndarray,
    normals: np.ndarray,
    views: np.ndarray,
    roughness: np.ndarray,
    out: np.ndarray,
) -> None:
    for i in prange(len(normals)):
        n, v = normals[i], views[i]
        facing = n[0] * v[0] + n[1] * v[1] + n[2] * v[2]
        if not facing > 0:
            continue
        layer, part = width_place(grid, roughness[i])
        lobe_at(
            values,
            layer,
            part,
            2 * facing * n[0] - v[0],
            2 * facing * n[1] - v[1],
            2 * facing * n[2] - v[2],
            out[i],
        )
