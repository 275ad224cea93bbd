"""Oriented points to one mesh: screened Poisson surface, cut where nothing was seen."""

from __future__ import annotations

import dataclasses

import numpy as np

from lightstage.counting import counted
from lightstage.formats.mesh import Mesh, connected, edge_counts, vertex_normals
from processing import late_open3d as open3d
from processing.errors import ReconstructionError
from processing.reconstruction.config import ReconstructConfig
from processing.reconstruction.consistency import Points
from processing.reconstruction.settle import settled

SOME = 4
"""One of so many points is tested for the part of a mesh that rests on one view."""
MIN_POINTS = 500
"""Fewer points make no surface."""


@dataclasses.dataclass(frozen=True)
class Holes:
    """Boundary loops of a mesh.

    Attributes:
        outline_mm: length of the longest loop, the mesh's own outline (0 for a closed mesh).
        lengths_mm: lengths of all others, longest first.
    """

    outline_mm: float
    lengths_mm: tuple[float, ...]


def fuse(points: Points, config: ReconstructConfig) -> Mesh:
    """Fit a surface to oriented points [Kazhdan2013].

    Args:
        points: that several views agree on.
        config: cell width and trimming distance.

    Returns:
        One connected mesh, oriented outward; holes where no point is within `trim_mm` are kept.

    Raises:
        ReconstructionError: too few points.
    """
    if len(points.positions) < MIN_POINTS:
        raise ReconstructionError(
            "fusion",
            found=f"agreement of two views on {counted(len(points.positions), 'point')}",
            expected=f"at least {MIN_POINTS}",
            hint="Are the cameras' poses right, and do neighbouring views overlap?",
        )
    cloud = open3d.geometry.PointCloud(
        open3d.utility.Vector3dVector(points.positions.astype(float))
    )
    cloud.normals = open3d.utility.Vector3dVector(points.normals.astype(float))
    cloud = cloud.voxel_down_sample(0.5 * config.cell_mm)
    cloud.normalize_normals()
    with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
        # One thread: the solver's sums depend on the order in which threads finish.
        surface, _ = open3d.geometry.TriangleMesh.create_from_point_cloud_poisson(
            cloud, depth=0, width=config.cell_mm, n_threads=1
        )
    vertices = np.asarray(surface.vertices)
    triangles = np.asarray(surface.triangles).astype(np.int32)
    near = np.asarray(
        open3d.geometry.PointCloud(surface.vertices).compute_point_cloud_distance(cloud)
    )
    kept = triangles[(near < config.trim_mm)[triangles].all(axis=1)]
    mesh = compact(vertices, largest_component(kept, len(vertices)))
    mesh = oriented(mesh, np.asarray(cloud.points), np.asarray(cloud.normals))
    return settled(mesh, points.positions, points.normals, config.settle_mm)


def largest_component(triangles: np.ndarray, vertices: int) -> np.ndarray:
    """The (t, 3) triangles of the part, connected by shared vertices, that has most of them."""
    if not len(triangles):
        raise ReconstructionError(
            "fusion", found="a surface far from every point", expected="a mesh"
        )
    part = connected(triangles[:, [0, 1, 1, 2]].reshape(-1, 2), vertices)[triangles[:, 0]]
    return triangles[part == np.bincount(part).argmax()]


def compact(vertices: np.ndarray, triangles: np.ndarray) -> Mesh:
    """A mesh of (n, 3) vertices and (t, 3) triangles without vertices that no triangle uses."""
    used, faces = np.unique(triangles, return_inverse=True)
    return Mesh(vertices[used], faces.reshape(-1, 3).astype(np.int32))


def oriented(mesh: Mesh, positions: np.ndarray, normals: np.ndarray) -> Mesh:
    """The mesh with its triangles turned, all together, to the side of the nearest points' normals.

    Args:
        mesh: consistently oriented.
        positions, normals: (n, 3) oriented points on it.
    """
    from scipy.spatial import cKDTree

    some = np.arange(0, len(mesh.vertices), max(1, len(mesh.vertices) // 2000))
    nearest = cKDTree(positions).query(mesh.vertices[some])[1]
    own = vertex_normals(mesh.vertices, mesh.faces)[some]
    inward = np.einsum("nk,nk->n", own, normals[nearest]).sum() < 0
    return Mesh(mesh.vertices, mesh.faces[:, ::-1].copy()) if inward else mesh


def alone_share(mesh: Mesh, points: Points) -> float:
    """Share of a mesh's vertices whose nearest point no other view agrees on.

    Args:
        mesh: fused from the points.
        points: of which every SOME-th is tested.
    """
    from scipy.spatial import cKDTree

    lone = points.views < 1
    if not lone.any():
        return 0.0
    near = [
        cKDTree(points.positions[some][::SOME]).query(mesh.vertices)[0] for some in (lone, ~lone)
    ]
    return float(np.mean(near[0] < near[1]))


def boundary_loops(mesh: Mesh) -> Holes:
    """Lengths of the loops of edges that one triangle alone has."""
    edges, counts = edge_counts(mesh.faces)
    border = edges[counts == 1]
    if not len(border):
        return Holes(0.0, ())
    labels = connected(border, len(mesh.vertices))[border[:, 0]]
    length = np.linalg.norm(mesh.vertices[border[:, 0]] - mesh.vertices[border[:, 1]], axis=1)
    loops = np.bincount(labels, weights=length)
    ordered = np.sort(loops[loops > 0])[::-1]
    return Holes(float(ordered[0]), tuple(float(loop) for loop in ordered[1:]))
