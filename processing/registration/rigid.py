"""Rigid and similarity alignment of corresponding points."""

from __future__ import annotations

import dataclasses

import numpy as np

from lightstage.counting import counted
from processing.errors import RegistrationError


@dataclasses.dataclass(frozen=True)
class Similarity:
    """``y = scale * rotation @ x + translation``; rigid when scale is 1."""

    rotation: np.ndarray
    """(3, 3), determinant +1."""
    translation: np.ndarray
    """(3,) mm."""
    scale: float = 1.0

    def apply(self, points: np.ndarray) -> np.ndarray:
        """Map (..., 3) points."""
        moved: np.ndarray = self.scale * points @ self.rotation.T + self.translation
        return moved

    def inverse(self) -> Similarity:
        """The way back."""
        back = self.rotation.T
        return Similarity(back, -back @ self.translation / self.scale, 1.0 / self.scale)

    def matrix(self) -> np.ndarray:
        """(3, 4) [scale * R | t]."""
        return np.concatenate([self.scale * self.rotation, self.translation[:, None]], axis=1)


def umeyama(
    source: np.ndarray,
    target: np.ndarray,
    weights: np.ndarray | None = None,
    *,
    scale: bool = False,
    reflect: bool = False,
) -> Similarity:
    """Least-squares alignment of point pairs [Umeyama1991].

    Args:
        source: (n, 3).
        target: (n, 3), where each source point should go.
        weights: (n,) non-negative; all equal by default.
        scale: solve for scale too.
        reflect: allow a mirror image (rotation with determinant -1), to find out whether data are
            mirrored.

    Returns:
        target_from_source.

    Raises:
        RegistrationError: fewer than three weighted pairs, not finite, or all on one line, where
            the rotation is not determined.
    """
    source, target = np.asarray(source, float), np.asarray(target, float)
    weight = np.ones(len(source)) if weights is None else np.asarray(weights, float)
    used = weight > 0
    if used.sum() < 3:
        raise _undetermined(counted(int(used.sum()), "pair"), "at least 3")
    source, target, weight = source[used], target[used], weight[used] / weight.sum()
    if not (np.isfinite(source).all() and np.isfinite(target).all()):
        raise _undetermined("NaN or infinity", "finite points")
    centre_s, centre_t = weight @ source, weight @ target
    ds, dt = source - centre_s, target - centre_t
    u, singular, vt = np.linalg.svd((weight[:, None] * dt).T @ ds)
    if singular[1] <= 1e-9 * max(singular[0], np.finfo(float).tiny):
        raise _undetermined("points on one line", "points that span at least a plane")
    sign = np.ones(3)
    if not reflect and np.linalg.det(u) * np.linalg.det(vt) < 0:
        sign[2] = -1
    rotation = (u * sign) @ vt
    factor = 1.0
    if scale:
        factor = float((singular * sign).sum() / (weight @ (ds**2).sum(axis=1)))
    return Similarity(rotation, centre_t - factor * rotation @ centre_s, factor)


def robust_umeyama(
    source: np.ndarray, target: np.ndarray, *, scale: bool = False, floor_mm: float = 2.0
) -> tuple[Similarity, np.ndarray]:
    """Alignment that single wrong pairs do not move: Tukey's biweight from a random-free start.

    Args:
        source: (n, 3).
        target: (n, 3).
        scale: solve for scale too.
        floor_mm: residuals below are never taken for outliers' (times 4.7 is the cut).

    Returns:
        target_from_source and (n,) residuals in mm under it.
    """
    found = umeyama(source, target, scale=scale)
    residual = np.linalg.norm(found.apply(source) - target, axis=1)
    for step in range(30):
        # The first steps use L1 weights, which no start can trap; then the redescending ones.
        if step < 15:
            weight = 1.0 / np.maximum(residual, 0.1 * floor_mm)
        else:
            cut = 4.685 * max(1.4826 * float(np.median(residual)), floor_mm)
            weight = np.clip(1 - (residual / cut) ** 2, 0, None) ** 2
        if (weight > 0).sum() < 4:
            break
        found = umeyama(source, target, weight, scale=scale)
        residual = np.linalg.norm(found.apply(source) - target, axis=1)
    return found, residual


def _undetermined(found: str, expected: str) -> RegistrationError:
    return RegistrationError("rigid alignment", found=found, expected=expected)
