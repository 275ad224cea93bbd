"""Which emitters of ICL's stage a channel of a rig's addresses is [Lsserver2026]."""

from __future__ import annotations

import numpy as np

from lightstage.counting import counted
from lightstage.errors import ConfigError
from lightstage.leds.address import IclOptions
from lightstage.leds.lsserver import EMITTERS

UPRIGHT_RGB = (0, 2, 4, 6, 7, 9, 11, 13)
"""Lights of an even arc whose rgb emitters have an upright polariser and whose white ones a lying
one; on an odd arc, and for the other lights, it is the other way round."""
RGB, WHITE = slice(0, 3), slice(3, 6)


class IclLights:
    """From levels of channels to values of a stage's emitters.

    A place is arc * (lights of an arc) + light. A channel is, by `options.lights`:

    - ``white``, ``rgb``, ``both``: the emitters of these groups in the place of that number;
    - ``polarised``: a place's emitters behind the upright polariser, or, as many channels as there
      are places further on, those behind the lying one;
    - ``emitters``: 6 * place + one of red, green, blue, warm, neutral, cool.

    Args:
        grid: arcs, and lights of each.
        count: channels, from the first on.
        options: which emitters, and their colours at full level.

    Raises:
        ConfigError: more channels than the stage has.
    """

    def __init__(self, grid: tuple[int, int], count: int, options: IclOptions) -> None:
        self.grid = grid
        members = channel_emitters(grid, options.lights)
        if count > len(members):
            raise ConfigError(
                "--leds",
                field=f"lights={options.lights}",
                found=f"a rig with a lamp at channel {count - 1}",
                expected=f"channels 0 to {len(members) - 1}: the stage has "
                f"{grid[0]} arcs of {counted(grid[1], 'lamp')}",
                hint="Do the rig's addresses and the URL's lights=.. belong together?",
            )
        own = members[:count]
        colour = [*bytes.fromhex(options.rgb), *bytes.fromhex(options.white)]
        # Of each emitter: its channel, and its share of that channel's level.
        self._channel = own.argmax(axis=0)
        self._share = own.any(axis=0) * np.tile(colour, grid[0] * grid[1]) / 255

    def counts(self, steps: np.ndarray) -> np.ndarray:
        """Values of all emitters.

        Args:
            steps: (n,) of the channels, 0..65535.

        Returns:
            (arcs, lights, 6) int, 0..65535; 0 where no channel is.
        """
        values = np.round(np.asarray(steps, float)[self._channel] * self._share)
        return values.astype(int).reshape(*self.grid, EMITTERS)


def channel_emitters(grid: tuple[int, int], lights: str) -> np.ndarray:
    """(channels, emitters) bool: which emitters of the stage are of a channel (`IclLights`)."""
    places = grid[0] * grid[1]
    if lights == "emitters":
        return np.eye(EMITTERS * places, dtype=bool)
    own = np.eye(places, dtype=bool)
    of_group = np.zeros((2, EMITTERS), bool)
    of_group[0, RGB] = of_group[1, WHITE] = True
    rgb, white = (np.kron(own, group[None]).astype(bool) for group in of_group)
    if lights == "polarised":
        arc, light = np.divmod(np.arange(places), grid[1])
        upright_rgb = ((arc % 2 == 0) == np.isin(light, UPRIGHT_RGB))[:, None]
        return np.concatenate(
            [np.where(upright_rgb, rgb, white), np.where(upright_rgb, white, rgb)]
        )
    return {"rgb": rgb, "white": white, "both": rgb | white}[lights]
