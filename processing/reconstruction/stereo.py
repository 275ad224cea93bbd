"""Depth of every view, coarse to fine, on the planes that photometric normals give.

Slanted windows and propagation of planes as in [Bleyer2011]; here the slant is known, and how the
window is bent, and only the depth is sought. Where no light gave normals, slants are those of the
coarser level's surface.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.nearest_point import nearest_equations
from lightstage.rig import Camera
from processing.reconstruction.config import ReconstructConfig
from processing.reconstruction.patches import NO_MATCH, Stereo
from processing.reconstruction.slants import one_level_on, without_normals
from processing.reconstruction.slopes import plane_slopes
from processing.reconstruction.sweeps import polish, propagate, sweep
from processing.reconstruction.views import Level, View, pyramid


def focus_point(cameras: Sequence[Camera]) -> np.ndarray:
    """(3,) the point nearest to all optical axes, mm: where the head is."""
    centres = np.array([camera.centre_mm for camera in cameras])
    axes = np.array([camera.cam_from_world[2, :3] for camera in cameras])
    return np.asarray(np.linalg.lstsq(*nearest_equations(centres, axes), rcond=None)[0])


def pick_sources(
    cameras: Sequence[Camera], usable: Sequence[bool], config: ReconstructConfig
) -> list[np.ndarray]:
    """The views that each view is matched with: the nearest by angle that are not too near.

    Args:
        cameras: of the views.
        usable: false for views that show nothing.
        config: angles and count.

    Returns:
        For each view (s,) int64 indices, the nearest first; empty where nothing fits.
    """
    focus = focus_point([c for c, use in zip(cameras, usable, strict=True) if use])
    toward = np.array([camera.centre_mm - focus for camera in cameras])
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    angles = np.degrees(np.arccos(np.clip(toward @ toward.T, -1, 1)))
    chosen = []
    for index in range(len(cameras)):
        near = np.argsort(angles[index], kind="stable")
        fit = [
            k
            for k in near
            if usable[k] and config.min_angle_deg <= angles[index, k] <= config.max_angle_deg
        ]
        chosen.append(np.array(fit[: config.source_views] if usable[index] else [], np.int64))
    return chosen


def transfer(level: Level, reference: int, other: int) -> tuple[np.ndarray, np.ndarray]:
    """M (3, 3) and m (3,) that carry the reference's pixels at inverse depth w: M x + m w."""
    relative = level.poses[other][:, :3] @ level.poses[reference][:, :3].T
    shift = level.poses[other][:, 3] - relative @ level.poses[reference][:, 3]
    lens = _matrix(level.lenses[other])
    return lens @ relative @ np.linalg.inv(_matrix(level.lenses[reference])), lens @ shift


def make_stereo(
    level: Level,
    reference: int,
    sources: np.ndarray,
    config: ReconstructConfig,
    normals: np.ndarray | None = None,
) -> Stereo:
    """Gather what the kernels need of one reference view at one level.

    Args:
        level: the pictures.
        reference: index of the view whose depth is sought.
        sources: (s,) indices of those it is matched with.
        config: patches and limits.
        normals: (h, w, 3) that patches follow; None for the level's own.
    """
    pairs = [transfer(level, reference, other) for other in sources]
    pose = level.poses[reference]
    centres = np.array([_centre(level.poses[other]) for other in sources])
    baselines = np.linalg.norm(centres - _centre(pose), axis=1)
    lens = level.lenses[reference]
    return Stereo(
        level.pictures,
        reference,
        sources,
        np.array([m for m, _ in pairs], np.float32),
        np.array([m for _, m in pairs], np.float32),
        lens.astype(np.float32),
        (centres @ pose[:, :3].T + pose[:, 3]).astype(np.float32),
        plane_slopes(level.normals[reference] if normals is None else normals, lens, pose),
        patch_offsets(config.patch_radius_px, config.patch_stride_px),
        np.float32(config.min_cosine),
        np.float32(min(config.graze_cosine, config.min_cosine)),
        np.float32(config.contrast_floor),
        np.float32(1.0 / (lens[:2].mean() * baselines.mean())),
    )


def patch_offsets(radius_px: int, stride_px: int) -> np.ndarray:
    """(k, 2) int64 du, dv of a square patch's samples."""
    reach = np.arange(-radius_px, radius_px + 1, stride_px)
    return np.stack(np.meshgrid(reach, reach), axis=-1).reshape(-1, 2).astype(np.int64)


def sources_of(views: Sequence[View], config: ReconstructConfig) -> list[np.ndarray]:
    """`pick_sources` of views."""
    usable = [bool(np.isfinite(view.textures).any()) for view in views]
    return pick_sources([view.camera for view in views], usable, config)


