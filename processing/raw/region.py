"""Where the face is, by a coarse preview of a photograph before anything is developed."""

from __future__ import annotations

import numpy as np

from lightstage.rig import Camera
from processing.frames.window import Window, box_of, whole
from processing.masks import foreground
from processing.raw.raw_file import RawFile

LONG_SIDE = 400
"""Cells along a preview's longer side, about."""
MARGIN_SHARE = 0.01
"""Share of the picture's longer side by which a window is wider than what was found."""
SAFETY = 0.5
"""A preview's threshold against that of the mask: a window must hold what the mask will."""


def preview(raw: RawFile) -> tuple[np.ndarray, int]:
    """A photograph's brightest colour in every so many rows and columns.

    One 2 x 2 cell of the mosaic is read in each square: no picture is made.

    Returns:
        (rows, columns) float32 of the upright picture, share of white, and the squares' side in
        pixels.
    """
    side = cell_px(raw.size)
    rows, columns = raw.size[0] // side * side, raw.size[1] // side * side
    top, left = raw.origin
    if raw.colours is None:
        few = raw.counts[:rows:side, :columns:side].astype(np.float32)
        share = (few - raw.black.astype(np.float32)) / (raw.white - raw.black).astype(np.float32)
        balanced = share * raw.neutral.astype(np.float32)
    else:
        balanced = np.zeros((rows // side, columns // side, 3), np.float32)
        for place, colour in enumerate(raw.colours.ravel()):
            y, x = place // 2, place % 2
            few = raw.counts[top + y : top + rows : side, left + x : left + columns : side].astype(
                np.float32
            )
            gain = raw.neutral[colour] * (0.5 if colour == 1 else 1.0) / raw.span
            balanced[..., colour] += (few - np.float32(raw.black[y, x])) * np.float32(gain)
    return np.ascontiguousarray(raw.orientation.upright(balanced.max(axis=2))), side


def cell_px(size: tuple[int, int]) -> int:
    """Even side of a preview's squares for a picture of (rows, columns)."""
    return max(2, round(max(size) / LONG_SIDE / 2) * 2)


def find_window(look: np.ndarray, side: int, shape: tuple[int, int], share: float) -> Window:
    """The part of a picture that holds what was lit.

    Args:
        look: (rows, columns) of `preview`, or the largest of several patterns'.
        side: pixels of its squares.
        shape: rows and columns of the whole picture.
        share: see `masks.foreground`; half of it is used here.

    Returns:
        A window with a margin; the whole picture where nothing is lit or it is too small.
    """
    if min(look.shape) < 32:
        return whole(shape)
    box = box_of(foreground(look, SAFETY * share))
    if box.empty:
        return whole(shape)
    found = Window(box.top * side, box.left * side, box.height * side, box.width * side)
    return found.grown(round(MARGIN_SHARE * max(shape)) + 2 * side, shape)


def mesh_window(vertices: np.ndarray, camera: Camera, margin_mm: float) -> Window:
    """The part of a picture that shows a mesh.

    Args:
        vertices: (n, 3) world, mm.
        camera: which sees it.
        margin_mm: kept around it.

    Returns:
        A window inside of the picture; empty where the camera sees no vertex.
    """
    shape = (camera.height_px, camera.width_px)
    places, depth = camera.project(vertices)
    ahead = (depth > 1.0) & np.isfinite(places).all(axis=1)
    if not ahead.any():
        return Window(0, 0, 0, 0)
    places = places[ahead]
    margin = margin_mm * camera.fx_px / float(np.median(depth[ahead]))
    low = np.floor(places.min(axis=0) - margin).astype(int)
    high = np.ceil(places.max(axis=0) + margin).astype(int)
    box = Window(int(low[1]), int(low[0]), int(high[1] - low[1]), int(high[0] - low[0]))
    return box.and_also(whole(shape))
