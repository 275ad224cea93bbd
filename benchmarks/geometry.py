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

import cv2
import numpy as np
import open3d

from benchmarks.record import record
from lightstage.formats.mesh import Mesh, read_ply
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import Session, load_session
from lightstage.rig import Camera
from processing.decode.stage import DecodeConfig, decode
from processing.frames.read import Frames, read_foreground, read_frames, write_frames
from processing.reconstruction.config import ReconstructConfig
from processing.reconstruction.consistency import consistent_points
from processing.reconstruction.fusion import fuse
from processing.reconstruction.poses import tone_mapped
from processing.reconstruction.stage import read_views
from processing.reconstruction.stereo import focus_point, match_views
from processing.reconstruction.views import Level, View, pyramid
from processing.separation.config import SeparateConfig
from processing.separation.stage import separate
from sim.errors import SimError
from sim.people.subjects import load_subject

NOISE = 0.001
# Neighbours whose epipolar lines cover the head from all sides, as PEERS' figure used.
PAIRS = ((0, 1), (0, 2), (1, 3), (2, 4), (0, 5), (0, 6), (5, 7), (5, 8))
REACH_MM = 130.0
BLOCK = 5


def rectify(one: Camera, two: Camera, focus: np.ndarray) -> np.ndarray:
    """(3, 3) axes of the rectified pair from the world; picture rows run along the baseline."""
    baseline = two.centre_mm - one.centre_mm
    x = baseline / np.linalg.norm(baseline)
    forward = focus - 0.5 * (one.centre_mm + two.centre_mm)
    y = np.cross(forward, x)
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)])


def sgbm_depth(
    one: Camera, two: Camera, pictures: list[np.ndarray], masks: list[np.ndarray], focus: np.ndarray
) -> np.ndarray:
    """World points (n, 3) of the first view's mask, by SGBM in the mode HH with a left-right check.

    The virtual lenses are shifted so that the point the cameras look at has disparity 0.
    """
    rotation = rectify(one, two, focus)
    size = (int(1.25 * one.width_px), one.height_px)
    lens, warped = one.fx_px, []
    centres = [camera.centre_mm for camera in (one, two)]
    local = [rotation @ (focus - centre) for centre in centres]
    middle = [(size[0] / 2 - lens * p[0] / p[2], size[1] / 2 - lens * p[1] / p[2]) for p in local]
    for camera, picture, mask, (cx, cy) in zip((one, two), pictures, masks, middle, strict=True):
        new = np.array([[lens, 0, cx], [0, lens, cy], [0, 0, 1]])
        turn = rotation @ camera.cam_from_world[:, :3].T
        homography = new @ turn @ np.linalg.inv(camera.matrix)
        half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
        homography = np.linalg.inv(half) @ homography @ half
        warped.append(cv2.warpPerspective(picture, homography, size, flags=cv2.INTER_CUBIC))
        warped.append(cv2.warpPerspective(mask.astype(np.uint8), homography, size))
    baseline = float(np.linalg.norm(centres[1] - centres[0]))
    depth = float(local[0][2])
    near = lens * baseline * (1 / (depth - REACH_MM) - 1 / depth)
    far = lens * baseline * (1 / (depth + REACH_MM) - 1 / depth)
    count = 16 * int(np.ceil((near - far) / 16))
    matcher = cv2.StereoSGBM.create(
        minDisparity=int(np.floor(far)),
        numDisparities=count,
        blockSize=BLOCK,
        P1=8 * BLOCK**2,
        P2=32 * BLOCK**2,
        disp12MaxDiff=1,
        uniquenessRatio=5,
        speckleWindowSize=100,
        speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_HH,
    )
    # Disparities near the picture's edge need columns beyond it.
    pad = count
    left, right = (cv2.copyMakeBorder(w, 0, 0, pad, pad, cv2.BORDER_CONSTANT) for w in warped[::2])
    disparity = matcher.compute(left, right)[:, pad:-pad].astype(np.float32) / 16
    row, column = np.nonzero((disparity > far) & (warped[1] > 0))
    shown = disparity[row, column]
    z = lens * baseline / (shown + lens * baseline / depth)
    (cx, cy) = middle[0]
    x, y = (column + 0.5 - cx) / lens * z, (row + 0.5 - cy) / lens * z
    return np.stack([x, y, z], axis=1) @ rotation + centres[0]


def splat(points: np.ndarray, level: Level, index: int) -> np.ndarray:
    """(h, w) inverse depth of points in one view at a level, the nearest point of each pixel."""
    pose, (fx, fy, cx, cy) = level.poses[index], level.lenses[index]
    local = points @ pose[:, :3].T + pose[:, 3]
    height, width = level.masks.shape[1:]
    column = np.floor(fx * local[:, 0] / local[:, 2] + cx).astype(int)
    row = np.floor(fy * local[:, 1] / local[:, 2] + cy).astype(int)
    inside = (row >= 0) & (column >= 0) & (row < height) & (column < width)
    out = np.zeros((height, width), np.float32)
    np.maximum.at(out, (row[inside], column[inside]), 1 / local[inside, 2].astype(np.float32))
    out[~level.masks[index]] = 0
    return out


def peer_depths(
    session: Session, out: Path, views: list[View], config: ReconstructConfig
) -> tuple[Level, list[np.ndarray], list[np.ndarray]]:
    """SGBM's depth maps of all views, on the level that ours end at."""
    level = pyramid(views, config.finest_rows, config.coarsest_rows)[-1]
    cameras = [session.rig.camera(camera) for camera in session.camera_ids()]
    pictures, masks = [], []
    for camera in session.camera_ids():
        frames = read_frames(out, camera)
        masks.append(read_foreground(out, camera))
        pictures.append(tone_mapped(frames.image(frames.patterns.index("full")), masks[-1]))
    focus = focus_point(cameras)
    clouds: list[list[np.ndarray]] = [[] for _ in views]
    for first, second in PAIRS:
        pair = [pictures[first], pictures[second]]
        cover = [masks[first], masks[second]]
        points = sgbm_depth(cameras[first], cameras[second], pair, cover, focus)
        clouds[first].append(points)
        clouds[second].append(points)
    depths = [splat(np.concatenate(c), level, k) for k, c in enumerate(clouds)]
    costs = [np.where(depth > 0, 0.2, 2.0).astype(np.float32) for depth in depths]
    return level, depths, costs


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
    views = read_views(session, out, config)
    # Compiled before the clock starts.
    match_views(views, dataclasses.replace(config, finest_rows=140, iterations=(1,)))
    rows, seconds, median = [], {}, {}
    for name in ("ours", "OpenCV SGBM HH, 8 pairs"):
        start, used = time.perf_counter(), time.process_time()
        if name == "ours":
            level, depths, costs = match_views(views, config)
        else:
            level, depths, costs = peer_depths(session, out, views, config)
        matched = time.perf_counter() - start
        points = consistent_points(level, depths, costs, config)
        mesh = fuse(points, config)
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
