"""The 24-patch colour chart in a photograph: its patches' places and readings, and its pose.

OpenCV's detector finds the chart and places patches up to a quarter of a patch off. So each patch
is grown from its middle, and one homography of the 6 x 4 grid is fitted to the patches' centroids.
"""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np

from lightstage.rig import Camera

ROWS, COLUMNS = 4, 6
PATCH_SHARE = 0.9
"""Side of a patch as a share of the pitch, on the classic chart."""
INNER_SHARE = 0.55
"""Share of a patch's side that is read: the frame is blurred into its edges."""
LOOKED_AT_PX = 1200
"""Longer side of the picture in which the chart is searched for."""
GROW = 14
"""A patch's pixels differ from its middle by at most so much of 255, encoded for display."""


@dataclasses.dataclass(frozen=True)
class ChartView:
    """A chart in one picture of 2 x 2 cells.

    Attributes:
        image_from_grid: (3, 3) homography from the grid to the picture's pixels; the grid's unit is
            the pitch, its origin the first patch's middle, +x along its rows. The top left pixel's
            middle is (0, 0).
        rgb: (24, 3) raw readings of the patches' inner parts, row by row.
        noise: (24, 3) standard error of them.
        clipped: (24,) share of the pixels at the white level.
        grown: how many patches the homography was fitted to.
        fit_px: RMS distance of those patches' centroids from it.
    """

    image_from_grid: np.ndarray
    rgb: np.ndarray
    noise: np.ndarray
    clipped: np.ndarray
    grown: int
    fit_px: float

    @property
    def places_px(self) -> np.ndarray:
        """(24, 2) the patches' middles in the picture."""
        return _through(self.image_from_grid, grid_places())


def grid_places() -> np.ndarray:
    """(24, 2) the patches' middles on the grid, row by row."""
    rows, columns = np.divmod(np.arange(ROWS * COLUMNS), COLUMNS)
    return np.stack([columns, rows], axis=1).astype(float)


