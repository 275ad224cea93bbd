"""Skin that one camera alone confirms: a view's surface carried on from points that two agree on.

On the sides of the jaw and behind the ears a second camera grazes the skin or does not see it. One
camera's own match there is a guess, and its normals are known. So from pixel to pixel, outward from
the confirmed ones, the normals show where the surface continues; a matched depth on it is
taken, as in the growing of patches [Furukawa2010], and where there is none the surface is carried
on by the normals alone, a little way.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit, prange

from processing.parallel import over_views, workers
from processing.reconstruction.config import ReconstructConfig
from processing.reconstruction.grow import CONFIRMED, JUMP_MM, NONE, grow
from processing.reconstruction.relief import at_pixels, low_pass
from processing.reconstruction.views import Level, depth_to_points

PIXEL_BYTES = 400
"""That a pixel of a view takes, at most."""
BIAS_MM = 2.0
"""Sigma of the mean by which normals are compared with confirmed points, and turned to them."""
DOUBT = 0.05
"""Least slope by which normals are taken to be off, 3 degrees."""
NEAR_MM = 3.0
"""Two views' points that are within this along a line of sight are of one surface."""


def carried(
    level: Level,
    depths: Sequence[np.ndarray],
    costs: Sequence[np.ndarray],
    confirmed: np.ndarray,
    slopes: Sequence[np.ndarray],
    config: ReconstructConfig,
) -> tuple[np.ndarray, np.ndarray]:
    """All views' surfaces carried on, each where no other view has it or contradicts it.

    Args:
        level: the views.
        depths: of each view (h, w) inverse depth, of `match_views`.
        costs: of each view (h, w), likewise.
        confirmed: (views, h, w, 3) float32 mm, NaN where no other view agrees.
        slopes: of each view (h, w, 2), of `slopes.plane_slopes`.
        config: the stage's settings.

    Returns:
        (views, h, w, 3) float32 points, NaN where there is none, and (views, h, w) int8 their kind.
    """
    points = confirmed.copy()
    kinds = np.zeros(confirmed.shape[:3], np.int8)
    cosines = np.zeros(kinds.shape, np.float32)
    views, at_once = range(len(kinds)), workers(PIXEL_BYTES * kinds[0].size)

    def grown(index: int) -> None:
        lens, pose = level.lenses[index], level.poses[index]
        cosine = _cosines(level.normals[index], lens, pose)
        cosine[~(level.masks[index] & (cosine > config.min_cosine))] = 0
        along = confirmed[index].astype(float) @ pose[2, :3] + pose[2, 3]
        depth = -np.log(np.where(along > 0, along, np.nan))
        own = np.where(costs[index] < config.alone_cost, depths[index], 0)
        matched = np.log(np.where(own > 0, own, np.nan))
        bias, doubt = disagreement(depth, slopes[index], cosine, 2 / float(lens[0] + lens[1]))
        trusted = slopes[index] + bias
        found = grow(depth, matched, trusted, doubt, cosine, config.agree_mm, config.carry_mm)
        new = found.kind > CONFIRMED
        inverse_depth = np.where(new, np.exp(np.where(new, found.depth, 0)), 0)
        points[index][new] = depth_to_points(inverse_depth, lens, pose)[new]
        kinds[index], cosines[index] = found.kind, cosine

    for _ in over_views(grown, views, at_once):
        pass
    projections = level.projections()
    # A view that shows nothing at all does not show where the head is.
    masks = level.masks | ~level.masks.any(axis=(1, 2), keepdims=True)
    kept = np.zeros(kinds.shape, bool)

    def placed_view(index: int) -> None:
        placed_over(index, points, kinds, cosines, masks, projections, NEAR_MM, kept[index])

    for _ in over_views(placed_view, views, at_once):
        pass
    points[~kept], kinds[~kept] = np.nan, NONE
    return points, kinds


