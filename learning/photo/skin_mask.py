"""What of a photograph's texture is skin: hair, glasses, cloth and walls are left out."""

from __future__ import annotations

import cv2
import numpy as np

from learning.masks import widened
from learning.networks.whole_face import DARKEST, WholeFaceNetwork
from learning.photo.face_light import harmonics
from learning.render.uv import UvRaster
from lightstage.formats.template import Template

NOT_SKIN = 0.9
"""Difference in natural logarithms from the mean person's pattern, over some millimetres, from
which a place shows no skin: hair, glasses, a hand's shadow. Freckles and lips stay below .5."""
SPREAD = 1 / 64
"""Of such a place around it, of the texture's rows."""
AROUND = 1 / 192
"""Standard deviation of the millimetres over which means are taken, of the texture's rows."""
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
NOSE_BASE, CHIN, EARS, MOUTH = 33, 8, (0, 16), slice(48, 68)
BELOW_CHIN_MM = 15.0
BEFORE_EARS_MM = 30.0
OTHER_TINT = 0.6
"""Difference of red or blue over green, natural logarithm, from the face's: lights of two colours
make half of it."""
HAIRLINE = 1 / 64
"""Standard deviation by which corners of the region `hair` are rounded, of a texture's rows."""
LEAST_OPEN, LIPS_BORDER = 0.06, 0.02
"""Height of an open mouth, and width of the lips' edge that teeth shine through, of its width."""
BROW_MM = 14.0
NOT_SKIN_TINT = 0.35
"""The same of red or blue over green: grey cloth and walls."""


def features(template: Template, raster: UvRaster) -> np.ndarray:
    """(rows, columns) bool, eyes, lips and brows of a template: they differ between people."""
    vertices = template.mesh.vertices
    chosen = _of_regions(template, FEATURES)
    brows = vertices[template.landmarks[BROWS]]
    for place in brows:
        chosen |= np.linalg.norm(vertices - place, axis=1) < BROW_MM
    return _touched(chosen, raster)


def around_eyes(template: Template, raster: UvRaster) -> np.ndarray:
    """(rows, columns) bool, a template's eyes and what is within `EYES_SPREAD` of them.

    The network reads the light's strength from the whites of the eyes. A fitted shape has them some
    millimetres beside the person's, and highlights lie on them: without them the network is nearer.
    """
    return spread(_touched(_of_regions(template, ("eyes",)), raster), EYES_SPREAD)


def beard_texels(template: Template, raster: UvRaster) -> np.ndarray:
    """(rows, columns) bool, where beards grow: below the nose, in front of the ears."""
    marks = template.mesh.vertices[template.landmarks]
    place = raster.interpolate(template.mesh.vertices)
    below = place[..., 1] < marks[NOSE_BASE, 1]
    above = place[..., 1] > marks[CHIN, 1] - BELOW_CHIN_MM
    ahead = place[..., 2] > marks[list(EARS), 2].mean()
    return np.asarray(raster.covered & below & above & ahead)


