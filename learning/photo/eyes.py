"""Eyes that a photograph shows open, and the brightness of their whites."""

from __future__ import annotations

import cv2
import numpy as np

from lightstage.faces.eyes import Eye, see_eye
from processing.colour import srgb_from_linear

EYES = (slice(36, 42), slice(42, 48))
"""Outlines among iBUG's 68 landmarks [Sagonas2016]."""
SKIN = (2, 14, 29, 30, 31, 35)
"""Beside these landmarks (jaw, nose) nearly every photograph shows skin."""
LEAST_PX = 8
"""Least width of an eye in which its white can be distinguished from its iris."""
AS_BRIGHT, AS_COLOURED, LEAST_SHARE = 0.4, 0.7, 0.08
"""White is at least so bright beside skin, at most so saturated, and this share of an open eye."""
LEAST_SATURATION = 0.02
"""Of skin: below it a photograph has no colour."""
GROWN = 2.0
"""White that reaches into the eye's outline is followed so far beyond, in sizes of the outline: the
detector's is a few millimetres off."""
IRIS = 0.2
"""Its radius, of an eye's width."""
FINER = 4
"""Pixels on a pixel's side in which an eye's outlines are drawn."""
IRIS_BORDER, LID_BORDER = 1.2, 0.08
"""Radius of what is left out with the iris, and width of what is left out at the lids, in radii of
the iris: the border of the iris and lashes are dark."""
LEAST_WHITE_PX = 2.0
"""Pixels of white at least."""
WHITE_RANGE = 0.5, 0.9
"""Quantiles of brightness between which a white is taken: below is shade, above are highlights."""
OUTERMOST = 0.03
"""Share of the white's pixels that its extent leaves out on each side."""


def openings(rgb_linear: np.ndarray, marks: np.ndarray) -> np.ndarray:
    """Where a face's eyes are open: parallelograms that hold their whites and irises.

    Args:
        rgb_linear: (h, w, 3).
        marks: (68, 2) px of iBUG's landmarks, NaN where hidden.

    Returns:
        (2, 3, 2) px, of the person's right and left eye: the corner up and left in an upright face,
        the side from there to the face's left, and the side down. NaN where no white is seen,
        and where the photograph has no colour: lids in light are as bright as whites.
    """
    found = np.full((2, 3, 2), np.nan)
    skin = _skin(rgb_linear, marks)
    if skin is None or _saturation(skin) < LEAST_SATURATION:
        return found
    for index, outline in enumerate(EYES):
        eye = marks[outline]
        if not np.isfinite(eye).all() or np.ptp(eye[:, 0]) < LEAST_PX:
            continue
        opening = _opening(rgb_linear, eye, skin)
        if opening is not None:
            found[index] = opening
    return found


def whites(rgb_linear: np.ndarray, marks: np.ndarray) -> np.ndarray:
    """Find how bright the whites of a face's eyes are.

    Args:
        rgb_linear: (h, w, 3).
        marks: (68, 2) px of iBUG's landmarks, NaN where hidden.

    Returns:
        (2, 3) linear value, of the person's right and left eye: the median of the brighter half of
        what is between the lids and beside the iris, without highlights. NaN where too little of
        it is seen.
    """
    found = np.full((2, 3), np.nan)
    shown = np.clip(np.nan_to_num(rgb_linear), 0, 1)
    codes = np.round(255 * srgb_from_linear(shown)).astype(np.uint8)
    for index, outline in enumerate(EYES):
        corners = marks[outline][[0, 3] if index == 0 else [3, 0]]
        if not np.isfinite(corners).all() or np.ptp(corners[:, 0]) < LEAST_PX:
            continue
        if not _inside_picture(corners, shown.shape):
            continue
        value = _white_of(shown, see_eye(codes, corners, index == 0))
        if value is not None:
            found[index] = value
    return found


def _inside_picture(places: np.ndarray, shape: tuple[int, ...]) -> bool:
    """Tell whether (n, 2) places are in a picture of a shape."""
    return bool((places >= 0).all() and (places < shape[1::-1]).all())


