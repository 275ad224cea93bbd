"""ICC profiles of three curves and a matrix: display values to linear sRGB [ICC2022]."""

from __future__ import annotations

import dataclasses
import struct
from pathlib import Path

import numpy as np

from lightstage.errors import FormatError
from lightstage.formats.srgb import XYZ_FROM_SRGB, linear_from_srgb
from lightstage.printable import printable

MOST_TAGS = 200
CODES = 65536
"""Places at which a curve is sampled."""
_PARAMETERS = (1, 3, 4, 5, 7)
"""Numbers of a parametric curve, by its type."""
_HINT = "Convert the picture to sRGB or Adobe RGB with 16 bits, or take the camera's RAW."


@dataclasses.dataclass(frozen=True)
class Profile:
    """What display values mean.

    Attributes:
        name: to be shown.
        curves: (3, 65536) float32, linear light of evenly spaced display values 0..1.
        matrix: (3, 3) from the curves' light to linear sRGB.
    """

    name: str
    curves: np.ndarray
    matrix: np.ndarray

    def linear(self, codes: np.ndarray) -> np.ndarray:
        """(h, w, 3) float32 linear sRGB, 1 = white, of (h, w, 3) uint8 or uint16."""
        most = np.iinfo(codes.dtype).max
        places = np.arange(most + 1) * ((CODES - 1) // most)
        light = np.empty(codes.shape, np.float32)
        for colour in range(3):
            light[..., colour] = self.curves[colour][places][codes[..., colour]]
        if np.array_equal(self.matrix, np.eye(3)):
            return light
        return np.asarray(light @ self.matrix.T.astype(np.float32))


def srgb() -> Profile:
    """What a picture without a profile is taken for."""
    curve = linear_from_srgb(np.linspace(0, 1, CODES)).astype(np.float32)
    return Profile("sRGB", np.stack([curve] * 3), np.eye(3))


def read_profile(data: bytes, where: str | Path) -> Profile:
    """Read a profile.

    Args:
        data: as it is in the picture.
        where: the picture, for errors.

    Raises:
        FormatError: damaged, of another kind of colours than red, green and blue, or made of
            tables instead of curves and a matrix.
    """
    if len(data) < 132 or data[36:40] != b"acsp":
        raise _unusable(where, f"a damaged one of {len(data)} bytes")
    space = printable(data[16:20].decode("latin-1"))
    if space != "RGB":
        raise _unusable(where, f"one of {space} colours")
    try:
        tags = _tags(data)
        columns = [_xyz(tags[name]) for name in (b"rXYZ", b"gXYZ", b"bXYZ")]
        curves = np.stack([_curve(tags[name]) for name in (b"rTRC", b"gTRC", b"bTRC")])
    except KeyError:
        raise _unusable(where, "one without curves and a matrix") from None
    except (struct.error, ValueError, IndexError):
        raise _unusable(where, "a damaged one") from None
    matrix = np.linalg.inv(XYZ_FROM_SRGB) @ np.stack(columns, axis=1)
    # sRGB's own profile is rounded to 16 bits: no colour changes by that.
    matrix = np.eye(3) if np.abs(matrix - np.eye(3)).max() < 2e-3 else matrix
    usable = np.isfinite(curves).all() and np.isfinite(matrix).all()
    if not usable or abs(np.linalg.det(matrix)) < 1e-3 or np.abs(matrix).max() > 10:
        raise _unusable(where, "one of colours that cannot be")
    return Profile(_name(tags.get(b"desc", b"")), curves.astype(np.float32), matrix)


def _unusable(where: str | Path, found: str) -> FormatError:
    return FormatError(
        where,
        field="ICC profile",
        found=found,
        expected="red, green and blue by curves and a matrix, as of sRGB or Adobe RGB",
        hint=_HINT,
    )


def _tags(data: bytes) -> dict[bytes, bytes]:
    """Content of the profile's tags by signature; struct.error where the table is cut."""
    (count,) = struct.unpack_from(">I", data, 128)
    found = {}
    for index in range(min(count, MOST_TAGS)):
        name, place, size = struct.unpack_from(">4sII", data, 132 + 12 * index)
        if place + size > len(data):
            raise ValueError("a tag beyond the end")
        found[name] = data[place : place + size]
    return found


def _fixed(data: bytes, place: int, count: int) -> np.ndarray:
    """Numbers of s15Fixed16."""
    return np.array(struct.unpack_from(f">{count}i", data, place), float) / 65536


def _xyz(tag: bytes) -> np.ndarray:
    if tag[:4] != b"XYZ ":
        raise ValueError("no XYZ")
    return _fixed(tag, 8, 3)


def _curve(tag: bytes) -> np.ndarray:
    """(65536,) linear light of a tag `curv` or `para`."""
    x = np.linspace(0, 1, CODES)
    if tag[:4] == b"curv":
        (count,) = struct.unpack_from(">I", tag, 8)
        if count == 0:
            return x
        if count == 1:
            return np.asarray(x ** (struct.unpack_from(">H", tag, 12)[0] / 256))
        if count > CODES:
            raise ValueError("a table that is too long")
        table = np.array(struct.unpack_from(f">{count}H", tag, 12)) / 65535
        return np.interp(x, np.linspace(0, 1, count), table)
    if tag[:4] != b"para":
        raise ValueError("no curve")
    (kind,) = struct.unpack_from(">H", tag, 8)
    p = _fixed(tag, 12, _PARAMETERS[kind])
    g, (a, b) = p[0], p[1:3] if kind else (1.0, 0.0)
    c, e, f = 0.0, 0.0, 0.0
    if kind == 0:
        edge = -np.inf
    elif kind in (1, 2):
        edge = -b / a if a else np.inf
        e = f = p[3] if kind == 2 else 0.0
    else:
        c, edge = p[3], p[4]
        e, f = p[5:7] if kind == 4 else (0.0, 0.0)
    power = np.maximum(a * x + b, 0.0) ** g + e
    return np.where(x >= edge, power, c * x + f)


def _name(tag: bytes) -> str:
    """A profile's description as printable text."""
    text = ""
    if tag[:4] == b"desc" and len(tag) >= 12:
        (length,) = struct.unpack_from(">I", tag, 8)
        text = tag[12 : 12 + min(length, 200)].decode("latin-1")
    elif tag[:4] == b"mluc" and len(tag) >= 28:
        size, place = struct.unpack_from(">II", tag, 20)
        text = tag[place : place + min(size, 400)].decode("utf-16-be", "replace")
    return printable(text.replace("\0", " ")) or "a profile without a name"
