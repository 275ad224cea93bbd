"""Are the cameras where the rig has them? Checked against matches that pycolmap finds by itself.

SIFT features are matched and verified between all pairs of views without the rig's poses
[Lowe2004]; then each verified match is held against the rig, and the tracks are
triangulated with the rig's poses. Nothing is moved: a camera that is off is named.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import cv2
import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.counting import counted
from lightstage.rig import Camera
from processing.colmap import pycolmap
from processing.errors import PoseError
from processing.reconstruction.config import ReconstructConfig
from processing.reconstruction.matches import find_matches

REFERENCE_ROWS = 1000
"""`max_residual_px` is meant for pictures of this height."""


@dataclasses.dataclass(frozen=True)
class PairMatches:
    """Verified matches of two views.

    Attributes:
        first, second: indices of the views.
        pixels: (n, 2, 2) undistorted pixels in the first and in the second view.
        residual_px: (n,) distance to the epipolar geometry that the rig gives (Sampson).
    """

    first: int
    second: int
    pixels: np.ndarray
    residual_px: np.ndarray


@dataclasses.dataclass(frozen=True)
class PoseReport:
    """What the matches show about each camera, in the order of the cameras.

    Attributes:
        camera_ids: names.
        matches: verified matches with all other cameras.
        residual_px: median distance of a camera's matches to the rig's epipolar geometry, of the
            pairs with cameras that are not off themselves; NaN without matches.
        limit_px: residual above which a camera is off.
        off: indices of cameras that are off, the worst first.
        pairs: (first, second, median residual in px) of every pair with verified matches.
        tracks: points triangulated with the rig's poses.
        track_residual_px: their median reprojection error, NaN without tracks.
        spread_mm: median distance of the tracks from their median, the size of what was seen.
        points_mm: (tracks, 3) those points, world.
    """

    camera_ids: tuple[str, ...]
    matches: tuple[int, ...]
    residual_px: tuple[float, ...]
    limit_px: float
    off: tuple[int, ...]
    pairs: tuple[tuple[int, int, float], ...]
    tracks: int
    track_residual_px: float
    spread_mm: float
    points_mm: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((0, 3)))


def tone_mapped(image: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """An 8-bit grey picture with the local contrast evened out, for the feature detector.

    Args:
        image: (h, w, 3) linear.
        mask: (h, w) bool foreground; the scale is taken from it.
    """
    grey = np.nan_to_num(image.mean(axis=2))
    inside = grey[mask]
    scale = float(np.percentile(inside, 99)) if inside.size else 0.0
    encoded = np.clip(grey / scale, 0, 1) ** (1 / 2.2) if scale > 0 else np.zeros(grey.shape)
    even = cv2.createCLAHE(clipLimit=3.0, tileGridSize=(8, 8))
    return np.asarray(even.apply(np.round(encoded * 255).astype(np.uint8)))


def check_poses(
    pictures: Sequence[np.ndarray],
    masks: Sequence[np.ndarray],
    cameras: Sequence[Camera],
    config: ReconstructConfig,
    progress: ProgressCallback = quiet,
) -> PoseReport:
    """Hold matches between the pictures against the rig.

    Args:
        pictures: of each camera, (h, w) uint8, in the camera's own (distorted) pixels.
        masks: of each camera, (h, w) bool; features outside are not used.
        cameras: the rig's.
        config: limits.
        progress: called after each step.

    Returns:
        The report; `raise_when_off` turns it into an error.
    """
    found = find_matches(pictures, masks, cameras, progress)
    pairs = [
        PairMatches(first, second, pixels, against_rig(cameras[first], cameras[second], pixels))
        for first, second, pixels in found
    ]
    rows = float(np.median([camera.height_px for camera in cameras]))
    limit = config.max_residual_px * max(1.0, rows / REFERENCE_ROWS)
    residuals, off = blame(pairs, len(cameras), limit, config.min_matches)
    good = [pair for pair in pairs if pair.first not in off and pair.second not in off]
    points, errors = _triangulate(good, cameras)
    near = np.isfinite(errors) & (errors < 4 * limit)
    points, errors = points[near], errors[near]
    spread = np.linalg.norm(points - np.median(points, axis=0), axis=1) if len(points) else [np.nan]
    counts = np.zeros(len(cameras), int)
    for pair in pairs:
        counts[[pair.first, pair.second]] += len(pair.residual_px)
    return PoseReport(
        tuple(camera.id for camera in cameras),
        tuple(int(count) for count in counts),
        tuple(float(value) for value in residuals),
        limit,
        tuple(off),
        tuple((p.first, p.second, float(np.median(p.residual_px))) for p in pairs),
        len(points),
        float(np.median(errors)) if len(errors) else float("nan"),
        float(np.median(spread)),
        points,
    )


def drifted(report: PoseReport, config: ReconstructConfig) -> list[str]:
    """Warnings of cameras that are not off, but farther from the rig than they should be."""
    limit = report.limit_px * config.drift_px / config.max_residual_px
    return [
        f"the matches of {camera} miss the rig by {residual:.2f} px (median, above {limit:.2f}): "
        "cameras are due to be measured again"
        for k, (camera, residual) in enumerate(
            zip(report.camera_ids, report.residual_px, strict=True)
        )
        if residual > limit and k not in report.off
    ]


def unchecked(report: PoseReport, config: ReconstructConfig) -> list[str]:
    """One warning of all cameras with too few matches to be held against the rig."""
    few = [
        f"{camera} ({counted(count, 'match', 'matches')})"
        for camera, count, residual in zip(
            report.camera_ids, report.matches, report.residual_px, strict=True
        )
        if np.isnan(residual)
    ]
    if not few:
        return []
    return [
        f"not checked whether the rig has the right pose of {', '.join(few)}: that takes "
        f"{config.min_matches} matches with other cameras, of which larger photographs have more"
    ]


def in_pixels(report: PoseReport, times: int) -> PoseReport:
    """A report of pictures whose pixels are cells of `times` pixels a side, in those pixels."""
    return dataclasses.replace(
        report,
        residual_px=tuple(times * value for value in report.residual_px),
        limit_px=times * report.limit_px,
        pairs=tuple((one, two, times * value) for one, two, value in report.pairs),
        track_residual_px=times * report.track_residual_px,
    )


def raise_when_off(report: PoseReport, stage_radius_mm: float) -> None:
    """Turn a report into an error where a camera is off or the rig's unit is wrong.

    Args:
        report: of `check_poses`.
        stage_radius_mm: median distance of the lights from the origin.

    Raises:
        PoseError: naming every camera that is off.
    """
    if report.off:
        named = ", ".join(f"{report.camera_ids[k]} ({_misses(report, k)})" for k in report.off)
        raise PoseError(
            "camera poses",
            field=named,
            found="matches that miss the rig's geometry by that much (median)",
            expected=f"at most {report.limit_px:.1f} px",
            hint="Were cameras swapped or moved since the rig was calibrated? "
            "Of each pair that is named, one or both stand elsewhere.",
        )
    spread = report.spread_mm
    if report.tracks >= 20 and not 0.005 < spread / stage_radius_mm < 0.5:
        raise PoseError(
            "camera poses",
            found=f"matched points spread over {spread:.3g} mm in a stage of "
            f"{stage_radius_mm:.3g} mm radius",
            expected="a head",
            hint="Are the cameras' positions in mm, as the lights' are?",
        )


def _misses(report: PoseReport, camera: int) -> str:
    """A camera's residual, and that of each pair in which it is above the limit."""
    parts = [f"{report.residual_px[camera]:.1f} px"]
    for first, second, residual in report.pairs:
        if camera in (first, second) and residual > report.limit_px:
            partner = report.camera_ids[first + second - camera]
            parts.append(f"with {partner} {residual:.1f} px")
    return ", ".join(parts)


