"""Cross-view consistency: depth maps to oriented points that several views agree on."""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from numba import njit, prange

from processing.parallel import over_views, workers
from processing.reconstruction.carry import carried
from processing.reconstruction.config import ReconstructConfig
from processing.reconstruction.grow import CONFIRMED
from processing.reconstruction.relief import with_relief
from processing.reconstruction.slopes import plane_slopes
from processing.reconstruction.views import Level, depth_to_points

PIXEL_BYTES = 400
"""That a pixel of a view takes, at most."""


@dataclasses.dataclass(frozen=True)
class Points:
    """Oriented points on the surface.

    Attributes:
        positions: (n, 3) float32 mm, world.
        normals: (n, 3) float32 unit, world, outward.
        views: (n,) int32 how many other views agree.
        seen_by: (n,) int32 index of the view whose depth map a point is from.
        agreeing: of each view (h, w) int32 how many other views agree, -1 where nothing matched.
    """

    positions: np.ndarray
    normals: np.ndarray
    views: np.ndarray
    seen_by: np.ndarray
    agreeing: tuple[np.ndarray, ...] = ()


class Oriented(NamedTuple):
    """One view's points: (h, w, 3), normals (h, w, 3) and trust (h, w)."""

    points: np.ndarray
    normals: np.ndarray
    weights: np.ndarray


@njit(cache=True, parallel=True)
def smooth_normals(points: np.ndarray, guide: np.ndarray, radius: int, reach: float) -> np.ndarray:
    """Normals of a point grid: photometric ones turned to follow the points.

    A plane is fitted to the neighbours within `reach` of the tangent plane that the photometric
    normal gives, as a small turn of that normal (linear least squares with a little damping).

    Args:
        points: (h, w, 3) float32 mm, NaN where there is none.
        guide: (h, w, 3) float32 photometric normals, unit, outward.
        radius: of the neighbourhood, px.
        reach: a neighbour further off the tangent plane than this is on another surface, mm.

    Returns:
        (h, w, 3) float32 unit normals, NaN where there is no point.
    """
    height, width = points.shape[0], points.shape[1]
    out = np.full(points.shape, np.nan, np.float32)
    for row in prange(height):
        for column in range(width):
            p = points[row, column]
            n = guide[row, column]
            if math.isnan(p[0]) or n[0] * n[0] + n[1] * n[1] + n[2] * n[2] < 0.5:
                continue
            # Any two axes across the normal.
            axis = 0 if abs(n[0]) < 0.6 else 1
            ex, ey, ez = (1.0, 0.0, 0.0) if axis == 0 else (0.0, 1.0, 0.0)
            ax, ay, az = n[1] * ez - n[2] * ey, n[2] * ex - n[0] * ez, n[0] * ey - n[1] * ex
            length = math.sqrt(ax * ax + ay * ay + az * az)
            ax, ay, az = ax / length, ay / length, az / length
            bx, by, bz = n[1] * az - n[2] * ay, n[2] * ax - n[0] * az, n[0] * ay - n[1] * ax
            suu = svv = suv = suh = svh = su = sv = sh = count = 0.0
            for y in range(max(0, row - radius), min(height, row + radius + 1)):
                for x in range(max(0, column - radius), min(width, column + radius + 1)):
                    q = points[y, x]
                    if math.isnan(q[0]):
                        continue
                    dx, dy, dz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
                    h = dx * n[0] + dy * n[1] + dz * n[2]
                    if abs(h) > reach:
                        continue
                    u, v = dx * ax + dy * ay + dz * az, dx * bx + dy * by + dz * bz
                    count += 1.0
                    su, sv, sh = su + u, sv + v, sh + h
                    suu, svv, suv = suu + u * u, svv + v * v, suv + u * v
                    suh, svh = suh + u * h, svh + v * h
            suu, svv = suu - su * su / count, svv - sv * sv / count
            suv = suv - su * sv / count
            suh, svh = suh - su * sh / count, svh - sv * sh / count
            damp = 0.02 * (suu + svv) + 1e-6
            determinant = (suu + damp) * (svv + damp) - suv * suv
            gu = ((svv + damp) * suh - suv * svh) / determinant
            gv = ((suu + damp) * svh - suv * suh) / determinant
            nx = n[0] - gu * ax - gv * bx
            ny = n[1] - gu * ay - gv * by
            nz = n[2] - gu * az - gv * bz
            length = math.sqrt(nx * nx + ny * ny + nz * nz)
            out[row, column, 0] = nx / length
            out[row, column, 1] = ny / length
            out[row, column, 2] = nz / length
    return out


