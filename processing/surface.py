"""The mesh under the stage's lights: what its vertices see, and what a camera sees of it."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import open3d
from scipy import sparse

from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.mesh import Mesh, vertex_normals
from lightstage.rig import Camera
from processing.lights import PatternLights, Shadows
from processing.rays import MeshRays, interpolate

MOST_ROUNDS = 100
SKY_MM = 1e5
"""Distance of the directions that ambient occlusion asks for: far beyond the stage."""


@dataclasses.dataclass(frozen=True)
class LitSurface:
    """A mesh and what its V vertices receive.

    Attributes:
        vertices: (V, 3) mm.
        triangles: (t, 3).
        normals: (V, 3) smooth unit normals.
        rays: the mesh, ready for ray queries.
        visible: (V, L) uint8, lights that each vertex sees.
        occlusion: (V,) 1 = open sky, cosine-weighted.
        average: (V, V) sparse, one round of averaging over neighbours.
        edge_mm: mean length of the mesh's edges.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    normals: np.ndarray
    rays: MeshRays
    visible: np.ndarray
    occlusion: np.ndarray
    average: sparse.csr_array
    edge_mm: float

    def rounds(self, sigma_mm: float) -> int:
        """Rounds of averaging that make a Gaussian of this sigma."""
        return averaging_rounds(sigma_mm, self.edge_mm)


@dataclasses.dataclass(frozen=True)
class Sight:
    """What one camera sees of the mesh, at the n pixels of `mask` in row order.

    Attributes:
        mask: (h, w) bool, foreground that the mesh covers.
        points_mm: (n, 3).
        normals: (n, 3) smooth mesh normals, unit.
        views: (n, 3) unit, toward the camera.
        occlusion: (n,).
        shadows: lights that each pixel sees.
        depth_mm: (h, w) distance from the camera, infinite outside `mask`.
    """

    mask: np.ndarray
    points_mm: np.ndarray
    normals: np.ndarray
    views: np.ndarray
    occlusion: np.ndarray
    shadows: Shadows
    depth_mm: np.ndarray


def lit_surface(
    mesh: Mesh,
    lights: PatternLights,
    *,
    offset_mm: float,
    smoothing_mm: float,
    directions: int,
    most_faces: int,
    progress: ProgressCallback = quiet,
) -> LitSurface:
    """Cast each vertex's rays to the lights and to the sky, once.

    Shadows and open sky vary over millimetres, so a denser mesh is thinned first.

    Args:
        mesh: mm, world.
        lights: of P patterns.
        offset_mm: how far off the mesh rays start, beyond its own roughness.
        smoothing_mm: over which the normals are averaged.
        directions: of the sky, spread evenly over the sphere.
        most_faces: a mesh of more triangles is thinned to as many.
        progress: counts rays' vertices.
    """
    vertices, triangles = thinned(mesh, most_faces)
    average = _average(triangles, len(vertices))
    normals = vertex_normals(vertices, triangles)
    sides = vertices[triangles[:, 0]] - vertices[triangles[:, 1]]
    edge_mm = float(np.linalg.norm(sides, axis=1).mean())
    for _ in range(averaging_rounds(smoothing_mm, edge_mm)):
        normals = average @ normals
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, length, out=np.zeros_like(normals), where=length > 1e-9)
    rays = MeshRays(vertices, triangles)
    seen = rays.visible(
        vertices, normals, lights.position_mm, offset_mm=offset_mm, progress=progress
    ).astype(np.uint8)
    sky = fibonacci_sphere(directions)
    open_sky = rays.visible(vertices, normals, sky * SKY_MM, offset_mm=offset_mm)
    cosine = np.maximum(normals.astype(np.float32) @ sky.T.astype(np.float32), 0)
    total = cosine.sum(axis=1)
    lit = np.einsum("vd,vd->v", cosine, open_sky)
    occlusion = np.where(total > 0, lit / np.where(total > 0, total, 1), 1)
    return LitSurface(vertices, triangles, normals, rays, seen, occlusion, average, edge_mm)


