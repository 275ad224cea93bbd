"""Lamps seen in a mirror ball: their highlights in a picture, and where they should be."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
from scipy.spatial import cKDTree

from lightstage.rig import Camera
from processing.calibration.ball import Picture, sphere_hits
from processing.vectors import unit

MIRROR_ROUNDS = 30


@dataclasses.dataclass(frozen=True)
class Highlights:
    """n highlights of one picture.

    Attributes:
        place_px: (n, 2) centroids; the top left pixel's centre is (0.5, 0.5).
        flux: (n, 3) light in each channel, summed over pixels; NaN where some of it clipped.
    """

    place_px: np.ndarray
    flux: np.ndarray


@dataclasses.dataclass(frozen=True)
class Reflected:
    """Rays after a mirror ball.

    Attributes:
        points_mm: (n, 3) where they met it.
        directions: (n, 3) unit, the way they leave.
        hit: (n,) bool.
    """

    points_mm: np.ndarray
    directions: np.ndarray
    hit: np.ndarray


def find_highlights(
    picture: Picture, reach_px: float, floor_share: float, noise_times: float
) -> Highlights:
    """Small bright blobs that stand apart from each other.

    Args:
        picture: of a mirror ball.
        reach_px: half the width of the window that holds a blob.
        floor_share: blobs are brighter than this share of the brightest one.
        noise_times: and than the noise times this.

    Returns:
        Highlights; of two nearer to each other than the window neither.
    """
    light = picture.rgb.mean(axis=2)
    clipped = (~picture.valid).astype(np.uint8)
    # What clipped is as bright as the brightest at least, or it is no number.
    light = np.where(np.isfinite(light), light, 0).astype(np.float32)
    smooth = cv2.GaussianBlur(light, (0, 0), max(0.6, reach_px / 5))
    background = float(np.median(light))
    noise = 1.4826 * float(np.median(np.abs(light - background)))
    floor = background + max(floor_share * float(smooth.max() - background), noise_times * noise)
    reach = max(1, round(reach_px))
    around = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    tops = (smooth > floor) & (smooth >= cv2.dilate(smooth, around))
    _, _, _, middles = cv2.connectedComponentsWithStats(tops.astype(np.uint8))
    places = middles[1:] + 0.5
    apart = _apart(places, 2.0 * reach)
    return _windows(picture.rgb, clipped, light, places[apart], reach)


def flux_at(picture: Picture, places_px: np.ndarray, reach_px: float) -> np.ndarray:
    """(n, 3) light of blobs at given places of another picture; NaN where it clipped."""
    clipped = (~picture.valid).astype(np.uint8)
    light = picture.rgb.mean(axis=2)
    return _windows(picture.rgb, clipped, light, places_px, max(1, round(reach_px)), True).flux


def _windows(
    rgb: np.ndarray,
    clipped: np.ndarray,
    light: np.ndarray,
    places: np.ndarray,
    reach: int,
    keep_all: bool = False,
) -> Highlights:
    """Centroid and light of the window around each place, less what its frame shows."""
    kept, flux = [], []
    nothing = np.full(3, np.nan)
    for x, y in places:
        top, left = int(y) - reach, int(x) - reach
        rows, columns = slice(top, top + 2 * reach + 1), slice(left, left + 2 * reach + 1)
        inside = top >= 1 and left >= 1 and rows.stop < len(light)
        if not (inside and columns.stop < light.shape[1]):
            if keep_all:
                kept.append((x, y))
                flux.append(nothing)
            continue
        frame = _frame(rgb, rows, columns)
        weight = np.maximum(light[rows, columns] - frame.mean(), 0)
        whole = weight.sum()
        if not (whole > 0 or keep_all):
            continue
        down, along = np.mgrid[rows, columns] + 0.5
        middle = (
            (x, y) if keep_all else ((along * weight).sum() / whole, (down * weight).sum() / whole)
        )
        kept.append(middle)
        dark = clipped[rows, columns].any()
        flux.append(nothing if dark else (rgb[rows, columns] - frame).sum(axis=(0, 1)))
    return Highlights(np.array(kept, float).reshape(-1, 2), np.array(flux).reshape(-1, 3))


def mirrored(
    centre_mm: np.ndarray, radius_mm: float, origins: np.ndarray, rays: np.ndarray
) -> Reflected:
    """Rays off a mirror ball.

    Args:
        centre_mm: (3,) or (n, 3).
        radius_mm: of the ball.
        origins: (3,) or (n, 3).
        rays: (n, 3) unit.
    """
    points, hit = sphere_hits(centre_mm, radius_mm, origins, rays)
    normals = (points - centre_mm) / radius_mm
    along = np.einsum("nk,nk->n", rays, normals)
    return Reflected(points, rays - 2 * along[:, None] * normals, hit)


def expected_px(
    camera: Camera, centre_mm: np.ndarray, radius_mm: float, lamps_mm: np.ndarray
) -> np.ndarray:
    """Where a camera sees lamps in a mirror ball: (m, 2) pixels, NaN where it does not.

    The ball's normal there halves the angle between the ways to camera and lamp. Taken from the
    ball's centre it is nearly that; taken again from the place found, it converges by the ratio of
    the ball's radius to the distances.
    """
    lamps = np.asarray(lamps_mm, float).reshape(-1, 3)
    points = np.broadcast_to(centre_mm, lamps.shape)
    normal = np.zeros_like(lamps)
    seen = np.ones(len(lamps), bool)
    for _ in range(MIRROR_ROUNDS):
        to_lamp, to_camera = unit(lamps - points), unit(camera.centre_mm - points)
        normal = unit(to_lamp + to_camera)
        seen = np.einsum("nk,nk->n", normal, to_camera) > 0
        points = centre_mm + radius_mm * normal
    pixels, _ = camera.project(points)
    inside = (pixels > 0) & (pixels < [camera.width_px, camera.height_px])
    pixels[~(seen & inside.all(axis=1))] = np.nan
    return pixels


def _apart(places: np.ndarray, distance: float) -> np.ndarray:
    """(n,) bool: places that have no other within a distance."""
    if len(places) < 2:
        return np.ones(len(places), bool)
    nearest = np.asarray(cKDTree(places).query(places, k=2)[0])[:, 1]
    return np.asarray(nearest > distance)


def _frame(rgb: np.ndarray, rows: slice, columns: slice) -> np.ndarray:
    """(3,) median of the pixels just around a window."""
    outer = rgb[rows.start - 1 : rows.stop + 1, columns.start - 1 : columns.stop + 1]
    border = np.concatenate([outer[0], outer[-1], outer[1:-1, 0], outer[1:-1, -1]])
    return np.asarray(np.median(border, axis=0))
