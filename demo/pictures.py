"""Drawings for the report: the stage's lights, shaded meshes, wireframes, marks and curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from lightstage.formats.mesh import Mesh, vertex_normals
from lightstage.rig import Camera, Rig
from processing.rays import MeshRays, interpolate

INK = (60, 60, 60)
COLOURS = ((31, 119, 180), (214, 96, 30), (44, 140, 60), (148, 70, 180))
SHIFT = 4
"""OpenCV draws at sixteenths of a pixel."""


def stage_picture(rig: Rig, levels: np.ndarray, size_px: int = 480) -> np.ndarray:
    """The sphere of lights seen from the front, a little from above and the side.

    Args:
        rig: lights and cameras.
        levels: (n,) drive levels; a lit light is yellow, a dark one grey.
        size_px: side of the picture.

    Returns:
        (size, size, 3) uint8.
    """
    turn, tilt = np.radians(-20.0), np.radians(18.0)
    about_y = np.array(
        [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]
    )
    about_x = np.array(
        [[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]]
    )
    view = about_x @ about_y
    cameras = np.array([camera.centre_mm for camera in rig.cameras])
    radius = float(np.linalg.norm(rig.positions_mm, axis=1).max())
    points = np.concatenate([rig.positions_mm, cameras]) @ view.T / radius
    image = np.full((size_px, size_px, 3), 24, np.uint8)
    _disc(image, np.array([size_px / 2, size_px / 2]), 0.09 * size_px, (70, 60, 55))
    # From back to front, so that near lights cover far ones.
    for index in np.argsort(points[:, 2]):
        x, y, z = points[index]
        place = np.array([0.5 + 0.44 * x, 0.5 - 0.44 * y]) * size_px
        near = 0.6 + 0.4 * (z + 1) / 2
        if index >= len(rig.lights):
            half = 0.013 * size_px * near
            corners = (np.stack([place - half, place + half]) * 2**SHIFT).astype(int)
            first, second = corners.tolist()
            cv2.rectangle(image, first, second, (90, 150, 255), -1, cv2.LINE_AA, SHIFT)
            continue
        level = float(np.mean(levels[index]))
        dark, lit = np.array([75.0, 75, 80]), np.array([255.0, 214, 90])
        colour = (dark + (lit - dark) * level) * near
        _disc(image, place, 0.012 * size_px * near, tuple(colour))
    return image


def _disc(image: np.ndarray, place: np.ndarray, radius: float, colour: Sequence[float]) -> None:
    x, y = (place * 2**SHIFT).astype(int).tolist()
    shade = [float(c) for c in colour]
    cv2.circle(image, (x, y), int(radius * 2**SHIFT), shade, -1, cv2.LINE_AA, SHIFT)


def mesh_picture(
    mesh: Mesh, camera: Camera, height_px: int, colours: np.ndarray | None = None
) -> np.ndarray:
    """A mesh as its camera sees it, lit from beside the camera.

    Args:
        mesh: in world axes.
        camera: the view.
        height_px: of the picture.
        colours: (n, 3) 0..1 a vertex; light grey without.

    Returns:
        (height, w, 3) uint8 on white.
    """
    small = camera.scaled(height_px / camera.height_px)
    triangles = mesh.triangles()
    hits = MeshRays(mesh.vertices, triangles).cast_camera(small)
    normals = interpolate(vertex_normals(mesh.vertices, triangles), triangles, hits)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    rotation = small.cam_from_world[:, :3]
    key = rotation.T @ np.array([-0.45, -0.45, -0.8])
    fill = rotation.T @ np.array([0.7, 0.1, -0.6])
    shade = 0.2 + 0.65 * np.clip(normals @ key, 0, 1) + 0.25 * np.clip(normals @ fill, 0, 1)
    grey = np.full((len(mesh.vertices), 3), 0.82) if colours is None else colours
    surface = interpolate(grey, triangles, hits)
    image = np.clip(surface * shade[:, None], 0, 1) ** (1 / 1.4)
    image[hits.face < 0] = 1.0
    shown = np.round(image * 255).astype(np.uint8)
    return shown.reshape(small.height_px, small.width_px, 3)


def wireframe(image: np.ndarray, mesh: Mesh, camera: Camera) -> np.ndarray:
    """Draw the edges of the faces that face the camera over a picture of that camera.

    Args:
        image: (h, w, 3) uint8 of the camera, at any scale.
        mesh: in world axes; quads are drawn as quads.
        camera: the view.

    Returns:
        A copy with the wires, half transparent, since they are dense.
    """
    shown = image.copy()
    scale = image.shape[0] / camera.height_px
    triangles = mesh.triangles()
    normals = vertex_normals(mesh.vertices, triangles)
    toward = camera.centre_mm - mesh.vertices
    seen = MeshRays(mesh.vertices, triangles).visible(
        mesh.vertices, normals, camera.centre_mm[None], offset_mm=0.3
    )[:, 0]
    seen &= np.einsum("ni,ni->n", normals, toward) > 0
    pixels, _ = camera.project(mesh.vertices)
    for face in mesh.faces:
        corners = face[face >= 0]
        if seen[corners].all():
            ring = (pixels[corners] * scale * 2**SHIFT).astype(np.int32).reshape(-1, 1, 2)
            cv2.polylines(shown, [ring], True, (40, 90, 160), 1, cv2.LINE_AA, SHIFT)
    return np.asarray(cv2.addWeighted(shown, 0.5, image, 0.5, 0))


def marks(
    image: np.ndarray, points_mm: np.ndarray, camera: Camera, colour: Sequence[float]
) -> np.ndarray:
    """Draw (n, 3) points in mm as dots over a picture of a camera; NaN rows are left out."""
    shown = image.copy()
    scale = image.shape[0] / camera.height_px
    pixels, _ = camera.project(points_mm[np.isfinite(points_mm).all(axis=1)])
    for place in pixels[np.isfinite(pixels).all(axis=1)] * scale:
        _disc(shown, place, max(2.0, image.shape[0] / 240), colour)
    return shown


def line_chart(curves: Mapping[str, tuple[np.ndarray, np.ndarray]], x_label: str) -> np.ndarray:
    """Curves of losses over one axis, the vertical one logarithmic.

    Args:
        curves: name to (x, y), each (n,) finite, y above 0.
        x_label: with unit.

    Returns:
        (360, 720, 3) uint8.
    """
    height, width, left, right, top, bottom = 360, 720, 70, 20, 20, 50
    image = np.full((height, width, 3), 255, np.uint8)
    xs = np.concatenate([x for x, _ in curves.values()]).astype(float)
    ys = np.log10(np.concatenate([y for _, y in curves.values()]).astype(float))
    x_range = (float(xs.min()), max(float(xs.max()), float(xs.min()) + 1e-9))
    low, high = float(ys.min()), float(ys.max())
    room = max(0.05 * (high - low), 0.02)
    y_range = (low - room, high + room)

    def place(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        across = (x - x_range[0]) / (x_range[1] - x_range[0]) * (width - left - right) + left
        up = (y - y_range[0]) / (y_range[1] - y_range[0]) * (height - top - bottom)
        return np.stack([across, height - bottom - up], axis=-1)

    for y in np.linspace(*y_range, 5):
        row = int(place(np.array(x_range[0]), np.array(y))[1])
        cv2.line(image, (left, row), (width - right, row), (225, 225, 225), 1)
        _write(image, f"{10**y:.3g}", (6, row + 4))
    for x in np.linspace(*x_range, 6):
        column = int(place(np.array(x), np.array(y_range[0]))[0])
        cv2.line(image, (column, top), (column, height - bottom), (240, 240, 240), 1)
        _write(image, f"{x:.3g}", (column - 12, height - bottom + 18))
    _write(image, x_label, (width // 2 - 40, height - 10))
    _write(image, "loss", (6, 14))
    for index, (name, (x, y)) in enumerate(curves.items()):
        colour = COLOURS[index % len(COLOURS)]
        ring = (place(x, np.log10(y)) * 2**SHIFT).astype(np.int32).reshape(-1, 1, 2)
        cv2.polylines(image, [ring], False, colour, 2, cv2.LINE_AA, SHIFT)
        _write(image, name, (width - right - 190, top + 16 + 18 * index), colour)
    return image


def labelled(image: np.ndarray, text: str) -> np.ndarray:
    """A picture under a strip with a few words."""
    strip = np.full((24, image.shape[1], 3), 255, np.uint8)
    _write(strip, text, (4, 16))
    return np.concatenate([strip, image], axis=0)


def _write(
    image: np.ndarray, text: str, place: tuple[int, int], colour: Sequence[float] = INK
) -> None:
    cv2.putText(image, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.42, list(colour), 1, cv2.LINE_AA)
