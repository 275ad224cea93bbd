"""ICT's head beside ours: in the head frame, and which place of our head each of its points is."""

from __future__ import annotations

import functools

import numpy as np

from sim.head.mesh import neutral_mesh, regions
from sim.light.texture import raster_uv, texture_of
from sim.scans.ict import IctModel
from sim.scans.ict_tile import BACK, FACE, parts_of
from sim.scans.lps import head_from_landmarks
from sim.scans.match import carried, own_grid_uv

# ICT's right and left ear lie in these parts of the face's own tile (u below, v from and to).
_EAR_TILE = (0.12, 0.44, 0.72)


def head_from_ict(vertices_mm: np.ndarray, model: IctModel) -> np.ndarray:
    """(3, 4) rigid motion from the model's axes to the head frame, by a neutral face's landmarks.

    Args:
        vertices_mm: (n, 3) all the model's vertices of one person's neutral face.
        model: where its landmarks are.
    """
    return head_from_landmarks(vertices_mm[model.landmarks])


@functools.lru_cache(maxsize=2)
def own_grid_uv_of(model: IctModel, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """For each texel of the subject's texture its place in our vertex grid, found on the mean face.

    Args:
        model: the model.
        rows: of the texture; columns are two thirds.

    Returns:
        (rows, columns, 2) float32, and (rows, columns) bool where head or face is: the texels for
        which it holds.
    """
    parts = parts_of(model)
    motion = head_from_ict(model.mesh.vertices, model)
    everything = model.mesh.vertices @ motion[:, :3].T + motion[:, 3]
    mesh = parts.mesh(everything[parts.vertices])
    face, weights = raster_uv(mesh, rows, rows * 2 // 3)
    skin = np.isin(parts.triangle_parts(), (FACE, BACK))
    covered = (face >= 0) & skin[np.maximum(face, 0)]
    # The warp is smooth, so vertices are carried and texels lie between them.
    there = carried(mesh.vertices, everything[model.landmarks], anchors(model, everything))
    places = texture_of(there, mesh.triangles(), face, weights)
    out = np.zeros((*face.shape, 2), np.float32)
    out[covered] = own_grid_uv(places[covered], with_eyes=False)[0]
    return out, covered


def anchors(model: IctModel, vertices_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points beside the landmarks that both heads have: crown, back, neck, extremes of the ears.

    Args:
        model: the model.
        vertices_mm: (n, 3) all its vertices, head frame.

    Returns:
        (k, 3) on ICT's head and (k, 3) on ours.
    """
    parts = parts_of(model)
    used = np.unique(parts.faces[np.isin(parts.part, (FACE, BACK))])
    skin = vertices_mm[parts.vertices[used[used >= 0]]]
    own = neutral_mesh().vertices
    theirs: list[np.ndarray] = []
    ours: list[np.ndarray] = []
    for points, out in ((skin, theirs), (own, ours)):
        middle = points[np.abs(points[:, 0]) < 6.0]
        crown = middle[middle[:, 1].argmax()]
        behind = middle[np.abs(middle[:, 1]) < 40.0]
        out += [crown, behind[behind[:, 2].argmin()]]
    for ear in _ears(model, vertices_mm):
        theirs.append(_extremes(ear))
    for side in (-1, 1):
        ear = own[regions()["ears"]]
        ours.append(_extremes(ear[ear[:, 0] * side > 0]))
    return np.vstack(theirs), np.vstack(ours)


def _ears(model: IctModel, vertices_mm: np.ndarray) -> list[np.ndarray]:
    """Vertices of the right and the left ear."""
    mesh = model.mesh
    assert mesh.uvs is not None
    assert mesh.face_uvs is not None
    real = (mesh.faces >= 0) & (mesh.faces.max(axis=1, keepdims=True) <= 9408)
    uv = np.full((len(mesh.vertices), 2), np.nan)
    uv[mesh.faces[real]] = mesh.uvs[mesh.face_uvs[real]]
    edge, low, high = _EAR_TILE
    height = (uv[:, 1] > low) & (uv[:, 1] < high)
    return [vertices_mm[height & near] for near in (uv[:, 0] < edge, uv[:, 0] > 1 - edge)]


def _extremes(ear: np.ndarray) -> np.ndarray:
    """(4, 3) top, bottom, back and outermost point."""
    picks = (ear[:, 1].argmax(), ear[:, 1].argmin(), ear[:, 2].argmin(), np.abs(ear[:, 0]).argmax())
    return ear[list(picks)]
