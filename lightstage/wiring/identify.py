"""Lights one lamp after the other while an operator reports what is seen."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from lightstage.errors import LightstageError
from lightstage.interrupts import raise_once
from lightstage.leds.controller import LightLostError
from lightstage.leds.opening import open_wired_leds, require_channels
from lightstage.rig import Rig
from lightstage.safety import SafeLights, SafetyConfig
from lightstage.wiring.walk import HELP, Walk


def identify(
    rig: Rig,
    leds: str,
    ask: Callable[[str], str],
    show: Callable[[str], None],
    save: Callable[[Rig], None],
    safety: SafetyConfig,
    level: float,
    channels: int | None = None,
) -> Rig:
    """Light one lamp at a time until the operator ends it; dark on every way out.

    Args:
        rig: its lamps, with the addresses to be checked.
        leds: the LED device's URL, or one of each controller (`open_rig_leds`).
        ask: prints a question and returns the operator's line; EOFError where nobody is there
            any more.
        show: prints a line.
        save: keeps the rig; called after each correction.
        safety: limits of light.
        level: in 0..1, of the lamp that shines.
        channels: of a device that does not report how many it has; as many as the rig needs.

    Returns:
        The rig with its addresses as corrected.

    Raises:
        RigError: other controllers than `leds` names.
        DeviceError: nobody there, fewer channels than the rig needs.
    """
    raise_once()
    with open_wired_leds(leds, rig, channels or 0) as wired:
        walk = Walk(rig, wired.counts)
        require_channels(wired, rig, leds)
        if not wired.acknowledged:
            show("This LED device does not answer: what it lights is what was sent.")
        with SafeLights(wired, safety, rig) as lights:
            lights.dark()
            while not walk.over:
                if walk.lit:
                    _light(lights, level * np.eye(len(rig.lights))[walk.at])
                    show(walk.state())
                _step(walk, ask, show)
                if walk.rig is not rig:
                    save(walk.rig)
                    wired.rewire(walk.rig.addresses)
                    rig = walk.rig
                _show_loss(lights, show)
                if not walk.lit:
                    lights.dark()
    return rig


def _step(walk: Walk, ask: Callable[[str], str], show: Callable[[str], None]) -> None:
    try:
        line = ask(HELP)
    except EOFError:
        walk.over = True
        return
    answer = walk.hear(line)
    if answer:
        show(answer)


def _light(lights: SafeLights, levels: np.ndarray) -> None:
    """Light, once more where the device had lost what was lit (a reset, a cable)."""
    try:
        lights.light(levels)
    except LightLostError:
        lights.recover()
        lights.light(levels)


def _show_loss(lights: SafeLights, show: Callable[[str], None]) -> None:
    """Report where the lamp failed while somebody looked for it."""
    try:
        lights.confirm()
    except LightstageError as error:
        show(f"The light was lost: {error}")
