"""The finest relief as geometry: the mesh displaced so that it has the specular normals' detail.

After [Nehab2005], on the mesh: specular normals hold the skin's finest relief, but in the large
they are as wrong as any photometric normal. So only their slopes in what is smaller than `below_mm`
are taken, beyond those that the mesh has already; a displacement along the mesh's own normals that
has these slopes is sought by least squares, kept small.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import cv2
import numpy as np
from scipy import sparse

from lightstage.formats.mesh import Mesh, edge_counts, vertex_normals
from lightstage.rig import Camera
from processing.displacement import curved_middles, heights_of_steps
from processing.rays import MeshRays
from processing.splitting import split
from processing.vectors import unit

MOST_SPLITS = 4
LEAST_COSINE = 0.25
"""A camera that sees the surface under a smaller one does not show its relief."""
STEEPEST = 1.0
"""Slopes of relief are cut there: 45 degrees."""


@dataclasses.dataclass(frozen=True)
class NormalView:
    """What one camera knows of the surface's directions.

    Attributes:
        camera: with its distortion.
        normals: (h, w, 3) unit, world; anything where `trust` is 0.
        trust: (h, w) 0..1.
    """

    camera: Camera
    normals: np.ndarray
    trust: np.ndarray


@dataclasses.dataclass(frozen=True)
class Detailed:
    """A mesh with relief.

    Attributes:
        mesh: finer than what it came from, mm.
        height_mm: (v,) how far each vertex was moved along the normal of the mesh it came from.
        known: (v,) bool, whether any camera showed its relief.
    """

    mesh: Mesh
    height_mm: np.ndarray
    known: np.ndarray


def displaced(
    mesh: Mesh, views: Sequence[NormalView], edge_mm: float, below_mm: float, offset_mm: float = 0.1
) -> Detailed:
    """Split a mesh finely and give it the relief that normals show.

    Args:
        mesh: triangles, mm, world, oriented outward.
        views: each camera's specular normals.
        edge_mm: mean length of the result's edges, at most (or after four splits).
        below_mm: relief smaller than this comes from the normals.
        offset_mm: rays to the cameras start this far off the mesh.
    """
    triangles = mesh.triangles().astype(np.int64)
    vertices = np.asarray(mesh.vertices, float)
    rays = MeshRays(vertices, triangles)
    normals = vertex_normals(vertices, triangles)
    coarse_mm = mean_mm = _mean_edge(vertices, triangles)
    coarse, _ = edge_counts(triangles)
    halfway = []
    for _ in range(MOST_SPLITS):
        if mean_mm <= edge_mm:
            break
        triangles, ends = split(triangles, len(vertices))
        halfway.append(ends)
        vertices = np.concatenate([vertices, curved_middles(vertices, normals, ends)])
        normals = unit(np.concatenate([normals, normals[ends].mean(axis=1)]))
        mean_mm /= 2
    seen_normals, known = normals_at(vertices, normals, rays, views, offset_mm)
    edges, _ = edge_counts(triangles)
    slopes = slopes_beyond(seen_normals, normals, known)
    slopes = small_part(slopes, known, halfway, coarse, below_mm / coarse_mm)
    slopes -= np.einsum("vk,vk->v", slopes, normals)[:, None] * normals
    height = heights(vertices, slopes, known, edges, (mean_mm / below_mm) ** 2)
    moved = vertices + height[:, None] * normals
    return Detailed(Mesh(moved, triangles.astype(np.int32)), height, known)


def normals_at(
    vertices: np.ndarray,
    normals: np.ndarray,
    rays: MeshRays,
    views: Sequence[NormalView],
    offset_mm: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Vertices' directions by the views: means by trust and by how squarely each is seen.

    Args:
        vertices: (v, 3) mm.
        normals: (v, 3) unit, the mesh's own.
        rays: the mesh.
        views: of each camera.
        offset_mm: see `displaced`.

    Returns:
        (v, 3) unit, the mesh's own where nothing is known; (v,) bool.
    """
    total, weights = np.zeros_like(vertices), np.zeros(len(vertices))
    for view in views:
        toward = view.camera.centre_mm - vertices
        cosine = np.einsum("vk,vk->v", unit(toward), normals)
        some = np.flatnonzero(cosine > LEAST_COSINE)
        free = rays.visible(
            vertices[some], normals[some], view.camera.centre_mm[None], offset_mm=offset_mm
        )[:, 0]
        some = some[np.asarray(free, bool)]
        pixels, _ = view.camera.project(vertices[some])
        trust = np.where(np.isfinite(view.normals).all(axis=2), view.trust, 0).astype(np.float32)
        weighted = np.where(trust[..., None] > 0, view.normals * trust[..., None], 0)
        x, y = (pixels.T - 0.5).astype(np.float32)
        layers = [
            _sampled(np.ascontiguousarray(layer, np.float32), x, y)
            for layer in (*weighted.transpose(2, 0, 1), trust)
        ]
        squarely = cosine[some] ** 2
        total[some] += squarely[:, None] * np.stack(layers[:3], axis=1)
        weights[some] += squarely * layers[3]
    length = np.linalg.norm(total, axis=1)
    known = (weights > 1e-3) & (length > 0.5 * weights)
    # Where views contradict each other their mean is short.
    return np.where(known[:, None], total / np.maximum(length, 1e-12)[:, None], normals), known


