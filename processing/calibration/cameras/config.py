"""Settings of `calibrate-cameras`."""

from __future__ import annotations

import dataclasses

from lightstage.formats.board import BoardConfig


@dataclasses.dataclass(frozen=True)
class CamerasConfig:
    """How cameras are measured.

    Attributes:
        model: of the lenses, COLMAP's name: SIMPLE_RADIAL (one focal length and k1; enough for long
            lenses, whose principal point other terms blur), RADIAL (and k2), OPENCV (two focal
            lengths, k1, k2, p1, p2).
        max_residual_px: a camera whose corners are off by more (median) is refused, and so is one
            of whose boards more than a quarter are (median each): others may hide that it moved.
        outlier_px: corners farther off than this after a first adjustment are left out.
        min_sights: boards that a camera must have seen.
        moved_mm: a camera found farther than this from where rig.json has it is warned of.
        turned_deg: likewise for a camera's direction.
        unsure_mm: a camera whose place the boards leave less certain than this (standard deviation)
            is warned of.
        allow: ids of cameras that are kept whatever their residual.
    """

    model: str = "SIMPLE_RADIAL"
    max_residual_px: float = 0.5
    outlier_px: float = 2.0
    min_sights: int = 3
    moved_mm: float = 20.0
    turned_deg: float = 3.0
    unsure_mm: float = 0.2
    allow: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class CamerasFile:
    """Settings of `calibrate-cameras`; a table of its TOML file each."""

    board: BoardConfig = dataclasses.field(default_factory=BoardConfig)
    cameras: CamerasConfig = dataclasses.field(default_factory=CamerasConfig)
