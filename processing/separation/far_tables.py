"""The far field tabulated: what a normal receives of every pattern, and what a mirror would see.

A sum over hundreds of lights for each of millions of pixels is the same few thousand sums over and
over: it is made once for every cell of an octahedral grid of directions, and looked up.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numba import njit, prange

from processing.lanes import LANES
from processing.lighting.facets import STEEPEST, unmasked
from processing.lighting.interface import Interface, let_through, row_of
from processing.lighting.lights import OCTAHEDRON, PatternLights, octahedral_normals
from processing.lighting.lobe import fresnel_table

ROWS = 12
"""Rows of the diffuse table."""
CELLS = OCTAHEDRON
"""Cells a side of the octahedral grid of normals."""
LOBE_SIDE = 96
"""Cells a side of the octahedral grid of mirror directions, whose corners hold the lobe."""


@dataclasses.dataclass(frozen=True)
class FarTables:
    """Tables over octahedral grids, patterns in G groups of LANES, the lanes of no pattern 0.

    Attributes:
        diffuse: (cells, G, ROWS, LANES) float32 of every cell of normals. Rows 0 to 2: the
            pseudo-inverse of the irradiance vectors, rho n from a signal. Rows 3 to 5: the
            irradiance vectors at the sphere's centre. Rows 6 to 11: how the irradiance n . g
            changes with the place, n' J p, J symmetric (xx yy zz xy xz yz) and in 1/mm.
        lobe: ((LOBE_SIDE + 1)^2, G, LANES) the mirror lobe toward one camera times the cosine
            toward it, over the mirrored directions at the corners of the grid's cells.
        leaving: (COSINES + 1,) of the light that scattered in the skin, what leaves it toward a
            camera at cosines 0 to 1, over the mean of all directions.
        radius_mm: of the lights, mean.
    """

    diffuse: np.ndarray
    lobe: np.ndarray
    leaving: np.ndarray
    radius_mm: float


def far_tables(
    lights: PatternLights, view: np.ndarray, roughness: float, interface: Interface
) -> FarTables:
    """Tabulate a stage's lights for one camera.

    Args:
        lights: of P patterns.
        view: (3,) unit, from the sphere's centre toward the camera.
        roughness: Beckmann's m of the lobe and the interface.
        interface: that light passes on its way into the diffuse layer.

    Returns:
        FarTables; the solver is 0 where a cell's patterns do not determine a normal.
    """
    directions = (lights.position_mm / lights.radius_mm[:, None]).astype(np.float32)
    groups = -(-len(lights.patterns) // LANES)
    strength = np.zeros((groups * LANES, len(directions)), np.float32)
    strength[: len(lights.patterns)] = lights.strength
    normals = octahedral_normals().astype(np.float32)
    vectors = np.zeros((len(normals), 3, len(strength)), np.float32)
    drift = np.zeros((len(normals), 6, len(strength)), np.float32)
    solver = np.zeros_like(vectors)
    by_light = np.ascontiguousarray(strength.T)
    near = (1 / lights.radius_mm).astype(np.float32)
    _diffuse(normals, directions, by_light, near, interface.table, roughness, vectors, drift)
    some = slice(0, len(lights.patterns))
    stray = lights.stray
    vectors[:, :, some] += np.einsum("pij,nj->nip", stray[:, :, :3], normals, optimize=True)
    vectors[:, :, some] += stray[:, :, 3].T
    vectors[:, :, some] *= lights.diffuse_share
    drift[:, :, some] *= lights.diffuse_share
    _invert(vectors, solver)
    corners = octahedral_corners(LOBE_SIDE).astype(np.float32)
    lobe = np.zeros((len(corners), len(strength)), np.float32)
    fresnel = fresnel_table().astype(np.float32)
    _mirror(corners, view.astype(np.float32), directions, by_light, roughness, fresnel, lobe)
    lobe[:, some] *= lights.mirror_share
    rows = np.concatenate([solver, vectors, drift], axis=1)
    diffuse = np.ascontiguousarray(rows.reshape(-1, ROWS, groups, LANES).swapaxes(1, 2))
    row, part = row_of(roughness, len(interface.table))
    let = interface.table[row] * (1 - part) + interface.table[row + 1] * part
    mean = interface.mean[row] * (1 - part) + interface.mean[row + 1] * part
    return FarTables(
        diffuse,
        lobe.reshape(-1, groups, LANES),
        (let / mean).astype(np.float32),
        float(lights.radius_mm.mean()),
    )


def octahedral_corners(side: int) -> np.ndarray:
    """((side + 1)^2, 3) unit directions at the corners of the octahedral grid's cells.

    Source: [Cigolle2014].
    """
    line = np.arange(side + 1) / side * 2 - 1
    u, v = (grid.ravel() for grid in np.meshgrid(line, line, indexing="ij"))
    z = 1 - np.abs(u) - np.abs(v)
    below = z < 0
    x = np.where(below, (1 - np.abs(v)) * np.where(u >= 0, 1, -1), u)
    y = np.where(below, (1 - np.abs(u)) * np.where(v >= 0, 1, -1), v)
    corners = np.stack([x, y, z], axis=1)
    return np.asarray(corners / np.linalg.norm(corners, axis=1, keepdims=True))


@njit(parallel=True, cache=True)
def _diffuse(
    normals: np.ndarray,
    directions: np.ndarray,
    strength: np.ndarray,
    near: np.ndarray,
    through: np.ndarray,
    roughness: float,
    vectors: np.ndarray,
    drift: np.ndarray,
) -> None:
    """G = sum w T l, and J = sum w T (3 l l' - 1) / radius: the first order of l / d^2 in p."""
    row, part = row_of(roughness, len(through))
    for i in prange(len(normals)):
        for j in range(len(directions)):
            x, y, z = directions[j, 0], directions[j, 1], directions[j, 2]
            nl = normals[i, 0] * x + normals[i, 1] * y + normals[i, 2] * z
            if nl <= 0:
                continue
            enters = np.float32(let_through(through, row, part, nl))
            steep = 3 * near[j]
            xx, yy, zz = steep * x * x - near[j], steep * y * y - near[j], steep * z * z - near[j]
            xy, xz, yz = steep * x * y, steep * x * z, steep * y * z
            for k in range(strength.shape[1]):
                w = strength[j, k] * enters
                vectors[i, 0, k] += w * x
                vectors[i, 1, k] += w * y
                vectors[i, 2, k] += w * z
                drift[i, 0, k] += w * xx
                drift[i, 1, k] += w * yy
                drift[i, 2, k] += w * zz
                drift[i, 3, k] += w * xy
                drift[i, 4, k] += w * xz
                drift[i, 5, k] += w * yz


@njit(parallel=True, cache=True)
def _invert(vectors: np.ndarray, solver: np.ndarray) -> None:
    """(G'G)^-1 G' of every cell, 0 where ill-posed (as in processing.normals)."""
    for i in prange(len(vectors)):
        g = vectors[i]
        a = np.zeros((3, 3))
        for j in range(3):
            for m in range(3):
                for k in range(g.shape[1]):
                    a[j, m] += g[j, k] * g[m, k]
        c = np.empty((3, 3))
        for j in range(3):
            for m in range(3):
                j1, j2, m1, m2 = (j + 1) % 3, (j + 2) % 3, (m + 1) % 3, (m + 2) % 3
                c[j, m] = a[j1, m1] * a[j2, m2] - a[j1, m2] * a[j2, m1]
        det = a[0, 0] * c[0, 0] + a[0, 1] * c[0, 1] + a[0, 2] * c[0, 2]
        scale = (a[0, 0] + a[1, 1] + a[2, 2]) / 3
        if not det > 1e-4 * scale * scale * scale:
            continue
        for j in range(3):
            for k in range(g.shape[1]):
                total = c[j, 0] * g[0, k] + c[j, 1] * g[1, k] + c[j, 2] * g[2, k]
                solver[i, j, k] = total / det


@njit(cache=True)
def _one_side(cosine: float, roughness: float) -> float:
    return unmasked(cosine, roughness * math.sqrt(max(0.0, 1 - cosine * cosine)), False)


@njit(parallel=True, cache=True)
def _mirror(
    mirrored: np.ndarray,
    view: np.ndarray,
    directions: np.ndarray,
    strength: np.ndarray,
    roughness: float,
    table: np.ndarray,
    lobe: np.ndarray,
) -> None:
    """The lobe of `lighting.lobe`, times the cosine to the camera, of the normals between."""
    m2 = roughness * roughness
    steps = len(table) - 1
    for i in prange(len(mirrored)):
        nx, ny, nz = mirrored[i, 0] + view[0], mirrored[i, 1] + view[1], mirrored[i, 2] + view[2]
        length = math.sqrt(nx * nx + ny * ny + nz * nz)
        if length < 1e-3:  # the mirror faces along the camera's own ray: no normal does that
            continue
        nx, ny, nz = nx / length, ny / length, nz / length
        toward = _one_side(max(nx * view[0] + ny * view[1] + nz * view[2], 1e-3), roughness)
        for j in range(len(directions)):
            lx, ly, lz = directions[j, 0], directions[j, 1], directions[j, 2]
            nl = nx * lx + ny * ly + nz * lz
            if nl <= 0:
                continue
            hx, hy, hz = lx + view[0], ly + view[1], lz + view[2]
            length = math.sqrt(hx * hx + hy * hy + hz * hz)
            if length <= 0:
                continue
            nh = (nx * hx + ny * hy + nz * hz) / length
            nh2 = nh * nh
            if nh <= 0 or (1 - nh2) > STEEPEST * m2 * nh2:
                continue
            value = math.exp((nh2 - 1) / (nh2 * m2)) / (4 * m2 * nh2 * nh2)
            value *= toward * _one_side(nl, roughness)
            place = min(1.0, (view[0] * hx + view[1] * hy + view[2] * hz) / length) * steps
            below = min(steps - 1, int(place))
            rest = place - below
            value *= table[below] * (1 - rest) + table[below + 1] * rest
            for k in range(strength.shape[1]):
                lobe[i, k] += np.float32(value) * strength[j, k]
