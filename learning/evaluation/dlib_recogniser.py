"""Identity by dlib's face recogniser [King2009], where the extra `likeness` is installed.

A face is aligned by dlib's detector and five points. Where its detector finds none (heads that are
turned, or without hair), the five points are those of `lightstage.faces`.
"""

from __future__ import annotations

import functools
import importlib.util
from pathlib import Path
from typing import Any

import numpy as np

from learning.errors import RecogniserError
from lightstage.faces import detect_faces
from lightstage.faces.schemes import ibug68

PACKAGE = "face_recognition_models"
"""Folder of the wheel's files; it is not imported, since it asks for setuptools."""
NETWORK = "dlib_face_recognition_resnet_model_v1.dat"
POINTS = "shape_predictor_5_face_landmarks.dat"
"""Not the wheel's predictor of 68 points, whose training photographs are for research alone."""
NUMBERS = 128
SAME_PERSON = 0.6
"""Two photographs whose embeddings are nearer are of one person, says dlib of its network."""
CHIP_PX, PADDING = 150, 0.25
"""Side and margin of the aligned pictures that the network was trained on."""
FIVE = (45, 42, 36, 39, 33)
"""iBUG's numbers of the five points, in dlib's order: eye corners, then the base of the nose."""
ENLARGED = (0, 1)
"""Doublings of the picture for dlib's detector, one after the other, until it finds a face."""


class DlibRecogniser:
    """The network, the detector and the five points.

    Attributes:
        name: what identity is measured by.
        measure: of two embeddings.
        size: rows and columns of the pictures that it is given of rendered heads.
    """

    name = "dlib"
    measure = "distance"
    size = (448, 448)

    def __init__(self, models: Path) -> None:
        """Read the files.

        Raises:
            RecogniserError: one of them is missing or none of dlib's.
        """
        import dlib

        self._dlib: Any = dlib
        self._find = dlib.get_frontal_face_detector()
        self._points = _read(dlib.shape_predictor, models / POINTS)
        self._net = _read(dlib.face_recognition_model_v1, models / NETWORK)

    def embedding(self, picture: np.ndarray) -> np.ndarray:
        """(128,) float64 of the largest face; NaN where no face is found.

        Args:
            picture: (rows, columns, 3) sRGB, red green blue, 0..1.
        """
        codes = np.ascontiguousarray(np.round(255 * np.clip(picture, 0, 1)).astype(np.uint8))
        face = self._aligned_by_dlib(codes) or self._aligned_by_ours(codes)
        if face is None:
            return np.full(NUMBERS, np.nan)
        chip = self._dlib.get_face_chip(codes, face, CHIP_PX, PADDING)
        return np.array(self._net.compute_face_descriptor(chip))

    def _aligned_by_dlib(self, codes: np.ndarray) -> Any:
        """The five points of the largest face that dlib finds, or None."""
        for doubled in ENLARGED:
            if found := self._find(codes, doubled):
                return self._points(codes, max(found, key=lambda box: box.area()))
        return None

    def _aligned_by_ours(self, codes: np.ndarray) -> Any:
        """The same of our detector."""
        faces = detect_faces(codes)
        if not faces:
            return None
        points = ibug68(faces[0].points_px)[list(FIVE)]
        # dlib counts from the middle of the first pixel, and wants whole pixels.
        whole = [self._dlib.point(*map(int, np.round(point - 0.5))) for point in points]
        corners = np.round(faces[0].box_px).astype(int).tolist()
        return self._dlib.full_object_detection(self._dlib.rectangle(*corners), whole)


@functools.cache
def installed() -> DlibRecogniser | None:
    """The recogniser; None where the extra is not installed."""
    dlib, weights = (importlib.util.find_spec(name) for name in ("dlib", PACKAGE))
    if dlib is None or weights is None or not weights.submodule_search_locations:
        return None
    return DlibRecogniser(Path(weights.submodule_search_locations[0]) / "models")


def _read(make: Any, path: Path) -> Any:
    try:
        return make(str(path))
    except RuntimeError as wrong:
        raise RecogniserError(
            path,
            found=" ".join(str(wrong).split())[:200],
            expected="a file of dlib's networks",
            hint="Install the extra again: python -m pip install --force-reinstall "
            "face-recognition-models",
        ) from None
