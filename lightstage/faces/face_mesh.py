"""468 points on a face, seen by a network in an upright crop of it [Kartynnik2019].

The crop is a square turned so that the eyes are level, with a quarter of the face's size to spare
on each side. The network gives the points in the crop's pixels, their depths to the same scale, and
whether it sees a face at all.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lightstage.faces.blazeface import Found
from lightstage.faces.weights import LANDMARKS, outputs_of

COUNT = 468
SIZE_PX = 192
SPARE = 1.5
"""Side of the crop over that of the face's box [Kartynnik2019, section 2]."""
RIGHT_EYE, LEFT_EYE = 33, 263
"""The eyes' outer corners, the person's right and left."""
_POINTS, _PRESENCE = "conv2d_20", "conv2d_30"


class Crop(NamedTuple):
    """A turned square of a picture.

    Attributes:
        centre_px: (2,) in the picture.
        size_px: its side.
        angle: radians from the picture's x axis to the crop's, towards the picture's y axis.
    """

    centre_px: np.ndarray
    size_px: float
    angle: float

    def axes(self) -> np.ndarray:
        """(2, 2): rows are the crop's x and y axes in the picture, unit."""
        cosine, sine = np.cos(self.angle), np.sin(self.angle)
        return np.array([[cosine, sine], [-sine, cosine]])


class Seen(NamedTuple):
    """What the network finds in a crop, in the picture's pixels.

    Attributes:
        points_px: (468, 2).
        depth_px: (468,) away from the camera, zero at the head's middle, at the points' scale.
        presence: 0..1, whether this is a face.
    """

    points_px: np.ndarray
    depth_px: np.ndarray
    presence: float


def crop_of_found(found: Found) -> Crop:
    """The crop of a detected face, level by its eyes."""
    across = found.points_px[1] - found.points_px[0]
    angle = float(np.arctan2(across[1], across[0]))
    return Crop(found.centre_px, SPARE * found.size_px, angle)


def crop_of_points(points_px: np.ndarray) -> Crop:
    """The crop by a face's own (468, 2) points: tighter and more level than a detector's."""
    across = points_px[LEFT_EYE] - points_px[RIGHT_EYE]
    level = Crop(np.zeros(2), 1.0, float(np.arctan2(across[1], across[0]))).axes()
    turned = points_px @ level.T
    low, high = turned.min(axis=0), turned.max(axis=0)
    size = SPARE * float((high - low).max())
    return Crop(level.T @ ((low + high) / 2), size, float(np.arctan2(across[1], across[0])))


def see(image_srgb: np.ndarray, crop: Crop) -> Seen:
    """Find the points of the face in a crop.

    Args:
        image_srgb: (h, w, 3) uint8.
        crop: of the picture; may reach over its edge.
    """
    pixels = resampled(image_srgb, crop, SIZE_PX).astype(np.float32) / 255
    points, presence = outputs_of(LANDMARKS, pixels, (_POINTS, _PRESENCE))
    per_px = crop.size_px / SIZE_PX
    local = points.reshape(COUNT, 3)
    return Seen(
        crop.centre_px + per_px * (local[:, :2] - SIZE_PX / 2) @ crop.axes(),
        per_px * local[:, 2],
        float(1 / (1 + np.exp(-np.clip(presence[0], -80, 80)))),
    )


def resampled(image: np.ndarray, crop: Crop, side_px: int) -> np.ndarray:
    """(side, side, 3) uint8: the crop resampled; beside the picture, its edge continues."""
    import cv2

    axes = crop.axes()
    # A crop of many pixels is averaged down first: the warp reads four pixels for each it makes.
    block = max(1, int(crop.size_px // side_px))
    low, high = np.zeros(2, int), np.array(image.shape[1::-1])
    if block > 1:
        reach = np.abs(axes).sum(axis=0) * crop.size_px / 2 + 2 * block
        low = np.clip(np.floor(crop.centre_px - reach), 0, high - 1).astype(int)
        high = np.clip(np.ceil(crop.centre_px + reach), low + 1, high).astype(int)
        part = image[low[1] : high[1], low[0] : high[0]]
        small = tuple(int(n) for n in np.maximum(1, -(-(high - low) // block)))
        image = cv2.resize(part, small, interpolation=cv2.INTER_AREA)
    scale = np.array(image.shape[1::-1]) / (high - low)
    # From the crop's pixels to the picture's; OpenCV counts from the first pixel's centre.
    into = (scale[:, None] * axes.T) * (crop.size_px / side_px)
    middle = scale * (crop.centre_px - low)
    shift = middle + into @ np.full(2, 0.5 - side_px / 2) - 0.5
    return np.asarray(
        cv2.warpAffine(
            image,
            np.column_stack([into, shift]),
            (side_px, side_px),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_REPLICATE,
        )
    )
