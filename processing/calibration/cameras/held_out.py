"""What boards leave to chance: cameras adjusted without a quarter of them, four times over."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from processing.calibration.cameras.boards import Sight
from processing.calibration.cameras.fit import Adjusted, adjust
from processing.calibration.cameras.world import four, onto

PARTS = 4
"""Boards are left out in so many turns, each once."""


@dataclasses.dataclass(frozen=True)
class HeldOut:
    """Results of adjustments without some of the boards; cameras that saw too few are absent.

    Attributes:
        off_px: camera to (n,) distances of corners on boards that it was not adjusted to.
        sigma_mm: camera to the standard deviation of its place.
    """

    off_px: dict[str, np.ndarray]
    sigma_mm: dict[str, float]


def held_out(
    sights: Sequence[Sight],
    corners_mm: np.ndarray,
    found: Adjusted,
    min_sights: int,
    model: str,
    scale_px: float,
) -> HeldOut:
    """Leave out each quarter of the boards in turn, and predict their places from the rest.

    The spread of the cameras' places is what chance leaves of them: the jackknife's
    standard deviation [Efron1981].

    Args:
        sights: that `found` was adjusted to.
        corners_mm: (m, 3) of the board.
        found: with all boards.
        min_sights: boards that a camera must have seen of those that are left.
        model, scale_px: as in `adjust`.
    """
    shots = sorted({s.shot for s in sights})
    off: dict[str, list[np.ndarray]] = {}
    places: dict[str, list[np.ndarray]] = {}
    for part in range(min(PARTS, len(shots))):
        out = set(shots[part::PARTS])
        left = enough([s for s in sights if s.shot not in out], min_sights)
        kept = {s.camera for s in left}
        if not kept:
            continue
        cameras = {name: found.cameras[name] for name in kept}
        fitted = adjust(left, corners_mm, cameras, found.boards, model=model, scale_px=scale_px)
        same = onto(fitted.cameras, cameras)
        for name, camera in fitted.cameras.items():
            pose = four(camera.cam_from_world) @ same
            places.setdefault(name, []).append(-pose[:3, :3].T @ pose[:3, 3])
        tested = [s for s in sights if s.shot in out and s.camera in kept]
        if not tested:
            continue
        shown = adjust(
            tested,
            corners_mm,
            fitted.cameras,
            found.boards,
            model=model,
            lenses=False,
            poses=False,
            scale_px=scale_px,
        )
        for sight, miss in zip(tested, shown.residual_px, strict=True):
            off.setdefault(sight.camera, []).append(miss)
    sigma = {
        name: round(float(np.sqrt((PARTS - 1) * np.var(every, axis=0).sum())), 4)
        for name, every in places.items()
        if len(every) == PARTS
    }
    return HeldOut({name: np.concatenate(parts) for name, parts in off.items()}, sigma)


def enough(sights: Sequence[Sight], least: int) -> list[Sight]:
    """Sights of cameras that have enough of them."""
    counts = {s.camera: 0 for s in sights}
    for sight in sights:
        counts[sight.camera] += 1
    return [s for s in sights if counts[s.camera] >= least]
