"""A ball in the stage: its photographs, and where cameras see which of its places."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path

import cv2
import numpy as np
from scipy.optimize import least_squares

from lightstage.commands import ProgressCallback
from lightstage.counting import counted
from lightstage.errors import FormatError
from lightstage.formats.exr import read_exr
from lightstage.formats.flats import FlatField
from lightstage.formats.session import Session
from lightstage.nearest_point import nearest_equations
from lightstage.rig import Camera
from processing.calibration.picture import flattened, read_mosaic
from processing.colour import ColourCorrection
from processing.errors import ProcessingError

EDGE_POINTS = 400
"""Number of points on a ball's outline in each camera."""
LIT_SHARE = 0.25
"""A pixel of a grey ball is brighter than this share of the ball's typical one."""
LEAST_FILLED = 0.6
"""Least share of the box around a ball that is filled; a disc fills .785 of it."""
BESIDE_SHARE = 0.15
"""What is not the ball is darker than this share of it."""
UNDISTORT_ROUNDS = 12
BORDER_PX = 2.0
SMALLEST_PX = 6.0
"""Radius of a ball below which nothing is measured."""


@dataclasses.dataclass(frozen=True)
class Picture:
    """A photograph as calibration reads it.

    Attributes:
        rgb: (h, w, 3) float32 linear, on the camera's own scale, the same in all its photographs of
            one pose.
        valid: (h, w) bool, not clipped and finite.
        camera: of these pixels.
    """

    rgb: np.ndarray
    valid: np.ndarray
    camera: Camera


@dataclasses.dataclass(frozen=True)
class BallShots:
    """Photographs of a ball that stays in one place.

    Attributes:
        where: what an error names.
        levels: pattern to (L,) levels that were driven, in the order of the photographs.
        cameras: ids of the cameras that took them.
        read: the photograph of a pattern by a camera.
    """

    where: Path
    levels: Mapping[str, np.ndarray]
    cameras: tuple[str, ...]
    read: Callable[[str, str], Picture]


class Steps:
    """Counts photographs."""

    def __init__(self, progress: ProgressCallback, total: int) -> None:
        self._progress, self._total, self._done = progress, total, 0

    def one(self) -> None:
        """One more is read."""
        self._done += 1
        self._progress(self._done, self._total)


def whole_pattern(shots: BallShots) -> str:
    """The pattern of most light."""
    return max(shots.levels, key=lambda name: float(shots.levels[name].sum()))


def ball_shots(
    session: Session,
    colour: Mapping[str, ColourCorrection] | None = None,
    patterns: tuple[str, ...] | None = None,
    flats: Mapping[str, FlatField] | None = None,
) -> BallShots:
    """A session's photographs of a ball.

    Args:
        session: one pose.
        colour: corrections of its cameras; without them channels are the cameras' raw ones.
        patterns: some of its patterns; all where absent.
        flats: fields of its cameras, by which black level, hot pixels and vignetting of RAW
            photographs are mended: a lens's darker rim would pass for weaker lamps.
    """
    names = tuple(session.file.sequence) if patterns is None else patterns
    corrections, fields = colour or {}, flats or {}

    def read(pattern: str, camera_id: str) -> Picture:
        frame = session.frame(pattern, camera_id)
        path = session.frame_path(frame)
        camera = session.rig.camera(camera_id)
        if frame.encoding == "linear":
            rgb = read_exr(path)
            if rgb.ndim != 3:
                raise FormatError(path, found="one channel", expected="R G B")
            picture = Picture(rgb, np.isfinite(rgb).all(axis=2), camera)
        else:
            mosaic = flattened(read_mosaic(path), fields.get(camera_id))
            rgb = mosaic.cells()
            if camera_id in corrections:
                rgb = corrections[camera_id].apply(rgb)
            picture = Picture(rgb, ~mosaic.clipped_cells(), half(camera))
        size = (picture.camera.height_px, picture.camera.width_px)
        if picture.valid.shape != size:
            raise FormatError(
                path,
                found=f"{rgb.shape[1]} x {rgb.shape[0]} pixels",
                expected=f"{size[1]} x {size[0]}, by {camera_id} in rig.json",
            )
        return picture

    levels = {name: session.levels(name) for name in names}
    return BallShots(session.root, levels, tuple(session.camera_ids()), read)


