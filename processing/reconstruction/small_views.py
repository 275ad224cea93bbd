"""Photographs in the size that they are matched in: means of what is usable, view by view.

Of large photographs no whole float picture is ever made.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import cv2
import numpy as np
from numba import njit, prange

from lightstage.formats.half import as_float
from lightstage.rig import Camera
from processing.frames.read import Frames


@dataclasses.dataclass(frozen=True)
class SmallView:
    """One camera's photographs, smaller by a whole factor.

    Attributes:
        camera: of the small pictures.
        images: (P, h, w, 3) float32 linear, means over usable pixels; 0 where not valid.
        valid: (h, w) bool, at least half a cell's pixels are usable.
        mask: (h, w) bool, foreground in any pixel of the cell.
        normals: (h, w, 3) float32 unit, world; 0 where unknown.
    """

    camera: Camera
    images: np.ndarray
    valid: np.ndarray
    mask: np.ndarray
    normals: np.ndarray


def matched_times(rows: int, finest_rows: int) -> int:
    """The power of two by which pictures of so many rows are made smaller."""
    times = 1
    while rows > finest_rows * times:
        times *= 2
    return times


def small_view(
    camera: Camera,
    frames: Frames,
    mask: np.ndarray,
    normals: np.ndarray,
    times: int,
    patterns: Sequence[str] | None = None,
) -> SmallView:
    """Make a camera's photographs smaller.

    Args:
        camera: of the rig.
        frames: its photographs.
        mask: (H, W) bool foreground.
        normals: (H, W, 3) world, unit or 0; what is not finite counts as 0.
        times: pixels a side of a cell.
        patterns: which of the photographs; None for all.
    """
    height, width = (-(-side // times) for side in frames.shape)
    wanted = frames.patterns if patterns is None else patterns
    chosen = np.array([frames.patterns.index(name) for name in wanted], np.int64)
    images = np.zeros((len(chosen), height, width, 3), np.float32)
    count = np.zeros((height, width), np.int32)
    corner = (frames.window.top, frames.window.left)
    clipped = np.asarray(frames.clipped).view()
    clipped.flags.writeable = False  # as a file's: the loop is compiled once
    _means(frames.bits, chosen, clipped, corner, times, np.float32(frames.scale), images, count)
    valid = 2 * count >= times * times
    images[:, ~valid] = 0
    inside = np.zeros((height, width), bool)
    mean = np.zeros((height, width, 3), np.float32)
    _reduced(mask, normals, times, inside, mean)
    return SmallView(of_cells(camera, times), images, valid, inside, mean)


def of_cells(camera: Camera, times: int) -> Camera:
    """A camera whose pixels are cells of `times` pixels a side, the last ones perhaps cut."""
    return dataclasses.replace(
        camera,
        width_px=-(-camera.width_px // times),
        height_px=-(-camera.height_px // times),
        fx_px=camera.fx_px / times,
        fy_px=camera.fy_px / times,
        cx_px=camera.cx_px / times,
        cy_px=camera.cy_px / times,
    )


def smaller_picture(
    picture: np.ndarray, mask: np.ndarray, times: int
) -> tuple[np.ndarray, np.ndarray]:
    """An (h, w) uint8 picture by means over whole cells, and which of them a mask holds wholly."""
    if times == 1:
        return picture, mask
    height, width = (side // times for side in mask.shape)
    cut = np.s_[: height * times, : width * times]
    small = cv2.resize(picture[cut], (width, height), interpolation=cv2.INTER_AREA)
    blocks = mask[cut].reshape(height, times, width, times)
    return np.asarray(small), np.asarray(blocks.all(axis=(1, 3)))


@njit(cache=True, parallel=True)
def _means(
    bits: np.ndarray,
    chosen: np.ndarray,
    clipped: np.ndarray,
    corner: tuple[int, int],
    times: int,
    scale: np.float32,
    images: np.ndarray,
    count: np.ndarray,
) -> None:
    """Fill `images` (P, h, w, 3) with means of halves (., H, W, 3) where nothing is clipped."""
    rows, columns = clipped.shape
    for y in prange(count.shape[0]):
        for row in range(y * times - corner[0], (y + 1) * times - corner[0]):
            if row < 0 or row >= rows:
                continue
            for column in range(columns):
                if clipped[row, column] == 0:
                    count[y, (column + corner[1]) // times] += 1
        for k in range(len(chosen)):
            picture, out = bits[chosen[k]], images[k]
            for row in range(y * times - corner[0], (y + 1) * times - corner[0]):
                if row < 0 or row >= rows:
                    continue
                for column in range(columns):
                    if clipped[row, column] == 0:
                        x = (column + corner[1]) // times
                        for c in range(3):
                            out[y, x, c] += as_float(picture[row, column, c])
            for x in range(count.shape[1]):
                if count[y, x] > 0:
                    for c in range(3):
                        out[y, x, c] *= scale / np.float32(count[y, x])


@njit(cache=True, parallel=True)
def _reduced(
    mask: np.ndarray, normals: np.ndarray, times: int, inside: np.ndarray, mean: np.ndarray
) -> None:
    """Fill `inside` with whether a cell has any of the mask, `mean` with its unit mean normal."""
    height, width = mask.shape
    for y in prange(inside.shape[0]):
        for row in range(y * times, min((y + 1) * times, height)):
            for column in range(width):
                x = column // times
                inside[y, x] |= mask[row, column]
                n = normals[row, column]
                if np.isfinite(n[0]) and np.isfinite(n[1]) and np.isfinite(n[2]):
                    for c in range(3):
                        mean[y, x, c] += n[c]
        for x in range(inside.shape[1]):
            n = mean[y, x]
            length = np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
            for c in range(3):
                # Normals that cancel each other give no direction.
                mean[y, x, c] = n[c] / length if length > 0.1 else np.float32(0)
