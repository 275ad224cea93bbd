"""Which emitters of ICL's stage each light of a rig is: channels of its addresses to its grid."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lightstage.counting import counted
from lightstage.errors import ConfigError
from lightstage.leds.address import IclOptions
from lightstage.leds.lsserver import EMITTERS, FULL

UPRIGHT_RGB = (0, 2, 4, 6, 7, 9, 11, 13)
"""Of an even arc, lights whose rgb emitters have an upright polariser and whose white ones lie; of
an odd arc, and of the other lights, it is the other way round."""
RGB, WHITE = slice(0, 3), slice(3, 6)


class IclLights:
    """From levels of a rig's lights to values of a stage's emitters.

    A place is arc * (lights of an arc) + light. A channel is, by `options.lights`:

    - ``white``, ``rgb``, ``both``: the place whose emitters of that group are the light;
    - ``polarised``: a place's emitters behind the upright polariser, or, as many channels as there
      are places further on, those behind the lying one;
    - ``emitters``: 6 * place + one of red, green, blue, warm, neutral, cool.

    Args:
        grid: arcs, and lights of each.
        channels: of each light, in the rig's order; each at most once.
        options: which emitters, and their colours at full level.

    Raises:
        ConfigError: a channel that the stage does not have.
    """

    def __init__(self, grid: tuple[int, int], channels: Sequence[int], options: IclOptions) -> None:
        self.grid = grid
        weights = np.array([*bytes.fromhex(options.rgb), *bytes.fromhex(options.white)]) / 255
        members = channel_emitters(grid, options.lights)
        last = max(channels, default=0)
        if last >= len(members):
            raise ConfigError(
                "--leds",
                field=f"lights={options.lights}",
                found=f"a rig with a light at channel {last}",
                expected=f"channels 0 to {len(members) - 1}: the stage has "
                f"{grid[0]} arcs of {counted(grid[1], 'light')}",
                hint="Do the rig's addresses and the URL's lights=.. belong together?",
            )
        # (emitters, lights): one light's share of each emitter.
        self._shares = members[list(channels)].T * np.tile(weights, grid[0] * grid[1])[:, None]

    def counts(self, steps: np.ndarray) -> np.ndarray:
        """Values of all emitters.

        Args:
            steps: (n,) of the lights, 0..65535.

        Returns:
            (arcs, lights, 6) int, 0..65535; 0 where no light of the rig is.
        """
        values = np.round(self._shares @ np.asarray(steps, float))
        return np.clip(values, 0, FULL).astype(int).reshape(*self.grid, EMITTERS)


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
