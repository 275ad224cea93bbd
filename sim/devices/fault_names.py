"""The names of the faults that simulated devices can have, and the fields of each."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Literal

LEDS = "leds"
"""The LED device's name in a story; cameras go by the rig's names."""

OF_ICL = ("hang-up", "other-id")
"""Faults that ICL's server alone can have."""

Device = Literal["leds", "camera"]
Counted = Literal["packet", "open", "shot"]


@dataclasses.dataclass(frozen=True)
class FaultName:
    """What one name of the language means.

    Attributes:
        device: who can have it.
        counted: what its `at` counts, from 1: packets that reach the LED device, openings of its
            port or of a camera, or a camera's shots.
        lasts: whether it continues after `at`, or happens there only.
        effect: what happens.
        fields: its other parameters, with defaults.
    """

    device: Device
    counted: Counted
    lasts: bool
    effect: str
    fields: Mapping[str, Any] = dataclasses.field(default_factory=dict)


def _line(effect: str, **fields: Any) -> FaultName:
    return FaultName("leds", "packet", False, effect, {"way": "request", **fields})


def _lamps(effect: str) -> FaultName:
    return FaultName("leds", "packet", True, effect, {"lights": (0,)})


def _camera(
    effect: str, lasts: bool = False, counted: Counted = "shot", **fields: Any
) -> FaultName:
    return FaultName("camera", counted, lasts, effect, fields)


NAMES: dict[str, FaultName] = {
    # The LED device's line: `way` is "request" (toward the device) or "answer".
    "drop": _line("the packet never arrives"),
    "corrupt": _line("bits of the packet are flipped", bits=1),
    "delay": _line("the line stops before the packet, and all later ones wait", seconds=0.1),
    "duplicate": _line("the packet arrives twice"),
    "reorder": _line("the packet arrives after the next one"),
    # The LED device itself.
    "die": FaultName(
        "leds", "packet", False, "silent, with unchanged lights, until its port is opened again"
    ),
    "reset": FaultName(
        "leds",
        "packet",
        False,
        "restarts: dark, another boot id; packets that come while it starts are lost",
        {"seconds": 0.05},
    ),
    "reset-on-open": FaultName(
        "leds",
        "open",
        True,
        "restarts whenever its port is opened",
        {"seconds": 0.05},
    ),
    "wrong-acknowledgement": FaultName(
        "leds", "packet", False, "acknowledges levels that were not sent"
    ),
    "hang-up": FaultName(
        "leds",
        "packet",
        False,
        "the connection ends before the packet is read; the lights stay as they are",
    ),
    "other-id": FaultName(
        "leds", "packet", False, "the answer is that of a request that nobody sent"
    ),
    "stuck-on": _lamps("these lights stay fully on; the device reports it"),
    "stuck-on-hidden": _lamps(
        "these lights stay fully on; the device reports the levels that it was sent"
    ),
    "dead-light": _lamps("these lights stay dark; the device reports it"),
    "dead-light-hidden": _lamps(
        "these lights stay dark; the device reports the levels that it was sent"
    ),
    "swapped-bank": FaultName(
        "leds", "packet", True, "the two polarisation banks are plugged in the other way round"
    ),
    # Cameras.
    "fail": _camera("no photograph is taken; the next shot works"),
    "hang": _camera("the camera never answers, at the trigger or the download", during="trigger"),
    "busy": _camera("the camera is busy for a time before it triggers (-110)", seconds=0.3),
    "claimed": _camera(
        "another program has the camera for a time (-53)", counted="open", seconds=0.5
    ),
    "io": _camera(
        "the connection is lost (-7) after the exposure, or at the first download",
        during="trigger",
    ),
    "port-changes": _camera("unplugged, and plugged in again at another port"),
    "fill-up": _camera("the card is full", lasts=True),
    "disconnect": _camera("unplugged, back after a time", seconds=1.0),
    "battery-empty": _camera("switches itself off, for good"),
    "stale": _camera("the photograph of the shot before is delivered again"),
    "truncated": _camera("the file's first download gives only a part of it", share=0.5),
    "wrong-iso": _camera("the ISO setting drifts, and stays so", value="400"),
    "owner-set": _camera("somebody's name is in the owner field, and stays so", value="A. Person"),
    "drift": _camera("another setting drifts, and stays so", setting="white_balance", value="Auto"),
    "slow": _camera("the photograph comes late", seconds=0.3),
    "late-file": _camera("no photograph comes; it comes with the next shot's, before it"),
    "other-order": _camera(
        "events come in another order: done before the file, of a pair the JPEG first"
    ),
    "duplicate-serial": _camera("reports another camera's serial number", lasts=True, value="0000"),
    "event-storm": _camera("many meaningless events come before the photograph", count=200),
}


def _is_number(value: Any, low: float, high: float) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and low <= value <= high


def _is_count(value: Any, low: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= low


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and bool(value)


def _is_lights(value: Any) -> bool:
    return isinstance(value, (list, tuple)) and bool(value) and all(_is_count(v, 0) for v in value)


FIELDS = {
    "at": ("a whole number from 1", lambda value: _is_count(value, 1)),
    "until": ("a whole number from 1, at least `at`", lambda value: _is_count(value, 1)),
    "probability": ("a number over 0, up to 1", lambda value: _is_number(value, 1e-12, 1.0)),
    "camera": ("a camera's name", _is_text),
    "way": ('"request" or "answer"', lambda value: value in ("request", "answer")),
    "during": ('"trigger" or "download"', lambda value: value in ("trigger", "download")),
    "bits": ("a whole number from 1", lambda value: _is_count(value, 1)),
    "seconds": ("seconds from 0 to 3600", lambda value: _is_number(value, 0.0, 3600.0)),
    "lights": ("a list of places in the rig's order, from 0", _is_lights),
    "share": ("a share of the file, 0 to 1", lambda value: _is_number(value, 0.0, 1.0)),
    "value": ("a text", _is_text),
    "setting": ("a camera setting's name", _is_text),
    "count": ("a whole number from 1", lambda value: _is_count(value, 1)),
}
"""What each field may hold: in words, and as a test."""
