"""The second round: depth again in finer pictures, on the planes of the first round's mesh.

The first round has slants from coarse normals alone, which shadows turn by ten degrees in hollows,
and uses pictures of half the size. The mesh gives better slants of patches, and its place to a
fraction of a pixel: what is left is the minimum of a parabola.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.mesh import Mesh, vertex_normals
from processing.rays import Hits, MeshRays, interpolate
from processing.reconstruction.config import ReconstructConfig
from processing.reconstruction.patches import NO_MATCH
from processing.reconstruction.stereo import make_stereo, patch_offsets
from processing.reconstruction.sweeps import polish, search
from processing.reconstruction.views import Level

REACH_PX = 5
"""Where the mesh rests on one view alone, or this view did not agree, so far is searched, px of
disparity, in patches twice as wide."""
DELTAS_PX = (0.5, 0.3)
"""Steps of the parabolas, px of disparity: a pixel moves by at most half of each."""


class Sighted(NamedTuple):
    """What one view sees of a mesh, n pixels.

    Attributes:
        rows, columns: (n,) of the pixels whose rays meet it, from outside.
        hits: n of them.
        inverse_depth: (h, w) float32 1/mm along the optical axis, 0 where it is not met.
        normals: (h, w, 3) float32 smooth unit normals, world; 0 where it is not met.
    """

    rows: np.ndarray
    columns: np.ndarray
    hits: Hits
    inverse_depth: np.ndarray
    normals: np.ndarray


def sighted(level: Level, mesh: Mesh, rays: MeshRays, normals: np.ndarray) -> list[Sighted]:
    """What all views see of a mesh.

    Args:
        level: whose pixels are computed, of the foreground alone.
        mesh: mm, world.
        rays: of the mesh.
        normals: (v, 3) of its vertices.
    """
    out = []
    for (fx, fy, cx, cy), pose, mask in zip(level.lenses, level.poses, level.masks, strict=True):
        rows, columns = np.nonzero(mask)
        local = np.stack(
            [(columns + 0.5 - cx) / fx, (rows + 0.5 - cy) / fy, np.ones(len(rows))], axis=1
        )
        length = np.linalg.norm(local, axis=1)
        toward = (local / length[:, None]) @ pose[:, :3]
        hits = rays.cast(-pose[:, :3].T @ pose[:, 3], toward)
        normal = interpolate(normals, mesh.faces, hits)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
        met = (hits.face >= 0) & (np.einsum("nk,nk->n", normal, toward) < 0)
        rows, columns = rows[met], columns[met]
        seen = Hits(hits.face[met], hits.barycentric[met], hits.distance_mm[met])
        inverse_depth = np.zeros(mask.shape, np.float32)
        inverse_depth[rows, columns] = length[met] / seen.distance_mm
        across = np.zeros((*mask.shape, 3), np.float32)
        across[rows, columns] = normal[met]
        out.append(Sighted(rows, columns, seen, inverse_depth, across))
    return out


def rays_of(mesh: Mesh, occluders: Mesh | None = None) -> tuple[MeshRays, np.ndarray]:
    """A mesh's rays, with what stops them before they meet it, and its vertices' normals."""
    rays = MeshRays(mesh.vertices, mesh.faces, occluders)
    return rays, vertex_normals(mesh.vertices, mesh.faces)


def look_again(
    fine: Level,
    seen: Sequence[Sighted],
    sources: Sequence[np.ndarray],
    unsure: Sequence[np.ndarray],
    config: ReconstructConfig,
    progress: ProgressCallback = quiet,
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Depth of all views again.

    Args:
        fine: the pictures, of the size of `seen` or twice it.
        seen: what each view sees of the mesh.
        sources: of each view (s,) those that it is matched with.
        unsure: of each view (h, w) of `seen`, bool: no other view agreed.
        config: the stage's settings.
        progress: called after each view.

    Returns:
        For each view inverse depth and matching cost, (h, w) of `seen`, as of `match_views`.
    """
    depths, costs = [], []
    for index, sight in enumerate(seen):
        shape = sight.inverse_depth.shape
        depth = np.zeros(shape, np.float32)
        cost = np.full(shape, NO_MATCH, np.float32)
        if len(sources[index]) and len(sight.rows):
            _look(fine, index, sight, sources[index], unsure[index], config, depth, cost)
        depths.append(depth)
        costs.append(cost)
        progress(index + 1, len(seen))
    return depths, costs


def _look(
    fine: Level,
    index: int,
    sight: Sighted,
    sources: np.ndarray,
    unsure: np.ndarray,
    config: ReconstructConfig,
    depth: np.ndarray,
    cost: np.ndarray,
) -> None:
    """Fill one view's depth and cost."""
    height, width = fine.masks.shape[1:]
    every = 1 if sight.inverse_depth.shape == (height, width) else 2
    normals = sight.normals
    if every == 2:
        normals = cv2.resize(normals, (2 * normals.shape[1], 2 * normals.shape[0]))
        length = np.linalg.norm(normals, axis=2, keepdims=True)
        normals = np.divide(normals, length, out=np.zeros_like(normals), where=length > 0.1)
    normals = normals[:height, :width]
    stereo = make_stereo(fine, index, sources, config, normals)
    usable = ~np.isnan(fine.pictures[index, ::every, ::every, 0])
    # A coarse pixel's centre is half a fine pixel beyond that of its first fine pixel.
    slopes = stereo.slopes[::every, ::every]
    beyond = 1 + 0.5 * (every - 1) * slopes.sum(axis=2)
    now = np.zeros((height, width), np.float32)
    now[::every, ::every] = np.where(usable, sight.inverse_depth / beyond, 0)
    wanted = unsure & (now[::every, ::every] > 0)
    if wanted.any():
        wide = patch_offsets(2 * config.patch_radius_px, 2 * config.patch_stride_px)
        steps = np.arange(1, REACH_PX + 1)
        steps = (np.stack([steps, -steps], axis=1).ravel() * stereo.step).astype(np.float32)
        search(stereo._replace(offsets=wide), steps, every, wanted, now)
    judged = np.full((height, width), NO_MATCH, np.float32)
    still = np.zeros((height, width), bool)
    for delta in DELTAS_PX:
        step = np.float32(delta) * stereo.step
        polish(stereo, step, every, now.copy(), judged, now, still, np.float32(0))
    depth[:] = now[::every, ::every] * beyond
    cost[:] = judged[::every, ::every]
