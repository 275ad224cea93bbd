"""Latitude-longitude pictures of light from everywhere: OpenEXR or Radiance HDR.

Row 0 looks up (+y); the middle column looks along +z and columns grow toward +x.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from lightstage.counting import counted
from lightstage.errors import FormatError
from lightstage.formats.exr import read_exr

SUFFIXES = (".exr", ".hdr")
HEADER_BYTES = 1 << 16
MOST_TEXELS = 2**26


def read_panorama(path: Path) -> np.ndarray:
    """Read a latitude-longitude picture.

    Args:
        path: .exr or .hdr, twice as wide as high.

    Returns:
        (h, 2 h, 3) float64, linear, at least 0; one channel is repeated.

    Raises:
        FormatError: another kind of file, a damaged one, another shape, NaN, infinite or negative
            values (with the first one's place), or no light at all.
    """
    if path.suffix.lower() not in SUFFIXES:
        found = path.suffix or "no suffix"
        raise FormatError(path, found=found, expected=" or ".join(SUFFIXES))
    if not path.is_file():
        raise FormatError(path, found="no such file", expected="a latitude-longitude picture")
    pixels = read_exr(path) if path.suffix.lower() == ".exr" else _read_hdr(path)
    if pixels.ndim == 2:
        pixels = np.repeat(pixels[:, :, None], 3, axis=2)
    require_panorama(pixels, path)
    return np.ascontiguousarray(pixels, np.float64)


def require_panorama(radiance: np.ndarray, where: str | Path) -> None:
    """FormatError unless an array is a (h, 2 h, 3) latitude-longitude picture of light."""
    shape = radiance.shape
    good = len(shape) == 3 and shape[2] == 3 and shape[0] >= 1 and shape[1] == 2 * shape[0]
    if not good or shape[0] * shape[1] > MOST_TEXELS:
        raise FormatError(
            where,
            field="shape",
            found=" x ".join(str(n) for n in shape),
            expected="rows x columns x 3, twice as many columns as rows, at most 67 million texels",
            hint="Is it a latitude-longitude picture? Convert cubes and mirror balls first.",
        )
    for bad, found in ((~np.isfinite(radiance), "NaN or infinite"), (radiance < 0, "negative")):
        if bad.any():
            row, column, channel = (int(i) for i in np.argwhere(bad)[0])
            raise FormatError(
                where,
                field=f"row {row}, column {column}, {'RGB'[channel]}",
                found=counted(int(bad.sum()), f"{found} value"),
                expected="light of at least 0",
                hint="Clamp or repair the picture: no value is left out silently.",
            )
    if not radiance.any():
        raise FormatError(where, found="no light at all", expected="a picture of light")


def _read_hdr(path: Path) -> np.ndarray:
    # OpenCV prints a line of its own on damage, beside the message below.
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        read = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    finally:
        cv2.utils.logging.setLogLevel(level)
    if read is None or read.dtype != np.float32 or read.ndim != 3:
        raise FormatError(
            path,
            found="something else",
            expected="a whole Radiance HDR picture (RGBE)",
            hint="A light set is .json; a picture of light is .hdr or .exr, latitude-longitude.",
        )
    return np.asarray(read)[:, :, ::-1] / _exposure(path)


def _exposure(path: Path) -> np.ndarray:
    """(3,) float32 by which a Radiance picture's values were multiplied, by its header's lines."""
    with path.open("rb") as file:
        header = file.read(HEADER_BYTES).partition(b"\n\n")[0]
    factor = np.ones(3)
    for line in header.splitlines():
        name, _, value = line.partition(b"=")
        if name.strip() not in (b"EXPOSURE", b"COLORCORR"):
            continue
        try:
            numbers = np.array([float(word) for word in value.split()])
            factor = factor * numbers.reshape(1 if name.strip() == b"EXPOSURE" else 3)
        except ValueError:
            factor = np.zeros(3)
    if not (np.isfinite(factor).all() and (factor > 0).all()):
        raise FormatError(
            path, field="EXPOSURE, COLORCORR", found="no such numbers", expected="one, and three"
        )
    return factor.astype(np.float32)
