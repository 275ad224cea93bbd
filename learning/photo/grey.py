"""Black-and-white photographs: the colour of the skin comes from what people have in common."""

from __future__ import annotations

import numpy as np

from learning.networks.whole_face import WholeFaceNetwork
from lightstage.formats.srgb import LUMINANCE

GREY = 0.03
"""Largest share by which a pixel's channels differ in a photograph without colour."""
COLOURFUL = 0.01
"""Share of a colourless photograph's pixels that may differ by more: a JPEG is a little off."""
DARK = 0.02
"""Of the photograph's bright pixels: below it a pixel's colour is noise."""


def has_no_colour(rgb_linear: np.ndarray) -> bool:
    """Whether a photograph, (h, w, 3), is black and white."""
    most, least = rgb_linear.max(axis=2), rgb_linear.min(axis=2)
    level = float(np.percentile(most, 99))
    if not level > 0:
        return True
    bright = most > DARK * level
    return bool((most - least > GREY * most)[bright].mean() < COLOURFUL)


def coloured(rgb_linear: np.ndarray, network: WholeFaceNetwork) -> np.ndarray:
    """A black-and-white photograph in the mean person's skin colour, its luminance as it was.

    Args:
        rgb_linear: (h, w, 3).
        network: keeps the mean person.
    """
    here = (network.mean_position_mm[0] != 0).any(dim=0).numpy()
    skin = np.exp(network.mean_log_albedo[0].permute(1, 2, 0).numpy()[here].mean(axis=0))
    tint = skin / (skin @ LUMINANCE)
    grey = rgb_linear @ LUMINANCE
    return np.asarray(grey[..., None] * tint, np.float32)