def half(camera: Camera) -> Camera:
    """The camera of pictures whose pixels are cells of 2 x 2."""
    return dataclasses.replace(
        camera,
        width_px=camera.width_px // 2,
        height_px=camera.height_px // 2,
        fx_px=camera.fx_px / 2,
        fy_px=camera.fy_px / 2,
        cx_px=camera.cx_px / 2,
        cy_px=camera.cy_px / 2,
    )


def rays_through(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    """(n, 3) unit directions in the world through (n, 2) places of a picture."""
    x, y = np.asarray(pixels, float).reshape(-1, 2).T
    return camera.rays_through(x, y, UNDISTORT_ROUNDS)


def nearest_point(origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(3,) the place nearest to n lines, given (n, 3) places on them and unit directions."""
    return np.asarray(np.linalg.lstsq(*nearest_equations(origins, directions), rcond=None)[0])


def radius_px(camera: Camera, radius_mm: float) -> float:
    """Radius in a camera's picture of a ball near the origin."""
    return radius_mm * camera.fx_px / max(float(np.linalg.norm(camera.centre_mm)), 1.0)


def sphere_hits(
    centre_mm: np.ndarray, radius_mm: float, origins: np.ndarray, rays: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Where rays meet a ball.

    Args:
        centre_mm: (3,) or (n, 3).
        radius_mm: of the ball.
        origins: (3,) or (n, 3).
        rays: (n, 3) unit.

    Returns:
        (n, 3) places, and (n,) bool; a ray that passes by has its place on the ball's outline.
    """
    away = centre_mm - origins
    along = np.einsum("nk,nk->n", rays, np.broadcast_to(away, rays.shape))
    inside = radius_mm**2 - (np.sum(away * away, axis=-1) - along**2)
    points = origins + (along - np.sqrt(np.maximum(inside, 0)))[:, None] * rays
    off = points - centre_mm
    off *= radius_mm / np.maximum(np.linalg.norm(off, axis=1, keepdims=True), 1e-12)
    return centre_mm + off, (inside > 0) & (along > 0)


@dataclasses.dataclass(frozen=True)
class Outline:
    """Where a lit ball was found by its outline.

    Attributes:
        centre_mm: (3,).
        radius_mm: as the outlines give it.
        residual_px: root mean square of the outlines' distance from the ball's.
        cameras: how many saw it.
    """

    centre_mm: np.ndarray
    radius_mm: float
    residual_px: float
    cameras: int


def find_ball(pictures: list[Picture], radius_mm: float, where: Path) -> Outline:
    """Find a matte ball by its outline in pictures in which all of it is lit.

    A ball's outline is a cone around the way to its centre. What is not on it, such as a stand, is
    given less weight the farther it is off.

    Args:
        pictures: by several cameras at one time.
        radius_mm: about what it is.
        where: what an error names.

    Raises:
        ProcessingError: fewer than two cameras see a ball.
    """
    origins, rays, px, axes = [], [], [], []
    for picture in pictures:
        edge = _edge(picture, radius_px(picture.camera, radius_mm))
        if edge is None:
            continue
        middle, points = edge
        axes.append((picture.camera.centre_mm, rays_through(picture.camera, middle[None])[0]))
        rays.append(rays_through(picture.camera, points))
        origins.append(np.broadcast_to(picture.camera.centre_mm, rays[-1].shape))
        px.append(np.full(len(points), picture.camera.fx_px))
    if len(axes) < 2:
        raise ProcessingError(
            where,
            found=f"a lit ball in {len(axes)} of {counted(len(pictures), 'camera')}",
            expected="one in two at least",
            hint="Is the grey ball in the middle of the stage, and its radius right?",
        )
    start = nearest_point(np.array([a[0] for a in axes]), np.array([a[1] for a in axes]))
    origin, ray, scale = np.concatenate(origins), np.concatenate(rays), np.concatenate(px)

    def residual(values: np.ndarray) -> np.ndarray:
        away = values[:3] - origin
        far = np.linalg.norm(away, axis=1)
        along = np.einsum("nk,nk->n", ray, away) / far
        angle = np.arccos(np.clip(along, -1, 1))
        return np.asarray((angle - np.arcsin(np.clip(values[3] / far, 0, 1))) * scale)

    found = least_squares(residual, [*start, radius_mm], loss="soft_l1", f_scale=0.5, x_scale="jac")
    left = residual(found.x)
    near = np.abs(left) < 3 * max(float(np.median(np.abs(left))), 0.05)
    rms = float(np.sqrt(np.mean(left[near] ** 2)))
    return Outline(found.x[:3], float(found.x[3]), rms, len(axes))


def _edge(picture: Picture, expected_px: float) -> tuple[np.ndarray, np.ndarray] | None:
    """(2,) middle and (n, 2) places, finer than a pixel, of the largest lit blob's outline."""
    light = picture.rgb.mean(axis=2)
    light = np.where(np.isfinite(light), light, np.float32(0))
    typical = float(np.percentile(light, 100 * max(0.0, 1 - 1.5 * expected_px**2 / light.size)))
    mask = (light > LIT_SHARE * typical).astype(np.uint8)
    if not typical > 0:
        return None
    count, _, stats, middles = cv2.connectedComponentsWithStats(mask)
    if count < 2:
        return None
    largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    area = int(stats[largest, cv2.CC_STAT_AREA])
    radius = float(np.sqrt(area / np.pi))
    if radius < SMALLEST_PX or not 0.5 * expected_px < radius < 2 * expected_px:
        return None
    box = int(stats[largest, cv2.CC_STAT_WIDTH]) * int(stats[largest, cv2.CC_STAT_HEIGHT])
    beside = float(np.median(np.abs(light[mask == 0]))) if area < light.size else 0.0
    if area < LEAST_FILLED * box or beside > BESIDE_SHARE * typical:
        return None
    middle = middles[largest] + 0.5
    points = _crossings(light, middle, radius)
    return (middle, points) if len(points) >= EDGE_POINTS / 4 else None


def _crossings(light: np.ndarray, middle: np.ndarray, radius: float) -> np.ndarray:
    """(n, 2) where spokes from the middle leave the ball: half as bright as just inside of it."""
    reach = np.linspace(0.7, 1.3, max(48, int(2.4 * radius)))
    turn = np.linspace(0, 2 * np.pi, EDGE_POINTS, endpoint=False)
    way = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    places = middle + radius * reach[None, :, None] * way[:, None, :]
    along = cv2.remap(
        light,
        (places[..., 0] - 0.5).astype(np.float32),
        (places[..., 1] - 0.5).astype(np.float32),
        cv2.INTER_LINEAR,
    )
    # Pixels at the rim hold the ball by a share: the rim is where half of one is covered, and the
    # light of the ball there is what it is a pixel and a half further in.
    step = float(radius * (reach[1] - reach[0]))
    back = max(1, round(1.5 / step))
    inner = along.copy()
    inner[:, back:] = along[:, :-back]
    below = (along < 0.5 * inner) & (inner > LIT_SHARE * np.median(along[:, 0]))
    first = below.argmax(axis=1)
    good = below.any(axis=1) & (first > back)
    rows = np.flatnonzero(good)
    after, before = along[rows, first[good]], along[rows, first[good] - 1]
    wanted = 0.5 * inner[rows, first[good]]
    part = np.clip((before - wanted) / np.maximum(before - after, 1e-12), 0, 1)
    length = radius * reach[0] + step * (first[good] - 1 + part)
    found = middle + length[:, None] * way[rows]
    # Where the picture ends the ball need not.
    whole = (found > BORDER_PX) & (found < np.array(light.shape[::-1]) - BORDER_PX)
    return np.asarray(found[whole.all(axis=1)])
