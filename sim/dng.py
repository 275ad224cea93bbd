"""A mosaic as a DNG file that LibRaw decodes to exactly the counts written."""

from __future__ import annotations

import io

import numpy as np
import tifffile

from sim.sensor import Sensor

# CIE XYZ (D65) to linear sRGB, IEC 61966-2-1.
LINEAR_FROM_XYZ = np.array(
    [[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]]
)
D65 = 21
CFA = 32803
BYTE, ASCII, SHORT, LONG, RATIONAL, SRATIONAL = 1, 2, 3, 4, 5, 10


def dng_bytes(mosaic: np.ndarray, sensor: Sensor, model: str) -> bytes:
    """One photograph as DNG (TIFF/EP with the tags of [DNG14]).

    Args:
        mosaic: (h, w) uint16 RGGB counts.
        sensor: that took it.
        model: camera model.
    """
    config = sensor.config
    colour = sensor.raw_from_linear @ LINEAR_FROM_XYZ
    colour /= colour.max()
    tags = [
        (271, ASCII, None, model.split(" ")[0], True),
        (272, ASCII, None, model, True),
        (274, SHORT, 1, 1, True),
        (33421, SHORT, 2, (2, 2), True),  # CFARepeatPatternDim
        (33422, BYTE, 4, bytes([0, 1, 1, 2]), True),  # CFAPattern: R G G B
        (33434, RATIONAL, 1, _rational(sensor.exposure_s, 1_000_000), True),  # ExposureTime
        (34855, SHORT, 1, config.iso, True),  # ISOSpeedRatings
        (50706, BYTE, 4, bytes([1, 4, 0, 0]), True),  # DNGVersion
        (50707, BYTE, 4, bytes([1, 1, 0, 0]), True),  # DNGBackwardVersion
        (50708, ASCII, None, model, True),  # UniqueCameraModel
        (50710, BYTE, 3, bytes([0, 1, 2]), True),  # CFAPlaneColor
        (50711, SHORT, 1, 1, True),  # CFALayout: rectangular
        (50714, SHORT, 1, config.black_dn, True),  # BlackLevel
        (50717, LONG, 1, config.white_dn, True),  # WhiteLevel
        (50721, SRATIONAL, 9, _rationals(colour), True),  # ColorMatrix1
        (50728, RATIONAL, 3, _rationals(sensor.neutral), True),  # AsShotNeutral
        (50778, SHORT, 1, D65, True),  # CalibrationIlluminant1
    ]
    buffer = io.BytesIO()
    tifffile.imwrite(
        buffer,
        np.ascontiguousarray(mosaic, np.uint16),
        photometric=CFA,
        extratags=tags,
        metadata=None,
        software=False,
    )
    return buffer.getvalue()


def _rational(value: float, denominator: int) -> tuple[int, int]:
    return round(value * denominator), denominator


def _rationals(values: np.ndarray) -> tuple[int, ...]:
    return tuple(part for value in values.ravel() for part in _rational(float(value), 10_000))
