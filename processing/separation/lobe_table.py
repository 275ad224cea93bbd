"""Skin's mirror lobe under each pattern, tabulated by the direction that is mirrored.

What a lobe gives depends on the direction r that the surface mirrors into the camera. So the sum
over all lights is made once, at the stage's centre for one view, for a grid of r and of widths,
and each pixel looks it up: at the place of the lamps' sphere that it mirrors from where it is, and
times what facets mirror and leave unmasked at its own angle, over the same at the table's.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit, prange

from processing.lighting.facets import unmasked
from processing.lighting.lights import PatternLights, no_shadows, octahedral_normals
from processing.lighting.lobe import FRESNEL_STEPS, GRAZING, fresnel_table, transport

SIDE = 96
ALONG_VIEW = 1e-3
"""A mirrored direction this near to straight away from the camera has no facet."""


class LobeTable(NamedTuple):
    """What a lobe of specular albedo 1 gives at the stage's centre; the kernels take it as it is.

    Attributes:
        roughness: (M,) Beckmann's m, ascending, at least two.
        values: (M, (SIDE + 2)^2, P) float32 at the octahedral grid of mirrored directions, with the
            cells beyond its edges around it.
        toward: (3,) unit, the direction of the camera that it was made for.
        distance_mm: of the lamps from the centre, their median.
        rise: (FRESNEL_STEPS + 1,) Fresnel's rise by cosine, see `fresnel_table`.
    """

    roughness: np.ndarray
    values: np.ndarray
    toward: np.ndarray
    distance_mm: float
    rise: np.ndarray


def lobe_table(lights: PatternLights, view: np.ndarray, roughness: tuple[float, ...]) -> LobeTable:
    """The lobe at the stage's centre as a camera in one direction sees it.

    Args:
        lights: of P patterns.
        view: (3,) toward the camera, the middle of its views.
        roughness: M widths, ascending.
    """
    mirrored = octahedral_normals(SIDE)
    view = np.asarray(view, np.float64) / np.linalg.norm(view)
    half = mirrored + view
    length = np.linalg.norm(half, axis=1, keepdims=True)
    known = length > ALONG_VIEW
    normals = np.where(known, half / np.where(known, length, 1), 0)
    count = len(normals)
    views = np.broadcast_to(view, (count, 3))
    sky = no_shadows(count, lights)
    layers = [transport(lights, np.zeros((count, 3)), normals, views, m, sky)[1] for m in roughness]
    return LobeTable(
        np.array(roughness),
        np.stack(layers)[:, _with_border()],
        view,
        float(np.median(np.linalg.norm(lights.position_mm, axis=1))),
        fresnel_table(),
    )


def _with_border() -> np.ndarray:
    """((SIDE + 2)^2,) cells of the grid and those across its edges, which fold onto themselves."""
    i, j = np.meshgrid(np.arange(-1, SIDE + 1), np.arange(-1, SIDE + 1), indexing="ij")
    for _ in range(2):
        over = (i < 0) | (i >= SIDE)
        i, j = np.clip(i, 0, SIDE - 1), np.where(over, SIDE - 1 - j, j)
        i, j = j, i
    return np.asarray((i * SIDE + j).ravel())


def table_lobe(
    table: LobeTable,
    points_mm: np.ndarray,
    normals: np.ndarray,
    views: np.ndarray,
    roughness: np.ndarray | float,
) -> np.ndarray:
    """B_k of pixels by the table.

    Args:
        table: of P patterns.
        points_mm: (n, 3) places of the pixels; 0 for the centre, also where they are not known.
        normals: (n, 3) unit; 0 where there is none, whose lobe is 0.
        views: (n, 3) unit, toward the camera.
        roughness: Beckmann's m, one or (n,).

    Returns:
        (n, P) float32.
    """
    count = len(normals)
    out = np.zeros((count, table.values.shape[2]), np.float32)
    _look_up(
        table,
        np.ascontiguousarray(points_mm, np.float64),
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
def mirrored_to(
    table: LobeTable, place: np.ndarray, n: np.ndarray, v: np.ndarray
) -> tuple[float, float, float]:
    """The direction from the centre of what a facet mirrors: where its ray meets the lamps' sphere.

    Args:
        table: whose lamps they are.
        place: (3,) mm.
        n: (3,) unit normal.
        v: (3,) unit, toward the camera.

    Returns:
        x, y and z, of any length.
    """
    facing = n[0] * v[0] + n[1] * v[1] + n[2] * v[2]
    x, y, z = 2 * facing * n[0] - v[0], 2 * facing * n[1] - v[1], 2 * facing * n[2] - v[2]
    along = place[0] * x + place[1] * y + place[2] * z
    beyond = along * along + table.distance_mm**2
    beyond -= place[0] ** 2 + place[1] ** 2 + place[2] ** 2
    if not beyond > 0:  # outside of the sphere
        return x, y, z
    far = math.sqrt(beyond) - along
    return place[0] + far * x, place[1] + far * y, place[2] + far * z


@njit(cache=True)
def gain_over(table: LobeTable, m: float, facing: float, x: float, y: float, z: float) -> float:
    """How much more facets mirror at one angle than at that of the table.

    Args:
        table: the table.
        m: the lobe's width.
        facing: cosine between normal and view.
        x, y, z: see `mirrored_to`.

    Returns:
        The factor; 0 of no finite direction.
    """
    length = math.sqrt(x * x + y * y + z * z)
    if not (length > 0 and length < math.inf):
        return 0.0
    cosine = (x * table.toward[0] + y * table.toward[1] + z * table.toward[2]) / length
    return _shown(table.rise, m, facing) / _shown(table.rise, m, math.sqrt(0.5 + 0.5 * cosine))


@njit(cache=True)
def _shown(rise: np.ndarray, m: float, facing: float) -> float:
    """What facets mirror and leave unmasked where light and view are at one angle, to a factor."""
    facing = min(max(facing, GRAZING), 1.0)
    below = min(int(facing * FRESNEL_STEPS), FRESNEL_STEPS - 1)
    rest = facing * FRESNEL_STEPS - below
    open_share = unmasked(facing, m * math.sqrt(1 - facing * facing), False)
    return (rise[below] * (1 - rest) + rise[below + 1] * rest) * open_share * open_share


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
    table: LobeTable,
    points: np.ndarray,
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
        layer, part = width_place(table.roughness, roughness[i])
        x, y, z = mirrored_to(table, points[i], n, v)
        lobe_at(table.values, layer, part, x, y, z, out[i])
        gain = gain_over(table, roughness[i], facing, x, y, z)
        for k in range(out.shape[1]):
            out[i, k] *= gain
