"""Measured cameras fitted to the poses of a rig.json: boards do not show where the stage is."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from lightstage.rig import Camera


def onto(cameras: Mapping[str, Camera], nominal: Mapping[str, Camera]) -> np.ndarray:
    """(4, 4) reference from world that fits cameras to the rig's [Kabsch1976], robustly."""
    names = sorted(cameras)
    here = np.array([cameras[name].centre_mm for name in names])
    there = np.array([nominal[name].centre_mm for name in names])
    spread = np.linalg.svd(there - there.mean(axis=0), compute_uv=False)
    if len(names) < 3 or spread[1] < 1e-3 * spread[0]:
        one = four(nominal[names[0]].cam_from_world)
        return np.asarray(np.linalg.inv(four(cameras[names[0]].cam_from_world)) @ one)
    # To start with, the one camera by which most others stand where they are written: two that
    # were swapped would pull a plain mean far off.
    single = [
        np.linalg.inv(four(cameras[name].cam_from_world)) @ four(nominal[name].cam_from_world)
        for name in names
    ]
    out = min(single, key=lambda pose: float(np.median(_missed(pose, there, here))))
    for _ in range(10):
        miss = _missed(out, there, here)
        weights = 1 / (1 + (miss / max(2 * float(np.median(miss)), 1e-6)) ** 2)
        share = weights / weights.sum()
        middle, target = share @ here, share @ there
        turn, _ = Rotation.align_vectors(here - middle, there - target, weights=share)
        out = np.eye(4)
        out[:3, :3] = turn.as_matrix()
        out[:3, 3] = middle - out[:3, :3] @ target
    return out


def _missed(pose: np.ndarray, there: np.ndarray, here: np.ndarray) -> np.ndarray:
    """(n,) distances of points that a pose moves from where they should come, mm."""
    return np.asarray(np.linalg.norm(there @ pose[:3, :3].T + pose[:3, 3] - here, axis=1))


def four(pose: np.ndarray) -> np.ndarray:
    """(4, 4) of a (3, 4) pose."""
    out = np.eye(4)
    out[:3] = pose[:3]
    return out
