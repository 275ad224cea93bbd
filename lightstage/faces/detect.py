"""All faces of a picture, each with 468 points: detected in a small copy, seen in crops of it all.

Detection is sure only of faces that are nearly upright: where nothing is found, the small copy is
turned. A crop from a detector is loose; the face's own points give a better one, so each face is
seen again until its crop holds still.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from lightstage.errors import FaceError
from lightstage.faces import blazeface, face_mesh
from lightstage.faces.blazeface import Found
from lightstage.faces.face_mesh import Crop, Seen

LEAST_SCORE = 0.5
"""Least score of a detection."""
ONE_FACE = 0.3
"""Detections that overlap by more than this share are one face."""
LEAST_PRESENCE = 0.5
"""The least confidence of the points' network in a face's last crop, where no other is given."""
TURNS_DEG = (0.0, 45.0, -45.0, 90.0, -90.0)
"""How the small copy is turned, one after the other, until a face is found."""
PASSES = 3
"""How often a face is seen, the first time in the detector's crop."""
SMALL_PX = 512
"""Longer side of the small copy, which is turned for detection."""
PARTS = (4, 8)
"""Parts along the longer side of a picture that is searched for small faces."""
SURE = 0.9
"""Confidence from which there is surely a face."""
LARGEST = 1 << 15
"""Pixels a side; larger pictures cannot be resampled."""
LEAST_SIZE_PX = 8.0
"""Least size of a face; smaller ones are not used."""


@dataclasses.dataclass(frozen=True)
class Face:
    """A face in a picture.

    Attributes:
        points_px: (468, 2) float64, MediaPipe's points [Kartynnik2019]; the top-left pixel's centre
            is (0.5, 0.5). Those that the head hides are where they would be seen through it, and
            those that the picture's edge cuts are outside of it.
        depth_px: (468,) away from the camera, to the points' scale, zero at the head's middle.
        presence: 0..1, how sure the network is that this is a face.
        box_px: x0, y0, x1, y1 around the points.
    """

    points_px: np.ndarray
    depth_px: np.ndarray
    presence: float
    box_px: tuple[float, float, float, float]


def detect_faces(image_srgb: np.ndarray, least_presence: float = LEAST_PRESENCE) -> list[Face]:
    """Find the faces of a picture.

    Faces from a tenth of the picture's height up, turned by up to 45 degrees in the picture.

    Args:
        image_srgb: (h, w, 3) uint8, red green blue.
        least_presence: the least confidence in a face; profiles have little.

    Returns:
        Largest first; none where there is no face.

    Raises:
        FaceError: not such a picture, or the networks' weights are not installed.
    """
    _require_picture(image_srgb)
    small = _small(image_srgb)
    factor = np.array(small.shape[1::-1]) / image_srgb.shape[1::-1]
    faces: list[Face] = []
    for turn_deg in TURNS_DEG:
        for found in _turned(small, turn_deg):
            crop = face_mesh.crop_of_found(found)
            seen = _settled(image_srgb, Crop(crop.centre_px / factor, *_over(crop, factor)))
            if seen is not None and seen.presence >= least_presence:
                faces.append(_face(seen))
        if faces:
            break
    return _apart(faces)


