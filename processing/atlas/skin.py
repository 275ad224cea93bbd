"""Which of a template's places are skin: not eyes, teeth or hair, whoever was captured."""

from __future__ import annotations

import numpy as np

from lightstage.formats.template import Template

EYES = ((36, 37, 38, 39, 40, 41), (42, 43, 44, 45, 46, 47))
"""Landmarks around each eye, iBUG's order."""
INNER_LIPS = (60, 61, 62, 63, 64, 65, 66, 67)
"""Landmarks around the opening of the mouth."""
SKIN_REGIONS = ("skin", "lips")
OTHER_SKIN = ("skin", "lips", "ears")
STEP_MM = 1.0
"""Between the points that stand for the line around an eye or the mouth's opening."""


def skin_vertices(template: Template, margin_mm: float) -> np.ndarray:
    """Vertices that show skin and nothing else on everybody who is registered to a template.

    Skin is the regions `skin` and `lips`; of a template without a region `skin`, all but the
    regions that are named otherwise. Left out are the region `eyes`, what the landmarks of an eye
    or of the lips' inner border enclose in the texture, and all that is nearer than a margin to any
    of these: registration leaves lids and lips off by about as much, so an iris, lashes or teeth
    may be there.

    Args:
        template: with landmarks; its regions may be empty.
        margin_mm: on the template's own mesh.

    Returns:
        (n,) bool.
    """
    from scipy.spatial import cKDTree

    vertices = template.mesh.vertices
    skin = np.zeros(len(vertices), bool)
    if "skin" in template.regions:
        for name in SKIN_REGIONS:
            skin[template.regions.get(name, [])] = True
    else:
        skin[:] = True
        for name, chosen in template.regions.items():
            if name not in OTHER_SKIN:
                skin[chosen] = False
    no_skin = np.zeros(len(vertices), bool)
    no_skin[template.regions.get("eyes", [])] = True
    places = _first_uv(template)
    lines = []
    for contour in (*EYES, INNER_LIPS):
        around = template.landmarks[list(contour)]
        no_skin |= _inside(places, places[around])
        lines.append(_line(vertices[around]))
    points = np.concatenate([vertices[no_skin], *lines])
    distance_mm, _ = cKDTree(points).query(vertices, distance_upper_bound=max(margin_mm, 1e-9))
    return np.asarray(skin & ~no_skin & ~(distance_mm <= margin_mm))


def _first_uv(template: Template) -> np.ndarray:
    """(n, 2) texture coordinates of each vertex: of one of its corners where it has several."""
    mesh = template.mesh
    assert mesh.uvs is not None  # a template has UV
    uv = np.full((len(mesh.vertices), 2), np.nan)
    uv[mesh.triangles().ravel()] = mesh.uvs[mesh.triangle_uvs().ravel()]
    return uv


def _inside(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(n,) bool: points (n, 2) inside a polygon (k, 2), by counting crossed edges."""
    inside = np.zeros(len(points), bool)
    x, y = points.T
    for (x1, y1), (x2, y2) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        crosses = (y1 > y) != (y2 > y)
        if y1 != y2:
            inside ^= crosses & (x < x1 + (y - y1) * (x2 - x1) / (y2 - y1))
    return inside


def _line(corners: np.ndarray) -> np.ndarray:
    """(m, 3) points along a closed line through corners (k, 3) mm."""
    parts = []
    for first, last in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        count = 1 + int(np.linalg.norm(last - first) / STEP_MM)
        share = np.arange(count)[:, None] / count
        parts.append(first * (1 - share) + last * share)
    return np.concatenate(parts)
