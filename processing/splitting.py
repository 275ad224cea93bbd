"""Triangles split in four, places in their parts, and meshes taken back to fewer triangles."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from lightstage.formats.mesh import Mesh, directed_edges
from processing import late_open3d as open3d


def split(triangles: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Split every triangle into four at the middles of its edges.

    Args:
        triangles: (t, 3) of `count` vertices.
        count: vertices that there are.

    Returns:
        (4 t, 3) triangles: at the first, second and third corner, and the one between; and (m, 2)
        the vertices whose middles the new vertices count, count + 1 .. are.
    """
    ends = directed_edges(triangles)
    keys, index = np.unique(ends.min(axis=1) * count + ends.max(axis=1), return_inverse=True)
    ab, bc, ca = (count + index.reshape(-1, 3)).T
    a, b, c = triangles.T
    parts = [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
    children = np.array(parts).transpose(2, 0, 1).reshape(-1, 3)
    return children, np.stack([keys // count, keys % count], axis=1)


def in_part(face: np.ndarray, weights: np.ndarray, times: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Of n places on split triangles, the (n,) parts that they are in and (n, 3) weights there.

    Args:
        face: (n,) triangles before the split.
        weights: (n, 3) barycentric, in these.
        times: how often they were split.
    """
    parts, inside = face.astype(np.int64), np.array(weights, np.float64, order="C")
    _move_to_parts(parts, inside, times)
    return parts, inside


@njit(parallel=True, cache=True)
def _move_to_parts(face: np.ndarray, weights: np.ndarray, times: int) -> None:
    """What `in_part` does, in place."""
    for i in prange(len(face)):
        part, a, b, c = face[i], weights[i, 0], weights[i, 1], weights[i, 2]
        for _ in range(times):
            part *= 4
            if max(a, b, c) < 0.5:
                a, b, c = 1 - 2 * c, 1 - 2 * a, 1 - 2 * b
                part += 3
            elif a >= b and a >= c:
                a, b, c = 2 * a - 1, 2 * b, 2 * c
            elif b >= c:
                a, b, c = 2 * a, 2 * b - 1, 2 * c
                part += 1
            else:
                a, b, c = 2 * a, 2 * b, 2 * c - 1
                part += 2
        face[i], weights[i, 0], weights[i, 1], weights[i, 2] = part, a, b, c


def unsplit(mesh: Mesh, least: int = 1) -> Mesh:
    """The mesh as it was before `split`; as it is where it never was split.

    Args:
        mesh: triangles, in the order in which `split` leaves them.
        least: triangles that are left, at least.
    """
    triangles = mesh.triangles()
    while len(triangles) % 4 == 0 and len(triangles) >= 4 * least:
        corner, second, third, between = triangles.reshape(-1, 4, 3).transpose(1, 0, 2)
        coarse = np.stack([corner[:, 0], second[:, 1], third[:, 2]], axis=1)
        count = int(coarse.max()) + 1
        ab, bc, ca = between.T
        middles = [corner[:, 1:] == np.stack([ab, ca], axis=1)]
        middles += [second[:, [0, 2]] == np.stack([ab, bc], axis=1)]
        middles += [third[:, :2] == np.stack([ca, bc], axis=1), between >= count]
        if not all(same.all() for same in middles):
            break
        triangles = coarse
    if len(triangles) == len(mesh.triangles()):
        return mesh
    return Mesh(mesh.vertices[: int(triangles.max()) + 1], np.ascontiguousarray(triangles))


def thinned(mesh: Mesh, most_faces: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a mesh, thinned by quadric edge collapse where it has too many.

    Source: [Garland1997].
    """
    # To collapse the edges of a mesh that was split takes ten times as long as of what it was.
    mesh = unsplit(mesh, most_faces)
    triangles = mesh.triangles()
    if len(triangles) <= most_faces:
        return mesh.vertices, triangles
    shape = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(mesh.vertices), open3d.utility.Vector3iVector(triangles)
    ).simplify_quadric_decimation(most_faces)
    return np.asarray(shape.vertices), np.asarray(shape.triangles, np.int32)
