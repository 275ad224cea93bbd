"""Areas of the template's face by name: where on a head a distance is measured."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from lightstage.formats.template import Template

AROUND_EARS_MM = 20.0
NEAR = {
    "chin": (slice(5, 12), 25.0),
    "eyes": (slice(36, 48), 12.0),
    "nose": (slice(27, 36), 14.0),
    "lips": (slice(48, 68), 5.0),
}
"""Landmarks by iBUG's order, and how near to one of them a vertex counts; the last one wins."""
AREAS = (
    *("ears", "around the ears", "nose", "lips", "eyes", "cheeks", "forehead", "chin", "neck"),
    "scalp",
)


def areas_of(template: Template) -> np.ndarray:
    """(n,) index into `AREAS` of each of a template's vertices, in the head frame."""
    vertices, marks = template.mesh.vertices, template.mesh.vertices[template.landmarks]
    area = np.full(len(vertices), AREAS.index("cheeks"))
    brows, chin = marks[17:27, 1].mean(), marks[8]
    area[vertices[:, 1] > brows] = AREAS.index("forehead")
    behind = (vertices[:, 1] < chin[1]) | (vertices[:, 2] < marks[:, 2].min())
    area[behind & (vertices[:, 1] <= marks[:17, 1].max())] = AREAS.index("neck")
    area[vertices[:, 2] < marks[:, 2].min() - 20] = AREAS.index("scalp")
    area[vertices[:, 1] < chin[1]] = AREAS.index("neck")
    area[template.regions.get("hair", np.zeros(0, int))] = AREAS.index("scalp")
    for name, (some, near_mm) in NEAR.items():
        area[cKDTree(marks[some]).query(vertices)[0] < near_mm] = AREAS.index(name)
    for name in ("lips", "eyes", "ears"):
        chosen = template.regions.get(name, np.zeros(0, int))
        if name == "ears" and len(chosen):
            away = cKDTree(vertices[chosen]).query(vertices)[0]
            area[away < AROUND_EARS_MM] = AREAS.index("around the ears")
        area[chosen] = AREAS.index(name)
    return area
