"""Who finds landmarks: a file of clicks, our detector, or any program that prints our JSON.

A program is called as ``COMMAND FOLDER``. FOLDER holds CAMERA.png, one a view; what it prints on
standard output is landmarks.json: ``{"schema": "lightstage.landmarks/1", "scheme": "ibug68",
"points_px": {"CAMERA": [[x, y], null, ...]}}``, the first pixel's centre at (0.5, 0.5). So a
detector keeps its own environment and its own licence.
"""

from __future__ import annotations

import dataclasses
import shlex
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, Protocol

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from lightstage.errors import FormatError
from lightstage.faces import detect_faces
from lightstage.faces.of_template import landmark_weights, template_landmarks
from lightstage.faces.schemes import IBUG, seen_points
from lightstage.formats.landmarks import read_points_px
from lightstage.formats.mesh import Mesh, vertex_normals
from lightstage.formats.template import Template
from lightstage.rig import Camera, look_at
from processing.errors import RegistrationError
from processing.rays import MeshRays, interpolate
from processing.registration.landmarks import Triangulated, triangulate
from processing.registration.rigid import robust_umeyama
from processing.registration.start import MARKS, SIZES

SIDES_DEG = (0.0, -30.0, 30.0)
UNLIKE_MM = 10.0
"""Landmarks this far from the template's (median) are no face's."""
FEWEST_LANDMARKS = 20

PICTURE_PX = 1024
AWAY_MM = 1100.0
FACE_MM = 320.0
"""Height of what a rendered picture shows."""


