"""Perceived difference of two colours: CIELAB and its colour difference of the year 2000."""

from __future__ import annotations

import numpy as np

XYZ_FROM_RGB = np.array(
    [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ]
)


def lab_from_linear(rgb: np.ndarray) -> np.ndarray:
    """CIELAB of linear sRGB.

    Args:
        rgb: (..., 3), white is (1, 1, 1).

    Returns:
        (..., 3) L* 0..100, a*, b*.
    """
    xyz = rgb @ (XYZ_FROM_RGB / XYZ_FROM_RGB.sum(axis=1, keepdims=True)).T
    edge = 6 / 29
    f = np.where(xyz > edge**3, np.cbrt(xyz), xyz / (3 * edge**2) + 4 / 29)
    x, y, z = f[..., 0], f[..., 1], f[..., 2]
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


def delta_e_2000(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """CIEDE2000 between colours in CIELAB.

    Source: [Sharma2005].

    Args:
        one: (..., 3) L* a* b*.
        other: (..., 3), the same.

    Returns:
        (...); about 1 is just seen side by side.
    """
    light_1, a_1, b_1 = np.moveaxis(np.asarray(one, float), -1, 0)
    light_2, a_2, b_2 = np.moveaxis(np.asarray(other, float), -1, 0)
    chroma_7 = ((np.hypot(a_1, b_1) + np.hypot(a_2, b_2)) / 2) ** 7
    stretch = 1 + 0.5 * (1 - np.sqrt(chroma_7 / (chroma_7 + 25.0**7)))
    c_1, c_2 = np.hypot(stretch * a_1, b_1), np.hypot(stretch * a_2, b_2)
    hue_1 = np.degrees(np.arctan2(b_1, stretch * a_1)) % 360
    hue_2 = np.degrees(np.arctan2(b_2, stretch * a_2)) % 360
    grey = c_1 * c_2 == 0
    turn = (hue_2 - hue_1 + 180) % 360 - 180
    turn = np.where(grey, 0.0, np.where(turn == -180, 180.0, turn))
    hue = (hue_1 + hue_2) / 2
    hue = np.where(np.abs(hue_1 - hue_2) > 180, (hue + 180) % 360, hue)
    hue = np.where(grey, hue_1 + hue_2, hue)
    light, chroma = (light_1 + light_2) / 2, (c_1 + c_2) / 2
    weight = (
        1
        - 0.17 * np.cos(np.radians(hue - 30))
        + 0.24 * np.cos(np.radians(2 * hue))
        + 0.32 * np.cos(np.radians(3 * hue + 6))
        - 0.20 * np.cos(np.radians(4 * hue - 63))
    )
    off = (light - 50) ** 2
    in_light = (light_2 - light_1) / (1 + 0.015 * off / np.sqrt(20 + off))
    in_chroma = (c_2 - c_1) / (1 + 0.045 * chroma)
    in_hue = 2 * np.sqrt(c_1 * c_2) * np.sin(np.radians(turn) / 2) / (1 + 0.015 * chroma * weight)
    mixed_7 = chroma**7
    mixed = -2 * np.sqrt(mixed_7 / (mixed_7 + 25.0**7))
    mixed *= np.sin(np.radians(60 * np.exp(-(((hue - 275) / 25) ** 2))))
    total = in_light**2 + in_chroma**2 + in_hue**2 + mixed * in_chroma * in_hue
    return np.asarray(np.sqrt(np.maximum(total, 0)))
