"""Boards as the cameras of a rig would see them, by projection alone."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from lightstage.formats.board import BoardConfig
from lightstage.rig import Rig
from processing.calibration.cameras.boards import Sight
from sim.targets.boards import BoardConfig as PrintedBoard
from sim.targets.boards import board_poses

BOARD = BoardConfig()


def sights_of(rig: Rig, count: int, seed: int, noise_px: float = 0.03) -> list[Sight]:
    """Sights of `count` boards held toward one camera after the other."""
    rng = np.random.default_rng(seed)
    corners = BOARD.corners_mm()
    out = []
    for shot, pose in enumerate(board_poses(rig, PrintedBoard(), count, seed)):
        places = corners @ pose[:, :3].T + pose[:, 3]
        for camera in rig.cameras:
            toward = camera.centre_mm - pose[:, 3]
            if -pose[:, 2] @ toward / np.linalg.norm(toward) < 0.4:
                continue
            pixels = camera.project(places)[0] + rng.normal(0, noise_px, (len(corners), 2))
            inside = (pixels > 0).all(axis=1)
            inside &= (pixels < [camera.width_px, camera.height_px]).all(axis=1)
            if inside.sum() >= 8:
                out.append(Sight(shot, camera.id, np.flatnonzero(inside), pixels[inside]))
    return out


def pose_errors(found: Rig, true: Rig) -> tuple[np.ndarray, np.ndarray]:
    """Of each camera degrees and mm, after the turn and shift that no board can tell.

    Both are of the rig as a whole: centres are laid onto each other without a change of scale.
    """
    here = np.array([camera.centre_mm for camera in found.cameras])
    there = np.array([camera.centre_mm for camera in true.cameras])
    whole, _ = Rotation.align_vectors(there - there.mean(axis=0), here - here.mean(axis=0))
    shift = np.linalg.norm(
        whole.apply(here - here.mean(axis=0)) - there + there.mean(axis=0), axis=1
    )
    turns = [
        Rotation.from_matrix(
            t.cam_from_world[:, :3].T @ f.cam_from_world[:, :3] @ whole.as_matrix().T
        )
        for f, t in zip(found.cameras, true.cameras, strict=True)
    ]
    return np.degrees([turn.magnitude() for turn in turns]), shift
