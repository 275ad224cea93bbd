"""The mesh under the stage's lights: what its vertices see, and what a camera sees of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numba import njit, prange
from scipy import sparse

from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.mesh import Mesh, directed_edges, vertex_normals
from lightstage.rig import Camera
from processing.lighting.lights import PatternLights, Shadows
from processing.rays import MeshRays
from processing.splitting import in_part, split, thinned
from processing.vectors import unit

MOST_ROUNDS = 100
MOST_SPLITS = 4
BAND_PIXELS = 2_000_000
"""Pixels whose rays are held at once."""
SEEN_STEP = 3
SEEN_RAYS = 150_000
"""Every so many pixels a ray finds the triangles that a camera sees, and rarer in a picture that
would need more rays than this: what falls between them neighbours what was met."""
FAR_MM = np.float32(1e6)
"""The depth where there is no surface."""
SKY_MM = 1e5
"""Length of the rays of ambient occlusion: far beyond the stage."""


@dataclasses.dataclass(frozen=True)
class LitSurface:
    """A mesh, split finely enough to hold the edges of shadows, and what its V vertices receive.

    The first `coarse` vertices are the mesh's own; the others are halfway along its edges.

    Attributes:
        vertices: (V, 3) mm.
        triangles: (t, 3); a triangle's four parts stand together, so that the parts of triangle i
            of the mesh, split d times, are 4^d i to 4^d (i + 1) - 1.
        normals: (V, 3) smooth unit normals.
        coarse: number of vertices of the mesh.
        splits: how often triangles were split in four.
        rays: the mesh, ready for ray queries.
        visible: (V, L) uint8, lights that each vertex sees; of the vertices that split an edge only
            those that some camera sees were tested.
        occlusion: (V,) 1 = open sky, cosine-weighted.
        average: (V, V) sparse, one round of averaging over neighbours.
        edge_mm: mean length of the split mesh's edges.
        halfway: (m, 2) for each split, between which vertices the new ones are.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    normals: np.ndarray
    coarse: int
    splits: int
    rays: MeshRays
    visible: np.ndarray
    occlusion: np.ndarray
    average: sparse.csr_array
    edge_mm: float
    halfway: tuple[np.ndarray, ...]

    def at_all(self, values: np.ndarray) -> np.ndarray:
        """Values (coarse, ..) of the mesh's vertices as (V, ..) of all."""
        for edges in self.halfway:
            values = np.concatenate([values, (values[edges[:, 0]] + values[edges[:, 1]]) / 2])
        return values

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
        step: the pixels are every so many of every so many rows; `mask` and `depth_mm` hold these.
    """

    mask: np.ndarray
    points_mm: np.ndarray
    normals: np.ndarray
    views: np.ndarray
    occlusion: np.ndarray
    shadows: Shadows
    depth_mm: np.ndarray
    step: int = 1


def lit_surface(
    mesh: Mesh,
    lights: PatternLights,
    *,
    offset_mm: float,
    smoothing_mm: float,
    directions: int,
    most_faces: int,
    finest_mm: float = 1.2,
    seen_by: Sequence[tuple[Camera, np.ndarray]] | None = None,
    occluders: Mesh | None = None,
    progress: ProgressCallback = quiet,
) -> LitSurface:
    """Cast each vertex's rays to the lights and to the sky, once.

    Shadows and open sky vary over millimetres, so a denser mesh is thinned first, and a coarser one
    split where cameras see it.

    Args:
        mesh: mm, world.
        lights: of P patterns.
        offset_mm: how far off the mesh rays start, beyond its own roughness.
        smoothing_mm: over which the normals are averaged.
        directions: of the sky, spread evenly over the sphere.
        most_faces: a mesh of more triangles is thinned to as many.
        finest_mm: triangles are split until their edges are about so long.
        seen_by: cameras and their (h, w) bool foregrounds; None takes every vertex.
        occluders: what else hides lights and sky.
        progress: counts rays' vertices.
    """
    vertices, triangles = thinned(mesh, most_faces)
    average = _average(triangles, len(vertices))
    normals = vertex_normals(vertices, triangles)
    edge_mm = _edge_mm(vertices, triangles)
    for _ in range(averaging_rounds(smoothing_mm, edge_mm)):
        normals = average @ normals
    rays = MeshRays(vertices, triangles, occluders)
    normals = unit(normals, 1e-9)
    sky = fibonacci_sphere(directions)
    open_sky = rays.visible(vertices, normals, sky * SKY_MM, offset_mm=offset_mm)
    cosine = np.maximum(normals.astype(np.float32) @ sky.T.astype(np.float32), 0)
    total = cosine.sum(axis=1)
    lit = np.einsum("vd,vd->v", cosine, open_sky)
    occlusion = np.where(total > 0, lit / np.where(total > 0, total, 1), 1)
    coarse = len(vertices)
    seen_faces = np.ones(len(triangles), bool)
    if seen_by is not None:
        seen_faces = _faces_seen(rays, triangles, coarse, seen_by)
    splits = max(0, min(MOST_SPLITS, round(float(np.log2(max(edge_mm, 1e-6) / finest_mm)))))
    halfway = []
    for _ in range(splits):
        triangles, edges = split(triangles, len(vertices))
        halfway.append(edges)
        vertices, normals, occlusion = (
            np.concatenate([values, (values[edges[:, 0]] + values[edges[:, 1]]) / 2])
            for values in (vertices, normals, occlusion)
        )
    normals = unit(normals, 1e-9)
    needed = np.zeros(len(vertices), bool)
    needed[:coarse] = True
    needed[triangles[np.repeat(seen_faces, 4**splits)].ravel()] = True
    seen = np.zeros((len(vertices), len(lights.position_mm)), np.uint8)
    seen[needed] = rays.visible(
        vertices[needed],
        normals[needed],
        lights.position_mm,
        offset_mm=offset_mm,
        progress=progress,
    )
    return LitSurface(
        vertices=vertices,
        triangles=triangles,
        normals=normals,
        coarse=coarse,
        splits=splits,
        rays=rays,
        visible=seen,
        occlusion=occlusion,
        average=_average(triangles, len(vertices)) if splits else average,
        edge_mm=edge_mm / 2**splits,
        halfway=tuple(halfway),
    )


def _faces_seen(
    rays: MeshRays,
    triangles: np.ndarray,
    count: int,
    seen_by: Sequence[tuple[Camera, np.ndarray]],
) -> np.ndarray:
    """(t,) bool: triangles that some camera sees, and their neighbours."""
    touched = np.zeros(count, bool)
    for camera, foreground in seen_by:
        step = max(SEEN_STEP, int(np.sqrt(np.count_nonzero(foreground) / SEEN_RAYS)))
        some = np.nonzero(foreground[::step, ::step])
        face = rays.cast_pixels(_every(camera, step), *some)[0].face
        touched[triangles[np.unique(face[face >= 0])].ravel()] = True
    for _ in range(2):
        near = touched[triangles].any(axis=1)
        touched[triangles[near].ravel()] = True
    return np.asarray(touched[triangles].any(axis=1))


def see(surface: LitSurface, camera: Camera, foreground: np.ndarray, step: int = 1) -> Sight:
    """What a camera sees of the mesh where its photographs show something.

    Args:
        surface: the mesh.
        camera: the view.
        foreground: (h, w) bool.
        step: only every so many pixels of every so many rows.
    """
    camera, foreground = _every(camera, step), foreground[::step, ::step]
    rows, columns = np.nonzero(foreground)
    parts = [
        _see_pixels(surface, camera, rows[first:][:BAND_PIXELS], columns[first:][:BAND_PIXELS])
        for first in range(0, max(len(rows), 1), BAND_PIXELS)
    ]
    joined = {name: np.concatenate([part.pop(name) for part in parts]) for name in list(parts[0])}
    found = joined["found"]
    mask = np.zeros(foreground.shape, bool)
    mask[rows[found], columns[found]] = True
    depth = np.full(foreground.shape, np.inf, np.float32)
    depth[mask] = joined["distance_mm"]
    return Sight(
        mask=mask,
        points_mm=joined["points"],
        normals=joined["normals"],
        views=joined["views"],
        occlusion=joined["occlusion"],
        shadows=Shadows(joined["corners"], joined["weights"], surface.visible),
        depth_mm=depth,
        step=step,
    )


def depth_of(
    surface: LitSurface, camera: Camera, foreground: np.ndarray, band: int = BAND_PIXELS
) -> np.ndarray:
    """(h, w) float32 distance of the mesh at the pixels of a mask, mm; infinite elsewhere."""
    depth = np.full(foreground.shape, np.inf, np.float32)
    rows, columns = np.nonzero(foreground)
    for first in range(0, len(rows), band):
        some = rows[first:][:band], columns[first:][:band]
        depth[some] = surface.rays.cast_pixels(camera, *some)[0].distance_mm
    return depth


def _see_pixels(
    surface: LitSurface, camera: Camera, rows: np.ndarray, columns: np.ndarray
) -> dict[str, np.ndarray]:
    """The result of `see` for pixels that are few enough for their rays to be held at once."""
    hits, directions = surface.rays.cast_pixels(camera, rows, columns)
    found = hits.face >= 0
    distance_mm, directions = hits.distance_mm[found], directions[found]
    face, weights = in_part(hits.face[found], hits.barycentric[found], surface.splits)
    weights = weights.astype(np.float32)
    corners = np.ascontiguousarray(surface.triangles[face], np.int32)
    at_vertices = np.column_stack([surface.normals, surface.occlusion]).astype(np.float32)
    at_pixels = at_vertices_to(at_vertices, corners, weights)
    normals = at_pixels[:, :3]
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    return {
        "found": found,
        "points": (camera.centre_mm + directions * distance_mm[:, None]).astype(np.float32),
        "normals": normals,
        "views": -directions.astype(np.float32),
        "occlusion": at_pixels[:, 3],
        "corners": corners,
        "weights": weights,
        "distance_mm": distance_mm,
    }


def _every(camera: Camera, step: int) -> Camera:
    """The camera whose pixels are every so many of another one's."""
    return dataclasses.replace(
        camera,
        width_px=-(-camera.width_px // step),
        height_px=-(-camera.height_px // step),
        fx_px=camera.fx_px / step,
        fy_px=camera.fy_px / step,
        cx_px=(camera.cx_px - 0.5) / step + 0.5,
        cy_px=(camera.cy_px - 0.5) / step + 0.5,
    )


def at_vertices_to(values: np.ndarray, corners: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Values (V, ..) at vertices as those of n places with (n, 3) corners and weights."""
    kind = np.result_type(values, weights)
    flat = np.ascontiguousarray(values, kind).reshape(len(values), -1)
    out = np.empty((len(corners), flat.shape[1]), kind)
    _mix_corners(flat, corners, np.ascontiguousarray(weights, kind), out)
    return out.reshape(len(corners), *values.shape[1:])


@njit(parallel=True, cache=True)
def _mix_corners(
    values: np.ndarray, corners: np.ndarray, weights: np.ndarray, out: np.ndarray
) -> None:
    """Fill (n, k) with the sums of (V, k) values at (n, 3) corners times their weights."""
    for i in prange(len(corners)):
        for j in range(values.shape[1]):
            total = weights[i, 0] * values[corners[i, 0], j]
            total += weights[i, 1] * values[corners[i, 1], j]
            out[i, j] = total + weights[i, 2] * values[corners[i, 2], j]


def depth_edges(
    depth_mm: np.ndarray, step_mm: float, where: np.ndarray | None = None
) -> np.ndarray:
    """(h, w) bool: pixels beside a step of depth, or beside no surface.

    A step is what leaves the plane through the pixels on both sides, along rows, columns or
    diagonals: a slope is none, however many millimetres a pixel of it spans.

    Args:
        depth_mm: (h, w), infinite where there is no surface.
        step_mm: by how much twice its depth is off the sum of both sides'.
        where: (h, w) bool, pixels that may be marked; None for all.
    """
    steps = np.ones(depth_mm.shape, bool) if where is None else where.copy()
    _keep_steps(np.ascontiguousarray(depth_mm, np.float32), np.float32(step_mm), steps)
    return steps


@njit(cache=True, error_model="numpy", forceinline=True)
def _finite(depth_mm: np.ndarray, row: int, column: int) -> np.float32:
    """A pixel's depth, far away where there is none; beyond the border the border's."""
    y = min(max(row, 0), depth_mm.shape[0] - 1)
    x = min(max(column, 0), depth_mm.shape[1] - 1)
    own = depth_mm[y, x]
    return own if abs(own) < FAR_MM else FAR_MM


@njit(parallel=True, cache=True, error_model="numpy")
def _keep_steps(depth_mm: np.ndarray, step_mm: float, marked: np.ndarray) -> None:
    """Clear marked pixels whose depth is between that of neighbours on both sides."""
    for row in prange(depth_mm.shape[0]):
        # A parallel loop counts without a sign.
        y = np.int64(row)
        for x in range(depth_mm.shape[1]):
            if not marked[y, x]:
                continue
            twice, step = _finite(depth_mm, y, x), False
            twice += twice
            for dy, dx in ((0, 1), (1, 0), (1, 1), (-1, 1)):
                sides = _finite(depth_mm, y - dy, x - dx) + _finite(depth_mm, y + dy, x + dx)
                step = step or abs(sides - twice) > step_mm
            marked[y, x] = step


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


def _edge_mm(vertices: np.ndarray, triangles: np.ndarray) -> float:
    return float(
        np.linalg.norm(vertices[triangles[:, 0]] - vertices[triangles[:, 1]], axis=1).mean()
    )


def _average(triangles: np.ndarray, count: int) -> sparse.csr_array:
    """(count, count) sparse: the mean of a vertex and its neighbours."""
    first, second = directed_edges(triangles).T
    rows, columns = np.concatenate([first, second]), np.concatenate([second, first])
    ones = np.ones(len(rows))
    joined = sparse.csr_array((ones, (rows, columns)), shape=(count, count))
    joined.data[:] = 1
    joined = sparse.csr_array(joined + sparse.eye_array(count))
    average = sparse.csr_array(sparse.diags_array(1 / joined.sum(axis=1)) @ joined)
    # Half as many bytes to read in every round.
    average.indptr = average.indptr.astype(np.int32)
    average.indices = average.indices.astype(np.int32)
    return average