class LandmarkProvider(Protocol):
    """Finds the 68 iBUG landmarks [Sagonas2016] in pictures."""

    def find(self, pictures: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Landmarks of some or all pictures.

        Args:
            pictures: camera id to (h, w, 3) uint8 sRGB.

        Returns:
            Camera id to (68, 2) pixels, NaN where hidden.

        Raises:
            FormatError: what was found is not in the form it should have.
            RegistrationError: nothing could be found.
        """
        ...


@dataclasses.dataclass(frozen=True)
class DetectedLandmarks:
    """The project's own face detector.

    Where the template has the places of the detector's points on it, its own landmarks are computed
    from them, those of the jaw's sides not; else the points that represent iBUG's are taken.
    """

    template: Template

    def find(self, pictures: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """The largest face's (68, 2) landmarks in each (h, w[, 3]) picture that shows one.

        Raises:
            FaceError: the detector's weights are not installed.
        """
        found = {}
        vertices, points = self.template.mesh.vertices, self.template.face_points
        weights = (
            None
            if points is None
            else landmark_weights(points.on(vertices), vertices[self.template.landmarks])
        )
        for name, picture in pictures.items():
            faces = detect_faces(np.ascontiguousarray(picture))
            if faces:
                face = faces[0]
                found[name] = (
                    seen_points(face, IBUG)
                    if weights is None
                    else template_landmarks(face, weights)
                )
        return found


@dataclasses.dataclass(frozen=True)
class CommandLandmarks:
    """A program of its own environment."""

    command: str
    timeout_s: float = 600.0

    def find(self, pictures: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """The (68, 2) landmarks that the program prints for these (h, w[, 3]) pictures."""
        with tempfile.TemporaryDirectory() as folder:
            for name, picture in pictures.items():
                path = Path(folder) / f"{name}.png"
                cv2.imwrite(str(path), np.ascontiguousarray(picture[:, :, ::-1]))
            try:
                done = subprocess.run(
                    [*shlex.split(self.command), folder],
                    capture_output=True,
                    text=True,
                    timeout=self.timeout_s,
                    check=False,
                )
            except (OSError, ValueError, subprocess.TimeoutExpired) as error:
                raise self._failed(str(error)) from None
            if done.returncode:
                stderr = done.stderr.strip().splitlines()
                last = stderr[-1] if stderr else "nothing on standard error"
                raise self._failed(f"exit {done.returncode}: {last}")
            printed = Path(folder) / "landmarks.json"
            printed.write_text(done.stdout)
            try:
                found = read_points_px(printed)
            except FormatError as error:  # its file is gone when the message is read
                field = f"{error.field}: " if error.field else ""
                raise self._failed(
                    f"on standard output {field}{error.found} in place of {error.expected}"
                ) from None
        unknown = sorted(set(found) - set(pictures))
        if unknown:
            raise self._failed(f"landmarks of {', '.join(unknown)}, which it was not given")
        return found

    def _failed(self, found: str) -> RegistrationError:
        return RegistrationError(
            f"landmark command {self.command!r}",
            found=found,
            expected="our landmarks.json on standard output, exit 0",
            hint="Run it by hand on a folder of PNG pictures.",
        )


class FoundOnMesh(NamedTuple):
    """Landmarks of a mesh, and its pose.

    Attributes:
        landmarks: in the mesh's own axes.
        turn: (3, 3), what brings the face to +z and its top to +y; the mesh itself stays.
    """

    landmarks: Triangulated
    turn: np.ndarray


def landmarks_of_mesh(
    mesh: Mesh, provider: LandmarkProvider, agree_mm: float, template_mm: np.ndarray
) -> FoundOnMesh:
    """Landmarks of a scan that has none, from pictures rendered of it.

    Three grey pictures, from the front and 30 degrees to both sides: as the paper finds landmarks,
    but with wrong ones left out where the views disagree. A face that does not point along +z with
    +y up is sought in a picture from the front for each other turn about the axes by right angles.

    Args:
        mesh: mm.
        provider: which finds landmarks in the pictures.
        agree_mm: how far a ray may pass from its landmark.
        template_mm: (68, 3), the template's landmarks: what is found has their shape.

    Returns:
        FoundOnMesh.

    Raises:
        RegistrationError: no face in any picture.
    """
    rays = MeshRays(mesh.vertices, mesh.triangles())

    def seen(turns: Sequence[np.ndarray], sides: Sequence[float]) -> list[Triangulated | None]:
        cameras, pictures = {}, {}
        for number, turn in enumerate(turns):
            for side in sides:
                camera = _portrait(mesh, turn, side, f"turn{number}{side:+.0f}")
                cameras[camera.id] = camera
                pictures[camera.id] = _rendered(mesh, rays, camera, turn)
        found = provider.find(pictures)
        out: list[Triangulated | None] = []
        for number in range(len(turns)):
            own = {name: p for name, p in found.items() if name.startswith(f"turn{number}")}
            own = {n: p for n, p in own.items() if n[len(f"turn{number}")] in "+-"}
            face = any(np.isfinite(points).any() for points in own.values())
            shown = {name: cameras[name] for name in own}
            out.append(triangulate(own, shown, agree_mm=agree_mm, surface=rays) if face else None)
        return out

    upright = np.eye(3)
    first = seen([upright], SIDES_DEG)[0]
    if first is not None and _unlike(first, template_mm) < UNLIKE_MM:
        return FoundOnMesh(first, upright)
    turns = np.round(Rotation.create_group("O").as_matrix())
    others = [turn for turn in turns if not np.array_equal(turn, upright)]
    unlike = [
        np.inf if found is None else _unlike(found, template_mm) for found in seen(others, (0.0,))
    ]
    best = others[int(np.argmin(unlike))]
    again = seen([best], SIDES_DEG)[0] if min(unlike) < UNLIKE_MM else None
    if again is not None and _unlike(again, template_mm) < UNLIKE_MM:
        return FoundOnMesh(again, best)
    if first is not None:  # what is wrong with them is reported where they are aligned
        return FoundOnMesh(first, upright)
    raise RegistrationError(
        MARKS,
        found=f"none in pictures of the mesh from the front and in {len(others)} other turns",
        expected="a face",
        hint="Is there a face on it? Does it point along an axis of the mesh, within 30 degrees?",
    )


def _unlike(found: Triangulated, template_mm: np.ndarray) -> float:
    """Median distance in mm of landmarks from the template's, fitted to them; infinite if few."""
    known = np.isfinite(found.points_mm).all(axis=1)
    if known.sum() < FEWEST_LANDMARKS:
        return float("inf")
    try:
        pose, away = robust_umeyama(template_mm[known], found.points_mm[known], scale=True)
    except RegistrationError:
        return float("inf")
    likely = SIZES[0] < pose.scale < SIZES[1]
    return float(np.median(away)) if likely else float("inf")


def _portrait(mesh: Mesh, turn: np.ndarray, side_deg: float, name: str) -> Camera:
    """A camera in front of the turned face; the head's middle is that of its highest part."""
    turned = mesh.vertices @ turn.T
    head = turned[turned[:, 1] > float(turned[:, 1].max()) - 250.0]
    middle = (head.min(axis=0) + head.max(axis=0)) / 2
    side = np.deg2rad(side_deg)
    place = middle + AWAY_MM * np.array([np.sin(side), 0.0, np.cos(side)])
    focal = PICTURE_PX * AWAY_MM / FACE_MM
    pose = np.array(look_at(place, middle))
    pose[:, :3] = pose[:, :3] @ turn
    return Camera(
        id=name,
        serial="",
        model="rendered",
        width_px=PICTURE_PX,
        height_px=PICTURE_PX,
        fx_px=focal,
        fy_px=focal,
        cx_px=PICTURE_PX / 2,
        cy_px=PICTURE_PX / 2,
        dist=(0.0, 0.0, 0.0, 0.0, 0.0),
        cam_from_world=pose,
    )


def _rendered(mesh: Mesh, rays: MeshRays, camera: Camera, turn: np.ndarray) -> np.ndarray:
    """(h, w, 3) uint8: grey, lit from beside the camera, on black."""
    triangles = mesh.triangles()
    hits = rays.cast_camera(camera)
    normal = interpolate(vertex_normals(mesh.vertices, triangles), triangles, hits)
    light = camera.centre_mm - mesh.vertices.mean(axis=0) + np.array([300.0, 500.0, 0.0]) @ turn
    shade = np.clip(normal @ (light / np.linalg.norm(light)), 0, 1)
    grey = np.where(hits.face >= 0, 40 + 200 * shade, 0).astype(np.uint8)
    return np.repeat(grey.reshape(camera.height_px, camera.width_px, 1), 3, axis=2)
