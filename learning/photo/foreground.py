"""Which pixels of a photograph show the person, and not what is behind.

A fitted mesh never has quite the outline of the person: its scalp and neck reach over the wall. The
colours of what is surely the face and of what is surely behind separate what is between, by a
cut through the graph of the pixels [Rother2004].
"""

from __future__ import annotations

import cv2
import numpy as np

from learning.masks import widened
from learning.photo.unwrap import smaller
from learning.render.view import cast_from, scene_of
from lightstage.formats.mesh import Mesh
from lightstage.rig import Camera
from processing.colour import srgb_from_linear

LARGEST_PX = 320
"""Longer side of the picture that is cut: colours separate what is behind, not detail."""
ROUNDS = 3
BESIDE = 0.06
"""Of the larger side of the head's outline: what is farther outside it is surely behind."""
LEAST_BEHIND = 0.02
"""Share of the picture that must be surely behind, to know its colours."""


def foreground(rgb_linear: np.ndarray, mesh: Mesh, face: np.ndarray, camera: Camera) -> np.ndarray:
    """Find the pixels that show the person.

    Args:
        rgb_linear: (h, w, 3) photograph.
        mesh: the fitted head, in the camera's world, y upward.
        face: (n,) bool, vertices that surely are the person's.
        camera: of the photograph.

    Returns:
        (h, w) bool; all of it where nothing is surely behind the head.
    """
    small = smaller(camera, LARGEST_PX)
    size = (small.width_px, small.height_px)
    picture = cv2.resize(rgb_linear.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    codes = np.round(255 * np.clip(srgb_from_linear(np.clip(picture, 0, 1)), 0, 1))
    hit = cast_from(scene_of(mesh), *small.pixel_rays())
    triangle = hit["primitive_ids"].astype(np.int64).reshape(size[::-1])
    head = np.isfinite(hit["t_hit"].reshape(size[::-1]))
    sure = head.copy()
    sure[head] = face[mesh.triangles()].all(axis=1)[triangle[head]]
    behind = ~widened(head, _reach(head))
    whole = np.ones(rgb_linear.shape[:2], bool)
    if not sure.any() or behind.mean() < LEAST_BEHIND:
        return whole
    marks = np.where(head, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    marks[behind] = cv2.GC_BGD
    # Dark hair before a dark wall has the wall's colours; so far inside its outline it is the head.
    # Below the face a collar may be inside.
    inner = 2 * _reach(head) + 1
    bordered = np.pad(head.astype(np.uint8), 1)
    inside = cv2.erode(bordered, np.ones((inner, inner), np.uint8))[1:-1, 1:-1] > 0
    height = mesh.vertices[:, 1]
    beside_face = np.zeros_like(head)
    if face.any():
        above = height[mesh.triangles()].min(axis=1) > height[face].min()
        beside_face[head] = above[triangle[head]]
    sure |= inside & beside_face
    marks[sure] = cv2.GC_FGD
    colours_behind, colours_of_person = np.zeros((1, 65)), np.zeros((1, 65))
    anywhere = (0, 0, 0, 0)
    cv2.setRNGSeed(0)
    cv2.grabCut(
        np.ascontiguousarray(codes[..., ::-1].astype(np.uint8)),
        marks,
        anywhere,
        colours_behind,
        colours_of_person,
        ROUNDS,
        cv2.GC_INIT_WITH_MASK,
    )
    person = np.isin(marks, (cv2.GC_FGD, cv2.GC_PR_FGD)).astype(np.uint8)
    # A cut is known to a pixel: at a collar the one before it shows both.
    person = (cv2.erode(person, np.ones((3, 3), np.uint8)) | sure).astype(np.float32)
    return np.asarray(cv2.resize(person, whole.shape[::-1], interpolation=cv2.INTER_LINEAR) > 0.5)


def _reach(head: np.ndarray) -> int:
    """Pixels beside an outline that are in doubt."""
    rows, columns = (np.flatnonzero(head.any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        return 1
    return max(1, round(BESIDE * max(np.ptp(rows), np.ptp(columns))))
