"""Errors of a reconstructed mesh and of a registered template against the true surface."""

from __future__ import annotations

import numpy as np

from lightstage.counting import counted
from lightstage.formats.mesh import Mesh
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.template import Template
from processing.closest import ClosestPoints, weighted_quantile
from processing.errors import EvaluationError


def true_skin_points(true: ProcessedFolder, most: int) -> np.ndarray:
    """(n, 3) points of the true skin that the cameras see, evenly from all views' pixels."""
    points = [
        true.read_view(camera, "position")[true.read_mask(camera)] for camera in true.view_ids()
    ]
    joined = np.concatenate(points) if points else np.zeros((0, 3), np.float32)
    return joined[:: max(1, -(-len(joined) // most))]


def base_mesh_errors(
    found: Mesh, true: Mesh, surface_mm: np.ndarray, within_mm: float
) -> dict[str, float]:
    """How far a reconstructed mesh is from the true one, and how much of the face it has.

    Args:
        found: the reconstruction.
        true: the whole true mesh.
        surface_mm: (n, 3) points of true skin that the cameras saw.
        within_mm: a true point this near to the mesh counts as reconstructed.

    Returns:
        base_mesh_median_mm and _p95_mm (reconstruction to truth, every part of it weighted by its
        area), skin_median_mm and skin_p95_mm (true skin to reconstruction) and the share of the
        skin within `within_mm`.
    """
    triangles = found.triangles()
    corners = found.vertices[triangles]
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    if not area.any():
        raise EvaluationError("base mesh", found="no area", expected="a surface")
    away = ClosestPoints(true.vertices, true.triangles()).query(corners.mean(axis=1)).distance_mm
    facts = {
        "base_mesh_median_mm": weighted_quantile(away, area, 0.5),
        "base_mesh_p95_mm": weighted_quantile(away, area, 0.95),
    }
    if len(surface_mm):
        missing = ClosestPoints(found.vertices, triangles).query(surface_mm).distance_mm
        facts["skin_median_mm"] = float(np.median(missing))
        facts["skin_p95_mm"] = float(np.percentile(missing, 95))
        facts["skin_within_share"] = float((missing <= within_mm).mean())
        facts["skin_within_mm"] = within_mm
    return facts


def registration_errors(
    found: Mesh,
    true: Mesh,
    surface_mm: np.ndarray,
    landmarks_mm: np.ndarray,
    template: Template,
) -> dict[str, float]:
    """How far a registered template is from the person, as a surface and as a correspondence.

    A surface error near zero with landmarks millimetres away is a failed registration that seems
    perfect, so both are reported.

    Args:
        found: the registered template.
        true: the person's own mesh.
        surface_mm: (n, 3) points of true skin that the cameras saw.
        landmarks_mm: (68, 3) true landmarks, NaN where absent.
        template: what was registered.

    Returns:
        skin_median_mm and skin_p95_mm (true skin to registered surface), landmark_mean_mm and
        landmark_max_mm; correspondence_mean_mm over the template's skin where the person has the
        template's own topology, so that each vertex has a true place.
    """
    if len(found.vertices) != len(template.mesh.vertices):
        raise EvaluationError(
            "registered mesh",
            found=counted(len(found.vertices), "vertex", "vertices"),
            expected=f"the {len(template.mesh.vertices)} of template {template.name}",
            hint="Name the template that it was registered to.",
        )
    facts: dict[str, float] = {}
    if len(surface_mm):
        away = ClosestPoints(found.vertices, found.triangles()).query(surface_mm).distance_mm
        facts["skin_median_mm"] = float(np.median(away))
        facts["skin_p95_mm"] = float(np.percentile(away, 95))
    apart = np.linalg.norm(found.vertices[template.landmarks] - landmarks_mm, axis=1)
    apart = apart[np.isfinite(apart)]
    if len(apart):
        facts["landmark_mean_mm"] = float(apart.mean())
        facts["landmark_max_mm"] = float(apart.max())
    if np.array_equal(found.faces, true.faces) and "skin" in template.regions:
        skin = template.regions["skin"]
        facts["correspondence_mean_mm"] = float(
            np.linalg.norm(found.vertices[skin] - true.vertices[skin], axis=1).mean()
        )
    return facts
