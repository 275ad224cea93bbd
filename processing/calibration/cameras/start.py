"""A first guess of how cameras stand to each other, from boards that pairs of them saw.

A board seen by a long lens fits two poses nearly as well: its own, and one tilted the other way.
So each sight gives both, and that counts which fits the pictures of the other cameras too.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from processing.calibration.cameras.boards import Sight

ROUNDS = 2
MOST_SHARED = 12
"""Boards that a pair of cameras is linked by."""
CAP_PX = 200.0
"""A sight that is farther off than this counts as wrong, not as more wrong."""

Poses = list[np.ndarray]
"""(4, 4) each."""


def board_poses_of(
    sight: Sight, corners_mm: np.ndarray, lens: np.ndarray, dist: np.ndarray
) -> Poses:
    """One or two poses (camera from board) that a sight fits, the better first [Collins2014].

    Args:
        sight: corners in pixels.
        corners_mm: (m, 3) of the board.
        lens: (3, 3) for pixels whose top-left centre is (0, 0).
        dist: (d,) OpenCV's distortion.
    """
    count, turns, shifts, _ = cv2.solvePnPGeneric(
        corners_mm[sight.ids], sight.pixels - 0.5, lens, dist, flags=cv2.SOLVEPNP_IPPE
    )
    out = []
    for turn, shift in zip(turns[:count], shifts[:count], strict=True):
        pose = np.eye(4)
        pose[:3, :3] = cv2.Rodrigues(turn)[0]
        pose[:3, 3] = shift.ravel()
        if np.isfinite(pose).all():
            out.append(pose)
    return out


def link(
    pairs: Sequence[tuple[Sight, Poses, Sight, Poses]],
    corners_mm: np.ndarray,
    lenses: Mapping[str, tuple[np.ndarray, np.ndarray]],
) -> tuple[np.ndarray, float]:
    """The pose of one camera relative to another by which most shared boards fit both pictures.

    Args:
        pairs: of each shared board the first camera's sight and poses, and the second's.
        corners_mm: (m, 3) of the board.
        lenses: as in `first_poses`.

    Returns:
        (4, 4) second from first, and the mean distance of the boards in the second picture, px.
    """
    some = pairs[:: -(-len(pairs) // MOST_SHARED)]
    best, least = np.eye(4), np.inf
    for _, ones, _, twos in some:
        for one, two in itertools.product(ones, twos):
            relative = two @ np.linalg.inv(one)
            misses = [
                min(_missed_px(sight, relative @ pose, corners_mm, lenses) for pose in poses)
                for _, poses, sight, _ in some
            ]
            if np.mean(misses) < least:
                best, least = relative, float(np.mean(misses))
    return best, least


def first_poses(
    sights: Sequence[Sight],
    corners_mm: np.ndarray,
    lenses: Mapping[str, tuple[np.ndarray, np.ndarray]],
) -> tuple[dict[str, np.ndarray], dict[int, np.ndarray]]:
    """Cameras and boards in the frame of the camera that saw most.

    Args:
        sights: of all cameras.
        corners_mm: (m, 3) of the board.
        lenses: camera to (3, 3) matrix (OpenCV's pixels) and (d,) distortion.

    Returns:
        Camera to (4, 4) camera from reference, cameras that share no board with it left out; and
        shot to (4, 4) reference from board. The reference itself is the identity, and first.
    """
    poses = {(s.camera, s.shot): board_poses_of(s, corners_mm, *lenses[s.camera]) for s in sights}
    poses = {key: found for key, found in poses.items() if found}
    names = sorted({camera for camera, _ in poses})
    seen = {name: {shot for camera, shot in poses if camera == name} for name in names}
    corners = {n: sum(len(s.ids) for s in sights if s.camera == n) for n in names}
    reference = max(names, key=lambda name: corners[name])
    sight = {(s.camera, s.shot): s for s in sights}
    links: dict[tuple[str, str], tuple[np.ndarray, float]] = {}
    for one, two in itertools.combinations(names, 2):
        shared = [
            (sight[one, shot], poses[one, shot], sight[two, shot], poses[two, shot])
            for shot in sorted(seen[one] & seen[two])
        ]
        if shared:
            found, miss = link(shared, corners_mm, lenses)
            cost = (miss + 1.0) / len(shared)
            links[one, two] = found, cost
            links[two, one] = np.linalg.inv(found), cost
    # Prim's tree: always the surest link onward.
    cameras = {reference: np.eye(4)}
    while True:
        onward = [(links[a, b][1], a, b) for a, b in links if a in cameras and b not in cameras]
        if not onward:
            break
        _, a, b = min(onward)
        cameras[b] = links[a, b][0] @ cameras[a]
    return _settled(cameras, poses, [s for s in sights if s.camera in cameras], corners_mm, lenses)


def _settled(
    cameras: dict[str, np.ndarray],
    poses: Mapping[tuple[str, int], Poses],
    sights: Sequence[Sight],
    corners_mm: np.ndarray,
    lenses: Mapping[str, tuple[np.ndarray, np.ndarray]],
) -> tuple[dict[str, np.ndarray], dict[int, np.ndarray]]:
    """Of all poses that sights fit, those of boards and cameras that miss all pixels least."""
    boards: dict[int, np.ndarray] = {}
    for _ in range(ROUNDS):
        for shot in sorted({s.shot for s in sights}):
            own = [s for s in sights if s.shot == shot]
            guesses = [
                np.linalg.inv(cameras[s.camera]) @ pose
                for s in own
                for pose in poses.get((s.camera, shot), [])
            ]
            if guesses:
                misses = [
                    [_missed_px(s, cameras[s.camera] @ g, corners_mm, lenses) for s in own]
                    for g in guesses
                ]
                boards[shot] = guesses[int(np.argmin(np.sum(misses, axis=1)))]
        for name in list(cameras)[1:]:
            own = [s for s in sights if s.camera == name and s.shot in boards]
            guesses = [cameras[name]] + [
                pose @ np.linalg.inv(boards[s.shot])
                for s in own
                for pose in poses.get((name, s.shot), [])
            ]
            misses = [
                [_missed_px(s, g @ boards[s.shot], corners_mm, lenses) for s in own]
                for g in guesses
            ]
            cameras[name] = guesses[int(np.argmin(np.sum(misses, axis=1)))]
    return cameras, boards


def _missed_px(
    sight: Sight,
    pose: np.ndarray,
    corners_mm: np.ndarray,
    lenses: Mapping[str, tuple[np.ndarray, np.ndarray]],
) -> float:
    """Median distance of a board's corners from a sight's, capped; distortion is passed over."""
    lens = lenses[sight.camera][0]
    local = corners_mm[sight.ids] @ pose[:3, :3].T + pose[:3, 3]
    shown = local @ lens.T
    with np.errstate(divide="ignore", invalid="ignore"):
        miss = np.linalg.norm(shown[:, :2] / shown[:, 2:] - sight.pixels + 0.5, axis=1)
    miss = np.where(local[:, 2] > 0, miss, np.inf)
    return float(min(np.median(miss), CAP_PX))