def small_faces(image_srgb: np.ndarray) -> list[Face]:
    """Find faces that are small in a large picture: in overlapping parts of it, in all its pixels.

    Faces from an eightieth of the picture's height up, upright or nearly.

    Args:
        image_srgb: (h, w, 3) uint8, red green blue.

    Returns:
        Largest first, those alone of which the network is sure; none where there is none.

    Raises:
        FaceError: see `detect_faces`.
    """
    _require_picture(image_srgb)
    for count in PARTS:
        side = -(-max(image_srgb.shape[:2]) // count)
        faces = []
        for row, column in _corners(image_srgb.shape[:2], side):
            part = np.ascontiguousarray(image_srgb[row : row + side, column : column + side])
            small = _small(part)
            factor = np.array(small.shape[1::-1]) / part.shape[1::-1]
            for found in blazeface.find(small, LEAST_SCORE, ONE_FACE):
                crop = face_mesh.crop_of_found(found)
                centre = crop.centre_px / factor + [column, row]
                seen = _settled(image_srgb, Crop(centre, *_over(crop, factor)))
                if seen is not None and seen.presence >= SURE:
                    faces.append(_face(seen))
        if faces:
            return _apart(faces)
    return []


def _corners(size: tuple[int, int], side: int) -> list[tuple[int, int]]:
    """Rows and columns where square parts of a picture begin; each overlaps the next by half."""
    rows, columns = (
        sorted({*range(0, max(length - side, 0), max(side // 2, 1)), max(length - side, 0)})
        for length in size
    )
    return [(row, column) for row in rows for column in columns]


def _require_picture(image: np.ndarray) -> None:
    right = image.dtype == np.uint8 and image.ndim == 3 and image.shape[2] == 3
    if not right or not image.size > 0 or max(image.shape[:2]) >= LARGEST:
        raise FaceError(
            "picture",
            found=f"{image.dtype} of shape {image.shape}",
            expected=f"uint8 (h, w, 3), red green blue, fewer than {LARGEST} px a side",
        )


def _small(image: np.ndarray) -> np.ndarray:
    """The picture, made smaller where it is large."""
    import cv2

    height, width = image.shape[:2]
    factor = SMALL_PX / max(height, width)
    if factor >= 1:
        return image
    size = (max(1, round(width * factor)), max(1, round(height * factor)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))


def _over(crop: Crop, factor: np.ndarray) -> tuple[float, float]:
    """A small copy's crop as size and angle in the picture."""
    return crop.size_px / float(np.sqrt(factor.prod())), crop.angle


def _turned(small: np.ndarray, turn_deg: float) -> list[Found]:
    """What is found in a picture that was turned, in the picture's own coordinates."""
    import cv2

    if turn_deg == 0:
        return blazeface.find(small, LEAST_SCORE, ONE_FACE)
    shape = np.array(small.shape[1::-1], float)
    axes = Crop(shape / 2, 1.0, float(np.deg2rad(turn_deg))).axes()
    # Just so large that the whole picture stays in it.
    wide = np.ceil(np.abs(axes) @ shape)
    shift = shape / 2 - axes.T @ (wide / 2)
    turned = cv2.warpAffine(
        small,
        np.column_stack([axes.T, shift + axes.T @ np.full(2, 0.5) - 0.5]),
        (int(wide[0]), int(wide[1])),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
    )
    return [
        Found(f.score, f.centre_px @ axes + shift, f.size_px, f.points_px @ axes + shift)
        for f in blazeface.find(np.asarray(turned), LEAST_SCORE, ONE_FACE)
    ]


def _settled(image: np.ndarray, crop: Crop) -> Seen | None:
    """A face's points from a crop of its own, or None where they end in none."""
    for _ in range(PASSES):
        if not LEAST_SIZE_PX <= crop.size_px <= LARGEST:
            return None
        seen = face_mesh.see(image, crop)
        if not np.isfinite(seen.points_px).all():
            return None
        crop = face_mesh.crop_of_points(seen.points_px)
    return seen


def _face(seen: Seen) -> Face:
    low, high = seen.points_px.min(axis=0), seen.points_px.max(axis=0)
    box = (float(low[0]), float(low[1]), float(high[0]), float(high[1]))
    return Face(seen.points_px, seen.depth_px, seen.presence, box)


def _size(face: Face) -> float:
    x0, y0, x1, y1 = face.box_px
    return float(np.sqrt((x1 - x0) * (y1 - y0)))


def _apart(faces: list[Face]) -> list[Face]:
    """Largest first, each face once: two detections may end on one face."""
    out: list[Face] = []
    for face in sorted(faces, key=_size, reverse=True):
        centres = np.array([np.mean(np.reshape(f.box_px, (2, 2)), axis=0) for f in out])
        centre = np.mean(np.reshape(face.box_px, (2, 2)), axis=0)
        sides = np.array([_size(f) for f in out])
        if not out or blazeface.shared(centre, _size(face), centres, sides).max() <= ONE_FACE:
            out.append(face)
    return out
