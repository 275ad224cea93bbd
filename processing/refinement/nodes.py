"""The nodes that light is interpolated between: which there are, and what is known at each."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import cv2
import numpy as np
from numba import njit, prange

from lightstage.rig import Camera
from processing.lighting.lights import Shadows
from processing.refinement.config import RefineConfig
from processing.refinement.finish import facing
from processing.refinement.joint import Place, Scattered, lamps_of
from processing.refinement.joint_kernels import Solved
from processing.refinement.node_light import (
    MIDDLE,
    NORMAL,
    OF_GRID,
    OF_PATTERN,
    PRIOR,
    ROUGHNESS,
    SPECULAR,
    TERMS,
    WIDEST_TAN,
    grid_kernel,
    node_kernel,
    table_of,
    terms,
    turns,
)
from processing.refinement.node_pixels import Nodes
from processing.refinement.scene import Scene, View, place_of
from processing.surface import Sight, see

SMOOTH_PIXELS = 1.0
"""Sigma, in the grid's pixels, over which found normals are averaged to those of the nodes."""
MOST_BEND = float(np.cos(np.radians(20)))
"""Between nodes whose normals differ by more light is not interpolated."""
BAND_NODES = 150_000
"""Nodes whose light is held at a time, about."""


@dataclasses.dataclass(frozen=True)
class GridKnows:
    """What a grid's n pixels give all of a view's.

    Attributes:
        view: the grid.
        found: its pixels.
        around: light that wanders to them.
        roughness, specular: (n,) of them.
        prior: (n, 3) mean albedo of each one's neighbourhood.
    """

    view: View
    found: Solved
    around: Scattered
    roughness: np.ndarray
    specular: np.ndarray
    prior: np.ndarray


@dataclasses.dataclass(frozen=True)
class GridLight:
    """How the light of a grid's pixels bends with the normal.

    Attributes:
        number: (h, w) int32 row of `table`, -1 where there is none.
        table: see `node_light.grid_kernel`.
        axis: (3, 3) float32 toward the camera, right and up, see `node_light.across`.
    """

    number: np.ndarray
    table: np.ndarray
    axis: np.ndarray


def step_px(px_per_mm: float, config: RefineConfig) -> int:
    """Pixels between nodes; 1 where each pixel's own light is gathered."""
    return max(1, int(config.light_step_mm * px_per_mm))


def grid_light(scene: Scene, camera: Camera, knows: GridKnows) -> GridLight:
    """Gather light for several normals at the pixels of a grid."""
    sight, found = knows.view.sight, knows.found
    good = np.einsum("nk,nk->n", found.normal, found.normal) > 0.5
    toward, right = -camera.cam_from_world[2, :3], camera.cam_from_world[0, :3]
    axis = np.stack([toward, right, np.cross(toward, right)]).astype(np.float32)
    count, patterns = len(good), len(scene.lights.patterns)
    first = patterns * OF_PATTERN
    table = np.zeros((count, first + OF_GRID), np.float32)
    table[:, :first].reshape(count, patterns, OF_PATTERN)[:, :, 2 * TERMS + 3 :] = knows.around.rest
    for at, values in (
        (NORMAL, found.normal), (SPECULAR, knows.specular[:, None]),
        (MIDDLE, averaged(found.normal, sight, good)), (PRIOR, knows.prior),
        (ROUGHNESS, knows.roughness[:, None]),
    ):  # fmt: skip
        table[:, first + at : first + at + values.shape[1]] = values
    place, turn = place_of(scene, knows.view), turns()
    grid_kernel(
        place.points_mm, place.views, place.shadows.corners, place.shadows.weights,
        lamps_of(scene.lights, place, scene.interface), axis, turn,
        np.linalg.pinv(terms(turn)).astype(np.float32), good, table,
    )  # fmt: skip
    number = np.full(sight.mask.shape, -1, np.int32)
    number[sight.mask] = np.where(good, np.arange(count), -1)
    return GridLight(number, table, axis)


def averaged(normals: np.ndarray, sight: Sight, solved: np.ndarray) -> np.ndarray:
    """(n, 3) unit normals averaged over neighbouring pixels; the mesh's where none is solved."""
    image = np.zeros((*sight.mask.shape, 3), np.float32)
    image[sight.mask] = normals * solved[:, None]
    border = cv2.BORDER_CONSTANT
    near = cv2.GaussianBlur(image, (0, 0), SMOOTH_PIXELS, borderType=border)[sight.mask]
    length = np.linalg.norm(near, axis=1, keepdims=True)
    return np.where(length > 1e-3, near / np.maximum(length, 1e-3), sight.normals)


@dataclasses.dataclass(frozen=True)
class NodeSites:
    """The nodes of a view.

    Attributes:
        sight: of the nodes.
        number: (h, w) int32 of the nodes, -1 where there is none.
        safe: (h - 1, w - 1) bool: between these four light may be interpolated.
    """

    sight: Sight
    number: np.ndarray
    safe: np.ndarray