def blame(
    pairs: Sequence[PairMatches], count: int, limit_px: float, min_matches: int
) -> tuple[np.ndarray, list[int]]:
    """Which cameras are off: the one with most misses is taken out until the others agree.

    A camera that is off spoils all pairs it is in, so what is left without it decides about the
    others.

    Args:
        pairs: matches held against the rig.
        count: of cameras.
        limit_px: median residual above which a camera is off.
        min_matches: a camera of fewer matches is not judged.

    Returns:
        (count,) median residual of each camera (NaN where there are no matches), and the indices
        of those that are off, the worst first.
    """
    off: list[int] = []
    final = np.full(count, np.nan)
    while True:
        left = [pair for pair in pairs if not {pair.first, pair.second} & set(off)]
        residuals = [
            np.concatenate(
                [np.zeros(0)] + [p.residual_px for p in left if k in (p.first, p.second)]
            )
            for k in range(count)
        ]
        judged = [k for k in range(count) if k not in off and len(residuals[k]) >= min_matches]
        final[judged] = [np.median(residuals[k]) for k in judged]
        suspects = [k for k in judged if final[k] > limit_px]
        if not suspects:
            return final, off
        # One that is off misses with everybody; its neighbours miss only with it.
        off.append(max(suspects, key=lambda k: int((residuals[k] > limit_px).sum())))