def disagreement(
    depth: np.ndarray, slopes: np.ndarray, cosine: np.ndarray, pixel: float
) -> tuple[np.ndarray, np.ndarray]:
    """How the normals' slopes differ from those of the confirmed points around.

    Args:
        depth: (h, w) ln of inverse depth, NaN where no other view agrees.
        slopes: (h, w, 2) of `slopes.plane_slopes`.
        cosine: (h, w) of the normal to the line of sight.
        pixel: angle of one, rad.

    Returns:
        (h, w, 2) what the points' slopes have beyond the normals', a Gaussian mean, 0 where no
        point is near; and (h, w) by how much slopes may be off: no less than DOUBT on the surface.
    """
    some = np.isfinite(depth)
    middle = float(np.exp(-np.median(depth[some]))) if some.any() else 1.0
    bias = np.zeros_like(slopes)
    for k in range(2):
        a, b = np.moveaxis(slopes[..., k], 1 - k, 0)[:-1], np.moveaxis(slopes[..., k], 1 - k, 0)[1:]
        excess = np.diff(depth, axis=1 - k) - np.moveaxis(0.5 * (a + b), 0, 1 - k)
        links = np.abs(excess) * middle < JUMP_MM
        bias[..., k] = at_pixels(low_pass(excess, links, BIAS_MM / (middle * pixel)), 1 - k)
    least = DOUBT * pixel / np.maximum(cosine, 1e-3) ** 2
    return bias, np.maximum(np.linalg.norm(bias, axis=2), least)


def _cosines(normals: np.ndarray, lens: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """(h, w) float32 cosine of world normals to the line of sight; 0 where there is none."""
    height, width = normals.shape[:2]
    fx, fy, cx, cy = lens
    x = ((np.arange(width) + 0.5 - cx) / fx)[None]
    y = ((np.arange(height) + 0.5 - cy) / fy)[:, None]
    local = normals @ pose[:, :3].T.astype(np.float32)
    toward = -(local[..., 0] * x + local[..., 1] * y + local[..., 2])
    return np.asarray(toward / np.sqrt(1 + x**2 + y**2), np.float32)


@njit(cache=True, parallel=True)
def placed_over(
    view: int,
    positions: np.ndarray,
    kinds: np.ndarray,
    cosines: np.ndarray,
    masks: np.ndarray,
    projections: np.ndarray,
    near_mm: float,
    kept: np.ndarray,
) -> None:
    """Which of a view's grown points no other view contradicts, or has itself.

    A point is dropped that another camera would see before its background or before a confirmed
    point; where a confirmed point of another view is; and where another view's grown point is
    that is seen more squarely.

    Args:
        view: whose points are tested.
        positions: (views, h, w, 3) float32 mm.
        kinds: (views, h, w) int8.
        cosines: (views, h, w) of the normals to the lines of sight.
        masks: (views, h, w) bool, foreground.
        projections: (views, 3, 4) pixel_from_world.
        near_mm: points within this along the line of sight are of one surface.
        kept: (h, w) bool, filled: confirmed points, and grown ones that stay.
    """
    height, width = kinds.shape[1], kinds.shape[2]
    for row in prange(height):
        for column in range(width):
            kind = kinds[view, row, column]
            kept[row, column] = kind == CONFIRMED
            if kind <= CONFIRMED:
                continue
            p, good = positions[view, row, column], True
            for k in range(len(projections)):
                if k == view:
                    continue
                m = projections[k]
                z = m[2, 0] * p[0] + m[2, 1] * p[1] + m[2, 2] * p[2] + m[2, 3]
                if not z > 0:
                    continue
                u = (m[0, 0] * p[0] + m[0, 1] * p[1] + m[0, 2] * p[2] + m[0, 3]) / z
                v = (m[1, 0] * p[0] + m[1, 1] * p[1] + m[1, 2] * p[2] + m[1, 3]) / z
                if not (0 <= u < width and 0 <= v < height):
                    continue
                x, y = int(u), int(v)
                if not masks[k, y, x]:
                    good = False
                    break
                other = kinds[k, y, x]
                if other == NONE:
                    continue
                q = positions[k, y, x]
                behind = m[2, 0] * q[0] + m[2, 1] * q[1] + m[2, 2] * q[2] + m[2, 3] - z
                if other == CONFIRMED:
                    good = not behind > -near_mm
                elif abs(behind) < near_mm:
                    here, there = cosines[view, row, column], cosines[k, y, x]
                    good = here > there or (here == there and view < k)
                if not good:
                    break
            kept[row, column] = good
