"""Non-rigid registration against trimesh's Amberg: surface error, correspondence error, seconds."""

from __future__ import annotations

import time

import numpy as np
import open3d
import trimesh

from benchmarks.record import record
from lightstage.formats.mesh import Mesh, vertex_normals
from lightstage.formats.template import default_template_path, load_template
from processing.registration.nonrigid import NonrigidConfig, fit_nonrigid
from processing.registration.target import Target

SEED = 11
CELL_MM = 5.5
PEER_STEPS = [[0.02, 3, 0.5, 10], [0.007, 3, 0.5, 10], [0.002, 3, 0.5, 10], [0.0005, 0, 0.0, 8]]
"""Per step: stiffness, landmark weight, normal weight, iterations; trimesh's own default has 4
steps of at most 10 too, for a mesh scaled to unit size."""


def coarse(mesh: Mesh) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertex clusters of a template, so that the peer's 4n x 4n system takes seconds.

    Returns:
        vertices, triangles, and for each vertex its cluster.
    """
    cell = np.floor(mesh.vertices / CELL_MM).astype(np.int64)
    _, cluster = np.unique(cell, axis=0, return_inverse=True)
    cluster = cluster.ravel()
    count = np.bincount(cluster)
    vertices = np.stack(
        [np.bincount(cluster, mesh.vertices[:, k]) / count for k in range(3)], axis=1
    )
    triangles = cluster[mesh.triangles()]
    distinct = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    triangles = triangles[distinct]
    _, first = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)
    return vertices, triangles[np.sort(first)], cluster


def open3d_closest(
    mesh: trimesh.Trimesh, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """trimesh.proximity.closest_point by Open3D: faster, and without rtree."""
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        open3d.core.Tensor(np.asarray(mesh.vertices, np.float32)),
        open3d.core.Tensor(np.asarray(mesh.faces, np.uint32)),
    )
    found = scene.compute_closest_points(open3d.core.Tensor(np.asarray(points, np.float32)))
    near = found["points"].numpy().astype(float)
    faces = found["primitive_ids"].numpy().astype(np.int64)
    return near, np.linalg.norm(near - points, axis=1), faces


def main() -> None:
    template = load_template(default_template_path())
    vertices, triangles, cluster = coarse(template.mesh)
    rng = np.random.default_rng(SEED)
    if template.modes is None:
        raise SystemExit("the template has no modes to make a person of")
    person = template.mesh.vertices + np.tensordot(
        rng.normal(size=len(template.modes.identity)), template.modes.identity, axes=1
    )
    offset = person - template.mesh.vertices
    count = np.bincount(cluster)
    truth = vertices + np.stack(
        [np.bincount(cluster, offset[:, k]) / count for k in range(3)], axis=1
    )
    scan_vertices, scan_faces = trimesh.remesh.subdivide(truth, triangles)
    scan = Target(Mesh(scan_vertices, scan_faces.astype(np.int32)))
    marks, first = np.unique(cluster[template.landmarks], return_index=True)
    marks = marks[np.argsort(first)]
    rows = []
    results = {}

    begin = time.perf_counter()
    ours = fit_nonrigid(vertices, triangles, scan, marks, truth[marks], NonrigidConfig())
    results["this project"] = (ours.vertices, time.perf_counter() - begin)

    # To the peer's advantage: its own search takes 20 times as long.
    trimesh.proximity.closest_point = open3d_closest
    begin = time.perf_counter()
    source = trimesh.Trimesh(vertices, triangles, process=False)
    target = trimesh.Trimesh(scan_vertices, scan_faces, process=False)
    peer = trimesh.registration.nricp_amberg(
        source, target, source_landmarks=marks, target_positions=truth[marks], steps=PEER_STEPS
    )
    results["trimesh nricp_amberg"] = (np.asarray(peer), time.perf_counter() - begin)
    results["no registration"] = (vertices, 0.0)

    reference = results["trimesh nricp_amberg"]
    normals = vertex_normals(truth, triangles)
    for name, (found, seconds) in results.items():
        error = np.linalg.norm(found - truth, axis=1)
        surface = scan.closest(found).distance_mm
        slid = error - np.abs(np.einsum("nk,nk->n", found - truth, normals))
        peer_error = np.linalg.norm(reference[0] - truth, axis=1).mean()
        rows.append(
            [
                name,
                f"{surface.mean():.3f}",
                f"{error.mean():.2f}",
                f"{np.quantile(error, 0.95):.2f}",
                f"{np.clip(slid, 0, None).mean():.2f}",
                f"{error.mean() / peer_error:.2f}",
                f"{seconds:.1f}",
                f"{seconds / reference[1]:.3f}",
            ]
        )
    record(
        "Registration: known person, whole head",
        [
            "method",
            "surface mm mean",
            "correspondence mm mean",
            "95 %",
            "tangential mm",
            "correspondence / trimesh",
            "seconds",
            "seconds / trimesh",
        ],
        rows,
        f"{len(vertices)} vertices onto {len(scan_faces)} faces of a person made of the template's "
        f"identity modes (seed {SEED}), {len(marks)} landmarks, no shape model used. "
        f"trimesh with Open3D's closest points and steps {PEER_STEPS}; ours {NonrigidConfig()}.",
    )


if __name__ == "__main__":
    main()
