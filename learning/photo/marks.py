"""Points of a photographed face: the detector's, and the network's."""

from __future__ import annotations

import dataclasses

import numpy as np

from learning.photo.shape_fit import Places, detector_places
from learning.points.network import PointFinder
from lightstage.faces.detect import Face
from lightstage.faces.schemes import FACE_MESH, seen_points
from lightstage.formats.template import Template

TYPICAL_MM = 2.5
"""Deviation of a point of the network's that counts as one of the detector's does."""
MOST_WEIGHT = 2.0
"""Of a point, however sure the network is."""


@dataclasses.dataclass(frozen=True)
class FaceMarks:
    """Places on a template, and how photographs give their points.

    Attributes:
        places: the detector's, those of them that the template has, then the network's.
        there: (468,) bool, the detector's that the template has.
        finder: the network; None where there is none for the template.
    """

    places: Places
    there: np.ndarray
    finder: PointFinder | None

    def of(self, picture_srgb: np.ndarray, face: Face) -> tuple[np.ndarray, np.ndarray]:
        """(p, 2) points of a face in a picture, NaN where hidden, and (p,) how much they count.

        Args:
            picture_srgb: (h, w, 3) uint8.
            face: as detected in it.
        """
        detected = seen_points(face, FACE_MESH)[self.there]
        if self.finder is None:
            return detected, np.ones(len(detected))
        dense = self.finder.found(picture_srgb, face.points_px)
        weight = np.minimum((TYPICAL_MM / dense.deviation_mm) ** 2, MOST_WEIGHT)
        points = np.concatenate([detected, dense.points_px])
        return points, np.concatenate([np.ones(len(detected)), weight])


def face_marks(template: Template, finder: PointFinder | None) -> FaceMarks | None:
    """The points of a template; None where it does not have the detector's."""
    found = detector_places(template)
    if found is None:
        return None
    places, there = found
    if finder is None:
        return FaceMarks(places, there, None)
    vertices = finder.layout.vertices
    both = Places(
        np.concatenate([places.triangles, np.repeat(vertices[:, None], 3, axis=1)]),
        np.concatenate([places.weights, np.tile([1.0, 0.0, 0.0], (len(vertices), 1))]),
        np.concatenate([places.spread_mm, np.zeros(len(vertices))]),
    )
    return FaceMarks(both, there, finder)