def slopes_beyond(seen_normals: np.ndarray, normals: np.ndarray, known: np.ndarray) -> np.ndarray:
    """(v, 3) gradients of the height along `normals` that would turn them into `seen_normals`.

    A surface x + h n has a normal along n - grad h, as far as it bends little.
    """
    along = np.einsum("vk,vk->v", seen_normals, normals)
    slopes = normals - seen_normals / np.maximum(along, 1e-3)[:, None]
    steep = np.linalg.norm(slopes, axis=1)
    slopes *= (np.minimum(steep, STEEPEST) / np.maximum(steep, 1e-12))[:, None]
    return np.where((known & (along > 0.1))[:, None], slopes, 0.0)


def small_part(
    slopes: np.ndarray,
    known: np.ndarray,
    halfway: Sequence[np.ndarray],
    edges: np.ndarray,
    sigma_edges: float,
) -> np.ndarray:
    """Slopes (v, 3) less their mean over a neighbourhood, which holds what is large.

    The mean is taken on the mesh before it was split, whose vertices are the first ones: what is
    large needs no finer one.

    Args:
        slopes: (v, 3), 0 where not known.
        known: (v,) bool; others do not count.
        halfway: of each split (m, 2), between which vertices the new ones are.
        edges: (e, 2) of the unsplit mesh.
        sigma_edges: of the Gaussian, in mean lengths of its edges.
    """
    value = np.column_stack([slopes, known.astype(float)])
    for ends in reversed(halfway):
        kept = value[: len(value) - len(ends)].copy()
        for end in ends.T:
            for k in range(4):
                kept[:, k] += np.bincount(end, 0.5 * value[len(kept) :, k], len(kept))
        value = kept
    count = len(value)
    ones = np.ones(len(edges))
    ways = sparse.coo_array((ones, (edges[:, 0], edges[:, 1])), (count, count))
    graph = (ways + ways.T).tocsr()
    degree = np.maximum(np.asarray(graph.sum(axis=1)).ravel(), 1)
    # One round halfway to the neighbours' mean spreads by a quarter of an edge squared an axis.
    for _ in range(max(1, round(4 * sigma_edges**2))):
        value = 0.5 * value + 0.5 * (graph @ value) / degree[:, None]
    mean = value[:, :3] / np.maximum(value[:, 3:], 1e-6)
    for ends in halfway:
        mean = np.concatenate([mean, mean[ends].mean(axis=1)])
    return np.where(known[:, None], slopes - mean, 0.0)


def heights(
    vertices: np.ndarray,
    slopes: np.ndarray,
    known: np.ndarray,
    edges: np.ndarray,
    weight: float,
) -> np.ndarray:
    """The height h with sum over edges (h' - h - step)^2 + weight * sum h^2 least.

    Args:
        vertices: (v, 3) mm.
        slopes: (v, 3) gradients.
        known: (v,) bool; an edge counts where both its ends are.
        edges: (e, 2).
        weight: of staying, above 0.

    Returns:
        (v,) mm.
    """
    used = edges[known[edges].all(axis=1)]
    first, second = used.T
    step = np.einsum(
        "ek,ek->e", 0.5 * (slopes[first] + slopes[second]), vertices[second] - vertices[first]
    )
    return heights_of_steps(len(vertices), used, step, weight)


def _sampled(layer: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(n,) bilinear samples; 0 outside. OpenCV takes maps of less than 32768 a side."""
    out = np.zeros(len(x), np.float32)
    for first in range(0, len(x), 32000):
        part = slice(first, first + 32000)
        out[part] = cv2.remap(
            layer, x[None, part], y[None, part], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT
        )[0]
    return out


def _mean_edge(vertices: np.ndarray, triangles: np.ndarray) -> float:
    ends = vertices[edge_counts(triangles)[0]]
    return float(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).mean()) if len(ends) else 0.0