def find_chart(rgb: np.ndarray, clipped: np.ndarray) -> ChartView | None:
    """Find the classic 24-patch chart.

    Args:
        rgb: (h, w, 3) float32 linear raw readings, 1 = white level.
        clipped: (h, w) bool.

    Returns:
        The chart, with the dark skin's patch first; None where there is none.
    """
    factor = min(1.0, LOOKED_AT_PX / max(rgb.shape[:2]))
    small = cv2.resize(rgb, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    shown = _shown(small)
    corners = _detected(shown)
    if corners is None:
        return None
    found = _grown_grid(shown, corners.mean(axis=1))
    if found is None:
        return None
    homography, grown, fit_px = found
    # Pixels of the small picture to those of the whole: middles at whole numbers.
    up = np.array([[1 / factor, 0, 0.5 / factor - 0.5], [0, 1 / factor, 0.5 / factor - 0.5]])
    whole = np.concatenate([up, [[0, 0, 1]]]) @ homography
    read = _read_patches(rgb, clipped, whole)
    if read is None:
        return None
    return ChartView(whole, *read, grown, fit_px / factor)


def chart_places_mm(
    view: ChartView, camera: Camera, pitch_mm: float | None
) -> tuple[np.ndarray, np.ndarray]:
    """Where a chart's patches are in the world.

    Args:
        view: from a picture of 2 x 2 cells of this camera.
        camera: that took it.
        pitch_mm: between the middles of neighbouring patches; None: the chart's middle is as far
            from the camera as the stage's centre is, as somebody holds it there.

    Returns:
        (24, 3) places in mm, and (3,) the unit normal of the chart's face.
    """
    grid = grid_places() - [(COLUMNS - 1) / 2, (ROWS - 1) / 2]
    flat = np.concatenate([grid, np.zeros((len(grid), 1))], axis=1)
    # A cell's middle is the corner between its four pixels; OpenCV counts pixels' middles.
    pixels = 2.0 * view.places_px + 0.5
    _, turns, shifts, _ = cv2.solvePnPGeneric(
        flat, pixels, camera.opencv_matrix, np.array(camera.dist), flags=cv2.SOLVEPNP_IPPE
    )
    rotation, shift = cv2.Rodrigues(turns[0])[0], shifts[0].ravel()
    rotation, shift = _refined(flat, pixels, camera, rotation, shift)
    if pitch_mm is None:
        pitch_mm = float(np.linalg.norm(camera.centre_mm) / np.linalg.norm(shift))
    local = (flat @ rotation.T + shift) * pitch_mm
    turn, move = camera.cam_from_world[:, :3], camera.cam_from_world[:, 3]
    # The grid's z points away from a viewer of the face.
    return (local - move) @ turn, -(turn.T @ rotation[:, 2])


def _refined(
    flat: np.ndarray, pixels: np.ndarray, camera: Camera, rotation: np.ndarray, shift: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The pose of least reprojection error near one given."""
    turn, moved = cv2.solvePnPRefineLM(
        flat,
        pixels,
        camera.opencv_matrix,
        np.array(camera.dist),
        cv2.Rodrigues(rotation)[0],
        shift.reshape(3, 1).copy(),
    )
    return cv2.Rodrigues(turn)[0], np.asarray(moved).ravel()


def _shown(rgb: np.ndarray) -> np.ndarray:
    """(h, w, 3) uint8 R G B, balanced by what is bright and encoded, for detectors."""
    top = np.maximum(np.percentile(rgb, 99.5, axis=(0, 1)), 1e-6)
    return np.asarray((255 * np.clip(rgb / top, 0, 1) ** (1 / 2.2)).astype(np.uint8))


def _detected(shown: np.ndarray) -> np.ndarray | None:
    """(24, 4, 2) corners of the patches as OpenCV's detector places them."""
    detector = cv2.mcc.CCheckerDetector.create()
    detector.setColorChartType(cv2.mcc.MCC24)
    if not detector.process(np.ascontiguousarray(shown[..., ::-1]), 1):
        return None
    charts = detector.getBestColorChecker().getColorCharts()
    return np.asarray(charts, float).reshape(ROWS * COLUMNS, 4, 2)


def _grown_grid(shown: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, int, float] | None:
    """A homography of the grid fitted to the patches' own shapes: it, how many, RMS in pixels."""
    smooth = cv2.medianBlur(shown, 3)
    grid = grid_places()
    homography, _ = cv2.findHomography(grid, places)
    for _ in range(3):
        middles, kept = [], []
        if homography is None:
            return None
        for index in range(len(grid)):
            middle = _grow(smooth, homography, grid[index])
            if middle is not None:
                middles.append(middle)
                kept.append(index)
        if len(kept) < 8:
            return None
        homography, inliers = cv2.findHomography(
            grid[kept], np.array(middles), cv2.RANSAC, 0.1 * _pitch_px(homography)
        )
    if homography is None:
        return None
    chosen = inliers.ravel() > 0
    off = _through(homography, grid[kept]) - np.array(middles)
    return homography, int(chosen.sum()), float(np.sqrt(np.mean(np.sum(off[chosen] ** 2, axis=1))))


def _pitch_px(homography: np.ndarray) -> float:
    """The grid's pitch in pixels in the chart's middle."""
    middle = np.array([(COLUMNS - 1) / 2, (ROWS - 1) / 2])
    ends = _through(homography, middle + np.array([[0, 0], [1, 0], [0, 1]]))
    return float(np.mean(np.linalg.norm(ends[1:] - ends[0], axis=1)))


def _grow(smooth: np.ndarray, homography: np.ndarray, place: np.ndarray) -> np.ndarray | None:
    """(2,) centroid of the even patch around a place of the grid; None where it is none.

    A patch as dark as the frame around it grows into the frame, and is left out by its size.
    """
    side = PATCH_SHARE / 2
    square = place + side * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    area = cv2.contourArea(_through(homography, square).astype(np.float32))
    reach = _through(homography, place + np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]))
    first = np.maximum(np.floor(reach.min(axis=0)).astype(int), 0)
    last = np.minimum(np.ceil(reach.max(axis=0)).astype(int) + 1, smooth.shape[1::-1])
    seed = np.round(_through(homography, place[None])[0]).astype(int) - first
    if (last - first < 4).any() or (seed < 0).any() or (seed >= last - first).any():
        return None
    part = np.ascontiguousarray(smooth[first[1] : last[1], first[0] : last[0]])
    mask = np.zeros((part.shape[0] + 2, part.shape[1] + 2), np.uint8)
    flags = 4 | (1 << 8) | cv2.FLOODFILL_FIXED_RANGE | cv2.FLOODFILL_MASK_ONLY
    start = (int(seed[0]), int(seed[1]))
    cv2.floodFill(part, mask, start, 0, (GROW,) * 3, (GROW,) * 3, flags)
    inside = np.argwhere(mask[1:-1, 1:-1])
    if not 0.5 * area < len(inside) < 1.4 * area:
        return None
    return np.asarray(inside[:, ::-1].mean(axis=0) + first)


def _read_patches(
    rgb: np.ndarray, clipped: np.ndarray, homography: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Readings, their standard errors and clipped shares of the patches' inner parts."""
    side = PATCH_SHARE * INNER_SHARE / 2
    square = side * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    read, noise, cut = np.zeros((24, 3)), np.zeros((24, 3)), np.zeros(24)
    for index, place in enumerate(grid_places()):
        outline = _through(homography, place + square)
        first = np.floor(outline.min(axis=0)).astype(int)
        last = np.ceil(outline.max(axis=0)).astype(int) + 1
        if (first < 0).any() or (last > np.array(rgb.shape[1::-1])).any():
            return None
        mask = np.zeros((last - first)[::-1], np.uint8)
        cv2.fillConvexPoly(mask, np.round(outline - first).astype(np.int32), 1)
        inside = mask > 0
        part = slice(first[1], last[1]), slice(first[0], last[0])
        values = rgb[part][inside].astype(float)
        read[index] = values.mean(axis=0)
        noise[index] = values.std(axis=0) / np.sqrt(len(values))
        cut[index] = clipped[part][inside].mean()
    return read, noise, cut


def _through(homography: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(n, 2) points through a homography."""
    whole = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ homography.T
    return np.asarray(whole[:, :2] / whole[:, 2:])
