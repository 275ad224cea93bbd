"""Parts of RGB that diffuse normals can be taken from: chroma, red, blue, the mean of all."""

from __future__ import annotations

import numpy as np

from processing.normals import chroma_signal

WHITE = np.ones(3)


def normal_signal(rgb: np.ndarray, part: str) -> np.ndarray:
    """The readings that normals are solved from.

    Args:
        rgb: (n, P, 3) readings, white where the lights are.
        part: ``chroma``, free of mirror reflection; ``red``, ``blue`` or ``mean``, with it. Red is
            the strongest and widest spread below the skin, blue the sharpest.

    Returns:
        (n, P) float32.

    Source: [Lattas2021] for red and blue, [Mallick2005] for chroma.
    """
    if part == "chroma":
        return chroma_signal(rgb, WHITE)[0]
    if part == "mean":
        return np.asarray(rgb.mean(axis=2), np.float32)
    return np.ascontiguousarray(rgb[:, :, ("red", "green", "blue").index(part)], np.float32)


def noise_of(part: str, noise: float) -> float:
    """Noise of `normal_signal`, where each channel has the noise given."""
    return noise / float(np.sqrt(3)) if part == "mean" else noise
