"""Known reflectances of the classic 24-patch chart, and of charts that were measured."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lightstage.errors import FormatError
from lightstage.formats.files import read_json

CHART_SCHEMA = "lightstage.chart/1"
SKIN = slice(0, 2)
"""The two patches of skin, dark and light."""
NEUTRAL = slice(18, 24)
"""The six neutral patches, from white to black."""

CLASSIC_SRGB = np.array(
    [
        *([115, 82, 68], [194, 150, 130], [98, 122, 157], [87, 108, 67], [133, 128, 177]),
        *([103, 189, 170], [214, 126, 44], [80, 91, 166], [193, 90, 99], [94, 60, 108]),
        *([157, 188, 64], [224, 163, 46], [56, 61, 150], [70, 148, 73], [175, 54, 60]),
        *([231, 199, 31], [187, 86, 149], [8, 133, 161], [243, 243, 242], [200, 200, 200]),
        *([160, 160, 160], [122, 122, 121], [85, 85, 85], [52, 52, 52]),
    ]
)
"""The maker's 8-bit sRGB values, D65, row by row from the dark skin."""

LAB_2014 = np.array(
    [
        *([37.54, 14.37, 14.92], [64.66, 19.27, 17.50], [49.32, -3.82, -22.54]),
        *([43.46, -12.74, 22.72], [54.94, 9.61, -24.79], [70.48, -32.26, -0.37]),
        *([62.73, 35.83, 56.50], [39.43, 10.75, -45.17], [50.57, 48.64, 16.67]),
        *([30.10, 22.54, -20.87], [71.77, -24.13, 58.19], [71.51, 18.24, 67.37]),
        *([28.37, 15.42, -49.80], [54.38, -39.72, 32.27], [42.43, 51.05, 28.62]),
        *([81.80, 2.67, 80.41], [50.63, 51.28, -14.12], [49.57, -29.71, -28.32]),
        *([95.19, -1.03, 2.93], [81.29, -0.57, 0.44], [66.89, -0.75, -0.06]),
        *([50.76, -0.13, 0.14], [35.63, -0.46, -0.48], [20.64, 0.07, -0.46]),
    ]
)
"""The maker's L*a*b* of charts made since November 2014, D50."""

D50_WHITE = np.array([0.96422, 1.0, 0.82521])
D65_FROM_D50 = np.array(
    [
        [0.9555766, -0.0230393, 0.0631636],
        [-0.0282895, 1.0099416, 0.0210077],
        [0.0122982, -0.0204830, 1.3299098],
    ]
)
"""Bradford's adaptation of XYZ."""
RGB_FROM_XYZ = np.array(
    [
        [3.2404542, -1.5371385, -0.4985314],
        [-0.9692660, 1.8760108, 0.0415560],
        [0.0556434, -0.2040259, 1.0572252],
    ]
)
"""To sRGB's primaries, D65 [IEC61966]."""


def chart_reflectance(chart: str) -> np.ndarray:
    """Reflectances of a chart's patches in linear sRGB, a perfect white 1.

    Args:
        chart: ``classic`` (the maker's sRGB values, right for all charts within some 2 Delta E),
            ``2014`` (the maker's L*a*b* of charts made since November 2014; the cyan patch is
            outside sRGB and has a negative red), or a JSON file of a chart that was measured:
            ``{"schema": "lightstage.chart/1", "reflectance": [24 x [r, g, b]]}``.

    Returns:
        (24, 3) float64.

    Raises:
        FormatError: a file that does not hold that.
    """
    if chart == "classic":
        value = CLASSIC_SRGB / 255.0
        curve = ((value + 0.055) / 1.055) ** 2.4
        return np.asarray(np.where(value <= 0.04045, value / 12.92, curve))
    if chart == "2014":
        return np.asarray(_xyz_from_lab(LAB_2014) @ (RGB_FROM_XYZ @ D65_FROM_D50).T)
    path = Path(chart)
    if not path.is_file():
        raise FormatError(chart, found="no such chart", expected="classic, 2014 or a JSON file")
    try:
        known = np.array(read_json(path, CHART_SCHEMA)["reflectance"], float)
    except (KeyError, TypeError, ValueError):
        known = np.zeros(0)
    if known.shape != (24, 3) or not (np.isfinite(known) & (known > -0.2) & (known < 1.2)).all():
        raise FormatError(
            path,
            field="reflectance",
            found=f"shape {known.shape}" if known.shape != (24, 3) else "values out of range",
            expected="24 times r, g, b, a perfect white 1",
        )
    return known


def _xyz_from_lab(lab: np.ndarray) -> np.ndarray:
    """(n, 3) XYZ under D50, white's Y 1, of (n, 3) L*a*b* (CIE 15)."""
    y = (lab[:, 0] + 16) / 116
    f = np.stack([y + lab[:, 1] / 500, y, y - lab[:, 2] / 200], axis=1)
    cubed = np.where(f > 6 / 29, f**3, 3 * (6 / 29) ** 2 * (f - 4 / 29))
    return np.asarray(cubed * D50_WHITE)
