"""Colours for a bare template, by its regions and landmarks, so that a detector sees a face."""

from __future__ import annotations

import itertools

import numpy as np

from lightstage.formats.template import Template

SKIN = (0.50, 0.30, 0.22)
"""Linear red, green and blue, as all of these: a fair person's."""
LIPS = (0.36, 0.13, 0.11)
WHITE = (0.60, 0.57, 0.54)
IRIS = (0.12, 0.07, 0.04)
PUPIL = (0.01, 0.01, 0.01)
HAIR = (0.03, 0.02, 0.015)
BROWS = ((17, 22), (22, 27))
"""First landmark of each brow, and the one behind its last."""
BROW_MM, BROW_SOFT_MM = 3.0, 2.0
EYES = ((36, 3), (42, 0))
"""First landmark of each eye's six, and which of them is the corner at the nose."""
TEAR_DUCT = (0.42, 0.18, 0.15)
IRIS_MM, PUPIL_MM, LID_MM, TEAR_DUCT_MM = 5.8, 2.0, 1.2, 4.0
"""Radii of iris and pupil, half the width of the dark line of the lashes, and the reach of the red
corner at the nose."""


def painted(template: Template) -> np.ndarray:
    """Colours of a template's vertices.

    Args:
        template: regions that it does not name are skin.

    Returns:
        (n, 3) linear.
    """
    vertices = template.mesh.vertices
    colours = np.tile(SKIN, (len(vertices), 1))
    for name, colour in (("lips", LIPS), ("hair", HAIR), ("eyes", WHITE)):
        colours[template.regions.get(name, np.zeros(0, int))] = colour
    marks = vertices[template.landmarks]
    for first, end in BROWS:
        away = _from_line(vertices, marks[first:end])
        share = np.clip((BROW_MM + BROW_SOFT_MM - away) / BROW_SOFT_MM, 0, 1)
        colours += share[:, None] * (np.array(HAIR) - colours)
    ball = np.zeros(len(vertices), bool)
    ball[template.regions.get("eyes", np.zeros(0, int))] = True
    for first, corner in EYES:
        rim = marks[first : first + 6]
        # The iris looks ahead: x and y alone determine it.
        away = np.linalg.norm((vertices - rim.mean(axis=0))[:, :2], axis=1)
        colours[ball & (away < IRIS_MM)] = IRIS
        colours[ball & (away < PUPIL_MM)] = PUPIL
        near = np.linalg.norm(vertices - rim[corner], axis=1) < TEAR_DUCT_MM
        colours[ball & near] = TEAR_DUCT
        lashes = _from_line(vertices, np.concatenate([rim, rim[:1]])) < LID_MM
        colours[lashes & ~ball & ~near] = HAIR
    return colours


def _from_line(points: np.ndarray, line: np.ndarray) -> np.ndarray:
    """(n,) distance of (n, 3) points from a line of segments (m, 3)."""
    nearest = np.full(len(points), np.inf)
    for start, end in itertools.pairwise(line):
        along = end - start
        length = max(float(along @ along), 1e-12)
        part = np.clip((points - start) @ along / length, 0, 1)
        away = np.linalg.norm(points - start - part[:, None] * along, axis=1)
        nearest = np.minimum(nearest, away)
    return nearest
