"""The smallest demo that does all of its steps: a trial of the installation.

Numba compiles each numeric kernel when it is first called, and keeps it beside its file. A trial
at the end of set-up compiles them, so that the demo, the tests and a lab's first session do not.
"""

from __future__ import annotations

import dataclasses

from demo.steps import DemoConfig
from lightstage.rig import Rig, default_rig

CAMERAS = ("cam0", "cam1", "cam2", "cam5", "cam6")


def tiny_config() -> DemoConfig:
    """All steps, as small as they work, on the rig of `tiny_rig`."""
    return DemoConfig(
        "parametric",
        tiny_rig=True,
        scale=1.0,
        atlas_rows=384,
        skin_rows=384,
        people=2,
        train_seconds=2,
        refine_seconds=3,
    )


def tiny_rig() -> Rig:
    """Five cameras of 240 x 360 pixels and every fourth of the default lights."""
    rig = default_rig().scaled(360 / 6016)
    cameras = tuple(camera for camera in rig.cameras if camera.id in CAMERAS)
    return dataclasses.replace(rig, lights=rig.lights[::4], cameras=cameras)
