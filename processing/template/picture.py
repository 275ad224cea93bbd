"""A template's texture and mesh beside each other, its faults in colours."""

from __future__ import annotations

import cv2
import numpy as np

from lightstage.counting import counted
from lightstage.formats.template import Template
from processing.atlas.raster import rasterise
from processing.sides import side_hits
from processing.template.check import Finding

ROWS = 960
SIDES_DEG = (-50.0, 0.0, 50.0, 180.0)
PAPER, SKIN, OTHER, LINE, MARK = (255, 255, 255), (222, 214, 206), (170, 172, 178), 60, (20, 20, 20)
COLOURS = (
    (214, 39, 40), (31, 119, 180), (44, 160, 44), (255, 127, 14), (148, 103, 189), (227, 119, 194),
    (23, 190, 207), (188, 189, 34), (140, 86, 75),
)  # fmt: skip


def draw(template: Template, found: list[Finding]) -> np.ndarray:
    """The picture.

    Args:
        template: as read.
        found: by `check_template`; each that names triangles has a colour, which the line below
            explains; where a triangle has several, the first is shown.

    Returns:
        (h, w, 3) uint8: left the texture, right the mesh from four sides, below the findings.
    """
    triangles = template.mesh.triangles()
    colour = np.tile(np.array(OTHER, float), (len(triangles), 1))
    skin = np.zeros(len(template.mesh.vertices), bool)
    for name in ("skin", "lips"):
        skin[template.regions.get(name, np.zeros(0, int))] = True
    colour[skin[triangles].all(axis=1)] = SKIN
    shown = [each for each in found if len(each.triangles)]
    for number, each in reversed(list(enumerate(shown))):
        colour[each.triangles] = COLOURS[number % len(COLOURS)]
    uv = _texture(template, colour)
    side = ROWS // 2
    views = [_side(template, colour, deg, side) for deg in SIDES_DEG]
    right = np.concatenate([np.concatenate(views[:2], 1), np.concatenate(views[2:], 1)])
    top = np.concatenate([uv, right], axis=1)
    return np.concatenate([top, _legend(template, found, shown, top.shape[1])])


def _texture(template: Template, colour: np.ndarray) -> np.ndarray:
    """(ROWS, 2/3 ROWS, 3) uint8: the texture with its triangles' edges and the landmarks."""
    mesh = template.mesh
    columns = ROWS * 2 // 3
    assert mesh.uvs is not None  # a template has UV
    raster = rasterise(mesh.uvs, mesh.triangle_uvs(), ROWS, columns)
    image = np.full((ROWS, columns, 3), 30, np.uint8)
    covered = raster.face >= 0
    image[covered] = colour[raster.face[covered]].astype(np.uint8)
    corners = mesh.uvs[mesh.triangle_uvs()] * [columns, -ROWS] + [0, ROWS]
    lines = image.copy()
    # OpenCV's pixel centres are whole numbers; eight bits below.
    cv2.polylines(
        lines, list(np.round((corners - 0.5) * 256).astype(np.int32)), True, (LINE, LINE, LINE),
        1, cv2.LINE_AA, 8,
    )  # fmt: skip
    image = np.asarray(cv2.addWeighted(image, 0.7, lines, 0.3, 0), np.uint8)
    triangles = mesh.triangles()
    for vertex in template.landmarks:
        at = np.argwhere(triangles == vertex)
        if len(at):
            x, y = corners[at[0][0], at[0][1]]
            cv2.circle(image, (round(x), round(y)), 2, MARK, -1, cv2.LINE_AA)
    return image


def _side(template: Template, colour: np.ndarray, side_deg: float, side_px: int) -> np.ndarray:
    """(side_px, side_px, 3) uint8: the mesh in its triangles' colours, lit from the viewer."""
    mesh = template.mesh
    corners = mesh.vertices[mesh.triangles()]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    turn = np.deg2rad(side_deg)
    toward = np.array([np.sin(turn), 0.4, np.cos(turn)]) / np.hypot(1, 0.4)
    shade = 0.45 + 0.55 * np.abs(normal @ toward)
    hits = side_hits(mesh, side_deg, side_px)
    face = np.maximum(hits.face, 0)
    image = np.clip(colour[face] * shade[face][:, None], 0, 255)
    image[hits.face < 0] = PAPER
    return np.asarray(image.reshape(side_px, side_px, 3).astype(np.uint8))


def _legend(
    template: Template, found: list[Finding], shown: list[Finding], width: int
) -> np.ndarray:
    """Lines of text on white, the colour of each finding before it."""
    summary = counted(len(found), "finding") if found else "nothing found"
    lines: list[tuple[int | None, str]] = [(None, f"{template.name}: {summary}")]
    for each in found:
        number = next((k for k, other in enumerate(shown) if other is each), None)
        line = f"{each.name}: {each.text}" + (" (cannot be used)" if each.unusable else "")
        lines.append((number, line))
    image = np.full((24 * len(lines) + 12, width, 3), 255, np.uint8)
    for row, (number, text) in enumerate(lines):
        y = 24 * row + 20
        if number is not None:
            colour = COLOURS[number % len(COLOURS)]
            cv2.rectangle(image, (8, y - 12), (22, y + 2), colour, -1)
        # OpenCV's letters are ASCII.
        plain = text.encode("ascii", "replace").decode()
        cv2.putText(image, plain, (30, y), cv2.FONT_HERSHEY_SIMPLEX, 0.5, MARK, 1, cv2.LINE_AA)
    return image
