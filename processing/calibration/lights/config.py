"""Settings of the tables `[lights.mirror]` and `[lights.grey]` of `calibrate`."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class MirrorBallConfig:
    """The mirror ball.

    Attributes:
        radius_mm: of the ball, measured.
        radius_sigma_mm: how well it is known.
        position_sigma_mm: how far lamps may stand from where the rig has them.
        place_sigma_mm: how far from the stage's centre the ball may stand.
        noise_px: least error of a highlight's centroid.
        gate_px: a highlight is a lamp's only if it is nearer than this to where it should be.
        window_share: half the width of a highlight's window, as a share of the ball's radius.
        floor_share: highlights are brighter than this share of the brightest.
        noise_times: and than this many times the noise.
        rim_share: highlights nearer to the ball's outline than this share of its radius are left
            out: there the mirror turns fastest.
    """

    radius_mm: float = 38.1
    radius_sigma_mm: float = 0.3
    position_sigma_mm: float = 25.0
    place_sigma_mm: float = 100.0
    noise_px: float = 0.05
    gate_px: float = 4.0
    window_share: float = 0.013
    floor_share: float = 0.04
    noise_times: float = 8.0
    rim_share: float = 0.03


@dataclasses.dataclass(frozen=True)
class GreyBallConfig:
    """The grey ball.

    Attributes:
        radius_mm: of the ball, about.
        gain_sigma: how far lamps' gains may be from nominal, as a share, where no highlights show
        them.
        highlight_sigma: the least standard deviation of gains from highlights.
        exponent: of a lamp's fall-off with the angle to its axis, where the balls do not show it: 1
            is a bare LED.
        exponent_sigma: how far it may be from that.
        noise_share: error of a reading, as a share of the typical one under all lamps.
        stray_share: stray light expected, as a share of a pattern's mean light.
        places: about how many places of the ball each camera gives.
    """

    radius_mm: float = 38.1
    gain_sigma: float = 0.05
    highlight_sigma: float = 0.01
    exponent: float = 1.0
    exponent_sigma: float = 0.5
    noise_share: float = 0.002
    stray_share: float = 0.01
    places: int = 600


@dataclasses.dataclass(frozen=True)
class LightsConfig:
    """How lamps are measured."""

    mirror: MirrorBallConfig = dataclasses.field(default_factory=MirrorBallConfig)
    """How their places are found by a mirror ball."""
    grey: GreyBallConfig = dataclasses.field(default_factory=GreyBallConfig)
    """How their gains and fall-off are found by a grey ball."""
