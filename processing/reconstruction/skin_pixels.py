"""Thin things before the skin that have no colour, such as the frame of glasses.

No photometric normal follows from the colour of such pixels. A patch that holds them and skin is
matched at the depth of whichever has more contrast: a frame's dark line pulls the skin beside it
forward by as far as a patch reaches. So the skin is matched without them. Wide regions, such as
hair and grey cloth, stay: they have a surface of their own, and the skull's is needed. Single
pixels, such as pupils and the hairs of a beard, stay too: without all that is beside them too
little skin would be left.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import cv2
import numpy as np

from processing.readings import px_per_mm
from processing.reconstruction.views import View

WIDE_MM = 8.0
"""A region without a normal is wide where a disc of this diameter fits into it, and beside that."""
BESIDE_PX = 1
"""Pixels so near to one without a normal show both."""
LEAST_SHARE = 0.001
"""Share of the foreground; smaller regions without a normal stay."""


def skin_alone(views: Sequence[View]) -> list[View]:
    """The views without thin regions that have no normal, and without the pixels beside them.

    A view in which there is no such region, or no pixel has a normal, stays as it is.

    Args:
        views: with their foregrounds; these stay.
    """
    return [_skin_alone(view) for view in views]


def _skin_alone(view: View) -> View:
    known = np.einsum("hwk,hwk->hw", view.normals, view.normals) > 0
    other = (view.mask & ~known).astype(np.uint8)
    if not known.any() or not other.any():
        return view
    thin = _thin(other, view.mask, px_per_mm(view.camera))
    _, labels, stats, _ = cv2.connectedComponentsWithStats(thin)
    large = stats[:, cv2.CC_STAT_AREA] > LEAST_SHARE * np.count_nonzero(view.mask)
    large[0] = False
    if not large.any():
        return view
    kernel = np.ones((2 * BESIDE_PX + 1, 2 * BESIDE_PX + 1), np.uint8)
    beside = cv2.dilate(large[labels].astype(np.uint8), kernel) > 0
    textures = np.where(beside[..., None], np.float32(np.nan), view.textures)
    return dataclasses.replace(view, textures=textures)


def _thin(region: np.ndarray, mask: np.ndarray, px_mm: float) -> np.ndarray:
    """(h, w) uint8: a region without its wide parts, and what is beside these or the background.

    The grazing edge of a face has no normal either, and is skin.
    """
    radius = max(1, round(WIDE_MM / 2 * px_mm))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    wide = cv2.dilate(cv2.morphologyEx(region, cv2.MORPH_OPEN, disc), disc)
    inside = cv2.erode(mask.astype(np.uint8), disc)
    return np.asarray(region & (1 - wide) & inside)
