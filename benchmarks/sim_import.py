"""What does taking in other people's heads cost, and how exactly do they arrive?

Run `python -m benchmarks.sim_import`: files beside trimesh, the correspondence beside plain
float64, a whole scan whose place is known, and people of ICT Face Model Light where it is at hand.
"""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from benchmarks.record import record
from lightstage.formats.exr import write_exr
from lightstage.formats.mesh import Mesh, write_obj
from sim.head.mesh import landmarks, neutral_mesh
from sim.scans.checks import CheckConfig
from sim.scans.folder import load_subject_folder, save_subject
from sim.scans.gltf import read_gltf
from sim.scans.ict import ict_folder
from sim.scans.ict_subject import ict_subject
from sim.scans.match import SMOOTHING, carried, own_grid_uv
from sim.scans.scan import WORLD_SHIFT_MM, ScanConfig, import_scan
from sim.scans.subdivide import loop_subdivide

T = TypeVar("T")
ROWS = 1536
PLAIN_POINTS = 60
"""The plain closest points are searched for so many; their time is scaled."""
Row = tuple[object, ...]


def main() -> None:
    rng = np.random.default_rng(0)
    head = loop_subdivide(neutral_mesh())
    with tempfile.TemporaryDirectory() as folder:
        rows = [reading(head, Path(folder)), warp(rng), closest(rng)]
        rows += whole(head, Path(folder))
    model = ict_folder()
    if model is not None:
        for step in ("ICT, first person", "ICT, next person"):
            seconds, person = timed(lambda: ict_subject("ict", model, 1, "smile", ROWS))
            apart = np.linalg.norm(person.landmarks_mm[36] - person.landmarks_mm[45])
            rows.append((step, f"{seconds:.1f}", "", "", f"eyes {apart:.0f} mm apart"))
    record(
        "Scans and models of others",
        ("step", "seconds", "peer or plain, seconds", "ratio", "error"),
        rows,
        f"Our own head of {len(head.faces)} triangles as a scan; reading beside trimesh, warp and "
        f"closest points beside numpy float64 (every point against every triangle, scaled up from "
        f"{PLAIN_POINTS}); maps of {ROWS} rows.",
    )


def reading(head: Mesh, folder: Path) -> Row:
    """A .glb that trimesh wrote, read by us and by trimesh."""
    path = folder / "head.glb"
    shape = trimesh.Trimesh(head.vertices / 1000, head.triangles(), process=False)
    path.write_bytes(trimesh.Scene(shape).export(file_type="glb"))
    ours, scan = timed(lambda: read_gltf(path))
    peer, _ = timed(lambda: trimesh.load(path, process=True, merge_norm=True, merge_tex=True))
    known = head.vertices[head.triangles()]
    error = np.abs(scan.mesh.vertices[scan.mesh.faces] * 1000 - known).max()
    return (".glb, merged", f"{ours:.3f}", f"{peer:.3f}", f"{ours / peer:.2f}", f"{error:.1e} mm")


def warp(rng: np.random.Generator) -> Row:
    """The thin-plate spline against the dense system solved plainly."""
    target = neutral_mesh().vertices[landmarks()]
    marks = np.round(target + rng.normal(0, 5, target.shape), 3)
    points = neutral_mesh().vertices
    ours, moved = timed(lambda: carried(points, marks))
    plain, wanted = timed(lambda: plain_warp(points, marks, target))
    error = np.abs(moved - wanted).max()
    return ("warp", f"{ours:.3f}", f"{plain:.3f}", f"{ours / plain:.2f}", f"{error:.1e} mm")


def plain_warp(points: np.ndarray, source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(n, 3) by the textbook's system: kernel -|r|, smoothing on its diagonal, affine part."""
    count = len(source)
    kernel = -np.linalg.norm(source[:, None] - source[None], axis=2) + SMOOTHING * np.eye(count)
    affine = np.concatenate([np.ones((count, 1)), source], axis=1)
    system = np.block([[kernel, affine], [affine.T, np.zeros((4, 4))]])
    weights = np.linalg.solve(system, np.concatenate([target, np.zeros((4, 3))]))
    reach = -np.linalg.norm(points[:, None] - source[None], axis=2)
    ones = np.ones((len(points), 1))
    return np.asarray(np.concatenate([reach, ones, points], axis=1) @ weights)


def closest(rng: np.random.Generator) -> Row:
    """Closest points against every triangle, how far off the head they are found."""
    mesh = neutral_mesh()
    chosen = rng.choice(np.unique(mesh.triangles()), 200_000)
    points = mesh.vertices[chosen] + rng.normal(0, 4, (200_000, 3))
    own_grid_uv(points[:10])
    ours, (_, off) = timed(lambda: own_grid_uv(points))
    corners = mesh.vertices[mesh.triangles()]
    plain, wanted = timed(lambda: [plain_distance(p, corners) for p in points[:PLAIN_POINTS]])
    plain *= len(points) / PLAIN_POINTS
    error = np.abs(off[:PLAIN_POINTS] - wanted).max()
    name = "closest points, 200,000"
    return (name, f"{ours:.2f}", f"{plain:.0f}", f"{ours / plain:.4f}", f"{error:.1e} mm")


def plain_distance(point: np.ndarray, corners: np.ndarray) -> float:
    """From a point to the nearest of (t, 3, 3) triangles."""
    return float(
        np.linalg.norm(
            trimesh.triangles.closest_point(corners, np.tile(point, (len(corners), 1))) - point,
            axis=1,
        ).min()
    )


def whole(head: Mesh, folder: Path) -> list[Row]:
    """A turned scan imported, saved and loaded: where its landmarks end up."""
    marks = neutral_mesh().vertices[landmarks()]
    turn = Rotation.from_euler("xyz", [20, -35, 10], degrees=True).as_matrix()
    moved = head.with_vertices(head.vertices @ turn.T + np.array([100.0, 200.0, 300.0]))
    path = write_obj(moved, folder / "scan.obj")
    file = folder / "marks.json"
    points = (marks @ turn.T + np.array([100.0, 200.0, 300.0])).tolist()
    file.write_text(json.dumps({"scheme": "ibug68", "points_mm": points}))
    colour = write_exr(folder / "colour.exr", np.full((ROWS, ROWS * 2 // 3, 3), 0.4, np.float32))
    config = ScanConfig(checks=CheckConfig(largest_hole_mm=1e3))
    seconds, (subject, _) = timed(
        lambda: import_scan(path, "scan", file, colour=colour, config=config)
    )
    error = np.linalg.norm(subject.landmarks_mm - marks - WORLD_SHIFT_MM, axis=1).max()
    save, kept = timed(lambda: save_subject(subject, folder / "kept"))
    load, again = timed(lambda: load_subject_folder(kept))
    off = np.abs(again.mesh.vertices - subject.mesh.vertices).max()
    off = max(off, np.abs(again.normal - subject.normal).max())
    return [
        ("import-scan", f"{seconds:.1f}", "", "", f"landmarks {error:.1e} mm"),
        ("save a subject", f"{save:.1f}", "", "", ""),
        ("load a subject", f"{load:.1f}", "", "", f"{off:g}"),
    ]


def timed(work: Callable[[], T]) -> tuple[float, T]:
    """Seconds and what came of it."""
    begun = time.perf_counter()
    value = work()
    return time.perf_counter() - begun, value


if __name__ == "__main__":
    main()
