"""The 24-patch colour chart, and the colour calibration that a user makes with it."""

from __future__ import annotations

import numpy as np

from sim.camera.sensor import Sensor

# Reflectance of the classic 24-patch chart as 8-bit sRGB under D65, as its maker publishes it.
CHART_SRGB = np.array(
    [
        [115, 82, 68], [194, 150, 130], [98, 122, 157], [87, 108, 67], [133, 128, 177],
        [103, 189, 170], [214, 126, 44], [80, 91, 166], [193, 90, 99], [94, 60, 108],
        [157, 188, 64], [224, 163, 46], [56, 61, 150], [70, 148, 73], [175, 54, 60],
        [231, 199, 31], [187, 86, 149], [8, 133, 161], [243, 243, 242], [200, 200, 200],
        [160, 160, 160], [122, 122, 121], [85, 85, 85], [52, 52, 52],
    ]
)  # fmt: skip
GREY_CARD = 0.18
PATCH_PX = 64


def chart_reflectance() -> np.ndarray:
    """(24, 3) linear reflectance of the patches, row by row from the dark skin."""
    encoded = CHART_SRGB / 255.0
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def calibrate_colour(sensor: Sensor, rng: np.random.Generator, white: float = 1.0) -> np.ndarray:
    """Colour calibration as a user makes it: from a noisy photograph of a chart and a grey card.

    The chart is at the sphere's centre facing the frontal camera, lit by `full` as the stage
    drives it, and a perfect white is to read 1. Patches that clip are left out. The grey card,
    photographed large, holds the scale.

    Args:
        sensor: the camera.
        rng: of the noise.
        white: light that a perfect white sends there, where every lamp at level 1 makes 1.

    Returns:
        (3, 3) linear_from_raw: rgb_linear = M @ (raw - black) / (white - black).
    """
    chart = chart_reflectance()
    known = np.concatenate([chart, np.full((1, 3), GREY_CARD)])
    config = sensor.config
    raw, kept, weight = [], [], []
    for index, colour in enumerate(known):
        side = PATCH_PX * (4 if index == len(chart) else 1)
        light = np.broadcast_to(colour * white, (side, side, 3)).astype(np.float32)
        counts = sensor.expose(light, rng)
        if counts.max() >= config.white_dn:
            continue
        green = (counts[0::2, 1::2].mean() + counts[1::2, 0::2].mean()) / 2
        mean = np.array([counts[0::2, 0::2].mean(), green, counts[1::2, 1::2].mean()])
        raw.append((mean - config.black_dn) / (config.white_dn - config.black_dn))
        kept.append(colour)
        weight.append(float(side) / PATCH_PX)
    scale = np.array(weight)[:, None]
    solution, *_ = np.linalg.lstsq(scale * np.array(raw), scale * np.array(kept), rcond=None)
    return solution.T
