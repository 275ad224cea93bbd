"""What a lens does to the picture: diffraction, blur, defocus by depth, vignetting, distortion."""

from __future__ import annotations

import dataclasses
import functools
import hashlib

import cv2
import numpy as np
from scipy.special import erf

from lightstage.rig import Camera, Rig
from sim.camera.flaws import LensConfig

WAVELENGTH_UM = (0.61, 0.54, 0.46)
"""Wavelengths of red, green and blue light, for diffraction."""
AIRY_SIGMA = 0.42
"""The Gaussian nearest to the Airy disc has this many wavelengths times f-number as sigma."""
UNSEEN_PX = 0.05
"""A Gaussian narrower than this leaves a picture as it is to one part in 10,000."""
RADII_PX = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0)
"""Discs between which defocus is interpolated."""


def own_rng(seed: int, camera_id: str, what: bytes) -> np.random.Generator:
    """Random numbers of one camera for one purpose."""
    digest = hashlib.sha256(camera_id.encode() + b"\0" + what).digest()
    return np.random.default_rng([seed, *np.frombuffer(digest, "<u4").tolist()])


@dataclasses.dataclass(frozen=True)
class Lens:
    """One camera's lens.

    Attributes:
        camera: behind it.
        config: of its kind.
        corner_loss: share of light lost in this lens's corners.
        focus_mm: distance of the plane of focus along the axis.
    """

    camera: Camera
    config: LensConfig
    corner_loss: float
    focus_mm: float

    @property
    def pitch_mm(self) -> float:
        """Size of a pixel."""
        return self.config.sensor_long_mm / max(self.camera.width_px, self.camera.height_px)

    @property
    def focal_mm(self) -> float:
        """Focal length."""
        return self.camera.fx_px * self.pitch_mm

    @property
    def sigma_px(self) -> np.ndarray:
        """(3,) standard deviation of the blur in focus, r g b."""
        airy = np.array(WAVELENGTH_UM) * AIRY_SIGMA * self.config.f_number
        spread_um = np.hypot(self.config.blur_um, airy if self.config.diffraction else 0.0)
        return np.broadcast_to(spread_um / (1000 * self.pitch_mm), 3)

    @functools.cached_property
    def shading(self) -> np.ndarray:
        """(h, w) float32 share of light that arrives, 1 on the axis."""
        camera = self.camera
        x = np.arange(camera.width_px) + 0.5 - camera.cx_px
        y = (np.arange(camera.height_px) + 0.5 - camera.cy_px)[:, None]
        corner2 = (camera.width_px**2 + camera.height_px**2) / 4
        r2 = (x * x + y * y) / corner2
        share = 1.0 - self.corner_loss * (0.7 * r2 + 0.3 * r2 * r2)
        if self.config.cosine_fourth:
            share = share / (1.0 + (x / camera.fx_px) ** 2 + (y / camera.fy_px) ** 2) ** 2
        return np.maximum(share, 0.0).astype(np.float32)

    def circle_px(self, depth_mm: np.ndarray) -> np.ndarray:
        """Radius of the circle of confusion [Potmesil1981] at (...) depths along the axis, px.

        Depths that are not positive (nothing there) are taken to be in focus.
        """
        depth = np.asarray(depth_mm, float)
        there = depth > 0
        magnification = self.focal_mm / (self.focus_mm - self.focal_mm)
        aperture_mm = self.focal_mm / self.config.f_number
        apart = np.abs(depth - self.focus_mm)
        share = np.divide(apart, depth, out=np.zeros_like(depth), where=there)
        return 0.5 * aperture_mm * magnification * share / self.pitch_mm

    def form(self, light: np.ndarray, depth_mm: np.ndarray | None = None) -> np.ndarray:
        """The picture on the sensor.

        Args:
            light: (h, w, 3) float32 what an ideal lens would show.
            depth_mm: (h, w) along the axis, not positive where nothing is; None: all in focus.

        Returns:
            (h, w, 3) float32.
        """
        out = np.asarray(light, np.float32)
        if self.config.depth_of_field and depth_mm is not None:
            out = defocus(out, self.circle_px(depth_mm))
        sigma = self.sigma_px
        if sigma.max() > UNSEEN_PX:
            out = np.stack([_gaussian(out[..., c], float(sigma[c])) for c in range(3)], axis=-1)
        if self.corner_loss or self.config.cosine_fourth:
            out = out * self.shading[..., None]
        return out


