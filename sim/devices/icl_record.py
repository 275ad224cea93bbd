"""What ICL's simulated stage has lit: as numbers for tests, as a picture for people."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from sim.devices.icl_server import IclState
from sim.devices.icl_stage import ARCS, LIGHTS, MOST

SCHEMA = "lightstage.simulated_icl/1"
WHITES = np.array([[1.0, 0.66, 0.34], [1.0, 0.9, 0.78], [0.78, 0.88, 1.0]])
"""How warm, neutral and cool look, of at most 1."""
CELL_PX, GAP_PX = 6, 4
TILES_A_ROW = 8
MOST_TILES = 96
GAMMA = 1 / 2.2
WALL, UNLIT = 40, 14
"""Grey between the tiles, and of a lamp that is off."""


def record(states: Sequence[IclState], triggers: int, began_s: float) -> dict[str, Any]:
    """A record of states, in order.

    Args:
        states: with (ARCS * LIGHTS, 6) counts.
        triggers: how often the cameras' line rose.
        began_s: from when on times are counted (monotonic).
    """
    return {
        "schema": SCHEMA,
        "triggers": triggers,
        "states": [
            {
                "at_s": round(max(0.0, state.at_s - began_s), 3),
                "mode": state.mode,
                "rgb": _grid(state.counts[:, :3]),
                "white": _grid(state.counts[:, 3:]),
            }
            for state in states
        ],
    }


def drawn(states: Sequence[IclState]) -> np.ndarray:
    """(h, w, 3) uint8 sRGB: a tile for each of the last states, coloured fixtures left of white.

    A column is an arc; rows are heights, the uppermost light on top.
    """
    tiles = [tile(state.counts) for state in states[-MOST_TILES:]]
    height, width = tiles[0].shape[:2]
    columns = min(TILES_A_ROW, len(tiles))
    rows = -(-len(tiles) // columns)
    shape = (rows * (height + GAP_PX) + GAP_PX, columns * (width + GAP_PX) + GAP_PX, 3)
    sheet = np.full(shape, WALL, np.uint8)
    for place, each in enumerate(tiles):
        row, column = divmod(place, columns)
        top, left = GAP_PX + row * (height + GAP_PX), GAP_PX + column * (width + GAP_PX)
        sheet[top : top + height, left : left + width] = each
    return sheet


def tile(counts: np.ndarray) -> np.ndarray:
    """(h, w, 3) uint8 of one state's (ARCS * LIGHTS, 6) counts."""
    levels = counts.reshape(ARCS, LIGHTS, 6) / MOST
    colours = np.stack([levels[..., :3], levels[..., 3:] @ (WHITES / WHITES.sum(axis=0))])
    # Lights 0 to 6 of an arc have the even heights from the top, 7 to 13 those between.
    light = np.arange(LIGHTS)
    height = np.where(light < 7, 2 * light, 2 * (light - 7) + 1)
    by_height = np.empty_like(colours)
    by_height[:, :, height] = colours
    shown = UNLIT + (255 - UNLIT) * np.clip(by_height, 0, 1) ** GAMMA
    cells = np.round(shown).astype(np.uint8).transpose(0, 2, 1, 3)
    large = np.kron(cells, np.ones((1, CELL_PX, CELL_PX, 1), np.uint8))
    return np.concatenate([large[0], np.full_like(large[0][:, :2], WALL), large[1]], axis=1)


def _grid(values: np.ndarray) -> list[Any]:
    return list(values.reshape(ARCS, LIGHTS, 3).tolist())
