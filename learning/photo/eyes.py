"""Where a photograph shows the whites of the eyes, by which skin's brightness is known.

A dark face in bright light and a light one in dim light give the same skin in a photograph; the
whites of the eyes differ little between people, and the network reads the light's strength from
them. Behind sunglasses or closed lids there are none, and the tone is less certain. A fitted shape
has its eyes some millimetres beside the person's, so that its texels would show lids: they are
filled from where the photograph shows the eye open.
"""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np

from learning.photo.unwrap import GRAZING, Unwrapped
from learning.render.uv import UvRaster
from lightstage.formats.template import Template

EYES = (slice(36, 42), slice(42, 48))
"""Outlines among iBUG's 68 landmarks [Sagonas2016]."""
SKIN = (2, 14, 29, 30, 31, 35)
"""Beside these landmarks (jaw, nose) nearly every photograph shows skin."""
LEAST_PX = 8
"""Least width of an eye in which its white can be told from its iris."""
AS_BRIGHT, AS_COLOURED, LEAST_SHARE = 0.4, 0.7, 0.08
"""White is at least so bright beside skin, at most so saturated, and this share of an open eye."""
GROWN = 1.35
"""White is sought within the eye's outline, made so much larger: the detector's is a little off."""
OUTERMOST = 0.03
"""Share of the white's pixels that its extent leaves out on each side."""


def whites_are_seen(rgb_linear: np.ndarray, marks: np.ndarray) -> bool | None:
    """Whether a face's photograph shows the white of an eye.

    Args:
        rgb_linear: (h, w, 3).
        marks: (68, 2) px of iBUG's landmarks, NaN where hidden.

    Returns:
        None where it cannot be known: both eyes are hidden by the head or too small, or there is
        no skin to compare with.
    """
    eyes = [marks[each] for each in EYES]
    large = [eye for eye in eyes if np.isfinite(eye).all() and np.ptp(eye[:, 0]) >= LEAST_PX]
    skin = _skin(rgb_linear, marks)
    if not large or skin is None:
        return None
    return any(_white_share(rgb_linear, eye, skin) >= LEAST_SHARE for eye in large)


def openings(rgb_linear: np.ndarray, marks: np.ndarray) -> np.ndarray:
    """Where a face's eyes are open: parallelograms that hold their whites and irises.

    Args:
        rgb_linear: (h, w, 3).
        marks: (68, 2) px of iBUG's landmarks, NaN where hidden.

    Returns:
        (2, 3, 2) px, of the person's right and left eye: the corner up and left in an upright face,
        the side from there to the face's left, and the side down. NaN where no white is seen.
    """
    found = np.full((2, 3, 2), np.nan)
    skin = _skin(rgb_linear, marks)
    for index, outline in enumerate(EYES):
        eye = marks[outline]
        if skin is None or not np.isfinite(eye).all() or np.ptp(eye[:, 0]) < LEAST_PX:
            continue
        if _white_share(rgb_linear, eye, skin) < LEAST_SHARE:
            continue
        middle = eye.mean(axis=0)
        row, column = np.nonzero(_whites(rgb_linear, GROWN * (eye - middle) + middle, skin))
        # The iris lies between its whites; of an eye that looks aside one of the two is hidden.
        places = np.concatenate([np.column_stack([column, row]) + 0.5, middle[None]])
        along = (eye[3] - eye[0]) / max(float(np.linalg.norm(eye[3] - eye[0])), 1e-6)
        axes = np.array([along, [-along[1], along[0]]])
        low, high = np.quantile(places @ axes.T, [OUTERMOST, 1 - OUTERMOST], axis=0)
        found[index] = [low @ axes, *((high - low)[:, None] * axes)]
    return found


@dataclasses.dataclass(frozen=True)
class EyeTexels:
    """The texels of a template's eyes.

    Attributes:
        texels: (2, rows, columns) bool, of the person's right and left eye.
        place: (rows, columns, 2) in their eye: from 0 to 1 to the face's left, and down.
    """

    texels: np.ndarray
    place: np.ndarray


def eye_texels(template: Template, raster: UvRaster) -> EyeTexels | None:
    """Where a template's eyes are in its texture; None where it names no region `eyes`."""
    vertices = template.mesh.vertices
    region = template.regions.get("eyes", np.zeros(0, int))
    if not len(region):
        return None
    middles = np.array([vertices[template.landmarks[each]].mean(axis=0) for each in EYES])
    nearest = np.linalg.norm(vertices[region, None] - middles, axis=2).argmin(axis=1)
    texels = np.zeros((2, *raster.covered.shape), bool)
    place = np.zeros((*raster.covered.shape, 2))
    position = raster.interpolate(vertices)
    for index in range(2):
        own = region[nearest == index]
        if not len(own):
            continue
        inside = np.zeros((len(vertices), 1))
        inside[own] = 1
        texels[index] = raster.covered & (raster.interpolate(inside)[..., 0] > 0.5)
        low, high = vertices[own].min(axis=0), vertices[own].max(axis=0)
        # A texel that is half the region's may lie a little beyond its vertices.
        share = np.clip((position[texels[index]] - low) / np.maximum(high - low, 1e-6), 0, 1)
        place[texels[index]] = np.column_stack([share[:, 0], 1 - share[:, 1]])
    return EyeTexels(texels, place)


