"""Blending: what the views show of each texel, in two bands, so that no seam is left."""

from __future__ import annotations

import dataclasses

import numpy as np

from processing.atlas.sampling import accumulate, low_band
from processing.atlas.weights import ViewSamples, WeightConfig


@dataclasses.dataclass(frozen=True)
class BlendConfig:
    """How views are weighted and merged."""

    band_mm: float = 3.0
    """Gaussian sigma between the two bands: below it views are averaged widely, above narrowly."""
    detail_power: float = 4.0
    """Power on the weights of the fine band: the best view's detail is kept, not averaged away."""
    weights: WeightConfig = dataclasses.field(default_factory=WeightConfig)


class Blender:
    """Sums of one map over the views: a low band widely averaged, a fine band narrowly."""

    def __init__(self, texels: int, channels: int, config: BlendConfig) -> None:
        self._config = config
        self._low = np.zeros((texels, channels), np.float32)
        self._fine = np.zeros((texels, channels), np.float32)
        self._weight = np.zeros((texels, 2), np.float32)

    def add(self, samples: ViewSamples, image: np.ndarray) -> None:
        """Add one view's (h, w, c) float32 map."""
        if not len(samples.slot):
            return
        sigma = max(self._config.band_mm / samples.footprint_mm, 0.5)
        low = low_band(image, samples.usable, sigma)
        accumulate(
            np.ascontiguousarray(image, np.float32),
            samples.usable,
            low.sums,
            low.counts,
            low.step,
            samples.slot,
            samples.pixel,
            samples.weight,
            self._config.detail_power,
            self._low,
            self._fine,
            self._weight,
        )

    def result(self) -> np.ndarray:
        """(k, c) float32 blended values; 0 where no view sees the texel."""
        least = np.finfo(np.float32).tiny
        self._low /= np.maximum(self._weight[:, :1], least)
        self._fine /= np.maximum(self._weight[:, 1:], least)
        self._low += self._fine
        return self._low
