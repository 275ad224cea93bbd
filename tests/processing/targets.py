"""A session of simulated calibration targets, small and made once a test run."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from lightstage.commands import quiet
from lightstage.rig import default_rig
from sim.camera.flaws import PRESETS
from sim.targets.photographs import TargetsConfig, write_targets

CONFIG = TargetsConfig(board_poses=0, mirror_places_mm=())


def make_targets(out: Path, flaws: str, scale: float = 0.12, cameras: int = 2) -> Path:
    """Chart toward each camera, grey ball, two flats, two darks; truth beside it."""
    rig = default_rig()
    rig = dataclasses.replace(rig, cameras=rig.cameras[:cameras]).scaled(scale)
    return write_targets(rig, out, CONFIG, PRESETS[flaws], 3, quiet)