def with_eyes(
    unwrapped: Unwrapped, rgb_linear: np.ndarray, openings_px: np.ndarray, eyes: EyeTexels
) -> Unwrapped:
    """A photograph in texels whose eyes are filled from where it shows them open.

    Args:
        unwrapped: by the fitted shape.
        rgb_linear: (h, w, 3).
        openings_px: of `openings`.
        eyes: texels of the template.
    """
    texture, seen = unwrapped.texture.copy(), unwrapped.seen.copy()
    facing = unwrapped.facing.copy()
    for here, (corner, *sides) in zip(eyes.texels, openings_px, strict=True):
        if not here.any() or not np.isfinite([corner, *sides]).all():
            continue
        place = corner + eyes.place[here] @ np.array(sides)
        # Where a texel holds several pixels it shows their mean.
        area = float(np.prod(np.linalg.norm(sides, axis=1))) / here.sum()
        texture[here] = _blurred_at(rgb_linear, place, 0.5 * np.sqrt(area))
        seen[here] = True
        facing[here] = np.maximum(facing[here], GRAZING)
    return Unwrapped(texture, seen, facing)


def _blurred_at(rgb: np.ndarray, place_px: np.ndarray, sigma: float) -> np.ndarray:
    """(n, 3) of a picture at (n, 2) places, blurred."""
    margin = int(np.ceil(4 * sigma)) + 2
    size = np.array(rgb.shape[1::-1])
    low = np.clip(np.floor(place_px.min(axis=0)).astype(int) - margin, 0, size - 1)
    high = np.clip(np.ceil(place_px.max(axis=0)).astype(int) + margin, low + 1, size)
    part: np.ndarray = np.ascontiguousarray(rgb[low[1] : high[1], low[0] : high[0]], np.float32)
    if sigma > 0.5:
        part = cv2.GaussianBlur(part, (0, 0), sigma)
    at = (place_px - low - 0.5).astype(np.float32)
    out = np.empty((len(at), 3), np.float32)
    # OpenCV's maps have at most 32,767 rows.
    for start in range(0, len(at), 30_000):
        some = at[start : start + 30_000]
        got = cv2.remap(
            part, some[:, 0], some[:, 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        out[start : start + 30_000] = got.reshape(-1, 3)
    return out


def _skin(rgb: np.ndarray, marks: np.ndarray) -> np.ndarray | None:
    """(3,) skin's colour, the median around some landmarks; None where nothing is known of it."""
    known = marks[np.isfinite(marks).all(axis=1)]
    if not len(known):
        return None
    around = max(2, int(0.04 * np.ptp(known, axis=0).max()))
    beside = marks[list(SKIN)]
    beside = beside[np.isfinite(beside).all(axis=1)]
    near = np.clip(beside, 0, rgb.shape[1::-1]).astype(int)
    squares = [
        rgb[max(row - around, 0) : row + around, max(column - around, 0) : column + around]
        for column, row in near
    ]
    colours = np.concatenate([np.zeros((0, 3)), *(each.reshape(-1, 3) for each in squares)])
    colours = colours[np.isfinite(colours).all(axis=1)]
    found = np.median(colours, axis=0) if len(colours) else np.zeros(3)
    return found if found.max() > 0 else None


def _white_share(rgb: np.ndarray, eye: np.ndarray, skin: np.ndarray) -> float:
    """Share of an eye's opening that is nearly as bright as skin and clearly less coloured."""
    inside = _inside(rgb, eye)
    count = int((inside & np.isfinite(rgb).all(axis=2)).sum())
    return float(_whites(rgb, eye, skin).sum() / count) if count else 0.0


def _whites(rgb: np.ndarray, eye: np.ndarray, skin: np.ndarray) -> np.ndarray:
    """(h, w) bool, pixels within an outline that are white beside skin."""
    inside = _inside(rgb, eye) & np.isfinite(rgb).all(axis=2)
    some = rgb[inside]
    bright = some.mean(axis=1) > AS_BRIGHT * skin.mean()
    plain = _saturation(some) < AS_COLOURED * _saturation(skin[None])[0]
    # A photograph without colour tells by brightness alone.
    colourless = _saturation(skin[None])[0] < 0.02
    white = np.zeros(rgb.shape[:2], bool)
    white[inside] = bright & (plain | colourless)
    return white


def _inside(rgb: np.ndarray, eye: np.ndarray) -> np.ndarray:
    """(h, w) bool, pixels within an outline."""
    opening = np.zeros(rgb.shape[:2], np.uint8)
    inside_picture = np.clip(eye, -1, np.array(rgb.shape[1::-1]))
    cv2.fillPoly(opening, [np.round(inside_picture).astype(np.int32)], 1)
    return opening > 0


def _saturation(rgb: np.ndarray) -> np.ndarray:
    """(n,) from 0, grey, to 1."""
    most = rgb.max(axis=-1)
    return np.asarray((most - rgb.min(axis=-1)) / np.maximum(most, 1e-6))