@njit(cache=True, parallel=True)
def merge_view(
    reference: int,
    points: np.ndarray,
    normals: np.ndarray,
    weights: np.ndarray,
    projections: np.ndarray,
    agree_mm: float,
    in_front_mm: float,
    merged: np.ndarray,
    agreeing: np.ndarray,
) -> None:
    """Compare a view's points with all other views' surfaces; move them to the weighted mean.

    Two views agree where the other's surface is within `agree_mm` along the normal. A point that
    is more than `in_front_mm` before what another view sees contradicts that view.

    Args:
        reference: index of the view.
        points, normals: (views, h, w, 3) float32, NaN where there is none.
        weights: (views, h, w) float32 trust in each point.
        projections: (views, 3, 4) pixel_from_world.
        merged: (h, w, 3), filled: moved points.
        agreeing: (h, w) int32, filled: how many other views agree, less those contradicted.
    """
    height, width = points.shape[1], points.shape[2]
    for row in prange(height):
        for column in range(width):
            agreeing[row, column] = -1
            p, n = points[reference, row, column], normals[reference, row, column]
            if math.isnan(p[0]) or math.isnan(n[0]):
                continue
            total, shift, count = weights[reference, row, column], 0.0, 0
            for k in range(points.shape[0]):
                if k == reference:
                    continue
                m = projections[k]
                z = m[2, 0] * p[0] + m[2, 1] * p[1] + m[2, 2] * p[2] + m[2, 3]
                if not z > 0:
                    continue
                x = int((m[0, 0] * p[0] + m[0, 1] * p[1] + m[0, 2] * p[2] + m[0, 3]) / z)
                y = int((m[1, 0] * p[0] + m[1, 1] * p[1] + m[1, 2] * p[2] + m[1, 3]) / z)
                if not (0 <= x < width and 0 <= y < height):
                    continue
                q, o = points[k, y, x], normals[k, y, x]
                if math.isnan(q[0]) or math.isnan(o[0]):
                    continue
                if n[0] * o[0] + n[1] * o[1] + n[2] * o[2] > 0.5:
                    # Along the mean normal: the two pixels' points do not coincide.
                    off = 0.0
                    for axis in range(3):
                        off += 0.5 * (n[axis] + o[axis]) * (q[axis] - p[axis])
                    if abs(off) < agree_mm:
                        count += 1
                        total += weights[k, y, x]
                        shift += weights[k, y, x] * off
                        continue
                there = m[2, 0] * q[0] + m[2, 1] * q[1] + m[2, 2] * q[2] + m[2, 3]
                if there - z > in_front_mm:
                    count -= 1
            agreeing[row, column] = max(count, 0)
            for axis in range(3):
                merged[row, column, axis] = p[axis] + n[axis] * shift / max(total, 1e-6)


def consistent_points(
    level: Level,
    depths: list[np.ndarray],
    costs: list[np.ndarray],
    config: ReconstructConfig,
) -> Points:
    """Points that at least `config.agree_views` other views confirm.

    Args:
        level: the finest level that was matched.
        depths: of each view (h, w) inverse depth, of `match_views`.
        costs: of each view (h, w), likewise.
        config: the stage's settings.
    """
    views = range(len(depths))
    at_once = workers(PIXEL_BYTES * depths[0].size)

    def oriented(index: int) -> Oriented:
        return _oriented(level, index, depths[index], costs[index], config)

    every = [found for _, found in over_views(oriented, views, at_once)]
    points, normals, weights = (np.stack(part) for part in zip(*every, strict=True))
    projections = level.projections()

    merged = np.empty_like(points)
    agreeing = np.empty(points.shape[:3], np.int32)

    def joined(index: int) -> None:
        merge_view(
            index, points, normals, weights, projections, config.agree_mm, 5.0,
            merged[index], agreeing[index],
        )  # fmt: skip

    for _ in over_views(joined, views, at_once):
        pass
    merged[agreeing < config.agree_views] = np.nan
    slopes = [plane_slopes(level.normals[k], level.lenses[k], level.poses[k]) for k in views]
    if config.carry_mm > 0:
        merged, kinds = carried(level, depths, costs, merged, slopes, config)
        alone = kinds > CONFIRMED
        normals[alone], agreeing[alone] = level.normals[alone], 0

    def settled(index: int) -> tuple[np.ndarray, ...]:
        places, facing = merged[index], normals[index]
        if config.relief_mm > 0:
            places, facing = _relief(level, index, places, facing, slopes[index], config)
        good = np.isfinite(places[..., 0])
        seen_by = np.full(good.sum(), index)
        return places[good], facing[good], agreeing[index][good], seen_by

    parts = [found for _, found in over_views(settled, views, at_once)]
    places, facing, agreed, seen_by = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Points(places, facing, agreed, seen_by, tuple(agreeing))


def _oriented(
    level: Level, index: int, depth: np.ndarray, cost: np.ndarray, config: ReconstructConfig
) -> Oriented:
    """Points of one view's depth with normals and trust, before other views are compared."""
    kept = np.where(cost < config.max_cost, depth, 0)
    lens, pose = level.lenses[index], level.poses[index]
    grid = depth_to_points(kept, lens, pose)
    turned = smooth_normals(grid, level.normals[index], 3, 3.0)
    # Depth is the less certain, the more the surface turns away.
    centre = -pose[:, :3].T @ pose[:, 3]
    sight = (centre - grid).astype(np.float32)
    sight /= np.linalg.norm(sight, axis=2, keepdims=True)
    cosine = np.einsum("hwk,hwk->hw", sight, turned)
    facing = np.where((cosine > config.min_cosine)[..., None], turned, np.float32(np.nan))
    trust = np.clip(1 - cost, 0.05, 1) * np.clip(cosine, 0, 1) ** 2
    return Oriented(grid, facing, trust.astype(np.float32))


def _relief(
    level: Level,
    index: int,
    points: np.ndarray,
    normals: np.ndarray,
    slopes: np.ndarray,
    config: ReconstructConfig,
) -> tuple[np.ndarray, np.ndarray]:
    """A view's points and normals together; points without a photometric normal as they were."""
    lens, pose, guide = level.lenses[index], level.poses[index], level.normals[index]
    known = np.einsum("hwk,hwk->hw", guide, guide) > 0.5
    moved, mended = with_relief(points, slopes, known, lens, pose, config)
    return moved, np.where(np.isnan(mended), normals, mended)
