"""Flat targets: a textured plane in the stage, drawn by exact projection of its own pixels."""

from __future__ import annotations

import dataclasses

import cv2
import numba
import numpy as np

from lightstage.rig import Camera
from sim.light.lamps import Lamps
from sim.targets.light import FINER, corner_rays, white_reading, window

GRID = 9
"""Light changes slowly over a plane: it is computed on a grid of this many places a side."""


@dataclasses.dataclass(frozen=True)
class Plane:
    """A rectangle. Its axes: x right, y down, z away from who looks at its face, mm.

    Attributes:
        reflectance: (rows, columns, 3) float32 of its face, row 0 on top.
        corner_mm: (x, y) of the face's top left corner.
        size_mm: width and height.
        world_from_target: (3, 4) rigid.
        back: reflectance of its other side.
    """

    reflectance: np.ndarray
    corner_mm: tuple[float, float]
    size_mm: tuple[float, float]
    world_from_target: np.ndarray
    back: float = 0.05

    def world(self, points_mm: np.ndarray) -> np.ndarray:
        """(n, 3) world places of (n, 2) places on the plane."""
        return points_mm @ self.world_from_target[:, :2].T + self.world_from_target[:, 3]

    @property
    def normal(self) -> np.ndarray:
        """(3,) unit, out of the face."""
        return -self.world_from_target[:, 2]


def photograph_plane(
    plane: Plane, camera: Camera, lamps: Lamps, levels: np.ndarray, ambient: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """A plane alone in the stage.

    Args:
        plane: the target.
        camera: the view.
        lamps: what shines.
        levels: (m,) of the lamps.
        ambient: (3,) what a white diffuser reads of the room.

    Returns:
        (h, w, 3) float32 light, and (h, w) float32 depth along the axis in mm, 0 beside the plane.
    """
    light = np.zeros((camera.height_px, camera.width_px, 3), np.float32)
    depth = np.zeros(light.shape[:2], np.float32)
    along = np.linspace(0.0, 1.0, 33)
    u, v = (a.ravel() for a in np.meshgrid(along, along))
    place = np.array(plane.corner_mm) + np.stack([u, v], 1) * plane.size_mm
    part = window(camera, camera.project(plane.world(place))[0])
    if part is None:
        return light, depth
    origin, rays = corner_rays(part.camera)
    rotation, shift = plane.world_from_target[:, :3], plane.world_from_target[:, 3]
    start = (origin - shift) @ rotation
    local = rays @ rotation
    away = -start[2] * local[..., 2] > 0
    distance = np.divide(-start[2], local[..., 2], out=np.full(away.shape, np.nan), where=away)
    xy = start[:2] + distance[..., None] * local[..., :2]
    share = np.ascontiguousarray((xy - plane.corner_mm) / plane.size_mm)
    face = start[2] < 0
    shape = (part.camera.height_px, part.camera.width_px)
    shown, cover = np.zeros((*shape, 3), np.float32), np.zeros(shape, np.float32)
    plain = np.full((1, 1, 3), plane.back, np.float32)
    _draw(share, plane.reflectance if face else plain, FINER, shown, cover)
    seen = _white(plane, plane.normal if face else -plane.normal, lamps, levels, ambient)
    middle = _middles(share).astype(np.float32) * np.float32(GRID - 1)
    # At the plane's edge a pixel's middle may be beside it: it takes the edge's light.
    shown *= cv2.remap(
        seen.astype(np.float32),
        np.nan_to_num(middle[..., 0]),
        np.nan_to_num(middle[..., 1]),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    light[part.rows, part.columns] = shown
    deep = _middles(distance * (rays @ camera.cam_from_world[2, :3]))
    depth[part.rows, part.columns] = np.where(cover > 0, deep, 0.0)
    return light, depth


def _white(
    plane: Plane, outward: np.ndarray, lamps: Lamps, levels: np.ndarray, ambient: np.ndarray
) -> np.ndarray:
    """(GRID, GRID, 3) what a white plane would read."""
    along = np.linspace(0.0, 1.0, GRID)
    u, v = (a.ravel() for a in np.meshgrid(along, along))
    places = plane.world(np.array(plane.corner_mm) + np.stack([u, v], 1) * plane.size_mm)
    normals = np.broadcast_to(outward, places.shape)
    return (white_reading(places, normals, lamps, levels) + ambient).reshape(GRID, GRID, 3)


def _middles(corners: np.ndarray) -> np.ndarray:
    """Values at pixels' middles from (h + 1, w + 1[, k]) values at their corners."""
    return (corners[:-1, :-1] + corners[:-1, 1:] + corners[1:, :-1] + corners[1:, 1:]) / 4


@numba.njit(cache=True, parallel=True)
def _draw(
    share: np.ndarray, picture: np.ndarray, finer: int, out: np.ndarray, cover: np.ndarray
) -> None:
    """Mean of a picture over pixels, and the share of them that it covers.

    Args:
        share: (h + 1, w + 1, 2) float64 places in the picture of the pixels' corners, 0..1 across
            and down; NaN where a ray misses its plane.
        picture: (rows, columns, 3) float32, looked up bilinearly.
        finer: subpixels along a side.
        out: (h, w, 3) float32, written: 0 beside the picture.
        cover: (h, w) float32, written.
    """
    height, width = cover.shape
    rows, columns = picture.shape[:2]
    for row in numba.prange(height):
        for column in range(width):
            inside = 0
            red, green, blue = 0.0, 0.0, 0.0
            for i in range(finer):
                y = (i + 0.5) / finer
                for j in range(finer):
                    x = (j + 0.5) / finer
                    w0, w1 = (1 - y) * (1 - x), (1 - y) * x
                    w2, w3 = y * (1 - x), y * x
                    u = w0 * share[row, column, 0] + w1 * share[row, column + 1, 0]
                    u += w2 * share[row + 1, column, 0] + w3 * share[row + 1, column + 1, 0]
                    v = w0 * share[row, column, 1] + w1 * share[row, column + 1, 1]
                    v += w2 * share[row + 1, column, 1] + w3 * share[row + 1, column + 1, 1]
                    # Written so that NaN is outside.
                    if not (u >= 0.0 and u <= 1.0 and v >= 0.0 and v <= 1.0):
                        continue
                    inside += 1
                    px = min(max(u * columns - 0.5, 0.0), columns - 1.0)
                    py = min(max(v * rows - 0.5, 0.0), rows - 1.0)
                    left, top = int(px), int(py)
                    right, low = min(left + 1, columns - 1), min(top + 1, rows - 1)
                    fx, fy = px - left, py - top
                    a, b = (1 - fy) * (1 - fx), (1 - fy) * fx
                    c, d = fy * (1 - fx), fy * fx
                    red += a * picture[top, left, 0] + b * picture[top, right, 0]
                    red += c * picture[low, left, 0] + d * picture[low, right, 0]
                    green += a * picture[top, left, 1] + b * picture[top, right, 1]
                    green += c * picture[low, left, 1] + d * picture[low, right, 1]
                    blue += a * picture[top, left, 2] + b * picture[top, right, 2]
                    blue += c * picture[low, left, 2] + d * picture[low, right, 2]
            count = finer * finer
            cover[row, column] = inside / count
            out[row, column, 0] = red / count
            out[row, column, 1] = green / count
            out[row, column, 2] = blue / count
