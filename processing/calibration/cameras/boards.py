"""ChArUco boards in photographs: which corners, where to a fraction of a pixel."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import cv2
import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.board import BoardConfig
from processing.calibration.folder import Pose
from processing.calibration.picture import read_mosaic

FEWEST = 8
"""Fewer corners than this determine a pose too poorly."""
LARGEST_PX = 1600
"""Markers are found in a picture whose longer side is at most this; corners in the whole."""


@dataclasses.dataclass(frozen=True)
class Sight:
    """One board as one camera saw it.

    Attributes:
        shot: which holding of the board.
        camera: id.
        ids: (n,) int64 of the corners.
        pixels: (n, 2) where they are, the top-left pixel's centre at (0.5, 0.5).
    """

    shot: int
    camera: str
    ids: np.ndarray
    pixels: np.ndarray


def find_board(picture: np.ndarray, board: cv2.aruco.CharucoBoard) -> tuple[np.ndarray, np.ndarray]:
    """Corners of a board in a picture [GarridoJurado2014].

    Markers are found in a small 8-bit picture; the corners between them are then refined as saddle
    points of the whole picture's linear light, which neither rounding nor encoding has touched.

    Args:
        picture: (h, w) float32 linear grey.
        board: OpenCV's.

    Returns:
        (n,) int64 ids and (n, 2) float64 pixels, the top-left pixel's centre at (0.5, 0.5). None
        are found in a picture that is black or not a number.
    """
    none = np.zeros(0, np.int64), np.zeros((0, 2))
    light = np.nan_to_num(picture, nan=0.0, posinf=0.0, neginf=0.0).astype(np.float32)
    top = float(np.percentile(light[::4, ::4], 99.5)) if light.size else 0.0
    if not top > 0:
        return none
    light = np.clip(light / top, 0, 1.2)
    shrink = max(1, -(-max(light.shape) // LARGEST_PX))
    height, width = (side // shrink * shrink for side in light.shape)
    whole = light[:height, :width]
    small = whole.reshape(height // shrink, shrink, width // shrink, shrink).mean(axis=(1, 3))
    encoded = np.round(255 * np.minimum(small, 1) ** (1 / 2.2)).astype(np.uint8)
    corners, ids, *_ = cv2.aruco.CharucoDetector(board).detectBoard(encoded)
    if ids is None or len(ids) < FEWEST:
        return none
    found = (np.asarray(corners, float).reshape(-1, 2) + 0.5) * shrink - 0.5
    numbers = np.asarray(ids).ravel().astype(np.int64)
    start = found.astype(np.float32).reshape(-1, 1, 2).copy()
    half = _window_px(found, numbers, board)
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 40, 1e-3)
    # Edges one pixel wide are too steep for the gradients that the refinement takes: without this
    # blur corners of a photograph without noise are .08 px off, with it .01.
    soft = cv2.GaussianBlur(light, (0, 0), min(max(0.2 * half, 0.7), 3.0))
    refined = cv2.cornerSubPix(soft, start, (half, half), (-1, -1), stop)
    pixels = np.asarray(refined, float).reshape(-1, 2)
    kept = np.linalg.norm(pixels - found, axis=1) < half
    return numbers[kept], pixels[kept] + 0.5


def _window_px(pixels: np.ndarray, ids: np.ndarray, board: cv2.aruco.CharucoBoard) -> int:
    """Half a window that ends before the markers: a fifth of a square, as seen, and 3 at least."""
    places = np.asarray(board.getChessboardCorners(), float)[ids, :2]
    apart_mm = np.linalg.norm(places[:, None] - places[None], axis=2)
    apart_px = np.linalg.norm(pixels[:, None] - pixels[None], axis=2)
    next_to = np.isclose(apart_mm, board.getSquareLength())
    gap = board.getSquareLength() - board.getMarkerLength()
    share = min(0.2, 0.45 * gap / board.getSquareLength())
    if not next_to.any():
        return 3
    # The narrowest way across: boards are seen from the side too.
    return int(max(3, share * np.percentile(apart_px[next_to], 5)))


def green(path_light: np.ndarray, channels: np.ndarray) -> np.ndarray:
    """(h/2, w/2) a mosaic's greens, averaged in each 2 x 2 cell, whose middle is theirs.

    Args:
        path_light: (h, w) counts above black.
        channels: (2, 2) which of R G B (0, 1, 2) the top left four pixels see.
    """
    places = [place for place in range(4) if channels[place // 2, place % 2] == 1]
    parts = [path_light[place // 2 :: 2, place % 2 :: 2] for place in places]
    return np.asarray(np.mean(parts, axis=0, dtype=np.float32))


def see_boards(
    poses: Sequence[Pose], config: BoardConfig, progress: ProgressCallback = quiet
) -> list[Sight]:
    """Boards in the RAW photographs of all cameras.

    Args:
        poses: holdings of the board, each photographed by all cameras.
        config: the board.
        progress: of photographs.

    Raises:
        FormatError: a photograph that cannot be read.
    """
    board = config.board()
    total = sum(len(pose.session.camera_ids()) for pose in poses)
    sights, done = [], 0
    for shot, pose in enumerate(poses):
        for camera in pose.session.camera_ids():
            mosaic = read_mosaic(pose.photograph(camera))
            ids, pixels = find_board(green(mosaic.level, mosaic.channels), board)
            if len(ids) >= FEWEST:
                sights.append(Sight(shot, camera, ids, 2 * pixels))
            done += 1
            progress(done, total)
    return sights