def node_sites(
    scene: Scene, camera: Camera, foreground: np.ndarray, light: GridLight, knows: GridKnows,
    config: RefineConfig,
) -> NodeSites:  # fmt: skip
    """Cast the nodes' rays in a (h, w) foreground, and find the cells on one smooth piece of skin.

    Raises nothing where no cell does.
    """
    step = step_px(knows.view.px_per_mm * knows.view.sight.step, config)
    sight = see(scene.surface, camera, foreground, step)
    number = np.full(sight.mask.shape, -1, np.int32)
    number[sight.mask] = np.arange(len(sight.normals))
    rows, columns = (step * places for places in np.nonzero(sight.mask))
    grid = knows.view.sight.step
    # The grid's pixels around a node must all have light.
    known_nodes = cv2.erode(
        (light.number >= 0).astype(np.uint8), np.ones((2, 2), np.uint8), anchor=(0, 0)
    )
    known = known_nodes[
        np.minimum(rows // grid, known_nodes.shape[0] - 1),
        np.minimum(columns // grid, known_nodes.shape[1] - 1),
    ]
    return NodeSites(sight, number, safe_cells(number, known > 0, sight, config.depth_step_mm))


def safe_cells(number: np.ndarray, good: np.ndarray, sight: Sight, step_mm: float) -> np.ndarray:
    """(h - 1, w - 1) bool: cells whose four nodes are good and are on one smooth piece of skin.

    Args:
        number: (h, w) of the nodes, -1 where there is none.
        good: (n,) bool.
        sight: of the nodes.
        step_mm: depths that differ by more are two pieces.
    """
    safe = np.zeros((number.shape[0] - 1, number.shape[1] - 1), bool)
    _mark_safe(number, good, sight.normals, sight.depth_mm, np.float32(step_mm), safe)
    return safe


@njit(parallel=True, cache=True, error_model="numpy")
def _mark_safe(
    number: np.ndarray, good: np.ndarray, normals: np.ndarray, depth_mm: np.ndarray,
    step_mm: float, safe: np.ndarray,
) -> None:  # fmt: skip
    """Fill in what `safe_cells` returns; arguments as there."""
    for row in prange(safe.shape[0]):
        y = np.int64(row)
        four = np.zeros(4, np.int64)
        for x in range(safe.shape[1]):
            known = True
            nearest, farthest = np.float32(np.inf), np.float32(-np.inf)
            for k in range(4):
                four[k] = number[y + k // 2, x + k % 2]
                known = known and four[k] >= 0 and good[four[k]]
                depth = depth_mm[y + k // 2, x + k % 2]
                nearest, farthest = min(nearest, depth), max(farthest, depth)
            if not (known and farthest - nearest < step_mm):
                continue
            for i in range(3):
                for j in range(i + 1, 4):
                    a, b = normals[four[i]], normals[four[j]]
                    known = known and a[0] * b[0] + a[1] * b[1] + a[2] * b[2] > MOST_BEND
            safe[y, x] = known


def banded_nodes(
    scene: Scene, sites: NodeSites, light: GridLight, knows: GridKnows
) -> Iterator[Nodes]:
    """The nodes of some rows after the other, with their light: all at once take much memory."""
    sight, number = sites.sight, sites.number
    per_row = np.count_nonzero(sight.mask, axis=1)
    above = np.concatenate([[0], np.cumsum(per_row)])
    top = 0
    while top < len(number) - 1:
        bottom = int(np.searchsorted(above, above[top] + BAND_NODES))
        bottom = min(max(bottom, top + 1), len(number) - 1)
        some = slice(above[top], above[bottom + 1])
        rows, columns = (sight.step * at for at in np.nonzero(sight.mask[top : bottom + 1]))
        shadows = sight.shadows
        place = Place(
            sight.points_mm[some],
            sight.views[some],
            Shadows(shadows.corners[some], shadows.weights[some], shadows.visible),
            scene.from_skin,
            knows.view.mirrored,
            knows.view.diffuse,
        )
        mesh = sight.normals[some]
        others = np.column_stack([facing(mesh, place.views), sight.occlusion[some]])
        table = table_of(len(mesh), len(scene.lights.patterns))
        good = np.zeros(len(mesh), bool)
        node_kernel(
            rows + top * sight.step, columns, knows.view.sight.step, light.number, light.table,
            place.points_mm, place.views, mesh, others.astype(np.float32),
            place.shadows.corners, place.shadows.weights,
            lamps_of(scene.lights, place, scene.interface), light.axis, good, table,
        )  # fmt: skip
        local = number[top : bottom + 1] - above[top]
        local[number[top : bottom + 1] < 0] = -1
        there = (local >= 0) & good[local]
        safe = sites.safe[top:bottom] & there[:-1, :-1] & there[:-1, 1:]
        safe &= there[1:, :-1] & there[1:, 1:]
        yield Nodes(local.astype(np.int32), safe, table, sight.step, top, WIDEST_TAN**2)
        top = bottom
