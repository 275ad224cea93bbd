"""Skin between hairs: pixels of a foreign scene's skin that a beard or a fringe all but hides.

A pixel that happens to fall between two hairs shows skin, in a picture in which nothing less than
the hair can be resolved. `benchmarks.foreign` scores it with all other skin, and gives the errors
without it beside.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from benchmarks.foreign_session import SKIN
from lightstage.formats.mesh import read_ply
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import load_session
from processing.rays import MeshRays
from processing.readings import px_per_mm
from sim.session import truth_path

IN_FRONT_MM = 0.3
"""What is shown is so far in front of the bare person's surface where something is worn."""
GAP_MM = 4.0
"""Skin in narrower gaps between what is worn is between hairs."""


def between_hairs(session_path: Path) -> dict[str, np.ndarray]:
    """(h, w) bool of each camera: pixels that are worn, or in a narrow gap between such.

    The edge of a collar is no gap: skin beside it is not among these.
    """
    truth, out = ProcessedFolder(truth_path(session_path)), {}
    bare = read_ply(session_path.parent / SKIN)
    rays = MeshRays(bare.vertices, bare.triangles())
    for camera in load_session(session_path).rig.cameras:
        shown = truth.read_view(camera.id, "position")
        away = np.linalg.norm(shown - camera.centre_mm, axis=2)
        behind = rays.cast_camera(camera).distance_mm.reshape(away.shape)
        worn = shown.any(axis=2) & (behind - away > IN_FRONT_MM)
        out[camera.id] = narrow_gaps_filled(worn, GAP_MM * px_per_mm(camera))
    return out


def narrow_gaps_filled(mask: np.ndarray, gap_px: float) -> np.ndarray:
    """(h, w) bool: a mask, and gaps in it that no disc of `gap_px` across fits into."""
    radius = max(1, round(gap_px / 2))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    padded = np.pad(mask.astype(np.uint8), 2 * radius)
    closed = cv2.morphologyEx(padded, cv2.MORPH_CLOSE, disc) > 0
    return np.asarray(closed[2 * radius : -2 * radius, 2 * radius : -2 * radius])
