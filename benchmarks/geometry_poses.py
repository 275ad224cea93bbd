"""Poses of nine cameras from photographed ChArUco boards, beside OpenCV alone.

Run `python -m benchmarks.geometry_poses`, with --drawn on boards drawn by the simulator with sensor
noise, without on projected corners. The stage's cameras (true) are written down a little
wrong in rig.json: 3 mm, .3 degrees, half a percent of focal length, principal points in the
middle. Other benchmarks take their poses from here. OpenCV alone:
calibrateCamera for each camera, and of each pair of cameras the median relative pose of the boards
that both saw, chained from the frontal camera.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections.abc import Iterator

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from benchmarks.record import record
from benchmarks.reflectance_people import NOISE, SCALE, folder
from lightstage.formats.board import BoardConfig
from lightstage.rig import Camera, Rig, default_rig
from processing.calibration.cameras.boards import Sight, find_board
from processing.calibration.cameras.config import CamerasConfig
from processing.calibration.cameras.measured import MeasuredCameras, measure_cameras
from sim.light.lamps import lamps_of
from sim.targets.boards import BoardConfig as PrintedBoard
from sim.targets.boards import board_poses
from sim.targets.plane import photograph_plane

BOARDS, SEED = 18, 11
STEEPEST = 0.3
"""Least cosine between a board's face and the direction to a camera that counts as seeing it."""
CORNER_PX = 0.03
"""Noise of projected corners on each axis: three times what drawn ones are off."""
BOARD = BoardConfig()


def as_written(rig: Rig, seed: int = SEED, shift_mm: float = 3.0, turn_deg: float = 0.3) -> Rig:
    """The rig as its rig.json has it before cameras are measured: nominal lenses, elsewhere.

    Args:
        rig: the true one.
        seed: of what is off.
        shift_mm, turn_deg: standard deviations of cameras' places and turns on each axis.
    """
    rng = np.random.default_rng(seed)

    def off(camera: Camera) -> Camera:
        turn = Rotation.from_rotvec(np.radians(rng.normal(0, turn_deg, 3))).as_matrix()
        pose = camera.cam_from_world.copy()
        pose[:, :3] = turn @ pose[:, :3]
        pose[:, 3] = -pose[:, :3] @ (camera.centre_mm + rng.normal(0, shift_mm, 3))
        focal = 1 + rng.normal(0, 0.005)
        return dataclasses.replace(
            camera,
            fx_px=camera.fx_px * focal,
            fy_px=camera.fy_px * focal,
            cx_px=camera.width_px / 2,
            cy_px=camera.height_px / 2,
            dist=(0.0,) * 5,
            cam_from_world=pose,
        )

    return dataclasses.replace(rig, cameras=tuple(off(camera) for camera in rig.cameras))


def sights(rig: Rig, scale: float, drawn: bool = False, seed: int = SEED) -> list[Sight]:
    """Corners of boards as the rig's cameras see them.

    Args:
        rig: the true one.
        scale: of its pictures.
        drawn: found in drawn and noisy photographs, which takes minutes once; else projected, with
            CORNER_PX of noise.
        seed: of boards and noise.
    """
    path = folder() / f"geometry-boards-{scale:g}-{BOARDS}-{seed}.npz"
    if drawn and not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez(path, seen=np.concatenate([_found(*view) for view in _views(rig, seed)]))
    seen = np.load(path)["seen"] if drawn else None
    rng = np.random.default_rng([seed, 1])
    out, corners = [], BOARD.corners_mm()
    for shot, number, pose in _views(rig, seed):
        camera = rig.cameras[number]
        if seen is None:
            pixels = camera.project(corners @ pose[:, :3].T + pose[:, 3])[0]
            pixels += rng.normal(0, CORNER_PX, pixels.shape)
            inside = ((pixels > 0) & (pixels < [camera.width_px, camera.height_px])).all(axis=1)
            ids, pixels = np.flatnonzero(inside), pixels[inside]
        else:
            own = seen[(seen[:, 0] == shot) & (seen[:, 1] == number)]
            ids, pixels = own[:, 2].astype(np.int64), own[:, 3:]
        if len(ids) >= 8:
            out.append(Sight(shot, camera.id, ids, pixels))
    return out


