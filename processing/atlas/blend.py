"""Blending: what the views show of each texel, in two bands, so that no seam is left."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from processing.atlas.config import BlendConfig
from processing.atlas.sampling import Sharing, accumulate, hold, low_band, weigh_up, widen
from processing.atlas.weights import ViewSamples


class Blender:
    """Maps merged over the same views: a low band widely averaged, a fine band narrowly."""

    def __init__(self, best: np.ndarray, views: Sequence[ViewSamples], config: BlendConfig) -> None:
        """Sum the views' weights, which all maps share.

        Args:
            best: (n,) float32, the largest weight that any view has at each texel.
            views: their samples; those that no pixel serves are passed over.
            config: settings.
        """
        self._band_mm, self._views = config.band_mm, views
        self._sharing = Sharing(best, config.detail_power, config.detail_least)
        self._total = np.zeros((len(best), 2), np.float32)
        self._range: tuple[np.ndarray, np.ndarray] | None = None
        for samples in views:
            weigh_up(samples.reading, self._sharing, self._total)

    def add(self, view: int, image: np.ndarray, out: np.ndarray) -> None:
        """Add one view's maps to the blended ones.

        Args:
            view: which of the views.
            image: (h, w, d) of `side_by_side`, the view's window of all maps.
            out: (n, d) float32, zero before the first view; when all are added it holds the
                blended values, and 0 where no view sees the texel.
        """
        samples = self._views[view]
        if not len(samples.reading.slot):
            return
        if self._range is None:
            depth = image.shape[2]
            self._range = np.full(depth, np.inf, np.float32), np.full(depth, -np.inf, np.float32)
        widen(image, samples.reading.usable, *self._range)
        sigma = max(self._band_mm / samples.footprint_mm, 0.5)
        low = low_band(image, samples.reading.usable, sigma)
        accumulate(image, low, samples.reading, self._sharing, self._total, out)

    def finish(self, out: np.ndarray) -> None:
        """Hold the blended values to the range of the pixels that were read.

        One view's detail on the other views' low band can pass below the darkest pixel of all, so
        that an albedo becomes negative.

        Args:
            out: (n, d) float32 that `add` filled; changed in place.
        """
        if self._range is not None:
            hold(out, self._total, *self._range)
