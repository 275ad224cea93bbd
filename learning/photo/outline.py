"""Outlines of a head in a photograph: where the model turns away, and the edges beside it."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np

from learning.photo.model import ShapeModel
from learning.photo.sampling import sampled
from learning.render.view import cast_from, scene_of
from lightstage.formats.mesh import Mesh, vertex_normals
from lightstage.rig import Camera

REACH_MM = 8.0
"""Edges are sought so far from the model's outline."""
STEP_MM = 0.75
BEHIND_MM = 15.0
"""A rim of the model is an outline where what is seen beside it is so much farther away."""
BESIDE_MM = 2.0
ITSELF_MM = 12.0
"""A ray just inside the outline meets the head within so much of the rim."""
CLEAR = 1.5
"""An edge counts where it is so many times as strong as its surroundings; fully at `CLEAR` + 2."""
FLAT = 0.02
"""Change of the photograph's values, a step, that is noise."""
SHORTEST_PX = 0.2
TINY = 1e-9


@dataclasses.dataclass(frozen=True)
class Rims:
    """Places on the model's outline and where the photograph has an edge near each.

    Attributes:
        model: of the places.
        outward: (r, 2) unit, in the picture.
        target_px: (r,) along `outward` from the picture's origin.
        weight: (r,) how much each counts: mm of the outline, less where the edge is not clear.
    """

    model: ShapeModel
    outward: np.ndarray
    target_px: np.ndarray
    weight: np.ndarray


def find_rims(
    model: ShapeModel, mesh: Mesh, camera: Camera, rgb_linear: np.ndarray, rim: np.ndarray
) -> Rims:
    """Places of the outline, and the strongest edge of the photograph beside each.

    Args:
        model: of the mesh's n vertices.
        mesh: as the model has it, in the camera's world, mm.
        camera: the photograph's.
        rgb_linear: (h, w, 3).
        rim: (n,) bool, vertices that may be on an outline.
    """
    pairs = outline(mesh, camera)
    pairs = pairs[rim[pairs].all(axis=1)]
    px_of_mm = camera.fx_px / float(np.linalg.norm(camera.centre_mm))
    ends = camera.project(mesh.vertices[pairs].reshape(-1, 3))[0].reshape(-1, 2, 2)
    along = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(along, axis=1)
    keep = length > SHORTEST_PX
    pairs, ends, along, length = pairs[keep], ends[keep], along[keep], length[keep]
    middle = ends.mean(axis=1)
    outward = np.stack([along[:, 1], -along[:, 0]], axis=1) / length[:, None]
    normals = vertex_normals(mesh.vertices, mesh.triangles())[pairs].mean(axis=1)
    turned = (normals @ camera.cam_from_world[:, :3].T)[:, :2]
    outward *= np.where((turned * outward).sum(axis=1) < 0, -1, 1)[:, None]
    reach, step = REACH_MM * px_of_mm, STEP_MM * px_of_mm
    offsets = np.arange(-reach, reach + step / 2, step)
    at = (middle[:, None] + offsets[None, :, None] * outward[:, None]).reshape(-1, 2)
    # About as eyes see it, so that dark edges count too.
    seen = np.sqrt(np.clip(np.nan_to_num(rgb_linear), 0, 4)).astype(np.float32)
    soft = cv2.GaussianBlur(seen, (0, 0), 1.0)
    colours = [sampled(np.ascontiguousarray(soft[..., c]), at).astype(float) for c in range(3)]
    values = np.stack(colours, axis=1).reshape(len(middle), len(offsets), 3)
    change = np.linalg.norm(values[:, 2:] - values[:, :-2], axis=2)
    score = change * np.exp(-0.5 * (offsets[1:-1] / (0.5 * reach)) ** 2)
    best = score.argmax(axis=1)
    clear = score[np.arange(len(score)), best] / (change.mean(axis=1) + FLAT)
    target = (middle * outward).sum(axis=1) + offsets[1:-1][best]
    weight = np.clip((clear - CLEAR) / 2, 0, 1) * length / px_of_mm
    halves = np.tile([0.5, 0.5, 0.0], (len(pairs), 1))
    places = model.at(np.column_stack([pairs, pairs[:, :1]]), halves)
    return Rims(places, outward, target, weight)


def outline(mesh: Mesh, camera: Camera) -> np.ndarray:
    """(r, 2) edges of a mesh at which it turns away, with nothing of it close behind.

    Args:
        mesh: in the camera's world, mm.
        camera: that sees it.
    """
    triangles = mesh.triangles()
    corners = mesh.vertices[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing = (normal * (camera.centre_mm - corners[:, 0])).sum(axis=1) > 0
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    of = np.repeat(np.arange(len(triangles)), 3)
    order = np.lexsort(edges.T[::-1])
    edges, of = edges[order], of[order]
    same = (edges[1:] == edges[:-1]).all(axis=1)
    turns = same & (facing[of[1:]] != facing[of[:-1]])
    pairs = edges[1:][turns]
    # A ray just outside must pass the head or meet it far behind; one just inside, the rim itself.
    middle = mesh.vertices[pairs].mean(axis=1)
    normals = vertex_normals(mesh.vertices, triangles)[pairs].mean(axis=1)
    toward = middle - camera.centre_mm
    distance = np.linalg.norm(toward, axis=1, keepdims=True)
    scene = scene_of(mesh)

    def met(beside_mm: float) -> np.ndarray:
        ray = middle + beside_mm * normals - camera.centre_mm
        ray /= np.maximum(np.linalg.norm(ray, axis=1, keepdims=True), TINY)
        return cast_from(scene, camera.centre_mm, ray)["t_hit"]

    outer, inner = met(BESIDE_MM), met(-BESIDE_MM)
    clear = outer > distance[:, 0] + BEHIND_MM
    itself = np.abs(inner - distance[:, 0]) < ITSELF_MM
    found: np.ndarray = pairs[clear & itself]
    return found
