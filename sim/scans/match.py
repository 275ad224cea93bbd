"""Which place of our own head a place of another head is: landmarks, a smooth warp, closest points.

So our skin can be painted on any head whose landmarks are known, and our regions (skin, lips, eyes)
are known on it.
"""

from __future__ import annotations

import functools

import numpy as np
import open3d
from scipy.interpolate import RBFInterpolator

from sim.errors import SimError
from sim.head.mesh import grid_places, landmarks, neutral_mesh, regions

FEWEST_LANDMARKS = 8
"""Below this a face is not held in all directions."""
CHUNK = 1 << 18
SMOOTHING = 1.0
"""Smoothing of the warp: landmarks are clicked to a mm or two, so it need not pass through all of
them."""


def carried(
    points_mm: np.ndarray,
    landmarks_mm: np.ndarray,
    anchors: tuple[np.ndarray, np.ndarray] | None = None,
) -> np.ndarray:
    """Points of another head where they would be on ours.

    A thin-plate spline in space (its kernel is |r|, [Bookstein1989] in three dimensions) carries
    the other head's landmarks onto ours.

    Args:
        points_mm: (n, 3) of the other head with a closed mouth, head frame.
        landmarks_mm: (68, 3) iBUG landmarks of it, NaN where unknown.
        anchors: more points of the other head (k, 3) and where they are on ours (k, 3).

    Returns:
        (n, 3) mm.

    Raises:
        SimError: fewer known landmarks than a face needs.
    """
    known = np.isfinite(landmarks_mm).all(axis=1)
    if known.sum() < FEWEST_LANDMARKS:
        raise SimError(
            "landmarks",
            found=f"{int(known.sum())} known",
            expected=f"at least {FEWEST_LANDMARKS} of 68",
        )
    source, target = landmarks_mm[known], neutral_mesh().vertices[landmarks()[known]]
    if anchors is not None:
        source = np.concatenate([source, anchors[0]])
        target = np.concatenate([target, anchors[1]])
    # Points that coincide (a closed mouth's) would make the system singular.
    source, first = np.unique(np.round(source, 3), axis=0, return_index=True)
    warp = RBFInterpolator(source, target[first], kernel="linear", smoothing=SMOOTHING, degree=1)
    return np.asarray(warp(points_mm))


def own_grid_uv(carried_mm: np.ndarray, with_eyes: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Places of our vertex grid that are closest to carried points.

    Args:
        carried_mm: (n, 3) from `carried`.
        with_eyes: whether points may be on our eyeballs; not when the other head's eyeballs are
            parts of their own, so that lids stay lids.

    Returns:
        (n, 2) float64, as `sim.head.mesh.grid_places` has them, and (n,) how far the points are
        off our head, mm.
    """
    mesh = neutral_mesh()
    scene, triangles = _own_scene(with_eyes)
    uvs = grid_places()[mesh.triangle_uvs()[triangles]]
    uv, off = np.empty((len(carried_mm), 2)), np.empty(len(carried_mm))
    for start in range(0, len(carried_mm), CHUNK):
        part = slice(start, start + CHUNK)
        points = np.ascontiguousarray(carried_mm[part], np.float32)
        found = scene.compute_closest_points(open3d.core.Tensor(points))
        corner = uvs[found["primitive_ids"].numpy()]
        b, c = found["primitive_uvs"].numpy().astype(float).T[:, :, None]
        uv[part] = corner[:, 0] * (1 - b - c) + corner[:, 1] * b + corner[:, 2] * c
        off[part] = np.linalg.norm(found["points"].numpy() - points, axis=1)
    return np.clip(uv, 0.0, 1.0), off


@functools.lru_cache(maxsize=2)
def _own_scene(with_eyes: bool) -> tuple[open3d.t.geometry.RaycastingScene, np.ndarray]:
    """Our neutral head for closest points, and which of its triangles are in it."""
    mesh = neutral_mesh()
    triangles = mesh.triangles()
    kept = np.arange(len(triangles))
    if not with_eyes:
        kept = np.flatnonzero(~np.isin(triangles, regions()["eyes"]).any(axis=1))
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        open3d.core.Tensor(mesh.vertices.astype(np.float32)),
        open3d.core.Tensor(triangles[kept].astype(np.uint32)),
    )
    return scene, kept
