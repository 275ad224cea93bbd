"""From depth to a mesh, and from that mesh to better depth, better normals and a better mesh."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.mesh import Mesh
from processing.lighting.lights import PatternLights
from processing.reconstruction.config import ReconstructConfig
from processing.reconstruction.consistency import Points, consistent_points
from processing.reconstruction.finer import finer
from processing.reconstruction.fusion import fuse
from processing.reconstruction.occluders import OthersBeside, nothing_beside
from processing.reconstruction.second_depth import look_again, rays_of, sighted
from processing.reconstruction.shading import mended_normals
from processing.reconstruction.slants import as_matched, without_normals
from processing.reconstruction.stereo import sources_of
from processing.reconstruction.views import Level, View, pictures_of

Depths = tuple[Level, list[np.ndarray], list[np.ndarray]]
"""A level, and of each view inverse depth and cost, as of `match_views`."""


WIDER = 4.0
"""The first mesh reaches so much farther from its points: the second round decides what is true."""

TRIM_PX = 2.0
"""No surface is cut nearer to a point than so many pixels: neighbours would be parted."""


def spacing_mm(level: Level, points: Points) -> float:
    """Width of a pixel where the points are, the median of all; 0 without points."""
    if not len(points.positions):
        return 0.0
    centres = np.stack([-pose[:, :3].T @ pose[:, 3] for pose in level.poses])
    away = np.linalg.norm(points.positions - centres[points.seen_by], axis=1)
    return float(np.median(away / level.lenses[points.seen_by, 0]))


def meshed(found: Depths, config: ReconstructConfig) -> tuple[Points, Mesh]:
    """Consistency and fusion of depth of all views, and the mesh made finer."""
    points = consistent_points(*found, config)
    trim_mm = max(config.trim_mm, TRIM_PX * spacing_mm(found[0], points))
    mesh = fuse(points, dataclasses.replace(config, trim_mm=trim_mm))
    how = config.splits, config.split_settle_mm, config.relief_mm
    return points, finer(mesh, points.positions, points.normals, *how)


def as_known(
    views: Sequence[View], found: Depths, config: ReconstructConfig
) -> tuple[Depths, ReconstructConfig]:
    """Depths and settings as they are, or, where no light gave normals, as pictures alone allow.

    Planes through neighbouring points then stand for normals; relief, and what normals carry on,
    would be made up.
    """
    if not without_normals(views):
        return found, config
    plain = dataclasses.replace(config, relief_mm=0.0, carry_mm=0.0)
    return (as_matched(*found[:2]), *found[1:]), plain


def reconstruct_in_two_rounds(
    views: Sequence[View],
    found: Depths,
    config: ReconstructConfig,
    lights: PatternLights | None = None,
    progress: ProgressCallback = quiet,
    beside: OthersBeside = nothing_beside,
) -> tuple[Depths, Points, Mesh, Mesh | None]:
    """A mesh, and, where `config.look_again` is set, a second one by means of the first.

    Args:
        views: that were matched.
        found: of `match_views`.
        config: the stage's settings.
        lights: of the patterns that the views' signals are of.
        progress: called after each view of the second round.
        beside: finds what else casts shadows beside a mesh of the skin.

    Returns:
        Depths, points, mesh, and what else casts shadows.
    """
    alone = without_normals(views)
    found, config = as_known(views, found, config)
    if not config.look_again:
        points, mesh = meshed(found, config)
        return found, points, mesh, beside(mesh)
    wider = dataclasses.replace(
        config,
        carry_mm=WIDER * config.carry_mm,
        trim_mm=WIDER * config.trim_mm,
        splits=0,  # The second round needs planes and shadows alone.
    )
    points, mesh = meshed(found, wider)
    level = found[0]
    fine = pictures_of(views, config.finest_rows)
    occluders = beside(mesh)
    rays, normals = rays_of(mesh, occluders)
    seen = sighted(level, mesh, rays, normals)
    unsure = [count < 1 for count in points.agreeing]
    sources = sources_of(views, config)
    depths, costs = look_again(fine, seen, sources, unsure, config, progress)
    mended = np.stack([sight.normals for sight in seen]) if alone else None
    if lights is not None and not alone:
        same = fine.masks.shape == level.masks.shape
        # Views that were made smaller still have their signals at another size.
        if max(len(view.mask) for view in views) == fine.masks.shape[1]:
            times = 1 if same else 2
            mended = mended_normals(level, times, views, seen, mesh, rays, normals, lights)
    if mended is not None:
        level = dataclasses.replace(level, normals=mended)
    again = level, depths, costs
    points, mesh = meshed(again, config)
    return again, points, mesh, occluders
