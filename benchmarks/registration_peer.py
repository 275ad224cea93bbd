"""trimesh's non-rigid ICP, for the benchmarks of registration."""

from __future__ import annotations

import time

import numpy as np
import open3d
import trimesh

from benchmarks.registration_case import Case
from processing.registration.rigid import robust_umeyama

STEPS = {
    "its default": [
        [0.01, 10, 0.5, 10],
        [0.02, 5, 0.5, 10],
        [0.03, 2.5, 0.5, 10],
        [0.01, 0, 0, 10],
    ],
    "annealed": [[0.02, 3, 0.5, 8], [0.007, 3, 0.5, 8], [0.002, 3, 0.5, 8], [0.0005, 1, 0, 6]],
}
"""Per step: stiffness, landmark weight, normal weight, iterations at most; of a mesh scaled to
unit size. The second one is tuned on the first case."""


def closest(mesh: trimesh.Trimesh, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """trimesh.proximity.closest_point by Open3D: twenty times faster, and without rtree."""
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        open3d.core.Tensor(np.asarray(mesh.vertices, np.float32)),
        open3d.core.Tensor(np.asarray(mesh.faces, np.uint32)),
    )
    found = scene.compute_closest_points(open3d.core.Tensor(np.asarray(points, np.float32)))
    near = found["points"].numpy().astype(float)
    faces = found["primitive_ids"].numpy().astype(np.int64)
    return near, np.linalg.norm(near - points, axis=1), faces


def aligned(case: Case) -> np.ndarray:
    """(n, 3) the template by its landmarks: where the peer starts."""
    known = np.isfinite(case.landmarks_mm).all(axis=1)
    rest = case.template.mesh.vertices
    marks = case.template.landmarks[known]
    pose, _ = robust_umeyama(rest[marks], case.landmarks_mm[known], scale=True)
    return pose.apply(rest)


def nricp_amberg(case: Case, steps: str) -> tuple[np.ndarray, float]:
    """The peer's vertices, and the processor's seconds it took."""
    trimesh.proximity.closest_point = closest
    known = np.flatnonzero(np.isfinite(case.landmarks_mm).all(axis=1))
    triangles = case.template.mesh.triangles()
    begin = time.process_time()
    found = trimesh.registration.nricp_amberg(
        trimesh.Trimesh(aligned(case), triangles, process=False),
        trimesh.Trimesh(case.scan.vertices, case.scan.faces, process=False),
        source_landmarks=case.template.landmarks[known],
        target_positions=case.landmarks_mm[known],
        steps=STEPS[steps],
    )
    return np.asarray(found), time.process_time() - begin
