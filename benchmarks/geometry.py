"""Base mesh against truth: our matcher beside OpenCV's SGBM on rectified pairs, the same fusion.

Run `python -m benchmarks.geometry`, or with a session whose truth lies beside it and the processed
folder that `separate` left: `python -m benchmarks.geometry SESSION OUT`. Both get the same
photographs, masks and coarse normals; SGBM's depth maps go through the same cross-view consistency
and the same fusion as ours. Points are measured before fusion, the mesh after it.
"""

from __future__ import annotations

import dataclasses
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import open3d

from benchmarks.geometry_peer import Sgbm, peer_depths
from benchmarks.record import record
from lightstage.formats.mesh import Mesh, read_ply
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import Session, load_session
from processing.decode.stage import DecodeConfig, decode
from processing.frames.read import Frames, read_frames, write_frames
from processing.reconstruction.config import ReconstructConfig
from processing.reconstruction.stage import read_views
from processing.reconstruction.stereo import match_views
from processing.reconstruction.twice import meshed, twice
from processing.separation.config import SeparateConfig
from processing.separation.stage import separate
from sim.errors import SimError
from sim.people.subjects import load_subject

NOISE = 0.001


def errors(points: np.ndarray, mesh: Mesh) -> np.ndarray:
    """(n,) distance of points to a mesh, mm."""
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        open3d.core.Tensor(mesh.vertices.astype(np.float32)),
        open3d.core.Tensor(mesh.faces.astype(np.uint32)),
    )
    return np.asarray(scene.compute_distance(open3d.core.Tensor(points.astype(np.float32))).numpy())


def simulate(folder: Path) -> tuple[Session, Path]:
    """A session of the scanned head where there is one, else of a parametric one, with noise."""
    try:
        load_subject("lps", 1)
        subject = "lps"
    except SimError:  # no scan here
        subject = "parametric"
    command = [sys.executable, "-m", "sim", "session", "--subject", subject, "--seed", "1"]
    subprocess.run([*command, "--direct", "--out", str(folder / "session")], check=True)
    session, out = load_session(folder / "session"), folder / "out"
    decode(session, out, DecodeConfig())
    rng = np.random.default_rng(0)
    for camera in session.camera_ids():
        clean = read_frames(out, camera)
        noise = rng.normal(0, NOISE, (len(clean.patterns), *clean.shape, 3)).astype(np.float32)
        write_frames(out, camera, Frames.of(clean.patterns, clean.images + noise, clean.valid))
    separate(session, out, SeparateConfig())
    return session, out


def measure(session: Session, out: Path) -> None:
    truth_folder = ProcessedFolder(session.root.with_name(session.root.name + ".truth"))
    truth = read_ply(truth_folder.base_mesh)
    skin = np.concatenate(
        [
            truth_folder.read_view(camera, "position")[truth_folder.read_mask(camera)][::7]
            for camera in truth_folder.view_ids()
        ]
    )
    config = ReconstructConfig()
    views, lights = read_views(session, out, config)
    # Compiled before the clock starts.
    match_views(views, dataclasses.replace(config, finest_rows=140, iterations=(1,)))
    rows, seconds, median = [], {}, {}
    for name in ("ours", "OpenCV SGBM HH, 8 pairs"):
        start, used = time.perf_counter(), time.process_time()
        if name == "ours":
            found = match_views(views, config)
            matched = time.perf_counter() - start
            _, points, mesh = twice(views, found, config, lights)
        else:
            found = peer_depths(session, out, views, config, Sgbm())
            matched = time.perf_counter() - start
            points, mesh = meshed(found, config)
        seconds[name] = time.perf_counter() - start
        cpu = time.process_time() - used
        raw, gap = errors(points.positions, truth), errors(skin, mesh)
        median[name] = float(np.median(gap))
        rows.append(
            (
                name,
                f"{matched:.0f}",
                f"{seconds[name]:.0f}",
                f"{cpu:.0f}",
                f"{np.median(raw):.3f} / {np.percentile(raw, 95):.2f}",
                f"{np.median(gap):.3f} / {np.percentile(gap, 95):.2f}",
                f"{100 * (gap < 1).mean():.1f}",
            )
        )
    first, second = seconds
    rows.append(
        (
            "ours over peer",
            "",
            f"{seconds[first] / seconds[second]:.2f}",
            "",
            "",
            f"{median[first] / median[second]:.2f} (median)",
            "",
        )
    )
    camera = session.rig.camera(session.camera_ids()[0])
    record(
        "Geometry: base mesh of one head from nine views",
        (
            "method",
            "matching, s",
            "all, s",
            "processor, s",
            "points: median / p95, mm",
            "true skin to mesh: median / p95, mm",
            "skin within 1 mm, %",
        ),
        rows,
        f"Subject {session.file.subject}, {len(views)} views of {camera.width_px} x "
        f"{camera.height_px}, f {camera.fx_px:.0f} px; the same consistency and fusion for both.",
    )


def main() -> None:
    if len(sys.argv) == 3:
        measure(load_session(Path(sys.argv[1])), Path(sys.argv[2]))
        return
    with tempfile.TemporaryDirectory() as name:
        measure(*simulate(Path(name)))


if __name__ == "__main__":
    main()
