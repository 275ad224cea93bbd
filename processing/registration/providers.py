"""Who finds landmarks: a file of clicks, or any program that looks at pictures and prints our JSON.

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
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from lightstage.formats.landmarks import read_points_px
from lightstage.formats.mesh import Mesh, vertex_normals
from lightstage.rig import Camera, look_at
from processing.errors import RegistrationError
from processing.rays import MeshRays, interpolate
from processing.registration.landmarks import Triangulated, triangulate

TURNS_DEG = (0.0, -30.0, 30.0)
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
class ClickedLandmarks:
    """A landmarks.json that someone made by hand."""

    path: Path

    def find(self, pictures: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """The file's landmarks, of whatever pictures."""
        del pictures
        return read_points_px(self.path)


@dataclasses.dataclass(frozen=True)
class CommandLandmarks:
    """A program of its own environment."""

    command: str
    timeout_s: float = 600.0

    def find(self, pictures: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """What the program prints for these pictures."""
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
                said = done.stderr.strip().splitlines()
                last = said[-1] if said else "nothing on standard error"
                raise self._failed(f"exit {done.returncode}: {last}")
            printed = Path(folder) / "landmarks.json"
            printed.write_text(done.stdout)
            found = read_points_px(printed)
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


def landmarks_of_mesh(mesh: Mesh, provider: LandmarkProvider, agree_mm: float) -> Triangulated:
    """Landmarks of a scan that has none, from pictures rendered of it.

    Three grey pictures, from the front and 30 degrees to both sides: as the paper finds landmarks,
    but with wrong ones left out where the views disagree.

    Args:
        mesh: mm, the face toward +z, +y up.
        provider: who looks at the pictures.
        agree_mm: how far a ray may pass from its landmark.

    Returns:
        Triangulated.

    Raises:
        RegistrationError: no landmark in any picture.
    """
    rays = MeshRays(mesh.vertices, mesh.triangles())
    cameras = {f"turned{turn:+.0f}": _portrait(mesh, turn) for turn in TURNS_DEG}
    pictures = {name: _rendered(mesh, rays, camera) for name, camera in cameras.items()}
    found = provider.find(pictures)
    if not any(np.isfinite(points).any() for points in found.values()):
        raise RegistrationError(
            "landmarks",
            found="none in three pictures of the mesh",
            expected="a face",
            hint="Does it look along +z with +y up?",
        )
    return triangulate(found, cameras, agree_mm=agree_mm, surface=rays)


def _portrait(mesh: Mesh, turn_deg: float) -> Camera:
    """A camera in front of the face; the head's middle is the middle of its highest part."""
    top = float(mesh.vertices[:, 1].max())
    head = mesh.vertices[mesh.vertices[:, 1] > top - 250.0]
    middle = (head.min(axis=0) + head.max(axis=0)) / 2
    turn = np.deg2rad(turn_deg)
    place = middle + AWAY_MM * np.array([np.sin(turn), 0.0, np.cos(turn)])
    focal = PICTURE_PX * AWAY_MM / FACE_MM
    return Camera(
        id=f"turned{turn_deg:+.0f}",
        serial="",
        model="rendered",
        width_px=PICTURE_PX,
        height_px=PICTURE_PX,
        fx_px=focal,
        fy_px=focal,
        cx_px=PICTURE_PX / 2,
        cy_px=PICTURE_PX / 2,
        dist=(0.0, 0.0, 0.0, 0.0, 0.0),
        cam_from_world=look_at(place, middle),
    )


def _rendered(mesh: Mesh, rays: MeshRays, camera: Camera) -> np.ndarray:
    """(h, w, 3) uint8: grey, lit from beside the camera, on black."""
    triangles = mesh.triangles()
    hits = rays.cast_camera(camera)
    normal = interpolate(vertex_normals(mesh.vertices, triangles), triangles, hits)
    light = camera.centre_mm - mesh.vertices.mean(axis=0) + [300.0, 500.0, 0.0]
    shade = np.clip(normal @ (light / np.linalg.norm(light)), 0, 1)
    grey = np.where(hits.face >= 0, 40 + 200 * shade, 0).astype(np.uint8)
    return np.repeat(grey.reshape(camera.height_px, camera.width_px, 1), 3, axis=2)
