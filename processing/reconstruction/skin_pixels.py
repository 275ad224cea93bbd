"""Pixels of views that can show skin: those from whose colour a photometric normal follows.

Grey cloth and the frame of glasses have none. A patch that holds skin and such pixels is matched
at the depth of whichever has more contrast: a frame's dark line pulls the skin beside it forward
by as far as a patch reaches. So the skin is matched without them. Single pixels, such as pupils
and the hairs of a beard, stay: without all that is beside them too little skin would be left.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import cv2
import numpy as np

from processing.reconstruction.views import View

BESIDE_PX = 1
"""Pixels so near to one without a normal show both."""
LEAST_SHARE = 0.001
"""Share of the foreground; smaller regions without a normal stay."""


def skin_alone(views: Sequence[View]) -> list[View]:
    """The views without regions that have no normal, and without the pixels beside them.

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
    _, labels, stats, _ = cv2.connectedComponentsWithStats(other)
    large = stats[:, cv2.CC_STAT_AREA] > LEAST_SHARE * np.count_nonzero(view.mask)
    large[0] = False
    if not large.any():
        return view
    kernel = np.ones((2 * BESIDE_PX + 1, 2 * BESIDE_PX + 1), np.uint8)
    beside = cv2.dilate(large[labels].astype(np.uint8), kernel) > 0
    textures = np.where(beside[..., None], np.float32(np.nan), view.textures)
    return dataclasses.replace(view, textures=textures)
