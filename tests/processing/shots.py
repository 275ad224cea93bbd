"""A ball under any patterns, coloured or polarised lights, in plain float64; lights of a rig."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import cast

import numpy as np

from lightstage.formats.session import Calibration, Session
from lightstage.patterns import pattern_levels
from lightstage.rig import Rig
from processing.lighting.lights import PatternLights, pattern_lights
from tests.processing import lit_ball
from tests.processing.lit_ball import Ball, Sight

PASSED = {"": (1.0, 1.0), "parallel": (0.5, 1.0), "cross": (0.5, 0.0)}
"""What ideal polarisers pass of diffuse and of mirrored light."""


def rig_lights(rig: Rig, patterns: tuple[str, ...]) -> PatternLights:
    """The lights of patterns that are driven by their names alone."""
    levels = {name: pattern_levels(name, rig) for name in patterns}
    session = SimpleNamespace(
        rig=rig,
        levels=levels.__getitem__,
        file=SimpleNamespace(patterns={}, calibration=Calibration()),
    )
    return pattern_lights(cast(Session, session), patterns)


def coloured_rig(rig: Rig) -> Rig:
    """The rig with red, green and blue lights by turns."""
    one = np.eye(3)
    lights = tuple(
        dataclasses.replace(light, rgb_gain=tuple(one[(k + k // 14) % 3]))
        for k, light in enumerate(rig.lights)
    )
    return dataclasses.replace(rig, lights=lights)


def photograph(ball: Ball, sight: Sight, rig: Rig, patterns: tuple[str, ...]) -> np.ndarray:
    """(n, P, 3) float32 what the pixels read."""
    levels = np.stack([pattern_levels(name, rig) for name in patterns])
    share = np.array([PASSED[name.partition("@")[2]] for name in patterns])
    rgb = np.zeros((len(patterns), len(sight.normals), 3))
    white = (rig.rgb_gains == rig.rgb_gains[:, :1]).all()
    for c in range(3):
        if c == 0 or not white:
            light, gloss = lit_ball.shade(ball, sight, rig, levels * rig.rgb_gains[:, c])
        rgb[..., c] = share[:, :1] * light * ball.albedo[c] + share[:, 1:] * gloss
    return rgb.swapaxes(0, 1).astype(np.float32)


def middle(sight: Sight) -> Sight:
    """The same normals and views, every point at the stage's centre: lights truly far away."""
    return dataclasses.replace(sight, points_mm=sight.points_mm * 1e-6)
