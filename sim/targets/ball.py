"""Balls: a grey one that shows each lamp's light, a mirror that shows where each lamp is."""

from __future__ import annotations

import dataclasses
import math

import numba
import numpy as np

from lightstage.rig import Camera
from sim.errors import SimError
from sim.light.lamps import Lamps
from sim.targets.light import FINER, Window, corner_rays, white_reading, window

MIRROR_FINER = 16
"""Subpixels along a side of a pixel that shows a lamp in the mirror: lamps are small in it."""


@dataclasses.dataclass(frozen=True)
class Ball:
    """A sphere in the stage.

    Attributes:
        centre_mm: (3,) world.
        radius_mm: its radius.
        reflectance: Lambertian albedo of a grey ball, mirror reflectance of a mirror ball.
    """

    centre_mm: np.ndarray
    radius_mm: float
    reflectance: float


def photograph_grey(
    ball: Ball, camera: Camera, lamps: Lamps, levels: np.ndarray, ambient: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """A Lambertian ball alone in the stage; arguments, shapes and results as `photograph_plane`."""
    light, depth, part = _empty(ball, camera)
    if part is None:
        return light, depth
    origin, rays = part.camera.pixel_rays()
    points, cover = _nearest(ball, origin, rays), _cover(ball, part.camera)
    seen = cover > 0
    normals = (points[seen] - ball.centre_mm) / ball.radius_mm
    shown = np.zeros_like(points)
    shown[seen] = white_reading(points[seen], normals, lamps, levels) + ambient
    light[part.rows, part.columns] = ball.reflectance * shown * cover[..., None]
    depth[part.rows, part.columns] = np.where(seen, _depth(points, camera), 0.0)
    return light, depth


def photograph_mirror(
    ball: Ball, camera: Camera, lamps: Lamps, levels: np.ndarray, ambient: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """A mirror ball alone in the stage; arguments, shapes and results as `photograph_plane`.

    Each lamp is a sphere of its radius, as bright as its light asks. The room is seen as an even
    grey. Cameras are not seen in it.

    Raises:
        SimError: lamps without size have no picture in a mirror.
    """
    if not lamps.radius_mm > 0:
        raise SimError("lamps", field="radius_mm", found=f"{lamps.radius_mm}", expected="above 0")
    light, depth, part = _empty(ball, camera)
    if part is None:
        return light, depth
    origin, corners = corner_rays(part.camera)
    # What a lamp of radiance L and radius r reads on a white diffuser: L (r / d)^2.
    bright = np.asarray(levels)[:, None] * lamps.weights
    bright = bright * (np.sum(lamps.positions_mm**2, axis=1) / lamps.radius_mm**2)[:, None]
    cover = _cover(ball, part.camera)
    shown = np.zeros((*cover.shape, 3))
    lit = bright.any(axis=1)
    _reflect(
        corners,
        np.concatenate([origin - ball.centre_mm, [ball.radius_mm]]),
        lamps.positions_mm[lit] - ball.centre_mm,
        lamps.axes[lit],
        float(lamps.exponent),
        float(lamps.radius_mm),
        bright[lit],
        MIRROR_FINER,
        shown,
    )
    light[part.rows, part.columns] = ball.reflectance * (shown + ambient * cover[..., None])
    _, rays = part.camera.pixel_rays()
    points = _nearest(ball, origin, rays)
    depth[part.rows, part.columns] = np.where(cover > 0, _depth(points, camera), 0.0)
    return light, depth


def highlights_mm(ball: Ball, camera: Camera, lamps_mm: np.ndarray) -> np.ndarray:
    """Where on a mirror ball a camera sees lamps: Alhazen's problem, solved by bisection.

    In the plane of camera, lamp and the ball's centre the angle of incidence toward the camera
    grows and that toward the lamp falls as the point moves to the lamp; they meet once.

    Args:
        ball: the mirror.
        camera: the view.
        lamps_mm: (m, 3) places of the lamps.

    Returns:
        (m, 3) places on the ball, NaN where camera or lamp is below the horizon there.
    """
    to_camera = camera.centre_mm - ball.centre_mm
    to_lamp = np.asarray(lamps_mm, float) - ball.centre_mm
    a, b = float(np.linalg.norm(to_camera)), np.linalg.norm(to_lamp, axis=1)
    first = to_camera / a
    aside = to_lamp - (to_lamp @ first)[:, None] * first
    width = np.linalg.norm(aside, axis=1, keepdims=True)
    # A lamp behind the camera has no plane of its own; any will do, since the angle is nought.
    other = np.cross(first, [0.0, 1.0, 0.0] if abs(first[1]) < 0.9 else [1.0, 0.0, 0.0])
    other = np.where(width > 1e-9, aside / np.maximum(width, 1e-9), other / np.linalg.norm(other))
    between = np.arctan2(width[:, 0], to_lamp @ first)
    low, high = np.zeros_like(between), between.copy()
    for _ in range(60):
        middle = (low + high) / 2
        over = _incidence(middle, a, ball.radius_mm) > _incidence(
            between - middle, b, ball.radius_mm
        )
        low, high = np.where(over, low, middle), np.where(over, middle, high)
    angle = (low + high) / 2
    normal = np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * other
    seen = (a * np.cos(angle) > ball.radius_mm) & (b * np.cos(between - angle) > ball.radius_mm)
    return np.where(seen[:, None], ball.centre_mm + ball.radius_mm * normal, np.nan)


def _incidence(angle: np.ndarray, far: float | np.ndarray, radius: float) -> np.ndarray:
    """Angle between the normal and the way to a place `far` from the centre, `angle` from it."""
    return np.arctan2(far * np.sin(angle), far * np.cos(angle) - radius)


def _empty(ball: Ball, camera: Camera) -> tuple[np.ndarray, np.ndarray, Window | None]:
    light = np.zeros((camera.height_px, camera.width_px, 3), np.float32)
    depth = np.zeros(light.shape[:2], np.float32)
    return light, depth, window(camera, _outline(ball, camera))


def _outline(ball: Ball, camera: Camera) -> np.ndarray:
    """(n, 2) pixels of a box around the ball."""
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    return camera.project(ball.centre_mm + ball.radius_mm * signs)[0]


def _nearest(ball: Ball, origin: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """(h, w, 3) where rays meet the ball; on its outline where they pass by."""
    to_centre = ball.centre_mm - origin
    along = rays @ to_centre
    aside2 = to_centre @ to_centre - along**2
    reach = np.sqrt(np.maximum(ball.radius_mm**2 - aside2, 0.0))
    points = origin + (along - reach)[..., None] * rays
    off = points - ball.centre_mm
    return ball.centre_mm + ball.radius_mm * off / np.linalg.norm(off, axis=-1, keepdims=True)


def _cover(ball: Ball, camera: Camera) -> np.ndarray:
    """(h, w) share of each pixel that the ball covers."""
    origin, corners = corner_rays(camera)
    to_centre = ball.centre_mm - origin
    share = np.zeros((camera.height_px, camera.width_px))
    for y in (np.arange(FINER) + 0.5) / FINER:
        down = (1 - y) * corners[:-1] + y * corners[1:]
        for x in (np.arange(FINER) + 0.5) / FINER:
            rays = (1 - x) * down[:, :-1] + x * down[:, 1:]
            along = rays @ to_centre
            aside2 = to_centre @ to_centre - along**2 / np.sum(rays**2, axis=-1)
            share += (aside2 < ball.radius_mm**2) & (along > 0)
    return share / FINER**2


def _depth(points: np.ndarray, camera: Camera) -> np.ndarray:
    return points @ camera.cam_from_world[2, :3] + camera.cam_from_world[2, 3]


@numba.njit(cache=True, inline="always")
def _bounce(
    eye: np.ndarray, x: float, y: float, z: float
) -> tuple[bool, float, float, float, float, float, float]:
    """Whether a ray meets the ball, where (against its centre), and the way it leaves.

    eye is the ray's origin against the ball's centre, and the ball's radius; x y z its direction.
    """
    length = math.sqrt(x * x + y * y + z * z)
    x, y, z = x / length, y / length, z / length
    along = -(eye[0] * x + eye[1] * y + eye[2] * z)
    apart2 = eye[0] * eye[0] + eye[1] * eye[1] + eye[2] * eye[2]
    inside2 = eye[3] * eye[3] - apart2 + along * along
    if inside2 <= 0.0 or along <= 0.0:
        return False, 0.0, 0.0, 0.0, x, y, z
    reach = along - math.sqrt(inside2)
    px, py, pz = eye[0] + reach * x, eye[1] + reach * y, eye[2] + reach * z
    twice = 2.0 * (px * x + py * y + pz * z) / (eye[3] * eye[3])
    return True, px, py, pz, x - twice * px, y - twice * py, z - twice * pz


@numba.njit(cache=True, parallel=True)
def _reflect(
    corners: np.ndarray,
    eye: np.ndarray,
    lamps: np.ndarray,
    axes: np.ndarray,
    exponent: float,
    lamp_radius: float,
    bright: np.ndarray,
    finer: int,
    out: np.ndarray,
) -> None:
    """Add the lamps that (h, w) pixels see in the ball to `out` (h, w, 3).

    corners are the (h + 1, w + 1, 3) rays through the pixels' corners; eye as in `_bounce`; lamps
    (m, 3) against the ball's centre; bright (m, 3) each lamp's radiance along its axis. A pixel is
    sampled finely for the lamps that are near its reflected ray, by as much as that ray turns
    from corner to corner.
    """
    height, width = out.shape[:2]
    for row in numba.prange(height):
        for column in range(width):
            a, b = corners[row, column], corners[row, column + 1]
            c, d = corners[row + 1, column], corners[row + 1, column + 1]
            hit, px, py, pz, lx, ly, lz = _bounce(
                eye, a[0] + b[0] + c[0] + d[0], a[1] + b[1] + c[1] + d[1], a[2] + b[2] + c[2] + d[2]
            )
            met, turned = int(hit), 0.0
            for k in range(4):
                corner = corners[row + (k >> 1), column + (k & 1)]
                found, _, _, _, x, y, z = _bounce(eye, corner[0], corner[1], corner[2])
                met += int(found)
                turned = max(turned, (x - lx) ** 2 + (y - ly) ** 2 + (z - lz) ** 2)
            if met == 0:
                continue
            # On the ball's outline, where rays turn without end, every lamp is looked for.
            near = 1.5 * math.sqrt(turned) if met == 5 else 4.0
            steps = finer if met == 5 else FINER
            for k in range(len(lamps)):
                x, y, z = lamps[k, 0] - px, lamps[k, 1] - py, lamps[k, 2] - pz
                far = math.sqrt(x * x + y * y + z * z)
                off2 = (x / far - lx) ** 2 + (y / far - ly) ** 2 + (z / far - lz) ** 2
                if off2 > (near + 2.0 * lamp_radius / far) ** 2:
                    continue
                share = 0.0
                for i in range(steps):
                    v = (i + 0.5) / steps
                    for j in range(steps):
                        u = (j + 0.5) / steps
                        w0, w1, w2, w3 = (1 - v) * (1 - u), (1 - v) * u, v * (1 - u), v * u
                        found, qx, qy, qz, x, y, z = _bounce(
                            eye,
                            w0 * a[0] + w1 * b[0] + w2 * c[0] + w3 * d[0],
                            w0 * a[1] + w1 * b[1] + w2 * c[1] + w3 * d[1],
                            w0 * a[2] + w1 * b[2] + w2 * c[2] + w3 * d[2],
                        )
                        if not found:
                            continue
                        tx, ty, tz = lamps[k, 0] - qx, lamps[k, 1] - qy, lamps[k, 2] - qz
                        along = tx * x + ty * y + tz * z
                        miss2 = tx * tx + ty * ty + tz * tz - along * along
                        aside = -(x * axes[k, 0] + y * axes[k, 1] + z * axes[k, 2])
                        if along > 0.0 and miss2 < lamp_radius * lamp_radius and aside > 0.0:
                            share += aside**exponent
                for channel in range(3):
                    out[row, column, channel] += share / (steps * steps) * bright[k, channel]