def _views(rig: Rig, seed: int) -> Iterator[tuple[int, int, np.ndarray]]:
    """Shot, camera's number and the board's pose, where the camera sees its face well."""
    for shot, pose in enumerate(board_poses(rig, PrintedBoard(), BOARDS, seed)):
        for number, camera in enumerate(rig.cameras):
            toward = camera.centre_mm - pose[:, 3]
            if -pose[:, 2] @ toward > STEEPEST * np.linalg.norm(toward):
                yield shot, number, pose


def _found(shot: int, number: int, pose: np.ndarray) -> np.ndarray:
    """(n, 5) shot, camera, corner and pixel, of a drawn photograph."""
    camera, lamps = true_rig().cameras[number], lamps_of(true_rig())
    full = np.ones(len(lamps.weights))
    plane = PrintedBoard().plane(pose)
    light = photograph_plane(plane, camera, lamps, full, np.zeros(3))[0][..., 1]
    rng = np.random.default_rng([shot, number])
    noise = NOISE * np.sqrt(0.25 + light) * rng.standard_normal(light.shape)
    ids, pixels = find_board(light + noise, BOARD.board())
    indices = np.full((len(ids), 2), [shot, number])
    return np.concatenate([indices, ids[:, None], pixels], axis=1)


def true_rig(scale: float = SCALE) -> Rig:
    """The stage of the benchmark's people: its cameras are the default rig's, without flaws."""
    return default_rig().scaled(scale)


def measured(scale: float = SCALE) -> MeasuredCameras:
    """Cameras from boards, in place of the truth."""
    rig = true_rig(scale)
    return measure_cameras(sights(rig, scale), as_written(rig), BOARD, CamerasConfig())


def opencv_alone(found: list[Sight], written: Rig) -> tuple[Camera, ...]:
    """Cameras by OpenCV's own functions; poses in the frame of the rig's first camera."""
    corners = BOARD.corners_mm()
    lens: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    poses: dict[tuple[str, int], np.ndarray] = {}
    for camera in written.cameras:
        own = [s for s in found if s.camera == camera.id]
        _, matrix, dist, turns, shifts = cv2.calibrateCamera(
            [corners[s.ids].astype(np.float32) for s in own],
            [(s.pixels - 0.5).astype(np.float32) for s in own],
            (camera.width_px, camera.height_px),
            camera.opencv_matrix,
            np.zeros(5),
            flags=cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3,
        )
        lens[camera.id] = matrix, dist
        for sight, turn, shift in zip(own, turns, shifts, strict=True):
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(turn)[0], np.ravel(shift)
            poses[camera.id, sight.shot] = pose
    placed = {written.cameras[0].id: np.eye(4)}
    while len(placed) < len(written.cameras):
        best: tuple[int, str, str] = (0, "", "")
        for one in placed:
            for camera in written.cameras:
                if camera.id not in placed:
                    shared = sum((one, k) in poses and (camera.id, k) in poses for k in range(99))
                    best = max(best, (shared, one, camera.id))
        _, one, two = best
        some = [
            poses[two, k] @ np.linalg.inv(poses[one, k])
            for k in range(99)
            if (one, k) in poses and (two, k) in poses
        ]
        relative = np.eye(4)
        relative[:3, :3] = Rotation.from_matrix([p[:3, :3] for p in some]).mean().as_matrix()
        relative[:3, 3] = np.median([p[:3, 3] for p in some], axis=0)
        placed[two] = relative @ placed[one]
    out = []
    for camera in written.cameras:
        matrix, dist = lens[camera.id]
        k1, k2, p1, p2, k3 = np.ravel(dist)[:5]
        out.append(
            dataclasses.replace(
                camera,
                fx_px=matrix[0, 0],
                fy_px=matrix[1, 1],
                cx_px=matrix[0, 2] + 0.5,
                cy_px=matrix[1, 2] + 0.5,
                dist=(k1, k2, p1, p2, k3),
                cam_from_world=placed[camera.id][:3],
            )
        )
    return tuple(out)


