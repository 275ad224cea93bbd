"""What of a photograph's texture is skin: hair, glasses, cloth and walls are left out."""

from __future__ import annotations

import cv2
import numpy as np

from learning.networks.whole_face import DARKEST, WholeFaceNetwork
from learning.render.uv import UvRaster
from lightstage.formats.template import Template

NOT_SKIN = 0.9
"""Difference in natural logarithms from the mean person's pattern, over some millimetres, from
which a place shows no skin: hair, glasses, a hand's shadow. Freckles and lips stay below .5."""
SPREAD = 1 / 64
"""Of such a place around it, of the texture's rows."""
HALF_AT = 0.35
"""Natural logarithm at which a place weighs a quarter in the fit of a soft light."""
ROBUST_ROUNDS = 12
LEAST_TEXELS = 200
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
    far = np.zeros_like(seen)
    for part, most in parts:
        far |= _over_millimetres(part - np.median(part[seen]), seen) > most
    far &= seen & ~keep
    return np.asarray(_spread(far, SPREAD) & ~keep)


def in_no_light(
    texture: np.ndarray,
    albedo: np.ndarray,
    normal: np.ndarray,
    seen: np.ndarray,
    keep: np.ndarray,
) -> np.ndarray:
    """(rows, columns) bool, places that no soft light on this skin explains: a hat, glasses.

    The logarithm of what arrives is fitted by spherical harmonics of the normals up to order 2
    [Ramamoorthi2001]; places that are far off lose their weight [GemanMcClure1985]. Cast shadows
    are far off too, so this is for photographs that no lamps explain.

    Args:
        texture: (rows, columns, 3) linear.
        albedo: (rows, columns, 3) that the network found.
        normal: (rows, columns, 3) unit.
        seen: (rows, columns) bool.
        keep: (rows, columns) bool, never taken for something else.
    """
    known = seen & (albedo > 0).all(axis=2)
    if known.sum() < LEAST_TEXELS:
        return np.zeros_like(seen)
    arriving = np.zeros(seen.shape)
    dark = np.maximum(texture[known], DARKEST)
    arriving[known] = (np.log(dark) - np.log(albedo[known])).mean(axis=1)
    basis = harmonics(normal[known])
    weight = np.ones(len(basis))
    for _ in range(ROBUST_ROUNDS):
        normal_matrix = basis.T @ (weight[:, None] * basis) + 1e-6 * len(basis) * np.eye(9)
        found = np.linalg.solve(normal_matrix, basis.T @ (weight * arriving[known]))
        off = arriving[known] - basis @ found
        weight = 1 / (1 + (off / HALF_AT) ** 2) ** 2
    arriving[known] = off
    far = (_over_millimetres(arriving, known) > NOT_SKIN) & known & ~keep
    return np.asarray(_spread(far, SPREAD) & ~keep)


def harmonics(normal: np.ndarray) -> np.ndarray:
    """(n, 9) polynomials of (n, 3) directions that span the harmonics of orders 0 to 2."""
    x, y, z = np.asarray(normal, float).T
    return np.stack([np.ones_like(x), x, y, z, x * y, y * z, x * z, x * x - y * y, z * z], axis=1)


def _over_millimetres(values: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """(rows, columns) size of the mean of what is seen around a texel."""
    sigma = len(seen) / 192
    around = np.maximum(cv2.GaussianBlur(seen.astype(np.float32), (0, 0), sigma), 1e-3)
    off = np.where(seen, values, 0).astype(np.float32)
    return np.abs(cv2.GaussianBlur(off, (0, 0), sigma) / around)


def _spread(mask: np.ndarray, share: float) -> np.ndarray:
    """A mask and what is around it, within so much of its rows."""
    reach = max(1, round(share * len(mask)))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    return np.asarray(cv2.dilate(mask.astype(np.uint8), disc) > 0)
