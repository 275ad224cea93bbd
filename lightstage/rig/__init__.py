"""The rig: lamps, cameras, and rig.json."""

from lightstage.rig.camera import Camera, look_at
from lightstage.rig.file import (
    default_rig,
    load_rig,
    rig_from_json,
    rig_sha256,
    rig_to_json,
    save_rig,
)
from lightstage.rig.stage import (
    MEASURED_WITH,
    UNCHECKED,
    UNMEASURED,
    Light,
    LightAddress,
    Rig,
)

__all__ = [
    "MEASURED_WITH",
    "UNCHECKED",
    "UNMEASURED",
    "Camera",
    "Light",
    "LightAddress",
    "Rig",
    "default_rig",
    "load_rig",
    "look_at",
    "rig_from_json",
    "rig_sha256",
    "rig_to_json",
    "save_rig",
]
