"""Hair that hangs over the forehead: texels whose colour is the hair's above, and not the cheeks'.

Blond or grey hair differs too little from the mean person's skin to be found by that difference.
The person's own colours find it: where those of hair and cheeks are far apart, each texel of the
forehead belongs to the nearer of the two by Fisher's linear discriminant [Fisher1936]. Templates
show the face upright, so that a texture's columns go up the forehead.
"""

from __future__ import annotations

import itertools

import cv2
import numpy as np

from learning.photo.skin_mask import BROWS, MOUTH, hair_texels, mean_around
from learning.render.uv import UvRaster
from learning.whole.scalp import log_colour
from lightstage.formats.template import Template

EYES = slice(36, 48)
"""In iBUG's order."""
ASIDE_MM = 55.0
"""Half of the width of the cheeks."""
AHEAD_MM = 30.0
"""Of the head's middle: what is behind is no forehead."""
CLEAR_MM = 2.0, 8.0, 2.0
"""Above the brows, below the eyes and above the mouth, what is no part of either."""
DARKEST = 1e-3
LEAST_APART = 0.55
"""Difference of hair's and cheeks' median colours, in natural logarithms, from which they are
distinct. Four bald skulls have .3 to .5 by what their light leaves, blond hair .6, dark hair on
light skin 1.3 to 1.9."""
LEAST_DEVIATIONS = 4.0
"""The same in standard deviations within hair and cheeks."""
DARKER = 0.35
"""Natural logarithm below the cheeks' median from which a texel under the scalp's hair is hair too,
or in its shadow; half of the hair's own where that is more."""
GAP = 1 / 8
"""Widest gap in a fringe that is no parting, of a texture's columns."""
LEAST_TEXELS = 100
NOISE = 0.05, 0.02, 0.02
"""Standard deviations that each has in any case, so that even colours do not decide alone."""


class Forehead:
    """Where a template has hair, forehead and cheeks in its texture."""

    def __init__(self, template: Template, raster: UvRaster) -> None:
        place = raster.interpolate(template.mesh.vertices)
        marks = template.mesh.vertices[template.landmarks]
        brows, eyes, mouth = (marks[part, 1] for part in (BROWS, EYES, MOUTH))
        above = self.height_mm = place[..., 1]
        ahead = raster.covered & (place[..., 2] > AHEAD_MM)
        hair = hair_texels(template, raster)
        self.hair = np.zeros_like(ahead) if hair is None else hair
        self.forehead = ahead & ~self.hair & (above > brows.max() + CLEAR_MM[0])
        between = (above < eyes.min() - CLEAR_MM[1]) & (above > mouth.max() + CLEAR_MM[2])
        self.cheeks = ahead & between & (np.abs(place[..., 0]) < ASIDE_MM)

    def fringe(self, albedo: np.ndarray, seen: np.ndarray, other: np.ndarray) -> np.ndarray:
        """(rows, columns) bool, the forehead's texels that show hair which reaches to the scalp.

        Args:
            albedo: (rows, columns, 3) linear, the texture without its light.
            seen: (rows, columns) bool.
            other: (rows, columns) bool, what is known to be no skin.
        """
        none = np.zeros_like(seen)
        hair, cheeks = self.hair & seen, self.cheeks & seen & ~other
        if min(hair.sum(), cheeks.sum()) < LEAST_TEXELS:
            return none
        colour = _colour(albedo, seen)
        middles = [np.median(colour[part], axis=0) for part in (hair, cheeks)]
        apart = middles[0] - middles[1]
        spread = 0.5 * sum(np.cov(colour[part].T) for part in (hair, cheeks)) + np.diag(NOISE) ** 2
        across = np.linalg.solve(spread, apart)
        distinct = np.linalg.norm(apart) > LEAST_APART and apart @ across > LEAST_DEVIATIONS**2
        if not distinct:
            return none
        nearer = (colour - 0.5 * (middles[0] + middles[1])) @ across > 0
        # A fringe is darkest at its lower end, which also shadows the skin.
        shadowed = colour[..., 0] < middles[1][0] - max(DARKER, -0.5 * apart[0])
        hanging = seen & ((self.forehead & (nearer | other | shadowed)) | self.hair)
        _, label = cv2.connectedComponents(hanging.astype(np.uint8))
        found = hanging & self.forehead & np.isin(label, np.unique(label[hair]))
        # Light on hair makes it as light as a cheek: what is above hair that hangs is hair too.
        lowest_mm = _bridged(np.where(found, self.height_mm, np.inf).min(axis=0))
        return np.asarray(seen & self.forehead & (self.height_mm >= lowest_mm))


def _bridged(lowest_mm: np.ndarray) -> np.ndarray:
    """(columns,) how far hair hangs, infinite where none does: narrow gaps are bridged."""
    hangs = np.flatnonzero(np.isfinite(lowest_mm))
    bridged = lowest_mm.copy()
    for left, right in itertools.pairwise(hangs):
        if 1 < right - left <= GAP * len(lowest_mm):
            between = np.arange(left + 1, right)
            bridged[between] = np.interp(between, (left, right), lowest_mm[[left, right]])
    return bridged


def _colour(albedo: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """(rows, columns, 3) logarithms of an albedo's mean, and of red and blue over green."""
    return log_colour(mean_around(np.log(np.clip(np.nan_to_num(albedo), DARKEST, 1)), seen))