def see(surface: LitSurface, camera: Camera, foreground: np.ndarray) -> Sight:
    """What a camera sees of the mesh where its photographs show something.

    Args:
        surface: the mesh.
        camera: the view.
        foreground: (h, w) bool.
    """
    hits = surface.rays.cast_camera(camera, foreground)
    found = hits.face >= 0
    hits = dataclasses.replace(
        hits,
        face=hits.face[found],
        barycentric=hits.barycentric[found],
        distance_mm=hits.distance_mm[found],
    )
    corners = np.ascontiguousarray(surface.triangles[hits.face], np.int32)
    weights = np.ascontiguousarray(hits.barycentric, np.float32)
    at_vertices = np.column_stack([surface.normals, surface.occlusion]).astype(np.float32)
    at_pixels = interpolate(at_vertices, surface.triangles, hits)
    normals = at_pixels[:, :3]
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    origin, rays = camera.pixel_rays()
    directions = rays.reshape(-1, 3)[found]
    mask = found.reshape(foreground.shape)
    depth = np.full(foreground.shape, np.inf, np.float32)
    depth[mask] = hits.distance_mm
    return Sight(
        mask=mask,
        points_mm=origin + directions * hits.distance_mm[:, None],
        normals=normals,
        views=-directions,
        occlusion=at_pixels[:, 3],
        shadows=Shadows(corners, weights, surface.visible),
        depth_mm=depth,
    )


def thinned(mesh: Mesh, most_faces: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a mesh, thinned by quadric edge collapse where it has too many.

    Source: [Garland1997].
    """
    triangles = mesh.triangles()
    if len(triangles) <= most_faces:
        return mesh.vertices, triangles
    shape = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(mesh.vertices), open3d.utility.Vector3iVector(triangles)
    ).simplify_quadric_decimation(most_faces)
    return np.asarray(shape.vertices), np.asarray(shape.triangles, np.int32)


def depth_edges(depth_mm: np.ndarray, step_mm: float) -> np.ndarray:
    """(h, w) bool: pixels whose 3 x 3 neighbourhood spans more depth than a step, or no surface."""
    finite = np.where(np.isfinite(depth_mm), depth_mm, np.float32(1e6)).astype(np.float32)
    kernel = np.ones((3, 3), np.uint8)
    return np.asarray(cv2.dilate(finite, kernel) - cv2.erode(finite, kernel) > step_mm)


def averaging_rounds(sigma_mm: float, edge_mm: float) -> int:
    """Rounds of averaging over a mesh's neighbours that spread like a Gaussian of this sigma.

    One round over a vertex and its six neighbours at distance e has the variance 3/7 e^2 an axis.
    """
    return min(MOST_ROUNDS, round(sigma_mm**2 / (3 / 7 * max(edge_mm, 1e-6) ** 2)))


def fibonacci_sphere(count: int) -> np.ndarray:
    """(count, 3) unit directions spread evenly over the sphere.

    Source: [Gonzalez2010].
    """
    index = np.arange(count) + 0.5
    z = 1 - 2 * index / count
    turn = np.pi * (1 + np.sqrt(5)) * index
    radius = np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=1)


def _average(triangles: np.ndarray, count: int) -> sparse.csr_array:
    """(count, count) sparse: the mean of a vertex and its neighbours."""
    rows = np.concatenate([triangles[:, [0, 1, 2]].ravel(), triangles[:, [1, 2, 0]].ravel()])
    columns = np.concatenate([triangles[:, [1, 2, 0]].ravel(), triangles[:, [0, 1, 2]].ravel()])
    ones = np.ones(len(rows))
    joined = sparse.csr_array((ones, (rows, columns)), shape=(count, count))
    joined.data[:] = 1
    joined = sparse.csr_array(joined + sparse.eye_array(count))
    return sparse.csr_array(sparse.diags_array(1 / joined.sum(axis=1)) @ joined)
