"""What a texture over its own light shows of the surface's small tilts.

A surface that is tilted by t (its normal's components along the texture's columns and rows) gets
E + dE . t in place of the light E of the shape: a texture's grey detail, divided by the slope
dE / E, is a tilt. Skin's own marks have a colour, melanin's or blood's; shading has that of the
light. The slope, the detail and the light's level are what a network is given.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from learning.whole.detail import blurred
from learning.whole.unlit import DARK_LIGHT

CHANNELS = 9
"""Detail's logarithm 3, slope 2, the tilt that would explain the detail 2, the light's level 1,
known or not 1."""
WIDEST = 1 / 96
"""Standard deviation of the blur that leaves what is wider than detail, as a share of the rows."""
MOST_DETAIL = 1.0
"""Logarithm at which detail is cut: hairs and errors of edges."""
MOST_SLOPE = 3.0
"""At grazing light the slope grows without bounds."""
STEADY_SLOPE = 0.3
"""Below it a tilt cannot be separated from noise."""
MOST_TILT = 0.9
"""Sine of the largest tilt."""
NEAREST_MM = 1.0
"""Least distance of a lamp to the surface."""


@dataclasses.dataclass(frozen=True)
class Frame:
    """Unit directions at each texel, in any axes.

    Attributes:
        normal: (rows, columns, 3) of the shape; 0 where no surface is.
        across: the same, along the texture's columns, perpendicular to the normal.
        up: the same, perpendicular to both.
    """

    normal: np.ndarray
    across: np.ndarray
    up: np.ndarray

    def tilted(self, tilt: np.ndarray) -> np.ndarray:
        """(rows, columns, 3) unit normals of (rows, columns, 2) tilts: sines along the frame."""
        length = np.linalg.norm(tilt, axis=2, keepdims=True)
        tilt = tilt * np.minimum(1, MOST_TILT / np.maximum(length, 1e-12))
        along = np.sqrt(1 - np.square(tilt).sum(axis=2, keepdims=True))
        found: np.ndarray = (
            along * self.normal + tilt[..., :1] * self.across + tilt[..., 1:] * self.up
        )
        return found

    def tilt_of(self, normal: np.ndarray) -> np.ndarray:
        """(rows, columns, 2) float32 tilts of (rows, columns, 3) unit normals; 0 behind."""
        front = (normal * self.normal).sum(axis=2, keepdims=True) > 0
        parts = [(normal * axis).sum(axis=2) for axis in (self.across, self.up)]
        found: np.ndarray = (np.stack(parts, axis=2) * front).astype(np.float32)
        return found


def frame_of(normal: np.ndarray, position_mm: np.ndarray, covered: np.ndarray) -> Frame:
    """The directions at each texel of a surface.

    Args:
        normal: (rows, columns, 3) unit, of the shape.
        position_mm: (rows, columns, 3).
        covered: (rows, columns) bool.

    Returns:
        Finite everywhere. Where neighbours do not show the texture's direction, `across` is any
        direction in the surface.
    """
    step = np.zeros_like(position_mm, dtype=np.float32)
    both = covered[:, 1:] & covered[:, :-1]
    difference = np.where(both[..., None], np.diff(position_mm, axis=1), 0).astype(np.float32)
    length = np.linalg.norm(difference, axis=2)
    # Across a seam of the layout neighbours are far from each other.
    seam = length > 10 * (np.median(length[both]) if both.any() else 0.0)
    difference[seam] = 0
    step[:, 1:] += difference
    step[:, :-1] += difference
    across = _perpendicular(step, normal)
    lost = np.linalg.norm(across, axis=2) < 0.5
    if lost.any():
        axis = np.eye(3, dtype=np.float32)[np.abs(normal[lost]).argmin(axis=1)]
        across[lost] = _perpendicular(axis, normal[lost])
    across *= covered[..., None]
    return Frame(normal, across, np.cross(normal, across))


def _perpendicular(vectors: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Unit parts of (..., 3) vectors perpendicular to normals; 0 where there is none."""
    beside = vectors - (vectors * normal).sum(axis=-1, keepdims=True) * normal
    length = np.linalg.norm(beside, axis=-1, keepdims=True)
    found: np.ndarray = np.divide(beside, length, out=np.zeros_like(beside), where=length > 1e-9)
    return found


def slope_of(
    frame: Frame,
    position_mm: np.ndarray,
    lamps_mm: np.ndarray,
    strength: np.ndarray,
    seen: np.ndarray,
    level: np.ndarray,
) -> np.ndarray:
    """How light changes with a small tilt, of its own strength.

    Args:
        frame: of the texels, in the lamps' axes.
        position_mm: (rows, columns, 3).
        lamps_mm: (L, 3).
        strength: (L,), what a white diffuser at the origin reads of each lamp.
        seen: (L, rows, columns), the share of each lamp that a texel sees.
        level: (rows, columns), irradiance of all light.

    Returns:
        (rows, columns, 2) float32, at most `MOST_SLOPE` long.
    """
    slope = np.zeros((*level.shape, 2), np.float32)
    for lamp, power, share in zip(lamps_mm.astype(np.float32), strength, seen, strict=True):
        toward = lamp - position_mm
        distance = np.maximum(np.linalg.norm(toward, axis=2), NEAREST_MM)
        facing = (toward * frame.normal).sum(axis=2) > 0
        # Strength is that at the origin, and falls off with the square of the distance from there.
        weight = power * share * facing * (lamp @ lamp) / distance**3
        slope[..., 0] += weight * (toward * frame.across).sum(axis=2)
        slope[..., 1] += weight * (toward * frame.up).sum(axis=2)
    slope /= np.maximum(level, DARK_LIGHT)[..., None]
    length = np.linalg.norm(slope, axis=2, keepdims=True)
    found: np.ndarray = slope * np.minimum(1, MOST_SLOPE / np.maximum(length, 1e-12))
    return found


def detail_of(logarithm: np.ndarray, known: np.ndarray) -> np.ndarray:
    """What is finer than `WIDEST`: (rows, columns, 3) float32, 0 where it is not known.

    Args:
        logarithm: (rows, columns, 3) of an albedo, natural.
        known: (rows, columns) bool.
    """
    weight = known.astype(np.float32)[..., None]
    sigma = WIDEST * len(known)
    there = np.where(known[..., None], logarithm, 0).astype(np.float32)
    around = blurred(there, sigma) / np.maximum(blurred(weight, sigma), 1e-3)
    found: np.ndarray = np.clip((there - around) * weight, -MOST_DETAIL, MOST_DETAIL)
    return found


def evidence(
    detail: np.ndarray, slope: np.ndarray, level: np.ndarray, known: np.ndarray
) -> np.ndarray:
    """A network's input.

    Args:
        detail: (rows, columns, 3), see `detail_of`.
        slope: (rows, columns, 2), see `slope_of`.
        level: (rows, columns), irradiance of all light.
        known: (rows, columns) bool.

    Returns:
        (rows, columns, `CHANNELS`) float32, 0 where it is not known.
    """
    grey = detail.mean(axis=2, keepdims=True)
    steady = np.square(slope).sum(axis=2, keepdims=True) + STEADY_SLOPE**2
    typical = float(np.median(level[known])) if known.any() else 1.0
    brightness = np.log(np.maximum(level, DARK_LIGHT) / max(typical, DARK_LIGHT))[..., None]
    parts = [detail, slope, grey * slope / steady, brightness, np.ones_like(grey)]
    return (np.concatenate(parts, axis=2) * known[..., None]).astype(np.float32)
