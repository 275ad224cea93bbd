"""A mosaic as a DNG file that LibRaw decodes to exactly the counts written."""

from __future__ import annotations

import dataclasses

import numpy as np

from sim.camera.sensor import Sensor
from sim.camera.tiff import ASCII, BYTE, LONG, RATIONAL, SHORT, SRATIONAL, UNDEFINED, tiff_bytes

# CIE XYZ (D65) to linear sRGB, IEC 61966-2-1.
LINEAR_FROM_XYZ = np.array(
    [[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]]
)
D65 = 21
CFA = 32803
TAKEN = "2000:01:01 12:00:00"
"""Every simulated photograph is of this moment: the same seed gives the same file to the byte."""


@dataclasses.dataclass(frozen=True)
class Exif:
    """What a camera writes of itself into its files; no name and no place unless they are set.

    Attributes:
        model: with its maker as first word.
        serial: of the body.
        f_number: aperture.
        focal_mm: focal length.
        taken: date and time, EXIF's form.
        offset: of that time from UTC; None where the camera does not write it.
        artist: a name that somebody left in the camera's menu.
        owner: the same.
        place: latitude and longitude in degrees, where the camera knows them.
    """

    model: str
    serial: str
    f_number: float
    focal_mm: float
    taken: str = TAKEN
    offset: str | None = "+00:00"
    artist: str | None = None
    owner: str | None = None
    place: tuple[float, float] | None = None


def dng_bytes(mosaic: np.ndarray, sensor: Sensor, exif: Exif) -> bytes:
    """One photograph as DNG (TIFF with the tags of [DNG14], and an EXIF directory).

    The colour matrix belongs to the LEDs' white, which is called D65. LibRaw turns it into its
    camera-to-sRGB matrix (rawpy: `color_matrix`); `rgb_xyz_matrix`, which it keeps for cameras of
    its own tables, it leaves zero for every DNG.

    Args:
        mosaic: (h, w) uint16 RGGB counts.
        sensor: that took it.
        exif: of the camera.
    """
    config = sensor.config
    colour = sensor.raw_from_linear @ LINEAR_FROM_XYZ
    colour = np.round(colour / np.abs(colour).max(), 6)
    height, width = mosaic.shape
    tags: dict[int, tuple[int, object]] = {
        254: (LONG, 0),  # NewSubfileType: the picture itself
        256: (LONG, width),
        257: (LONG, height),
        258: (SHORT, 16),  # BitsPerSample
        259: (SHORT, 1),  # Compression: none
        262: (SHORT, CFA),  # PhotometricInterpretation
        271: (ASCII, exif.model.split(" ")[0]),  # Make
        272: (ASCII, exif.model),
        274: (SHORT, 1),  # Orientation: as it is
        277: (SHORT, 1),  # SamplesPerPixel
        278: (LONG, height),  # RowsPerStrip
        284: (SHORT, 1),  # PlanarConfiguration
        306: (ASCII, exif.taken),
        33421: (SHORT, (2, 2)),  # CFARepeatPatternDim
        33422: (BYTE, (0, 1, 1, 2)),  # CFAPattern: R G G B
        50706: (BYTE, (1, 4, 0, 0)),  # DNGVersion
        50707: (BYTE, (1, 1, 0, 0)),  # DNGBackwardVersion
        50708: (ASCII, exif.model),  # UniqueCameraModel
        50710: (BYTE, (0, 1, 2)),  # CFAPlaneColor
        50711: (SHORT, 1),  # CFALayout: rectangular
        50714: (SHORT, config.black_dn),  # BlackLevel
        50717: (LONG, config.white_dn),  # WhiteLevel
        50721: (SRATIONAL, colour),  # ColorMatrix1
        50728: (RATIONAL, np.round(sensor.neutral, 6)),  # AsShotNeutral
        50735: (ASCII, exif.serial),  # CameraSerialNumber
        50778: (SHORT, D65),  # CalibrationIlluminant1
    }
    if exif.artist is not None:
        tags[315] = (ASCII, exif.artist)
    camera: dict[int, tuple[int, object]] = {
        33434: (RATIONAL, sensor.exposure_s),  # ExposureTime
        33437: (RATIONAL, round(exif.f_number, 2)),
        34855: (SHORT, config.iso),  # PhotographicSensitivity
        36864: (UNDEFINED, b"0230"),  # ExifVersion
        36867: (ASCII, exif.taken),  # DateTimeOriginal
        37386: (RATIONAL, round(exif.focal_mm, 2)),  # FocalLength
        37521: (ASCII, "000"),  # SubSecTimeOriginal
        42033: (ASCII, exif.serial),  # BodySerialNumber
    }
    if exif.offset is not None:
        camera[36881] = (ASCII, exif.offset)  # OffsetTimeOriginal
    if exif.owner is not None:
        camera[42032] = (ASCII, exif.owner)  # CameraOwnerName
    return tiff_bytes(mosaic, tags, camera, _gps(exif.place))


def _gps(place: tuple[float, float] | None) -> dict[int, tuple[int, object]]:
    """The GPS directory; empty where the camera does not know."""
    if place is None:
        return {}
    north, east = place
    return {
        0: (BYTE, (2, 3, 0, 0)),  # GPSVersionID
        1: (ASCII, "N" if north >= 0 else "S"),
        2: (RATIONAL, (abs(north), 0, 0)),
        3: (ASCII, "E" if east >= 0 else "W"),
        4: (RATIONAL, (abs(east), 0, 0)),
    }