def open_mouth(lips_px: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """(h, w) bool, pixels between open lips, which show teeth and tongue.

    Args:
        lips_px: (8, 2) inner edge of the lips in iBUG's order, NaN where hidden.
        shape: of the photograph.
    """
    inside = np.zeros(shape[:2], np.uint8)
    if not np.isfinite(lips_px).all():
        return inside > 0
    width = np.linalg.norm(lips_px[4] - lips_px[0])
    height = np.linalg.norm(lips_px[2] - lips_px[6])
    if height > LEAST_OPEN * width:
        near = np.clip(lips_px, -1, np.array(shape[1::-1]))
        cv2.fillPoly(inside, [np.round(near).astype(np.int32)], 1)
        border = 2 * max(1, round(LIPS_BORDER * width)) + 1
        wide = cv2.dilate(inside, np.ones((border, border), np.uint8))
        return np.asarray(wide > 0)
    return inside > 0


def above_mouth(template: Template, raster: UvRaster) -> np.ndarray:
    """(rows, columns) bool, texels above a template's mouth."""
    height = raster.interpolate(template.mesh.vertices)[..., 1]
    mouth = template.mesh.vertices[template.landmarks[MOUTH], 1].max()
    return np.asarray(raster.covered & (height > mouth))


def own_hair(other: np.ndarray, scalp: np.ndarray, within: np.ndarray) -> np.ndarray:
    """(rows, columns) bool, texels without skin that reach to the scalp: a person's hairline.

    Args:
        other: (rows, columns) bool, texels that show no skin.
        scalp: (rows, columns) bool, texels that are shown where most people have hair.
        within: (rows, columns) bool, where such hair is sought.
    """
    beyond = other & within
    _, label = cv2.connectedComponents((beyond | scalp).astype(np.uint8))
    return np.asarray(beyond & np.isin(label, np.unique(label[scalp])))


def hair_texels(template: Template, raster: UvRaster) -> np.ndarray | None:
    """(rows, columns) bool, where most people have hair; None where a template names no `hair`."""
    inside = _of_regions(template, ("hair",))
    if not inside.any():
        return None
    share = raster.interpolate(inside[:, None].astype(np.float32))[..., 0].astype(np.float32)
    # A region has the corners of a template's quads, which hair has not.
    weight = cv2.GaussianBlur(raster.covered.astype(np.float32), (0, 0), HAIRLINE * len(share))
    soft = cv2.GaussianBlur(share, (0, 0), HAIRLINE * len(share)) / np.maximum(weight, 1e-3)
    return np.asarray(raster.covered & (soft > 0.5))


def _of_regions(template: Template, names: tuple[str, ...]) -> np.ndarray:
    """(n,) bool, vertices of some of a template's regions."""
    chosen = np.zeros(len(template.mesh.vertices), bool)
    for name in names:
        chosen[template.regions.get(name, np.zeros(0, int))] = True
    return chosen


def _touched(chosen: np.ndarray, raster: UvRaster) -> np.ndarray:
    """(rows, columns) bool, texels of triangles that have one of some (n,) vertices."""
    return np.asarray(raster.interpolate(chosen[:, None].astype(float))[..., 0] > 0)


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
    return np.asarray(spread(far, SPREAD) & ~keep)


def other_tint(
    texture: np.ndarray, seen: np.ndarray, template: Template, raster: UvRaster
) -> np.ndarray:
    """(rows, columns) bool, places around the face whose tint is far from the face's: a cap, cloth.

    Light on a face is of few colours, and a cap that is taken for skin would decide the light.

    Args:
        texture: (rows, columns, 3) linear, with its light.
        seen: (rows, columns) bool.
        template: whose texels these are.
        raster: of the texture.
    """
    marks = template.mesh.vertices[template.landmarks]
    place = raster.interpolate(template.mesh.vertices)
    between = (place[..., 1] < marks[BROWS, 1].max()) & (place[..., 1] > marks[CHIN, 1])
    face = between & (place[..., 2] > marks[list(EARS), 2].mean() + BEFORE_EARS_MM)
    log = np.log(np.maximum(np.nan_to_num(texture), DARKEST))
    tint = mean_around(log[..., [0, 2]] - log[..., 1:2], seen)
    if (seen & face).sum() < LEAST_TEXELS:
        return np.zeros_like(seen)
    far = np.abs(tint - np.median(tint[seen & face], axis=0)).max(axis=2) > OTHER_TINT
    return np.asarray(seen & ~face & far)


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
    known = seen & (albedo > 0).all(axis=2) & np.isfinite(texture).all(axis=2)
    if known.sum() < LEAST_TEXELS:
        return np.zeros_like(seen)
    arriving = np.zeros(seen.shape)
    dark = np.maximum(texture[known], DARKEST)
    arriving[known] = (np.log(dark) - np.log(albedo[known])).mean(axis=1)
    values, _ = harmonics(normal[known])
    basis = np.column_stack([np.ones(len(values)), values])
    weight = np.ones(len(basis))
    ridge = 1e-6 * len(basis) * np.eye(basis.shape[1])
    for _ in range(ROBUST_ROUNDS):
        product = basis.T @ (weight[:, None] * basis) + ridge
        found = np.linalg.solve(product, basis.T @ (weight * arriving[known]))
        off = arriving[known] - basis @ found
        weight = 1 / (1 + (off / HALF_AT) ** 2) ** 2
    arriving[known] = off
    far = (_over_millimetres(arriving, known) > NOT_SKIN) & known & ~keep
    return np.asarray(spread(far, SPREAD) & ~keep)


def _over_millimetres(values: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """(rows, columns) size of the mean of what is seen around a texel."""
    return np.abs(mean_around(values, seen))


def mean_around(values: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """(rows, columns[, c]) float32 mean of what is seen within some millimetres of a texel."""
    sigma = AROUND * len(seen)
    around = np.maximum(cv2.GaussianBlur(seen.astype(np.float32), (0, 0), sigma), 1e-3)
    if values.ndim == 3:
        seen, around = seen[..., None], around[..., None]
    known = np.where(seen, values, 0).astype(np.float32)
    return np.asarray(cv2.GaussianBlur(known, (0, 0), sigma) / around)


def spread(mask: np.ndarray, share: float) -> np.ndarray:
    """(rows, columns) bool, a mask of that shape and what is within this share of its rows."""
    return widened(mask, max(1, round(share * len(mask))))
