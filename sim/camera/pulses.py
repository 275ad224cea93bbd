"""Lamps dimmed by pulses, seen through a rolling shutter: bands."""

from __future__ import annotations

import numpy as np

from sim.camera.flaws import PulseConfig

INSTANT = 1e-6
"""An exposure shorter than this share of a period sees the lamp either on or off."""


def band_gain(
    level: float, rows: int, exposure_s: float, phase: float, config: PulseConfig
) -> np.ndarray:
    """What each row of a picture sees of a pulsed lamp, against a steady lamp of the same level.

    The lamp shines fully for the share `level` of each period. The rows open one after another. An
    exposure of whole periods sees the same from any moment: no bands.

    Args:
        level: 0..1.
        rows: of the picture.
        exposure_s: of each row.
        phase: 0..1, share of a period that has passed when the first row opens.
        config: of pulses and shutter.

    Returns:
        (rows,) float64, 1 for a steady lamp (level 0 and 1, frequency 0).
    """
    if config.frequency_hz <= 0 or not 0 < level < 1:
        return np.ones(rows)
    delay_s = np.arange(rows) / rows * config.readout_ms / 1000
    opened = phase + delay_s * config.frequency_hz
    span = exposure_s * config.frequency_hz
    if span < INSTANT:
        return (opened % 1.0 < level) / level
    return (_on(opened + span, level) - _on(opened, level)) / (level * span)


def _on(periods: np.ndarray, level: float) -> np.ndarray:
    """Periods of light up to a moment, which is counted in periods."""
    whole = np.floor(periods)
    return whole * level + np.minimum(periods - whole, level)
