"""Photographs of a grey ball to readings of its places."""

from __future__ import annotations

import dataclasses

import numpy as np

from lightstage.counting import counted
from lightstage.patterns import complement
from lightstage.rig import Camera
from processing.calibration.ball import (
    BallShots,
    Picture,
    Steps,
    find_ball,
    radius_px,
    sphere_hits,
    whole_pattern,
)
from processing.calibration.lights.config import GreyBallConfig
from processing.calibration.lights.grey_ball import LEAST_FACING, Readings
from processing.errors import ProcessingError

LEAST_PLACES = 40
SUMS_TO = 1e-3
"""Levels of a pair may differ from those of the whole by this and still sum to it."""


def read_grey_ball(shots: BallShots, config: GreyBallConfig, steps: Steps) -> Readings:
    """Places of one pose of a grey ball."""
    whole = whole_pattern(shots)
    pictures = {camera_id: shots.read(whole, camera_id) for camera_id in shots.cameras}
    outline = find_ball(list(pictures.values()), config.radius_mm, shots.where)
    if abs(outline.radius_mm / config.radius_mm - 1) > 0.05:
        raise ProcessingError(
            shots.where,
            field="radius_mm",
            found=f"a grey ball of {outline.radius_mm:.1f} mm radius in the photographs",
            expected=f"{config.radius_mm:g} mm",
            hint="Measure the ball and give its radius.",
        )
    patterns = tuple(shots.levels)
    parts = []
    for index, camera_id in enumerate(shots.cameras):
        part = _part(pictures[camera_id].camera, outline.centre_mm, outline.radius_mm, config)
        if part is None:
            steps.one()
            continue
        shown = []
        for name in patterns:
            picture = pictures[camera_id] if name == whole else shots.read(name, camera_id)
            steps.one()
            shown.append(part.light(picture))
        parts.append((part, np.stack(shown, axis=1), np.full(len(part.points), index)))
    if not parts:
        raise _too_few(shots, 0)
    points, normals = (
        np.concatenate([getattr(p[0], k) for p in parts]) for k in ("points", "normals")
    )
    rgb, group = (np.concatenate([p[k] for p in parts]) for k in (1, 2))
    levels = np.stack([shots.levels[name] for name in patterns])
    rgb = rgb - _ambient(rgb, normals, group, patterns, levels, whole)
    good = np.isfinite(rgb).all(axis=(1, 2))
    if good.sum() < LEAST_PLACES:
        raise _too_few(shots, int(good.sum()))
    group = np.unique(group[good], return_inverse=True)[1]
    return Readings(patterns, levels, points[good], normals[good], rgb[good].astype(float), group)


def _too_few(shots: BallShots, count: int) -> ProcessingError:
    return ProcessingError(
        shots.where,
        field="grey",
        found=f"{counted(count, 'place')} of the grey ball not clipped in any photograph",
        expected=f"{LEAST_PLACES} at least, the whole ball in the picture",
        hint="Expose for `full`, and set the ball in the middle of the stage.",
    )


@dataclasses.dataclass(frozen=True)
class _Part:
    """The part of a picture that shows the ball, binned to few places."""

    rows: slice
    columns: slice
    factor: int
    mask: np.ndarray
    points: np.ndarray
    normals: np.ndarray

    def light(self, picture: Picture) -> np.ndarray:
        """(n, 3) mean light of the places; NaN where a pixel of them is not valid."""
        rgb = np.where(picture.valid[..., None], picture.rgb, np.nan)[self.rows, self.columns]
        return np.asarray(_blocks(rgb, self.factor).mean(axis=(1, 3))[self.mask], float)


def _part(
    camera: Camera, centre_mm: np.ndarray, radius_mm: float, config: GreyBallConfig
) -> _Part | None:
    """Where a camera shows a ball; None where it does not show the whole of it."""
    size = radius_px(camera, radius_mm)
    factor = max(1, int(size * np.sqrt(np.pi / config.places)))
    middle = camera.project(centre_mm[None])[0][0]
    side = int(np.ceil(size / factor)) + 1
    left, top = (round(value - side * factor) for value in middle)
    wide = 2 * side * factor
    if left < 0 or top < 0 or left + wide > camera.width_px or top + wide > camera.height_px:
        return None
    part = dataclasses.replace(
        camera, width_px=wide, height_px=wide, cx_px=camera.cx_px - left, cy_px=camera.cy_px - top
    )
    origin, rays = part.pixel_rays()
    flat = rays.reshape(-1, 3)
    points, hit = sphere_hits(centre_mm, radius_mm, origin, flat)
    normals = (points - centre_mm) / radius_mm
    good = hit & (np.einsum("nk,nk->n", normals, -flat) > LEAST_FACING)
    whole = np.asarray(_blocks(good.reshape(wide, wide), factor).all(axis=(1, 3)))
    # Light is nearly linear in the normal: a place's mean light is that of its mean normal.
    points, normals = (
        _blocks(value.reshape(wide, wide, 3), factor).mean(axis=(1, 3))[whole]
        for value in (points, normals)
    )
    rows, columns = slice(top, top + wide), slice(left, left + wide)
    return _Part(rows, columns, factor, whole, points, normals)


def _blocks(values: np.ndarray, factor: int) -> np.ndarray:
    """(h, w[, k]) values as (h / factor, factor, w / factor, factor[, k])."""
    height, width = (side // factor for side in values.shape[:2])
    return values.reshape(height, factor, width, factor, *values.shape[2:])


def _ambient(
    rgb: np.ndarray,
    normals: np.ndarray,
    group: np.ndarray,
    patterns: tuple[str, ...],
    levels: np.ndarray,
    whole: str,
) -> np.ndarray:
    """(n, 1, 3) the room's light: what a pair shows beyond every light's, smooth over the ball."""
    full = patterns.index(whole)
    extra = []
    for k, name in enumerate(patterns):
        mate = complement(name)
        if mate not in patterns[k + 1 :]:
            continue
        other = patterns.index(mate)
        if np.abs(levels[k] + levels[other] - levels[full]).max() < SUMS_TO:
            extra.append(rgb[:, k] + rgb[:, other] - rgb[:, full])
    out = np.zeros((len(rgb), 1, 3))
    if not extra:
        return out
    room = np.mean(extra, axis=0)
    terms = np.concatenate([np.ones((len(normals), 1)), normals], axis=1)
    for g in np.unique(group):
        own = (group == g) & np.isfinite(room).all(axis=1)
        if own.sum() > 20:
            fitted = np.linalg.lstsq(terms[own], room[own], rcond=None)[0]
            out[group == g, 0] = np.maximum(terms[group == g] @ fitted, 0)
    return out


def joined(parts: list[Readings]) -> Readings:
    """Readings of several poses under the same patterns."""
    first = parts[0]
    for part in parts[1:]:
        if part.patterns != first.patterns or np.abs(part.levels - first.levels).max() > SUMS_TO:
            raise ProcessingError(
                "grey ball",
                found=f"patterns {', '.join(part.patterns)} in one pose",
                expected=f"{', '.join(first.patterns)} as in the first one, driven alike",
            )
    shift = np.cumsum([0] + [int(part.group.max()) + 1 for part in parts[:-1]])
    return Readings(
        first.patterns,
        first.levels,
        np.concatenate([part.points_mm for part in parts]),
        np.concatenate([part.normals for part in parts]),
        np.concatenate([part.rgb for part in parts]),
        np.concatenate([part.group + by for part, by in zip(parts, shift, strict=True)]),
    )
