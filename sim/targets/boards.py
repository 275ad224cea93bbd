"""What is printed on flat targets, and how they are held: ChArUco board and 24-patch chart."""

from __future__ import annotations

import dataclasses
import functools

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from lightstage.rig import Rig
from sim.camera.chart import chart_reflectance
from sim.targets.plane import Plane

PAPER, INK = 0.85, 0.04
"""Reflectance of the board's white and black."""
CHART_FRAME = 0.035
"""Reflectance of what holds the chart's patches."""
CHART_PATCH, CHART_PITCH, CHART_BORDER = 2.5, 2.75, 0.25
"""Proportions of the classic chart: patch, patch and gap, border."""
CHART_ROWS, CHART_COLUMNS = 4, 6
NEARER_MM = 100.0
"""Boards are held so far before the middle of the stage and behind it."""


@dataclasses.dataclass(frozen=True)
class BoardConfig:
    """A ChArUco board.

    Attributes:
        columns: squares across.
        rows: squares down.
        square_mm: side of a square.
        marker_mm: side of a marker.
        margin_mm: white paper around the squares.
        texels_per_mm: of its picture.
    """

    columns: int = 8
    rows: int = 11
    square_mm: float = 20.0
    marker_mm: float = 12.0
    margin_mm: float = 8.0
    texels_per_mm: int = 12

    def board(self) -> cv2.aruco.CharucoBoard:
        """OpenCV's board, as a detector wants it; markers of DICT_4X4_50."""
        dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
        size = (self.columns, self.rows)
        return cv2.aruco.CharucoBoard(size, self.square_mm, self.marker_mm, dictionary)

    def corners_mm(self) -> np.ndarray:
        """((columns - 1)(rows - 1), 2) inner corners of the squares, by OpenCV's corner id."""
        return np.asarray(self.board().getChessboardCorners())[:, :2].astype(float)

    def plane(self, world_from_target: np.ndarray) -> Plane:
        """The board in the stage by a (4, 4) pose; its origin: the first square's outer corner."""
        picture = _printed(self)
        corner = -round(self.margin_mm * self.texels_per_mm) / self.texels_per_mm
        height, width = (side / self.texels_per_mm for side in picture.shape[:2])
        return Plane(picture, (corner, corner), (width, height), world_from_target)


@functools.lru_cache(maxsize=4)
def _printed(config: BoardConfig) -> np.ndarray:
    """(rows, columns, 3) float32 reflectance of a board with its margin."""
    texels = config.texels_per_mm
    inner = (
        round(config.columns * config.square_mm * texels),
        round(config.rows * config.square_mm * texels),
    )
    printed = config.board().generateImage(inner, marginSize=0, borderBits=1)
    printed = np.pad(printed, round(config.margin_mm * texels), constant_values=255)
    grey = np.where(printed > 127, PAPER, INK).astype(np.float32)
    return np.repeat(grey[..., None], 3, axis=2)


def chart_plane(width_mm: float, world_from_target: np.ndarray) -> Plane:
    """The 24-patch chart, its origin its own top left corner.

    Args:
        width_mm: of the whole chart.
        world_from_target: (3, 4) its pose.
    """
    units = CHART_COLUMNS * CHART_PITCH + CHART_BORDER, CHART_ROWS * CHART_PITCH + CHART_BORDER
    texels = 40  # per unit: every edge of a patch is an edge of texels
    shape = round(units[1] * texels), round(units[0] * texels), 3
    picture = np.full(shape, CHART_FRAME, np.float32)
    for index, colour in enumerate(chart_reflectance()):
        row, column = divmod(index, CHART_COLUMNS)
        top = round((CHART_BORDER + row * CHART_PITCH) * texels)
        left = round((CHART_BORDER + column * CHART_PITCH) * texels)
        side = round(CHART_PATCH * texels)
        picture[top : top + side, left : left + side] = colour
    return Plane(picture, (0.0, 0.0), (width_mm, width_mm * units[1] / units[0]), world_from_target)


def chart_patches_mm(width_mm: float) -> np.ndarray:
    """(24, 4, 2) corners of the patches on the chart, clockwise from the top left."""
    unit = width_mm / (CHART_COLUMNS * CHART_PITCH + CHART_BORDER)
    row, column = np.divmod(np.arange(24), CHART_COLUMNS)
    first = CHART_BORDER + CHART_PITCH * np.stack([column, row], axis=1)
    square = CHART_PATCH * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    return unit * (first[:, None] + square)


def facing(toward: np.ndarray, middle_mm: np.ndarray, size_mm: np.ndarray) -> np.ndarray:
    """(3, 4) pose of a plane of a size whose face looks one way, upright, its middle at a place."""
    z = -toward / np.linalg.norm(toward)
    up = np.array([0.0, 1.0, 0.0]) if abs(z[1]) < 0.95 else np.array([0.0, 0.0, 1.0])
    # For who looks at the face: x right, y down, z away.
    x = np.cross(z, up)
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(z, x), z], axis=1)
    return _placed(rotation, middle_mm, size_mm)


def board_poses(rig: Rig, config: BoardConfig, count: int, seed: int) -> np.ndarray:
    """Poses as someone holds a board for one camera after the other, tilted each time.

    In the first round a hand's width before the middle of the stage, in the second behind it, and
    so on: that parts a camera's focal length from its distance.

    Args:
        rig: the cameras.
        config: of the board.
        count: how many.
        seed: of tilts and places.

    Returns:
        (count, 3, 4).
    """
    rng = np.random.default_rng([seed, 0xC4A])
    size = np.array([config.columns, config.rows]) * config.square_mm
    out = np.zeros((count, 3, 4))
    for index in range(count):
        camera = rig.cameras[index % len(rig.cameras)]
        pose = facing(camera.centre_mm, np.zeros(3), size)[:, :3]
        tilt = Rotation.from_euler("xyz", rng.uniform(-1, 1, 3) * [30.0, 30.0, 20.0], degrees=True)
        middle = rng.uniform(-1, 1, 3) * [30.0, 40.0, 30.0]
        nearer = NEARER_MM if (index // len(rig.cameras)) % 2 == 0 else -NEARER_MM
        middle += nearer * camera.centre_mm / np.linalg.norm(camera.centre_mm)
        out[index] = _placed(pose @ tilt.as_matrix(), middle, size)
    return out


def _placed(rotation: np.ndarray, middle_mm: np.ndarray, size_mm: np.ndarray) -> np.ndarray:
    """(3, 4) pose with a rotation and the middle of a plane of a size at a place."""
    middle = np.array([size_mm[0] / 2, size_mm[1] / 2, 0.0])
    return np.concatenate([rotation, (middle_mm - rotation @ middle)[:, None]], axis=1)
