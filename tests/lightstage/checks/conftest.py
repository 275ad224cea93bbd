"""Small simulated people, photographed by three cameras; and one DNG."""

from __future__ import annotations

import dataclasses

import pytest

from benchmarks.check_faults import Stage, simulate
from lightstage.rig import Rig, default_rig

CAMERAS = ("cam0", "cam1", "cam4")


@pytest.fixture(scope="package")
def three_cameras() -> Rig:
    rig = default_rig().scaled(0.04)
    return dataclasses.replace(rig, cameras=tuple(c for c in rig.cameras if c.id in CAMERAS))


@pytest.fixture(scope="package")
def stages(three_cameras: Rig) -> dict[str, Stage]:
    """A light person driven evenly, and a very dark one who furrows the brow, lamps full on."""
    return {
        "light": simulate(0, three_cameras, sway=0.0, texture_rows=192),
        "dark": simulate(5, three_cameras, sway=0.0, extras=False, texture_rows=192),
    }


@pytest.fixture(scope="package")
def stage(stages: dict[str, Stage]) -> Stage:
    return stages["light"]
