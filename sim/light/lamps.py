"""Lamps: what the stage's lights really shine, as opposed to what the rig has of them."""

from __future__ import annotations

import dataclasses

import numpy as np

from lightstage.formats.environment import stage_lights
from lightstage.rig import Rig
from sim.errors import SimError


@dataclasses.dataclass(frozen=True)
class LampConfig:
    """How real lamps leave the rig's figures.

    Attributes:
        gain_spread: standard deviation of the natural logarithm of a lamp's gain that the rig
            does not know of; 0.05 is about five per cent.
        colour_spread: the same, of each colour channel of each lamp.
        exponent: radiant intensity falls as the cosine, to this power, of the angle to the lamp's
            axis: 0 is a point that shines alike everywhere, 1 a bare LED.
        radius_mm: of the shining disc; 0 is a point.
    """

    gain_spread: float = 0.0
    colour_spread: float = 0.0
    exponent: float = 1.0
    radius_mm: float = 10.0

    def __post_init__(self) -> None:
        """SimError when a value is negative or not finite."""
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if not (np.isfinite(value) and value >= 0):
                raise SimError(
                    "lamps", field=field.name, found=str(value), expected="a number of at least 0"
                )


@dataclasses.dataclass(frozen=True)
class Lamps:
    """All lamps of a stage, in the rig's order.

    Attributes:
        positions_mm: (m, 3) world.
        weights: (m, 3) what a perfect white diffuser at the origin facing the lamp reads at
            level 1, on the session's scale (formats.environment).
        axes: (m, 3) unit directions in which they shine most: toward the origin.
        exponent: see `LampConfig`.
        radius_mm: see `LampConfig`.
    """

    positions_mm: np.ndarray
    weights: np.ndarray
    axes: np.ndarray
    exponent: float
    radius_mm: float


def lamps_of(rig: Rig, config: LampConfig | None = None, seed: int = 0) -> Lamps:
    """The lamps at the rig's places, with a seeded spread of what they shine.

    Args:
        rig: positions and the gains that were measured.
        config: spread and shape; the default has no spread.
        seed: of the spread. The same lamp keeps its share of the spread when its size changes.

    Returns:
        One lamp per light. The scale is that of the rig's own gains: a spread does not renormalise.
    """
    config = config or LampConfig()
    count = len(rig.lights)
    rng = np.random.default_rng([seed, 168])
    gain = np.exp(config.gain_spread * rng.normal(size=(count, 1)))
    colour = np.exp(config.colour_spread * rng.normal(size=(count, 3)))
    positions = rig.positions_mm
    axes = -positions / np.linalg.norm(positions, axis=1, keepdims=True)
    weights = light_weights(rig) * gain * colour
    return Lamps(positions, weights, axes, float(config.exponent), float(config.radius_mm))


def point_lamps(positions_mm: np.ndarray) -> Lamps:
    """(m, 3) points that shine alike in all directions, each of weight 1."""
    positions = np.asarray(positions_mm, float).reshape(-1, 3)
    return Lamps(positions, np.ones_like(positions), np.zeros_like(positions), 0.0, 0.0)


def light_weights(rig: Rig) -> np.ndarray:
    """(m, 3) what a white diffuser at the origin facing each light reads at level 1."""
    shown = stage_lights(rig, np.ones(len(rig.lights)), "full")
    weights = np.zeros((len(rig.lights), 3))
    weights[rig.rgb_gains.max(axis=1) > 0] = shown.rgb
    return weights
