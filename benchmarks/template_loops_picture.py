"""Our template with closed loops of quads, to look at: face, eye and mouth, at rest and moved.

python -m benchmarks.template_loops_picture docs/template_loops.jpg
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np

from lightstage.formats.mesh import Mesh
from sim.head.loops import loops
from sim.head.loops_template import loops_mesh
from sim.head.modes import EXPRESSIONS, expression_modes

HEIGHT_PX, WIDTH_PX = 560, 360
FACE = (0.0, 0.0, 1.0), (0.0, -32.0, 60.0), 3.0, (HEIGHT_PX, 460)
EYE = (0.35, 0.0, 1.0), (31.0, -5.0, 80.0), 5.5, (HEIGHT_PX // 2, WIDTH_PX)
MOUTH = (0.0, 0.0, 1.0), (0.0, -77.0, 95.0), 4.7, (HEIGHT_PX // 2, WIDTH_PX)
"""Toward the viewer; middle, mm; pixels a mm; size."""
View = tuple[tuple[float, ...], tuple[float, ...], float, tuple[int, int]]
SHOWN = (
    (("", EYE, "at rest"), ("", MOUTH, "at rest")),
    (("eyes_closed", EYE, "closed eyes"), ("jaw_open", MOUTH, "open jaw")),
    (("smile", EYE, "smile"), ("smile", MOUTH, "smile")),
)
LAMP = np.array([-0.35, 0.5, 0.8])
SKIN, BACK, LINE = np.array([235.0, 228.0, 222.0]), np.array([190.0, 120.0, 110.0]), (60, 80, 105)
FINER = 2
"""Times as large it is drawn, for thin lines."""
FINE = 16
"""Parts of a pixel in which OpenCV draws: four bits."""
QUALITY = 58


def wireframe(mesh: Mesh, view: View) -> np.ndarray:
    """(h, w, 3) uint8: a mesh of quads with its edges, the nearest drawn last."""
    toward, middle, scale, (rows, columns) = view
    scale, rows, columns = FINER * scale, FINER * rows, FINER * columns
    ahead = np.array(toward) / np.linalg.norm(toward)
    right = np.cross((0.0, 1.0, 0.0), ahead)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(ahead, right), ahead], axis=1)
    place = (mesh.vertices - middle) @ axes
    pixel = place[:, :2] * (scale, -scale) + np.array([columns, rows]) / 2
    corners = mesh.vertices[mesh.faces]
    normal = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    shade = 0.55 + 0.42 * np.clip(normal @ (axes @ (LAMP / np.linalg.norm(LAMP))), 0, 1)
    colour = np.where((normal @ ahead > 0)[:, None], SKIN * shade[:, None], BACK)
    at = pixel[mesh.faces]
    inside = ((at > -40) & (at < (columns + 40, rows + 40))).all(axis=(1, 2))
    image = np.full((rows, columns, 3), 255, np.uint8)
    for face in np.argsort(place[mesh.faces, 2].mean(axis=1)):
        if inside[face]:
            outline = [np.round(FINE * at[face]).astype(np.int32)]
            cv2.fillPoly(image, outline, colour[face].tolist(), cv2.LINE_AA, 4)
            cv2.polylines(image, outline, True, LINE, 1, cv2.LINE_AA, 4)
    size = (columns // FINER, rows // FINER)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def named(image: np.ndarray, name: str) -> np.ndarray:
    """A picture with a name in its corner, or as it is where that is empty."""
    if name:
        (width, height), _ = cv2.getTextSize(name, cv2.FONT_HERSHEY_SIMPLEX, 0.5, 1)
        image[: height + 10, : width + 10] = 255
        place = (5, height + 4)
        cv2.putText(image, name, place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, LINE, 1, cv2.LINE_AA)
    return image


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("picture", type=Path)
    picture = parser.parse_args().picture
    mesh, modes = loops_mesh(), dict(zip(EXPRESSIONS, expression_modes(), strict=True))
    columns = [wireframe(mesh, FACE)]
    for column in SHOWN:
        cells = []
        for expression, view, name in column:
            offset = loops().carried(modes[expression]) if expression else 0.0
            cell = wireframe(mesh.with_vertices(mesh.vertices + offset), view)
            cells.append(named(cell, name))
        columns.append(np.concatenate(cells))
    image = np.concatenate(columns, axis=1)
    quality = [cv2.IMWRITE_JPEG_QUALITY, QUALITY]
    cv2.imwrite(str(picture), image[..., ::-1], quality)


if __name__ == "__main__":
    main()
