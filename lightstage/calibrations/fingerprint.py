"""Who took the shots, so that it shows when the stage is no longer the same."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lightstage.cameras.camera import Summary
from lightstage.leds.controller import Hello

SETTINGS = (
    "serial",
    "model",
    "firmware",
    "iso",
    "shutter",
    "aperture",
    "white_balance",
    "image_format",
    "focus",
)
"""Fields of a camera's Summary that are kept with calibration shots."""


def devices(summaries: Mapping[str, Summary], leds: Hello) -> dict[str, Any]:
    """What calibration.json keeps of the devices, JSON-ready.

    Args:
        summaries: by camera id.
        leds: the LED device.
    """
    return {
        "cameras": {
            camera_id: {name: getattr(summary, name) for name in SETTINGS}
            for camera_id, summary in summaries.items()
        },
        "leds": {"firmware": leds.firmware, "light_count": leds.light_count},
    }
