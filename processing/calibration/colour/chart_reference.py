"""Known reflectances of the classic 24-patch chart, and of charts that were measured."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lightstage.errors import FormatError
from lightstage.formats.fields import array_of
from lightstage.formats.files import read_json
from lightstage.formats.srgb import linear_from_srgb
from processing.colour_difference import colour_science

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
"""The maker's 8-bit sRGB values, D65, row by row from the dark skin; colour-science lacks them."""

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
        return linear_from_srgb(CLASSIC_SRGB / 255.0)
    if chart == "2014":
        colour = colour_science()
        xyz = colour.Lab_to_XYZ(_lab_2014(), colour.XYZ_to_xy(D50_WHITE))
        return np.asarray(xyz @ (RGB_FROM_XYZ @ D65_FROM_D50).T)
    path = Path(chart)
    if not path.is_file():
        raise FormatError(chart, found="no such chart", expected="classic, 2014 or a JSON file")
    try:
        known = array_of(read_json(path, CHART_SCHEMA).get("reflectance"), 24, 3)
    except ValueError:
        known = np.zeros(0)
    if not known.size or not ((known > -0.2) & (known < 1.2)).all():
        raise FormatError(
            path,
            field="reflectance",
            found="values out of range" if known.size else "something else",
            expected="24 times r, g, b, a perfect white 1",
        )
    return known


def _lab_2014() -> np.ndarray:
    """(24, 3) the maker's L*a*b* of charts made since November 2014, D50."""
    colour = colour_science()
    chart = colour.CCS_COLOURCHECKERS["ColorChecker24 - After November 2014"]
    xyz = colour.xyY_to_XYZ(np.array(list(chart.data.values())))
    return np.asarray(colour.XYZ_to_Lab(xyz, chart.illuminant))