def _white_of(rgb: np.ndarray, eye: Eye) -> np.ndarray | None:
    """(3,) median of an eye's white, None where too little is seen."""
    low = np.maximum(np.floor(eye.lids_px.min(axis=0)).astype(int) - 1, 0)
    high = np.ceil(eye.lids_px.max(axis=0)).astype(int) + 2
    part = rgb[low[1] : high[1], low[0] : high[0]].astype(np.float32)
    if not min(part.shape[:2]):
        return None
    # An eye of few pixels is enlarged, so that its outlines fall between them.
    fine = cv2.resize(part, None, fx=FINER, fy=FINER, interpolation=cv2.INTER_LINEAR)
    inside = np.zeros(fine.shape[:2], np.uint8)
    cv2.fillPoly(inside, [np.round((eye.lids_px - low) * FINER).astype(np.int32)], 1)
    middle = np.round((eye.iris_px - low) * FINER).astype(int).tolist()
    cv2.circle(inside, middle, round(IRIS_BORDER * eye.radius_px * FINER), 0, -1)
    edge = 2 * round(LID_BORDER * eye.radius_px * FINER) + 1
    seen = fine[cv2.erode(inside, np.ones((edge, edge), np.uint8)) > 0]
    if len(seen) < LEAST_WHITE_PX * FINER**2:
        return None
    level = seen.mean(axis=1)
    least, most = np.quantile(level, WHITE_RANGE)
    return np.asarray(np.median(seen[(level >= least) & (level <= most)], axis=0))


def _opening(rgb: np.ndarray, eye: np.ndarray, skin: np.ndarray) -> np.ndarray | None:
    """(3, 2) of `openings` for an eye's (6, 2) outline; None where no white is seen."""
    middle = eye.mean(axis=0)
    grown = GROWN * (eye - middle) + middle
    # The eye's part alone is examined, however large the photograph is.
    size = np.array(rgb.shape[1::-1])
    low = np.clip(np.floor(grown.min(axis=0)), 0, size - 1).astype(int)
    high = np.clip(np.ceil(grown.max(axis=0)) + 1, low + 1, size).astype(int)
    part = rgb[low[1] : high[1], low[0] : high[0]]
    finite = np.isfinite(part).all(axis=2)
    inside = _inside(eye - low, finite.shape)
    part = np.where(finite[..., None], part, 0)
    white = _white(part, skin) & finite & (inside | _inside(grown - low, finite.shape))
    count = (inside & finite).sum()
    if count == 0 or (white & inside).sum() / count < LEAST_SHARE:
        return None
    _, parts = cv2.connectedComponents(white.astype(np.uint8))
    row, column = np.nonzero(white & np.isin(parts, np.unique(parts[white & inside])))
    width = max(float(np.linalg.norm(eye[3] - eye[0])), 1e-6)
    along = (eye[3] - eye[0]) / width
    axes = np.array([along, [-along[1], along[0]]])
    places = (np.column_stack([column, row]) + low + 0.5) @ axes.T
    first, last = np.quantile(places, [OUTERMOST, 1 - OUTERMOST], axis=0)
    # The iris lies between its whites, of which one may be hidden or in shade.
    iris = axes[0] @ middle + IRIS * width * np.array([-1, 1])
    first[0], last[0] = min(first[0], iris[0]), max(last[0], iris[1])
    return np.stack([first @ axes, *((last - first)[:, None] * axes)])


def _skin(rgb: np.ndarray, marks: np.ndarray) -> np.ndarray | None:
    """(3,) skin's colour, the median around some landmarks; None where nothing is known of it."""
    known = marks[np.isfinite(marks).all(axis=1)]
    if not len(known):
        return None
    around = max(2, int(0.04 * np.ptp(known, axis=0).max()))
    beside = marks[list(SKIN)]
    beside = beside[np.isfinite(beside).all(axis=1)]
    near = np.clip(beside, 0, rgb.shape[1::-1]).astype(int)
    squares = [
        rgb[max(row - around, 0) : row + around, max(column - around, 0) : column + around]
        for column, row in near
    ]
    colours = np.concatenate([np.zeros((0, 3)), *(each.reshape(-1, 3) for each in squares)])
    colours = colours[np.isfinite(colours).all(axis=1)]
    found = np.median(colours, axis=0) if len(colours) else np.zeros(3)
    return found if found.max() > 0 else None


def _white(rgb: np.ndarray, skin: np.ndarray) -> np.ndarray:
    """(h, w) bool, pixels nearly as bright as skin and clearly less coloured."""
    bright = rgb.mean(axis=-1) > AS_BRIGHT * skin.mean()
    plain = _saturation(rgb) < AS_COLOURED * _saturation(skin)
    return np.asarray(bright & plain)


def _inside(eye: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """(h, w) bool, pixels of a picture within an outline."""
    opening = np.zeros(shape, np.uint8)
    near = np.clip(eye, -1, np.array(shape[::-1]))
    cv2.fillPoly(opening, [np.round(near).astype(np.int32)], 1)
    return opening > 0


def _saturation(rgb: np.ndarray) -> np.ndarray:
    """(...) of (..., 3), from 0, grey, to 1."""
    most = rgb.max(axis=-1)
    return np.asarray((most - rgb.min(axis=-1)) / np.maximum(most, 1e-6))