def match_views(
    views: Sequence[View], config: ReconstructConfig, progress: ProgressCallback = quiet
) -> tuple[Level, list[np.ndarray], list[np.ndarray]]:
    """Depth maps of all views.

    Args:
        views: at least two that see the same surface.
        config: the stage's settings.
        progress: called after each view of each level.

    Returns:
        The finest level that was searched, and for each view (h, w) float32 inverse depth (1/mm
        along the optical axis, 0 where there is none) and matching cost (0..2).
    """
    levels = pyramid(views, config.finest_rows, config.coarsest_rows)
    sources = sources_of(views, config)
    usable = [bool(np.isfinite(view.textures).any()) for view in views]
    focus = focus_point([v.camera for v, use in zip(views, usable, strict=True) if use])
    depths: list[np.ndarray] = []
    costs: list[np.ndarray] = []
    total, done = len(levels) * len(views), 0
    blind = without_normals(views)
    for number, level in enumerate(levels):
        if blind and number > 0:
            level = one_level_on(level, levels[number - 1], depths)
        shape = level.masks.shape[1:]
        coarser, depths, costs = depths, [], []
        radius = config.patch_radius_px
        if 0 < number == len(levels) - 1:
            radius = config.finest_patch_radius_px
        offsets = patch_offsets(radius, config.patch_stride_px)
        for index in range(len(views)):
            depth = np.zeros(shape, np.float32)
            cost = np.full(shape, NO_MATCH, np.float32)
            still = np.zeros(shape, bool)
            if len(sources[index]):
                stereo = make_stereo(level, index, sources[index], config)
                stereo = stereo._replace(offsets=offsets)
                if number == 0:
                    _start(level, stereo, focus, config, depth, cost)
                else:
                    depth[:] = doubled(coarser[index], stereo.slopes)
                    _polish(stereo, 0.5, config.still_px, depth, cost, still)
                iterations = config.iterations[min(number, len(config.iterations) - 1)]
                _propagate(stereo, iterations, config, still, depth, cost)
                # The second round starts from the mesh.
                if number == len(levels) - 1 and not config.look_again:
                    _polish(stereo, 0.3, 0.0, depth, cost, still)
            depths.append(depth)
            costs.append(cost)
            done += 1
            progress(done, total)
    return levels[-1], depths, costs


def doubled(inverse_depth: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """A coarser level's inverse depth at twice the size, each pixel continued along its plane.

    Args:
        inverse_depth: (h, w).
        slopes: (2 h or 2 h - 1, 2 w or 2 w - 1, 2) a, b of the finer level.
    """
    height, width = slopes.shape[:2]
    rows, columns = np.arange(height), np.arange(width)
    near = inverse_depth[rows[:, None] // 2, columns[None] // 2]
    # A fine pixel's centre is half a fine pixel from the coarse one's.
    dx = np.where(columns % 2, 0.5, -0.5)[None]
    dy = np.where(rows % 2, 0.5, -0.5)[:, None]
    return (near * (1 + slopes[..., 0] * dx + slopes[..., 1] * dy)).astype(np.float32)


def _start(
    level: Level,
    stereo: Stereo,
    focus: np.ndarray,
    config: ReconstructConfig,
    depth: np.ndarray,
    cost: np.ndarray,
) -> None:
    """Fill the coarsest level by a sweep in steps of half a pixel's disparity."""
    pose = level.poses[stereo.reference]
    middle = float(pose[2, :3] @ focus + pose[2, 3])
    near = max(middle - config.depth_reach_mm, 0.05 * middle)
    far = middle + config.depth_reach_mm
    candidates = np.arange(1 / far, 1 / near, 0.5 * float(stereo.step)).astype(np.float32)
    hull = [transfer(level, stereo.reference, other) for other in range(len(level.poses))]
    # A view that shows nothing at all does not show where the head is.
    masks = level.masks | ~level.masks.any(axis=(1, 2), keepdims=True)
    sweep(
        stereo,
        candidates,
        masks,
        np.array([m for m, _ in hull], np.float32),
        np.array([m for _, m in hull], np.float32),
        depth,
        cost,
    )


def _propagate(
    stereo: Stereo,
    iterations: int,
    config: ReconstructConfig,
    still: np.ndarray,
    depth: np.ndarray,
    cost: np.ndarray,
) -> None:
    for iteration in range(iterations):
        reaches = np.array([1, 3, 7] if iteration == 0 else [1, 3], np.int64)
        deltas = np.array([0.5, 0.25] if iteration == 0 else [0.25, 0.12], np.float32)
        for colour in (0, 1):
            smoothness = np.float32(config.smoothness)
            propagate(stereo, reaches, deltas, smoothness, colour, still, depth, cost)
        # What came to rest before the level began has been moved since, perhaps.
        still[:] = False


def _polish(
    stereo: Stereo,
    delta_px: float,
    still_px: float,
    depth: np.ndarray,
    cost: np.ndarray,
    still: np.ndarray,
) -> None:
    """`polish` in place, its step and what counts as still in px of disparity."""
    share = np.float32(still_px / delta_px)
    delta = np.float32(delta_px) * stereo.step
    polish(stereo, delta, 1, depth.copy(), cost, depth, still, share)


def _matrix(lens: np.ndarray) -> np.ndarray:
    fx, fy, cx, cy = lens
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])


def _centre(pose: np.ndarray) -> np.ndarray:
    return -pose[:, :3].T @ pose[:, 3]
