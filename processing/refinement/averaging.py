"""Readings averaged over neighbouring pixels, which calms noise and the skin's finest relief."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np

from processing.refinement.scene import View

SIDE, NOISY_SIDE = 3, 5
"""Readings are averaged over a square of so many pixels a side: more blurs the relief."""
CALM = 0.0045
"""Readings of 1 with more noise than this are averaged over the larger square."""


def averaged_side(noise: float) -> int:
    """Odd number of pixels a side, where a reading of 1 has this noise."""
    return NOISY_SIDE if noise > CALM else SIDE


def averaged(view: View, side: int) -> View:
    """A view whose readings are means over squares of an odd number of pixels a side.

    Pixels that cannot be used have no part in a mean and keep their reading.
    """
    mask, usable = view.sight.mask, view.usable[:, None]
    single = view.rgb.reshape(len(usable), 3 * view.rgb.shape[1])
    layers = np.zeros((single.shape[1] + 1, *mask.shape), np.float32)
    layers[:-1, mask] = np.where(usable, single, 0).T
    layers[-1, mask] = view.usable
    for layer in layers:
        cv2.blur(layer, (side, side), layer, borderType=cv2.BORDER_CONSTANT)
    means = layers[:, mask].T
    rgb = np.divide(means[:, :-1], means[:, -1:], out=single.copy(), where=usable)
    return dataclasses.replace(view, rgb=rgb.reshape(view.rgb.shape))
