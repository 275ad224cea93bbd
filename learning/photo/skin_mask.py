"""What of a photograph's texture is skin: hair, glasses, cloth and walls are left out."""

from __future__ import annotations

import cv2
import numpy as np

from learning.networks.whole_face import WholeFaceNetwork
from learning.render.uv import UvRaster
from lightstage.formats.template import Template

NOT_SKIN = 0.9
"""Difference in natural logarithms from the mean person's pattern, over some millimetres, from
which a place shows no skin: hair, glasses, a hand's shadow. Freckles and lips stay below .5."""
SPREAD = 1 / 64
"""Of such a place around it, of the texture's rows."""
EYES_SPREAD = 1 / 96
"""Around a template's eyes, of the texture's rows."""
FEATURES = ("eyes", "lips")
"""Regions of a template that may differ from the mean person as they please."""
BROWS = slice(17, 27)
"""In iBUG's order."""
BROW_MM = 14.0
NOT_SKIN_TINT = 0.35
"""The same of red or blue over green: grey cloth and walls."""


def features(template: Template, raster: UvRaster) -> np.ndarray:
    """(rows, columns) bool, eyes, lips and brows of a template: they differ between people."""
    vertices = template.mesh.vertices
    chosen = np.zeros(len(vertices), bool)
    for name in FEATURES:
        chosen[template.regions.get(name, np.zeros(0, int))] = True
    brows = vertices[template.landmarks[BROWS]]
    for place in brows:
        chosen |= np.linalg.norm(vertices - place, axis=1) < BROW_MM
    return np.asarray(raster.interpolate(chosen[:, None].astype(float))[..., 0] > 0)


def around_eyes(template: Template, raster: UvRaster) -> np.ndarray:
    """(rows, columns) bool, a template's eyes and what is within `EYES_SPREAD` of them.

    The network reads the light's strength from the whites of the eyes. A fitted shape has them some
    millimetres beside the person's, and highlights lie on them: without them the network is nearer.
    """
    chosen = np.zeros((len(template.mesh.vertices), 1))
    chosen[template.regions.get("eyes", np.zeros(0, int))] = 1
    eyes = raster.interpolate(chosen)[..., 0] > 0
    return _spread(eyes, EYES_SPREAD)


def no_skin(
    albedo: np.ndarray, network: WholeFaceNetwork, seen: np.ndarray, keep: np.ndarray
) -> np.ndarray:
    """(rows, columns) bool, places whose albedo is far from what skin has there.

    Args:
        albedo: (rows, columns, 3) found.
        network: with the mean person's pattern.
        seen: (rows, columns) bool.
        keep: (rows, columns) bool, never taken for something else.
    """
    rows, columns = seen.shape
    if not seen.any():
        return seen
    mean = network.mean_log_albedo[0].permute(1, 2, 0).numpy()
    mean = cv2.resize(mean, (columns, rows), interpolation=cv2.INTER_LINEAR)
    beside = np.log(np.maximum(albedo, 1e-3)) - mean
    green = beside[..., 1]
    parts = [(beside.mean(axis=2), NOT_SKIN)]
    parts += [(beside[..., c] - green, NOT_SKIN_TINT) for c in (0, 2)]
    weight = seen.astype(np.float32)
    sigma = rows / 192
    around = np.maximum(cv2.GaussianBlur(weight, (0, 0), sigma), 1e-3)
    far = np.zeros_like(seen)
    for part, most in parts:
        off = np.where(seen, part - np.median(part[seen]), 0).astype(np.float32)
        far |= np.abs(cv2.GaussianBlur(off, (0, 0), sigma) / around) > most
    far &= seen & ~keep
    return np.asarray(_spread(far, SPREAD) & ~keep)


def _spread(mask: np.ndarray, share: float) -> np.ndarray:
    """A mask and what is around it, within so much of its rows."""
    reach = max(1, round(share * len(mask)))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    return np.asarray(cv2.dilate(mask.astype(np.uint8), disc) > 0)