def against_rig(first: Camera, second: Camera, pixels: np.ndarray) -> np.ndarray:
    """Sampson distance of matches to the epipolar geometry of two cameras, pixels.

    Args:
        first, second: the cameras; their distortion is not used.
        pixels: (n, 2, 2) undistorted pixels in the first and in the second.

    Returns:
        (n,); infinite where both cameras stand in one place.
    """
    relative = second.cam_from_world[:, :3] @ first.cam_from_world[:, :3].T
    x, y, z = second.cam_from_world[:, 3] - relative @ first.cam_from_world[:, 3]
    if np.linalg.norm([x, y, z]) < 1e-9:
        return np.full(len(pixels), np.inf)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    fundamental = np.linalg.inv(second.matrix).T @ cross @ relative @ np.linalg.inv(first.matrix)
    one = np.concatenate([pixels[:, 0], np.ones((len(pixels), 1))], axis=1)
    two = np.concatenate([pixels[:, 1], np.ones((len(pixels), 1))], axis=1)
    line_two, line_one = one @ fundamental.T, two @ fundamental
    miss = np.einsum("nk,nk->n", two, line_two)
    under = np.sqrt((line_two[:, :2] ** 2).sum(axis=1) + (line_one[:, :2] ** 2).sum(axis=1))
    return np.abs(np.divide(miss, under, out=np.full(len(pixels), np.inf), where=under > 0))


def _triangulate(
    pairs: Sequence[PairMatches], cameras: Sequence[Camera]
) -> tuple[np.ndarray, np.ndarray]:
    """World points (n, 3) of all matches by the rig's poses, and their reprojection errors (n,)."""
    points, errors = [], []
    for pair in pairs:
        views = [cameras[pair.first], cameras[pair.second]]
        poses = [camera.cam_from_world for camera in views]
        for match in pair.pixels:
            rays = [
                [(u - c.cx_px) / c.fx_px, (v - c.cy_px) / c.fy_px]
                for (u, v), c in zip(match, views, strict=True)
            ]
            point = pycolmap.triangulate_point(poses[0], poses[1], rays[0], rays[1])
            if point is None:
                continue
            straight = [dataclasses.replace(camera, dist=(0, 0, 0, 0, 0)) for camera in views]
            off = [
                np.linalg.norm(camera.project(point)[0][0] - pixel)
                for camera, pixel in zip(straight, match, strict=True)
            ]
            points.append(np.asarray(point, float).reshape(3))
            errors.append(float(np.mean(off)))
    return np.array(points).reshape(-1, 3), np.array(errors)
