"""Triangles that a deformation folded over or pushed through each other."""

from __future__ import annotations

import numpy as np

from lightstage.formats.mesh import directed_edges
from processing import late_open3d as open3d
from processing.laplacian import neighbour_mean
from processing.registration.target import Target

FOLD_COS = -0.5
"""Neighbours whose normals are more than 120 degrees apart make a fold."""
ON_SCAN_MM = 1.0
"""A triangle whose middle is this near the scan is on it."""
FEATHER = (0.3, 0.1)
"""What the first ring of vertices around a fault takes of its mending, and the second."""


def folded_triangles(rest: np.ndarray, vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Triangles that a deformation folded over or collapsed.

    A triangle counts when it makes a fold with a neighbour that was none at rest, or has less than
    a thousandth of its area at rest.

    Args:
        rest: (n, 3) the undeformed mesh.
        vertices: (n, 3) the deformed mesh.
        triangles: (t, 3).

    Returns:
        (t,) bool; of a fold's two triangles the one that turned more against its surroundings.
    """
    normal_rest, area_rest = _normals(rest, triangles)
    normal, area = _normals(vertices, triangles)
    pairs = edge_pairs(triangles)
    a, b = pairs.T
    before = np.einsum("pk,pk->p", normal_rest[a], normal_rest[b])
    after = np.einsum("pk,pk->p", normal[a], normal[b])
    fold = (after < FOLD_COS) & (before >= FOLD_COS)
    around = np.zeros_like(normal)
    for axis in range(3):
        weighted = area * normal[:, axis]
        corner = np.bincount(triangles.ravel(), np.repeat(weighted, 3), minlength=len(rest))
        around[:, axis] = corner[triangles].sum(axis=1) - 3 * weighted
    agreement = np.einsum("tk,tk->t", around, normal)
    worse = np.where(agreement[a] < agreement[b], a, b)
    out = np.zeros(len(triangles), bool)
    out[worse[fold]] = True
    out |= (area < 1e-3 * area_rest) & (area_rest > 0)
    return out


def edge_pairs(triangles: np.ndarray) -> np.ndarray:
    """(p, 2) pairs of triangles that share an edge (edges of exactly two triangles)."""
    edges = np.sort(directed_edges(triangles), axis=1)
    key = edges[:, 0] * (int(triangles.max()) + 1) + edges[:, 1]
    order = np.argsort(key, kind="stable")
    _, first, times = np.unique(key[order], return_index=True, return_counts=True)
    starts = first[times == 2]
    return np.stack([order[starts] // 3, order[starts + 1] // 3], axis=1)


def grown(chosen: np.ndarray, triangles: np.ndarray, rings: int) -> np.ndarray:
    """(n,) bool vertices grown by so many rings of neighbours."""
    out = chosen.copy()
    for _ in range(rings):
        out[triangles[out[triangles].any(axis=1)]] = True
    return out


def feathered(chosen: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(n,) float: 1 at chosen vertices, and the shares of `FEATHER` at the rings around them."""
    share = chosen.astype(float)
    for less in FEATHER:
        ring = grown(share > 0, triangles, 1) & (share == 0)
        share[ring] = less
    return share


def crossing_triangles(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Triangles that an edge of the mesh pierces, edges that share a vertex with them aside.

    Two triangles in general position cross exactly when an edge of one pierces the other.

    Args:
        vertices: (n, 3) mm.
        triangles: (t, 3).

    Returns:
        (t,) bool: the pierced ones and those whose edges pierce.
    """
    scene = open3d.t.geometry.RaycastingScene()
    centre = vertices.mean(axis=0)
    scene.add_triangles(
        open3d.core.Tensor((vertices - centre).astype(np.float32)),
        open3d.core.Tensor(np.ascontiguousarray(triangles, np.uint32)),
    )
    start = triangles.reshape(-1)
    end = triangles[:, [1, 2, 0]].reshape(-1)
    rays = np.concatenate([vertices[start] - centre, vertices[end] - vertices[start]], axis=1)
    found = scene.list_intersections(open3d.core.Tensor(rays.astype(np.float32)))
    ray = found["ray_ids"].numpy().astype(np.int64)
    face = found["primitive_ids"].numpy().astype(np.int64)
    within = found["t_hit"].numpy() <= 1
    touching = (triangles[face] == start[ray, None]) | (triangles[face] == end[ray, None])
    pierced = within & ~touching.any(axis=1)
    out = np.zeros(len(triangles), bool)
    out[face[pierced]] = True
    out[ray[pierced] // 3] = True
    return out


class Faults:
    """Where a deformation folded a mesh or made it cross itself."""

    def __init__(self, rest: np.ndarray, triangles: np.ndarray, target: Target | None = None):
        """Prepare.

        Args:
            rest: (n, 3) the undeformed mesh.
            triangles: (t, 3).
            target: the scan: a fold that is on it, both sides outward, is the scan's own, as
                where lips meet.
        """
        self._rest, self._triangles, self._target = rest, triangles, target
        self._crossing_at_rest = crossing_triangles(rest, triangles)

    def folded(self, vertices: np.ndarray) -> np.ndarray:
        """(t,) bool: triangles that are folded over or collapsed."""
        out = folded_triangles(self._rest, vertices, self._triangles)
        some = np.flatnonzero(out)
        if self._target is not None and len(some):
            normal, area = _normals(vertices, self._triangles[some])
            near = self._target.closest(vertices[self._triangles[some]].mean(axis=1))
            outward = np.einsum("tk,tk->t", normal, near.normal) > 0
            out[some[outward & (near.distance_mm < ON_SCAN_MM) & (area > 0)]] = False
        return out

    def all(self, vertices: np.ndarray) -> np.ndarray:
        """(t,) bool: these, and those that cross others as they did not at rest."""
        crossing = crossing_triangles(vertices, self._triangles) & ~self._crossing_at_rest
        return np.asarray(self.folded(vertices) | crossing)


def against_scan(vertices: np.ndarray, triangles: np.ndarray, target: Target) -> np.ndarray:
    """(t,) bool: triangles that are on a scan and point into it, more than 90 degrees off.

    Thin places count too, where the scan's other side is nearest: closed lids, lips, an ear's rim.
    """
    normal, _ = _normals(vertices, triangles)
    near = target.closest(vertices[triangles].mean(axis=1))
    facing = np.einsum("tk,tk->t", normal, near.normal)
    return np.asarray((facing < 0) & (near.distance_mm < ON_SCAN_MM) & ~near.border)


def mend(
    faults: Faults, vertices: np.ndarray, triangles: np.ndarray, *, rounds: int
) -> tuple[np.ndarray, np.ndarray, int]:
    """Smooth the places where a deformation folded the mesh or made it cross itself.

    Each round moves the faulty triangles' vertices, and rings of neighbours that grow with the
    rounds, toward the mean of their neighbours: a Tutte-like embedding, which has no folds. The
    vertices around follow less and less, or what was smoothed would end in a step.

    Args:
        faults: of the mesh.
        vertices: (n, 3) the deformed one.
        triangles: (t, 3).
        rounds: at most.

    Returns:
        (n, 3) mended vertices, (t,) bool what is still at fault, and how many were before.
    """
    faulty = faults.all(vertices)
    before = int(faulty.sum())
    trial, trial_faulty = vertices, faulty
    mean = neighbour_mean(triangles, len(vertices))
    for turn in range(rounds):
        if not trial_faulty.any():
            break
        share = feathered(
            grown(corners_of(trial_faulty, triangles, len(vertices)), triangles, turn // 3),
            triangles,
        )[:, None]
        for _ in range(10):
            trial = trial + 0.5 * share * (mean @ trial - trial)
        trial_faulty = faults.all(trial)
        if trial_faulty.sum() < faulty.sum():
            vertices, faulty = trial, trial_faulty
    return vertices, faulty, before


def corners_of(chosen: np.ndarray, triangles: np.ndarray, count: int) -> np.ndarray:
    """(count,) bool: the vertices of some triangles, (t,) bool."""
    out = np.zeros(count, bool)
    out[triangles[chosen]] = True
    return out


def _normals(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    corners = vertices[triangles]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(cross, axis=1)
    normal = np.divide(cross, length[:, None], out=np.zeros_like(cross), where=length[:, None] > 0)
    return normal, length / 2
