"""What other settings of the camera make of a photograph, in the DNG's own bytes."""

from __future__ import annotations

import struct
from fractions import Fraction

from sim.errors import SimError

WIDTH, HEIGHT, COMPRESSION, EXIF, ISO = 256, 257, 259, 34665, 34855
STRIP_OFFSETS, STRIP_BYTES, BLACK, WHITE = 273, 279, 50714, 50717
TIME, STOP, TAKEN, SUBSECONDS, SERIAL = 33434, 33437, 36867, 37521, 42033
_LETTERS = {1: "B", 3: "H", 4: "I"}
_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 7: 1}


def exposure_gain(iso: str, shutter: str, aperture: str) -> float:
    """Counts for one unit of light, up to a constant of the sensor: ISO t / N^2.

    Args:
        iso: such as ``100``.
        shutter: seconds, such as ``1/60`` or ``0.5``.
        aperture: such as ``f/8``.

    Raises:
        SimError: a text that is none of these, or not positive.
    """
    try:
        number = Fraction(aperture.removeprefix("f/"))
        gain = float(Fraction(iso) * Fraction(shutter) / number**2)
    except (ValueError, ZeroDivisionError):
        gain = 0.0
    if not gain > 0:
        raise SimError(
            "camera settings",
            field="iso, shutter, aperture",
            found=f"{iso}, {shutter}, {aperture}",
            expected='numbers such as "100", "1/60", "f/8"',
        )
    return gain


def expose_again(dng: bytes, gain: float, iso: str) -> bytes:
    """The same photograph under other settings: counts above black times `gain`, clipped.

    Noise is scaled with the light: what a wrong setting shows is its level, not its grain.

    Args:
        dng: a little-endian DNG of uncompressed 16-bit counts.
        gain: of counts above the black level.
        iso: for the EXIF tag, where there is one.

    Raises:
        SimError: another kind of file.
    """
    data = bytearray(dng)
    tags = _entries(data, 4)
    if not {STRIP_OFFSETS, STRIP_BYTES, BLACK, WHITE} <= set(tags) or tags.get(COMPRESSION) != [1]:
        raise SimError("photograph", found="another kind of file", expected="an uncompressed DNG")
    import numpy as np  # a camera's process at its own settings starts sooner

    black, white = float(np.mean(tags[BLACK])), tags[WHITE][0]
    for offset, size in zip(tags[STRIP_OFFSETS], tags[STRIP_BYTES], strict=True):
        counts = np.frombuffer(data, "<u2", size // 2, offset)
        exposed = np.clip(np.round(black + (counts - black) * gain), 0, white).astype("<u2")
        data[offset : offset + size] = exposed.tobytes()
    return with_exposure(bytes(data), iso=iso)


def with_exposure(
    dng: bytes,
    iso: str | None = None,
    shutter: str | None = None,
    aperture: str | None = None,
    serial: str | None = None,
    taken: str | None = None,
    shot: int | None = None,
) -> bytes:
    """The same photograph with what a body writes of itself into its headers.

    Only fields that are there already are written, and none grows: the file keeps its size. A file
    without an EXIF directory comes back as it was.

    Args:
        dng: any bytes; a little-endian TIFF-like file is changed.
        iso: a number.
        shutter: seconds, such as ``1/60`` or ``0.0167s``.
        aperture: such as ``f/8``.
        serial: of the body.
        taken: date and time, EXIF's form.
        shot: how many shots the body has taken; it replaces the thousandths of the second, so
            that one light is never photographed twice in the same bytes.

    Raises:
        SimError: a serial or time longer than the field.
    """
    data = bytearray(dng)
    pointer = _entries(data, 4).get(EXIF)
    if pointer is None:
        return dng
    places = _places(data, pointer[0])
    if iso is not None and ISO in places:
        struct.pack_into("<H", data, places[ISO][2], min(int(Fraction(iso)), 65535))
    for tag, text in ((TIME, shutter), (STOP, aperture)):
        if text is not None and tag in places:
            value = Fraction(text.removeprefix("f/").removesuffix("s")).limit_denominator(10**6)
            struct.pack_into("<II", data, places[tag][2], value.numerator, value.denominator)
    thousandths = None if shot is None else f"{shot % 1000:03d}"
    for tag, text in ((SERIAL, serial), (TAKEN, taken), (SUBSECONDS, thousandths)):
        if text is not None and tag in places:
            _, room, place = places[tag]
            letters = text.encode("ascii", "replace")
            if len(letters) >= room:
                raise SimError(
                    "photograph", found=repr(text), expected=f"at most {room - 1} letters"
                )
            data[place : place + room] = letters.ljust(room, b"\0")
    return bytes(data)


def preview_jpeg(dng: bytes) -> bytes:
    """The small grey picture that a camera puts beside its RAW; SimError on another file."""
    import cv2
    import numpy as np

    tags = _entries(bytearray(dng), 4)
    if not {WIDTH, HEIGHT, STRIP_OFFSETS} <= set(tags) or tags.get(COMPRESSION) != [1]:
        raise SimError("photograph", found="another kind of file", expected="an uncompressed DNG")
    width, height = tags[WIDTH][0], tags[HEIGHT][0]
    strips = zip(tags[STRIP_OFFSETS], tags[STRIP_BYTES], strict=True)
    counts = np.concatenate([np.frombuffer(dng, "<u2", size // 2, at) for at, size in strips])
    small = counts.reshape(height, width)[::4, ::4] >> 6
    _, data = cv2.imencode(".jpg", np.minimum(small, 255).astype(np.uint8))
    return data.tobytes()


def _entries(data: bytearray, pointer: int) -> dict[int, list[int]]:
    """Values of the whole-number tags of the directory to which bytes 4 to 8 point."""
    if data[:4] != b"II*\0":
        return {}
    (directory,) = struct.unpack_from("<I", data, pointer)
    return {
        tag: list(struct.unpack_from(f"<{count}{_LETTERS[kind]}", data, place))
        for tag, (kind, count, place) in _places(data, directory).items()
        if kind in _LETTERS
    }


def _places(data: bytearray, directory: int) -> dict[int, tuple[int, int, int]]:
    """Type, count and place of the values of each tag of the directory at this byte."""
    (length,) = struct.unpack_from("<H", data, directory)
    places = {}
    for index in range(length):
        entry = directory + 2 + 12 * index
        tag, kind, count = struct.unpack_from("<HHI", data, entry)
        place = entry + 8
        if count * _SIZES.get(kind, 0) > 4:
            (place,) = struct.unpack_from("<I", data, place)
        places[tag] = kind, count, place
    return places