def make_lens(camera: Camera, config: LensConfig, seed: int) -> Lens:
    """One camera's lens: what differs from camera to camera is drawn from the seed."""
    rng = own_rng(seed, camera.id, b"lens")
    loss = config.vignetting + config.vignetting_spread * rng.standard_normal()
    error_mm = config.focus_error_mm * rng.standard_normal()
    axis_mm = float(camera.cam_from_world[2, 3])  # the origin's depth
    focus_mm = axis_mm - config.focus_before_origin_mm + error_mm
    lens = Lens(camera, config, float(np.clip(loss, 0.0, 0.95)), focus_mm)
    # Nothing nearer than two focal lengths is brought into focus by such a lens.
    return dataclasses.replace(lens, focus_mm=max(focus_mm, 2.0 * lens.focal_mm))


def distorted(rig: Rig, config: LensConfig) -> Rig:
    """The rig with the lenses' distortion added to what its cameras have."""
    if config.distortion_k1 == 0:
        return rig
    cameras = tuple(
        dataclasses.replace(camera, dist=(camera.dist[0] + config.distortion_k1, *camera.dist[1:]))
        for camera in rig.cameras
    )
    return dataclasses.replace(rig, cameras=cameras)


def defocus(light: np.ndarray, radius_px: np.ndarray) -> np.ndarray:
    """Spread each pixel's light over its own disc; none is lost but over the picture's edge.

    Args:
        light: (h, w, 3) float32.
        radius_px: (h, w) of the discs; interpolated between `RADII_PX`, at most the last of them.

    Returns:
        (h, w, 3) float32.
    """
    radii = np.array(RADII_PX)
    place = np.interp(radius_px, radii, np.arange(len(radii)))
    out = np.zeros_like(light)
    for index in range(int(np.floor(place.min())), int(np.ceil(place.max())) + 1):
        share = np.maximum(1.0 - np.abs(place - index), 0.0).astype(np.float32)
        rows, columns = np.flatnonzero(share.any(axis=1)), np.flatnonzero(share.any(axis=0))
        if not len(rows):
            continue
        reach = int(np.ceil(radii[index])) + 1
        part = (
            slice(max(rows[0] - reach, 0), rows[-1] + reach + 1),
            slice(max(columns[0] - reach, 0), columns[-1] + reach + 1),
        )
        layer = light[part] * share[part][..., None]
        if index > 0:
            # What is beyond the edge is like what is at it: a flat field stays flat.
            layer = cv2.filter2D(layer, -1, _disc(float(radii[index])), borderType=EDGE)
        out[part] += layer
    return out


EDGE = cv2.BORDER_REPLICATE


@functools.cache
def _disc(radius_px: float, finer: int = 9) -> np.ndarray:
    """A disc's share of each pixel, float32, sum 1."""
    reach = int(np.ceil(radius_px + 0.5))
    fine = (np.arange((2 * reach + 1) * finer) + 0.5) / finer - reach - 0.5
    inside = (fine[:, None] ** 2 + fine**2 <= radius_px**2).astype(float)
    kernel = inside.reshape(2 * reach + 1, finer, 2 * reach + 1, finer).sum(axis=(1, 3))
    return (kernel / kernel.sum()).astype(np.float32)


def _gaussian(plane: np.ndarray, sigma_px: float) -> np.ndarray:
    """A Gaussian blur whose kernel is integrated over pixels, right for narrow ones too."""
    reach = int(np.ceil(4 * sigma_px)) + 1
    edges = np.arange(-reach, reach + 2) - 0.5
    kernel = np.diff(erf(edges / (np.sqrt(2) * sigma_px)))
    kernel /= kernel.sum()
    return cv2.sepFilter2D(np.ascontiguousarray(plane), -1, kernel, kernel, borderType=EDGE)
