"""Slants of the surface where no light gave normals: planes through the points that were matched.

Patches on planes that face the camera drift off steep skin. So each level of the search, and then
consistency, follows the planes through what the level before found, as planes are propagated with
their slants in [Bleyer2011].
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from processing.reconstruction.consistency import smooth_normals
from processing.reconstruction.views import Level, View, depth_to_points

RADIUS_PX = 2
"""Radius of the neighbourhood to which a plane is fitted."""
REACH_MM = 20.0
"""Neighbours farther off, along the line of sight, are on another surface."""


def without_normals(views: Sequence[View]) -> bool:
    """Whether no light gave any normal: there are pictures alone."""
    return not any(view.normals.any() for view in views)


def toward_cameras(level: Level) -> Level:
    """The level with unit vectors to the cameras in place of its normals."""
    normals = np.empty_like(level.normals)
    height, width = normals.shape[1:3]
    for index, ((fx, fy, cx, cy), pose) in enumerate(zip(level.lenses, level.poses, strict=True)):
        x, y = (np.arange(width) + 0.5 - cx) / fx, (np.arange(height) + 0.5 - cy) / fy
        sight = np.stack(np.broadcast_arrays(x[None], y[:, None], 1.0), axis=-1)
        sight /= np.linalg.norm(sight, axis=-1, keepdims=True)
        normals[index] = -sight @ pose[:, :3]
    return dataclasses.replace(level, normals=normals)


def as_matched(level: Level, depths: Sequence[np.ndarray]) -> Level:
    """The level with the normals of planes through points, toward the cameras where there are none.

    Args:
        level: which has no normals.
        depths: of each view (h, w) inverse depth, 0 where there is none.
    """
    level = toward_cameras(level)
    for index, depth in enumerate(depths):
        grid = depth_to_points(depth, level.lenses[index], level.poses[index])
        turned = smooth_normals(grid, level.normals[index], RADIUS_PX, REACH_MM)
        known = np.isfinite(turned[..., 0])
        level.normals[index][known] = turned[known]
    return level


def one_level_on(level: Level, coarser: Level, depths: Sequence[np.ndarray]) -> Level:
    """The level with the normals of planes through the points of the coarser one before it.

    Args:
        level: which has no normals.
        coarser: half its size.
        depths: of each view of the coarser one (h, w) inverse depth, 0 where there is none.
    """
    height, width = level.normals.shape[1:3]
    normals = as_matched(coarser, depths).normals.repeat(2, axis=1).repeat(2, axis=2)
    return dataclasses.replace(level, normals=normals[:, :height, :width])
