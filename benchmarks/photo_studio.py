"""Photographs of a head's own surface, for programs that find its face in them.

The simulator casts a ray for each pixel at the head itself. A head of another topology is not shown
as the template that was registered to it: where that is a millimetre off at the eyes, the template
would wear the eye's white on its lid, as nobody does.
"""

from __future__ import annotations

import cv2
import numpy as np

from benchmarks.networks_lights import LitPoints, Points
from benchmarks.networks_people import Head
from learning.photo.eyes import openings, whites
from learning.photo.marks import FaceMarks, face_marks
from learning.photo.shape_fit import Photograph
from learning.points.network import shipped_finder
from lightstage.faces import detect_faces
from lightstage.faces.schemes import IBUG, INNER_LIPS, seen_points
from lightstage.formats.environment import LightSet
from lightstage.formats.srgb import linear_from_srgb
from lightstage.formats.template import Template
from lightstage.rig import Camera, look_at
from processing.colour import srgb_from_linear

AIM_MM = np.array([0.0, -20.0, 40.0])
"""Where cameras look, head frame."""
DISTANCE_MM, FOCAL_PX = 900.0, 2400.0
WIDTH_PX, HEIGHT_PX = 768, 1024
GREY = 0.25
"""Of the background, linear."""
SUPERSAMPLE = 2
"""Rays a side of a pixel."""


def camera_at(head: Head, yaw_deg: float, scale: float = 1.0, focal_px: float = FOCAL_PX) -> Camera:
    """A camera that looks at a head's face from a side, its picture made smaller or larger."""
    camera = studio_camera(head.head_from_world, yaw_deg, focal_px)
    return camera if scale == 1.0 else camera.scaled(scale)


def studio_camera(
    head_from_world: np.ndarray, yaw_deg: float, focal_px: float = FOCAL_PX
) -> Camera:
    """The studio's camera at a side of a head whose (3, 4) pose is given.

    Another focal length stands elsewhere, so that a face has one size in all pictures.
    """
    turn = np.radians(yaw_deg)
    distance_mm = DISTANCE_MM * focal_px / FOCAL_PX
    place = AIM_MM + distance_mm * np.array([np.sin(turn), 0.0, np.cos(turn)])
    from_head = look_at(place, AIM_MM)
    pose = from_head @ np.vstack([head_from_world, [0, 0, 0, 1]])
    return Camera(
        "photo",
        "",
        "",
        WIDTH_PX,
        HEIGHT_PX,
        focal_px,
        focal_px,
        WIDTH_PX / 2,
        HEIGHT_PX / 2,
        (0.0,) * 5,
        pose,
    )


class Sitter:
    """A head before one camera; rays to lamps are cast once for all its photographs."""

    def __init__(
        self,
        head: Head,
        yaw_deg: float,
        scale: float = 1.0,
        focal_px: float = FOCAL_PX,
        supersample: int = SUPERSAMPLE,
    ) -> None:
        """The head, the camera's place to its left, the scale of the photograph's size, its lens.

        Args:
            head: who is seen.
            yaw_deg: of the camera's place, to the head's left.
            scale: of the photograph's size.
            focal_px: of the camera before it is scaled.
            supersample: rays a side of a pixel.
        """
        self.camera = camera_at(head, yaw_deg, scale, focal_px)
        self._surface = head.lit.scene.surface(self.camera.scaled(supersample))
        seen = self._surface
        points = Points(
            seen.position,
            seen.start,
            seen.geometric,
            seen.normal,
            seen.albedo,
            seen.specular,
            seen.roughness,
            head.lit.points.distribution,
        )
        self._lit = LitPoints(head.lit.scene, points, seen.view)

    def under(self, lights: LightSet, behind: np.ndarray | None = None) -> np.ndarray:
        """(h, w, 3) float32 linear picture under a light.

        Args:
            lights: in the world.
            behind: (h, w, 3) linear background; grey where None.
        """
        size = (self._surface.camera.width_px, self._surface.camera.height_px)
        if behind is None:
            large = np.full((size[1], size[0], 3), GREY, np.float32)
        else:
            large = np.asarray(cv2.resize(behind, size), np.float32)
        large.reshape(-1, 3)[self._surface.pixel] = self._lit.under(lights)
        return self._smaller(large)

    def skin(self) -> np.ndarray:
        """(h, w) bool, where skin of the face or lips are seen."""
        seen = self._surface.picture(self._surface.skin.astype(np.float32))
        return np.asarray(self._smaller(seen) > 0.5)

    def _smaller(self, large: np.ndarray) -> np.ndarray:
        size = (self.camera.width_px, self.camera.height_px)
        return cv2.resize(large, size, interpolation=cv2.INTER_AREA)

    def shot(self, lights: LightSet) -> tuple[np.ndarray, np.ndarray]:
        """(h, w, 3) uint8 as a camera stores it, and float32 linear as that is read again."""
        codes = np.round(255 * srgb_from_linear(self.under(lights))).astype(np.uint8)
        return codes, linear_from_srgb(codes / 255.0).astype(np.float32)


def photograph(sitter: Sitter, lights: LightSet, marks: FaceMarks, name: str) -> Photograph:
    """An 8-bit photograph of a lit head, its face found.

    Args:
        sitter: who is seen.
        lights: in the world.
        marks: the points that are found.
        name: of the photograph.
    """
    return of_codes(sitter.shot(lights)[0], marks, name, sitter.camera.fx_px)


def of_codes(codes: np.ndarray, marks: FaceMarks, name: str, focal_px: float | None) -> Photograph:
    """An 8-bit photograph, (h, w, 3) sRGB codes, its face found; landmarks are NaN where none is.

    Args:
        codes: of the picture.
        marks: the points that are found.
        name: of the photograph.
        focal_px: where the file states it.
    """
    linear = linear_from_srgb(codes / 255.0).astype(np.float32)
    faces = detect_faces(codes)
    if not faces:
        lost = np.full((len(marks.places.weights), 2), np.nan)
        return Photograph(name, linear, lost, focal_px)
    points, weight = marks.of(codes, faces[0])
    landmarks = seen_points(faces[0], IBUG)
    seen = openings(linear, landmarks), whites(linear, landmarks), landmarks[INNER_LIPS]
    return Photograph(name, linear, points, focal_px, weight, *seen)


def marks_of(template: Template) -> FaceMarks:
    """The points that `fit` uses by itself."""
    marks = face_marks(template, shipped_finder(template))
    assert marks is not None, "the template has no mediapipe468.json"
    return marks
