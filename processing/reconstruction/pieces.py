"""Connected pieces of a mesh, by their area."""

from __future__ import annotations

import numpy as np

from lightstage.formats.mesh import Mesh, connected, directed_edges


def larger_pieces(mesh: Mesh, chosen: np.ndarray, least_cm2: float) -> np.ndarray:
    """Which of a mesh's chosen triangles are in pieces of a size.

    Args:
        mesh: mm.
        chosen: (t,) bool, triangles; pieces are of these alone.
        least_cm2: smaller pieces are dropped.

    Returns:
        (t,) bool.
    """
    faces = mesh.faces[chosen]
    out = np.zeros(len(mesh.faces), bool)
    if not len(faces):
        return out
    piece = connected(directed_edges(faces), len(mesh.vertices))[faces[:, 0]]
    corners = mesh.vertices[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area_mm2 = np.bincount(piece, weights=0.5 * np.linalg.norm(across, axis=1))
    out[chosen] = area_mm2[piece] > 100 * least_cm2
    return out
