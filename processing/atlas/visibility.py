"""What each view sees of a mesh: a z-buffer, and how far every pixel is from a silhouette."""

from __future__ import annotations

import cv2
import numba
import numpy as np

from lightstage.rig import Camera

BAND_ROWS = 128
"""Rows that one thread fills."""


def depth_buffer(camera: Camera, vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Depth along the optical axis of the nearest surface at every pixel centre.

    Vertices are projected with distortion; inside a triangle the projection is taken for straight,
    which for triangles of a few mm is right to a thousandth of a pixel.

    Args:
        camera: the view.
        vertices: (n, 3) mm.
        triangles: (t, 3).

    Returns:
        (h, w) float32 mm, infinite where nothing is.
    """
    pixels, depth = camera.project(vertices)
    out = np.full((camera.height_px, camera.width_px), np.inf, np.float32)
    inverse = np.divide(1.0, depth, out=np.zeros_like(depth), where=depth > 0)
    _fill_depth(pixels, inverse, np.ascontiguousarray(triangles, np.int32), out)
    return out


def silhouette_distance(depth: np.ndarray, mask: np.ndarray, jump_mm: float) -> np.ndarray:
    """Distance in pixels of every pixel to the nearest occlusion edge, hole or mask border.

    Args:
        depth: (h, w) z-buffer.
        mask: (h, w) bool, pixels whose maps may be used.
        jump_mm: neighbouring depths farther apart than this are different surfaces.

    Returns:
        (h, w) float32, 0 on edges and outside.
    """
    inside = mask & np.isfinite(depth)
    out = np.zeros(depth.shape, np.float32)
    rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    if not len(rows):
        return out
    # A frame of two around what is inside: one for the neighbours, one that is surely outside.
    box = (
        slice(max(rows[0] - 2, 0), rows[-1] + 3),
        slice(max(columns[0] - 2, 0), columns[-1] + 3),
    )
    inside, near = inside[box], depth[box]
    finite = np.where(np.isfinite(near), near, np.float32(1e6))
    kernel = np.ones((3, 3), np.uint8)
    # A pixel is on an edge when it is behind a nearer surface or in front of a farther one;
    # a steep but connected surface passes, since its steps halve when the neighbourhood does.
    jump = cv2.dilate(finite, kernel) - cv2.erode(finite, kernel)
    inside &= np.asarray(jump) < jump_mm
    framed = np.zeros((near.shape[0] + 2, near.shape[1] + 2), np.uint8)
    framed[1:-1, 1:-1] = inside
    out[box] = np.asarray(cv2.distanceTransform(framed, cv2.DIST_L2, 5))[1:-1, 1:-1]
    return out


@numba.njit(cache=True, parallel=True)
def _fill_depth(
    pixels: np.ndarray, inverse: np.ndarray, triangles: np.ndarray, out: np.ndarray
) -> None:
    height, width = out.shape
    for band in numba.prange((height + BAND_ROWS - 1) // BAND_ROWS):
        top, bottom = band * BAND_ROWS, min((band + 1) * BAND_ROWS, height)
        for t in range(len(triangles)):
            a, b, c = triangles[t]
            x0, y0 = pixels[a]
            x1, y1 = pixels[b]
            x2, y2 = pixels[c]
            double_area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
            if not abs(double_area) > 0:  # degenerate, or a corner behind the camera (NaN)
                continue
            low = max(min(y0, y1, y2), top - 1.0)
            high = min(max(y0, y1, y2), bottom + 1.0)
            if not low <= high:
                continue
            left = max(0, int(np.ceil(max(min(x0, x1, x2), -1.0) - 0.5)))
            right = min(width, int(min(max(x0, x1, x2), width + 1.0) + 0.5) + 1)
            for row in range(max(top, int(np.ceil(low - 0.5))), min(bottom, int(high + 0.5) + 1)):
                y = row + 0.5
                for column in range(left, right):
                    x = column + 0.5
                    b0 = ((x1 - x) * (y2 - y) - (x2 - x) * (y1 - y)) / double_area
                    b1 = ((x2 - x) * (y0 - y) - (x0 - x) * (y2 - y)) / double_area
                    b2 = 1.0 - b0 - b1
                    if b0 >= -1e-9 and b1 >= -1e-9 and b2 >= -1e-9:
                        depth = 1.0 / (b0 * inverse[a] + b1 * inverse[b] + b2 * inverse[c])
                        if depth < out[row, column]:
                            out[row, column] = depth
