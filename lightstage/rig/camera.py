"""One camera: lens and pose, projection and rays.

World: right-handed, mm, origin at the sphere's centre, +y up, +z toward the frontal camera.
Cameras: OpenCV axes (x right, y down, z forward); the top-left pixel's centre is (0.5, 0.5).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np


@dataclasses.dataclass(frozen=True)
class Camera:
    """One camera: intrinsics in pixels, distortion k1 k2 p1 p2 k3 (OpenCV), pose in mm."""

    id: str
    serial: str
    model: str
    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    dist: tuple[float, float, float, float, float]
    cam_from_world: np.ndarray
    """(3, 4) float64, [R | t]."""
    more: Mapping[str, Any] = dataclasses.field(default_factory=dict, compare=False)
    """Fields that others added in rig.json; they are kept."""

    @property
    def centre_mm(self) -> np.ndarray:
        """(3,) the camera's centre in the world."""
        rotation, translation = self.cam_from_world[:, :3], self.cam_from_world[:, 3]
        return -rotation.T @ translation

    @property
    def matrix(self) -> np.ndarray:
        """(3, 3) pinhole matrix for pixel centres at half-integers (top-left is (0.5, 0.5))."""
        return np.array(
            [[self.fx_px, 0, self.cx_px], [0, self.fy_px, self.cy_px], [0, 0, 1]], float
        )

    @property
    def opencv_matrix(self) -> np.ndarray:
        """(3, 3) the same where OpenCV is called: its top-left pixel's centre is (0, 0)."""
        shifted = self.matrix
        shifted[:2, 2] -= 0.5
        return shifted

    def project(self, points_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Project world points.

        Args:
            points_mm: (n, 3).

        Returns:
            (n, 2) pixels, NaN behind the camera, and (n,) depth in mm along the optical axis.
        """
        points = np.asarray(points_mm, float).reshape(-1, 3)
        local = points @ self.cam_from_world[:, :3].T + self.cam_from_world[:, 3]
        depth = local[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            x, y = local[:, 0] / depth, local[:, 1] / depth
        k1, k2, p1, p2, k3 = self.dist
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        pixels = np.stack([self.fx_px * u + self.cx_px, self.fy_px * v + self.cy_px], axis=1)
        pixels[~(depth > 0)] = np.nan
        return pixels, depth

    def pixel_rays(self) -> tuple[np.ndarray, np.ndarray]:
        """Rays through all pixel centres.

        Returns:
            (3,) origin in mm and (h, w, 3) unit directions in the world, float64.
        """
        columns = np.arange(self.width_px) + 0.5
        rows = np.arange(self.height_px) + 0.5
        return self.centre_mm, self.rays_through(*np.meshgrid(columns, rows))

    def rays_through(self, x_px: np.ndarray, y_px: np.ndarray, rounds: int = 8) -> np.ndarray:
        """(.., 3) unit directions in the world through places (..) of the picture, float64.

        A pixel's centre is half a pixel from its corner; the distortion is undone by so many
        rounds of fixed-point iteration.
        """
        u, v = (x_px - self.cx_px) / self.fx_px, (y_px - self.cy_px) / self.fy_px
        x, y = u.copy(), v.copy()
        k1, k2, p1, p2, k3 = self.dist
        for _ in range(rounds if any(self.dist) else 0):
            r2 = x * x + y * y
            radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
            dx = 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
            dy = p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
            x, y = (u - dx) / radial, (v - dy) / radial
        local = np.stack([x, y, np.ones_like(x)], axis=-1)
        local /= np.sqrt(x * x + y * y + 1)[..., None]
        return np.asarray(local @ self.cam_from_world[:, :3])

    def scaled(self, factor: float) -> Camera:
        """The same camera with `factor` times as many pixels a side (rounded to even numbers)."""
        width = max(2, 2 * round(self.width_px * factor / 2))
        height = max(2, 2 * round(self.height_px * factor / 2))
        sx, sy = width / self.width_px, height / self.height_px
        return dataclasses.replace(
            self,
            width_px=width,
            height_px=height,
            fx_px=self.fx_px * sx,
            fy_px=self.fy_px * sy,
            cx_px=self.cx_px * sx,
            cy_px=self.cy_px * sy,
        )


def look_at(position_mm: np.ndarray, target_mm: np.ndarray) -> np.ndarray:
    """cam_from_world (3, 4) of a camera at a position and aimed at a target, +y upward."""
    position = np.asarray(position_mm, float)
    forward = np.asarray(target_mm, float) - position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return np.concatenate([rotation, (-rotation @ position)[:, None]], axis=1)
