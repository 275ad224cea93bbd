"""Lids and iris of each eye, found by a network in an upright crop of it [Ablavatski2020]."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lightstage.faces.face_mesh import Crop, resampled
from lightstage.faces.weights import IRIS, outputs_of

SIZE_PX = 64
SPARE = 2.3
"""Side of the crop over the distance of the eye's corners [Ablavatski2020]."""
LIDS = 16
"""The first of 71 points are the lids' edge: 9 of the lower one, from the outer corner to the inner
one, then 7 between them on the upper one."""
_LIDS, _IRIS = "output_eyes_contours_and_brows", "output_iris"


class Eye(NamedTuple):
    """An eye in a picture.

    Attributes:
        lids_px: (16, 2) closed outline of what is between the lids.
        iris_px: (2,) its centre.
        radius_px: of the iris.
    """

    lids_px: np.ndarray
    iris_px: np.ndarray
    radius_px: float


def see_eye(image_srgb: np.ndarray, corners_px: np.ndarray, right: bool) -> Eye:
    """Find an eye's lids and iris.

    Args:
        image_srgb: (h, w, 3) uint8.
        corners_px: (2, 2) outer and inner corner.
        right: whether it is the person's right eye; the network knows left ones.
    """
    outer, inner = corners_px
    across = inner - outer if right else outer - inner
    length = float(np.linalg.norm(across))
    crop = Crop((outer + inner) / 2, SPARE * length, float(np.arctan2(across[1], across[0])))
    pixels = resampled(image_srgb, crop, SIZE_PX).astype(np.float32) / 255
    found = outputs_of(IRIS, pixels[:, ::-1] if right else pixels, (_LIDS, _IRIS))
    lids, iris = (values.reshape(-1, 3)[:, :2] for values in found)
    local = np.concatenate([lids[:9], lids[9:LIDS][::-1], iris])
    if right:
        local[:, 0] = SIZE_PX - local[:, 0]
    per_px = crop.size_px / SIZE_PX
    points = crop.centre_px + per_px * (local - SIZE_PX / 2) @ crop.axes()
    radius = np.linalg.norm(points[LIDS + 1 :] - points[LIDS], axis=1).mean()
    return Eye(points[:LIDS], points[LIDS], float(radius))