def onto_truth(cameras: tuple[Camera, ...], rig: Rig) -> tuple[Rotation, np.ndarray]:
    """Turn and shift of the world that fit cameras to the true ones: no board can show them.

    Those by which points in the head's place come nearest to their true pixels.
    """
    here = np.array([camera.centre_mm for camera in cameras])
    there = np.array([camera.centre_mm for camera in rig.cameras])
    first, _ = Rotation.align_vectors(there - there.mean(axis=0), here - here.mean(axis=0))
    shift = there.mean(axis=0) - first.apply(here.mean(axis=0))
    places = np.random.default_rng(0).uniform(-70, 70, (60, 3))
    wanted = [true.project(places)[0] for true in rig.cameras]

    def misses(move: np.ndarray) -> np.ndarray:
        turn = Rotation.from_rotvec(move[:3] / 100) * first
        own = turn.inv().apply(places - shift - move[3:])
        shown = [camera.project(own)[0] for camera in cameras]
        return np.ravel(np.array(shown) - np.array(wanted))

    found = least_squares(misses, np.zeros(6)).x
    return Rotation.from_rotvec(found[:3] / 100) * first, shift + found[3:]


def errors(cameras: tuple[Camera, ...], rig: Rig) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each camera: px on boards that nobody saw, degrees, mm, after `onto_truth`."""
    turn, shift = onto_truth(cameras, rig)
    degrees, apart, pixels = [], [], []
    held = board_poses(rig, PrintedBoard(), 9, SEED + 1)
    corners = BOARD.corners_mm()
    for camera, true in zip(cameras, rig.cameras, strict=True):
        rotation = camera.cam_from_world[:, :3] @ turn.as_matrix().T
        off = Rotation.from_matrix(true.cam_from_world[:, :3].T @ rotation)
        degrees.append(np.degrees(off.magnitude()))
        centre = turn.apply(camera.centre_mm) + shift
        apart.append(np.linalg.norm(centre - true.centre_mm))
        pose = np.concatenate([rotation, -(rotation @ centre)[:, None]], axis=1)
        placed = dataclasses.replace(camera, cam_from_world=pose)
        places = np.concatenate([corners @ p[:, :3].T + p[:, 3] for p in held])
        miss = np.linalg.norm(placed.project(places)[0] - true.project(places)[0], axis=1)
        pixels.append(np.median(miss))
    return np.array(pixels), np.array(degrees), np.array(apart)


def main() -> None:
    """Measure, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--drawn", action="store_true")
    drawn = parser.parse_args().drawn
    rig = true_rig()
    seen, written = sights(rig, SCALE, drawn), as_written(rig)
    rows = []
    start = time.process_time()
    ours = measure_cameras(seen, written, BOARD, CamerasConfig())
    ours_s = time.process_time() - start
    start = time.process_time()
    peer = opencv_alone(seen, written)
    peer_s = time.process_time() - start
    held = [each["held_out_px"] for each in ours.facts["cameras"].values()]
    cases: list[tuple[str, tuple[Camera, ...], float]] = [
        ("as written in rig.json", written.cameras, 0.0),
        ("OpenCV alone", peer, peer_s),
        ("ours: OpenCV, then COLMAP's adjustment", ours.cameras, ours_s),
    ]
    for name, cameras, seconds in cases:
        pixels, degrees, apart = errors(cameras, rig)
        rows.append(
            (
                name,
                f"{np.median(pixels):.3f} / {pixels.max():.3f}",
                f"{np.median(degrees):.4f} / {degrees.max():.4f}",
                f"{np.median(apart):.3f} / {apart.max():.3f}",
                f"{seconds:.1f}",
            )
        )
    where = "found in drawn ones with noise" if drawn else f"projected, noise {CORNER_PX} px"
    shape = f"{rig.cameras[0].width_px} x {rig.cameras[0].height_px}"
    record(
        "Geometry: poses of nine cameras from boards",
        (
            "method",
            "boards nobody saw, px off: median / worst camera",
            "turned, deg: median / worst",
            "centre, mm: median / worst",
            "processor, s",
        ),
        rows,
        f"{BOARDS} boards of 8 x 11 squares, pictures of {shape}, corners {where}. "
        "Reprojection of boards held out of the adjustment, by it: "
        f"{np.median(held):.3f} px, {np.max(held):.3f} at worst.",
    )


if __name__ == "__main__":
    main()
