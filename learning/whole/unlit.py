"""A texture over its own light, and where that shows the skin.

It does not in the dark, at edges of shadows, which are never quite in place, and where a
highlight hides the skin.
"""

from __future__ import annotations

import cv2
import numpy as np

from learning.masks import widened
from learning.networks.whole_face import DARKEST

DARK_LIGHT = 0.02
"""Irradiance below which nothing is divided by it."""
LEAST_LIGHT = 0.15
"""Share of the median irradiance below which the texture does not show a texel's own albedo."""
BLACK = 0.05
"""Share of a texture's median value below which a texel is in a shadow: a black beard on light skin
has a seventh of it."""
MOST_SHINE = 0.35
"""Share of a texture's value, in any channel, above which a highlight hides the skin."""
SHINE_OFF = 0.5
"""Standard deviation of a highlight that was found, as a share of it: lamps are no points, and skin
is not as rough everywhere."""
LIGHT_OFF = 0.04
"""Standard deviation of the irradiance that was found, of its median: what skin sends to skin, and
light that is not even from everywhere, are not in it."""
OWN_DEVIATION = 0.1
"""Standard deviation of the logarithm of what a skin is beside those that people have in common."""
TINY = 1e-9
"""Mirrored light, against division by zero."""
EDGE_SHARE = 1 / 384
"""Distance within which light must not change, of a texture's rows: 4 of 1536."""
STEEP = 1.35
"""Ratio of irradiance within that distance that is an edge."""
NEAR_SHARE = 1 / 96
"""Distance from such an edge, of a texture's rows, within which the real edge may be."""
MISPLACED = 1.4
"""Ratio to the skin found so far, near an edge, that is the edge's place in error and no mark."""


def over_light(texture: np.ndarray, irradiance: np.ndarray, shine: np.ndarray) -> np.ndarray:
    """Divide a texture by its light.

    Args:
        texture: (rows, columns, 3) linear.
        irradiance: (rows, columns, 3) of diffuse light.
        shine: (rows, columns, 3) what is mirrored.

    Returns:
        (rows, columns, 3) float32, `DARKEST` to 1. Of a texel that is not `matt`, only as much of
        the highlight is taken out as a matt texel has at most: a highlight that is less wide or
        elsewhere in the photograph would leave it black.
    """
    matte = texture - _most_shine(texture, shine) * shine
    return np.clip(matte / np.maximum(irradiance, DARK_LIGHT), DARKEST, 1.0).astype(np.float32)


def _most_shine(texture: np.ndarray, shine: np.ndarray) -> np.ndarray:
    """(rows, columns, 1) share of a highlight that a matt texel has at most."""
    most = MOST_SHINE * np.maximum(texture, 0)
    share = np.min(most / np.maximum(shine, TINY), axis=2, keepdims=True)
    return np.asarray(np.minimum(share, 1.0))


def trusted(
    texture: np.ndarray,
    shine: np.ndarray,
    level: np.ndarray,
    slope: np.ndarray,
    normals_off: float,
) -> np.ndarray:
    """How far a texture over its light is believed where it is not as people's skins are.

    What it is beside them is in part the skin's own, of deviation `OWN_DEVIATION`, and in part the
    error of the light that was divided by. Where light grazes the skin, normals that are a little
    off change it much; where it is mirrored, a highlight that is a little off changes what is
    left; and where there is little light, a little more changes it much. The best linear estimate
    of the skin's own part is the share of its variance in both.

    Args:
        texture: (rows, columns, 3) linear.
        shine: (rows, columns, 3) what is mirrored.
        level: (rows, columns) irradiance over its median.
        slope: (rows, columns, 2) change of the logarithm of the irradiance by radian of a tilt.
        normals_off: standard deviation of the shape's normals, radians along each axis.

    Returns:
        (rows, columns) float32, 0..1.
    """
    shine = _most_shine(texture, shine) * shine
    mirrored = (shine / np.maximum(texture - shine, TINY)).max(axis=2)
    off = normals_off**2 * np.square(slope).sum(axis=2) + (SHINE_OFF * mirrored) ** 2
    off += np.square(LIGHT_OFF / np.maximum(level, DARK_LIGHT))
    return (OWN_DEVIATION**2 / (OWN_DEVIATION**2 + off)).astype(np.float32)


def matt(texture: np.ndarray, shine: np.ndarray) -> np.ndarray:
    """(rows, columns) bool, where no highlight hides the skin; arguments as `over_light`."""
    return np.asarray((shine < MOST_SHINE * texture).all(axis=2))


def lit_enough(level: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """(rows, columns) bool, where irradiance, of (rows, columns), is not too dark to divide by."""
    found: np.ndarray = covered & (level > LEAST_LIGHT * median_light(level, covered))
    return found


def median_light(level: np.ndarray, covered: np.ndarray) -> float:
    """Median of (rows, columns) irradiance where a surface is; 0 where none is."""
    return float(np.median(level[covered])) if covered.any() else 0.0


def in_the_dark(texture: np.ndarray, photographed: np.ndarray) -> np.ndarray:
    """(rows, columns) bool, where a texture is so dark that no skin, lit as the face is, is there.

    Args:
        texture: (rows, columns, 3) linear.
        photographed: (rows, columns) bool.
    """
    level = texture.mean(axis=2)
    if not photographed.any():
        return photographed
    found: np.ndarray = photographed & (level < BLACK * np.median(level[photographed]))
    return found


def light_edges(level: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """(rows, columns) bool, where irradiance changes within a few texels: edges of shadows."""
    reach = max(1, round(EDGE_SHARE * level.shape[0]))
    kernel = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    most = cv2.dilate(np.where(covered, level, 0).astype(np.float32), kernel)
    least = cv2.erode(np.where(covered, level, np.inf).astype(np.float32), kernel)
    found: np.ndarray = most / STEEP > np.maximum(least, DARK_LIGHT)
    return found


def misplaced(ratio: np.ndarray, edges: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Near edges, where a texture over its light is far from the skin: lit here, in shadow there.

    Args:
        ratio: (rows, columns, 3) of the texture over its light to the skin found so far.
        edges: (h, w) bool, see `light_edges`, of as many texels or fewer.
        known: (rows, columns) bool, where the ratio shows the skin. Its median there is the
            person's tone.
    """
    rows, columns = ratio.shape[:2]
    reach = max(1, round(NEAR_SHARE * edges.shape[0]))
    near = cv2.resize(widened(edges, reach).astype(np.uint8), (columns, rows)) > 0
    # Over a few texels, so that single hairs and pores stay.
    off = cv2.GaussianBlur(np.log(ratio).mean(axis=2), (0, 0), max(1.0, rows / 768))
    tone = np.median(off[known]) if known.any() else 0.0
    found: np.ndarray = near & (np.abs(off - tone) > np.log(MISPLACED))
    return found
