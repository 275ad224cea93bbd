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
from learning.photo.eyes import openings
from learning.photo.marks import FaceMarks, face_marks
from learning.photo.shape_fit import Photograph
from learning.points.network import shipped_finder
from lightstage.faces import detect_faces
from lightstage.faces.schemes import IBUG, seen_points
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


def camera_at(head: Head, yaw_deg: float, scale: float = 1.0) -> Camera:
    """A camera that looks at a head's face from a side, its picture made smaller or larger."""
    camera = studio_camera(head.head_from_world, yaw_deg)
    return camera if scale == 1.0 else camera.scaled(scale)


def studio_camera(head_from_world: np.ndarray, yaw_deg: float) -> Camera:
    """The studio's camera at a side of a head whose (3, 4) pose is given."""
    turn = np.radians(yaw_deg)
    place = AIM_MM + DISTANCE_MM * np.array([np.sin(turn), 0.0, np.cos(turn)])
    from_head = look_at(place, AIM_MM)
    pose = from_head @ np.vstack([head_from_world, [0, 0, 0, 1]])
    return Camera(
        "photo",
        "",
        "",
        WIDTH_PX,
        HEIGHT_PX,
        FOCAL_PX,
        FOCAL_PX,
        WIDTH_PX / 2,
        HEIGHT_PX / 2,
        (0.0,) * 5,
        pose,
    )


class Sitter:
    """A head before one camera; rays to lamps are cast once for all its photographs."""

    def __init__(self, head: Head, yaw_deg: float, scale: float = 1.0) -> None:
        """The head, the camera's place to its left, and the scale of the photograph's size."""
        self.camera = camera_at(head, yaw_deg, scale)
        self._surface = head.lit.scene.surface(self.camera.scaled(SUPERSAMPLE))
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

    def under(self, lights: LightSet) -> np.ndarray:
        """(h, w, 3) float32 linear picture under a light, before a grey background."""
        surface = self._surface
        large = np.full((surface.camera.height_px * surface.camera.width_px, 3), GREY, np.float32)
        large[surface.pixel] = self._lit.under(lights)
        shape = (surface.camera.height_px, surface.camera.width_px, 3)
        size = (self.camera.width_px, self.camera.height_px)
        return cv2.resize(large.reshape(shape), size, interpolation=cv2.INTER_AREA)

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
    codes, linear = sitter.shot(lights)
    faces = detect_faces(codes)
    if not faces:
        lost = np.full((len(marks.places.weights), 2), np.nan)
        return Photograph(name, linear, lost, sitter.camera.fx_px)
    points, weight = marks.of(codes, faces[0])
    eyes_px = openings(linear, seen_points(faces[0], IBUG))
    return Photograph(name, linear, points, sitter.camera.fx_px, weight, eyes_px)


def marks_of(template: Template) -> FaceMarks:
    """The points that `fit` uses by itself."""
    marks = face_marks(template, shipped_finder(template))
    assert marks is not None, "the template has no mediapipe468.json"
    return marks
