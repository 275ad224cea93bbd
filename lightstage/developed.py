"""Developed pictures (JPEG, PNG, TIFF) back to linear light, as far as they allow it.

A camera's tone curve, its sharpening and its denoising stay in them; clipped colours are only
counted. OpenCV decodes, tifffile reads a TIFF's fields; the meaning of display values is taken
from the ICC profile, else from sRGB.
"""

from __future__ import annotations

import dataclasses
import io
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import tifffile

from lightstage.containers import FRAMES, JPEG_HEAD, PNG_HEAD, chunks, segments
from lightstage.errors import FormatError
from lightstage.exif import read_exif
from lightstage.formats.icc import Profile, read_profile, srgb
from lightstage.formats.orientation import OF_TIFF
from lightstage.photo_file import identify_file
from lightstage.tiff import Reader

_ICC_PART = b"ICC_PROFILE\0"
"""Head of a JPEG's segment APP2 that holds a part of the profile; its number and how many there are
follow, a byte each [ICC2022]."""
TIFF_HEADS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
BITS = (8, 16)
BLACK_IS_ZERO, RGB, YCBCR = 1, 2, 6
"""PhotometricInterpretation of pictures that are taken [TIFF1992]."""
_KINDS = {0: "grey, with white at 0", 3: "of a palette", 8: "in CIELAB"}
"""Others, by name."""
_KIND_HINT = "Export it as RGB with 16 bits."
_PNG_ALPHA, _PNG_COLOUR = 4, 2
"""Bits of a PNG's colour type."""
SRGB_GAMMA = 45455
"""A PNG's gAMA for sRGB, times 100,000."""
EXPECTED = "red, green and blue of 8 or 16 bits"
MOST_PIXELS = 300_000_000
"""Of a picture: a header that claims more would take all memory before the picture is known to be
damaged."""


MOST_PROFILE = 2**24
"""Bytes of an unpacked profile: a few bytes of a damaged one may unpack to any number."""


@dataclasses.dataclass(frozen=True)
class Developed:
    """A developed picture's linear light.

    Attributes:
        rgb: (h, w, 3) float32 linear sRGB, upright, 1 = the picture's white.
        kind: ``JPEG``, ``PNG`` or ``TIFF``.
        bits: 8 or 16.
        profile: name of the ICC profile; ``sRGB`` also where there is none.
        has_profile: whether there was a profile.
        clipped: share of pixels with a colour at white.
        exposure: seconds * ISO / f-number^2; None where the file does not state it.
    """

    rgb: np.ndarray
    kind: str
    bits: int
    profile: str
    has_profile: bool
    clipped: float
    exposure: float | None


def developed_kind(path: Path) -> str | None:
    """``JPEG``, ``PNG`` or ``TIFF`` by a file's bytes; None for a RAW, OpenEXR or anything else.

    Raises:
        OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        head = file.read(16)
    if head.startswith(JPEG_HEAD):
        return "JPEG"
    if head.startswith(PNG_HEAD):
        return "PNG"
    if not head.startswith(TIFF_HEADS):
        return None
    try:
        identify_file(path)
    except FormatError as error:
        # A RAW that is cut is a RAW.
        return None if "truncated" in error.hint else "TIFF"
    return None


def read_developed(path: Path, *, grey: bool = False) -> Developed:
    """Read a JPEG, PNG or TIFF.

    Args:
        path: the file.
        grey: take a grey picture too, as three equal colours with sRGB's curve.

    Raises:
        FormatError: another kind of file, a damaged one, transparent, grey or CMYK, of other than 8
            or 16 bits, of more than `MOST_PIXELS`, or of a colour profile that cannot be used.
        OSError: the file cannot be read.
    """
    kind = developed_kind(path)
    data = path.read_bytes()
    if kind == "JPEG":
        _check_jpeg(data, path, grey)
    elif kind == "PNG":
        _check_png(data, path, grey)
    elif kind != "TIFF":
        raise FormatError(
            path,
            found=_other_kind(data),
            expected="a JPEG, PNG or TIFF",
            hint="Copy it again, or export it as one of these.",
        )
    profile, opaque = _check_tiff(data, path, grey) if kind == "TIFF" else (None, False)
    embedded = _jpeg_profile(data) if kind == "JPEG" else None
    if kind == "PNG":
        embedded, data = _png_profile(data)
    pixels = _decoded(data, path)
    if grey and pixels.ndim == 2:
        pixels, profile, embedded = np.repeat(pixels[..., None], 3, axis=2), None, None
    codes = _colours(pixels, path, opaque=opaque)
    exif = read_exif(path)
    if kind != "TIFF" and exif.orientation is not None:  # OpenCV turns TIFFs itself
        codes = np.ascontiguousarray(OF_TIFF[exif.orientation].upright(codes))
    raw = embedded if profile is None else profile
    if raw is None and kind == "PNG":
        _check_gamma(data, path)
    meaning: Profile = srgb() if raw is None else read_profile(raw, path)
    most = np.iinfo(codes.dtype).max
    return Developed(
        meaning.linear(codes),
        kind,
        codes.dtype.itemsize * 8,
        meaning.name,
        raw is not None,
        float((codes == most).any(axis=2).mean()),
        exif.exposure,
    )


def _refused(path: Path, found: str, hint: str = "") -> FormatError:
    return FormatError(path, found=found, expected=EXPECTED, hint=hint)


def _other_kind(data: bytes) -> str:
    """What a file is that is no JPEG, PNG or TIFF, or none that is whole."""
    if not data:
        return "an empty file"
    if data.startswith(TIFF_HEADS):
        return "a RAW photograph, or a TIFF that is truncated"
    return "a HEIC or AVIF" if data[4:8] == b"ftyp" else "another kind of file"


_CMYK = "Printing inks do not give light: export the picture as RGB with 16 bits."


def _check_size(width: int, height: int, path: Path) -> None:
    """Refuse a picture whose size by its header is too large to be decoded."""
    if width * height > MOST_PIXELS:
        raise FormatError(
            path,
            found=f"{width} x {height} pixels",
            expected=f"at most {MOST_PIXELS // 10**6} megapixels",
            hint="Make the picture smaller.",
        )


def _check_jpeg(data: bytes, path: Path, grey: bool = False) -> None:
    reader = Reader(io.BytesIO(data))
    for marker, place, size in segments(reader, 2):
        if marker in FRAMES and size >= 6:
            bits, height, width, components = struct.unpack(">BHHB", reader.bytes_at(place, 6))
            _check_size(width, height, path)
            if components == 4:
                raise _refused(path, "a JPEG in CMYK", _CMYK)
            if components != 3 and not (grey and components == 1):
                raise _refused(path, "a grey JPEG" if components == 1 else "no colours")
            if bits != 8:
                raise _refused(path, f"a JPEG of {bits} bits")
            return
    raise _damaged(path)


def _jpeg_profile(data: bytes) -> bytes | None:
    """A JPEG's ICC profile, joined of its parts.

    OpenCV takes every segment APP2 for a part of it: cameras and telephones also keep lists of
    further pictures there (MPF), and maps of gain.
    """
    parts: dict[int, bytes] = {}
    for marker, place, size in segments(Reader(io.BytesIO(data)), 2):
        part = data[place : place + size] if marker == 0xE2 else b""
        if part.startswith(_ICC_PART) and len(part) > len(_ICC_PART) + 2:
            parts[part[len(_ICC_PART)]] = part[len(_ICC_PART) + 2 :]
    return b"".join(parts[number] for number in sorted(parts)) or None


def _png_profile(data: bytes) -> tuple[bytes | None, bytes]:
    """A PNG's ICC profile, and the PNG without it.

    libpng leaves out profiles that it holds for damaged, so that they would pass for sRGB, and
    prints lines of its own about others.
    """
    for kind, place, size in chunks(Reader(io.BytesIO(data))):
        if kind == b"iCCP":
            _, _, packed = data[place : place + size].partition(b"\0")  # behind the profile's name
            try:
                # The first byte is the method of compression, of which there is one.
                profile = zlib.decompressobj().decompress(packed[1:], MOST_PROFILE)
            except zlib.error:
                profile = b""
            return profile, data[: place - 8] + data[place + size + 4 :]
    return None, data


def _check_png(data: bytes, path: Path, grey: bool = False) -> None:
    if len(data) < 26:
        raise _damaged(path)
    width, height = struct.unpack(">II", data[16:24])
    _check_size(width, height, path)
    bits, colour_type = data[24], data[25]
    if not colour_type & _PNG_COLOUR and not grey:
        raise _refused(path, "a grey PNG")
    if bits not in BITS:
        raise _refused(path, f"a PNG of {bits} bits")


def _check_gamma(data: bytes, path: Path) -> None:
    """Refuse a PNG without a profile whose own chunks deny that it is sRGB."""
    reader = Reader(io.BytesIO(data))
    found = {kind: reader.bytes_at(place, min(size, 4)) for kind, place, size in chunks(reader)}
    if b"sRGB" in found or len(found.get(b"gAMA", b"")) < 4:
        return
    gamma = int.from_bytes(found[b"gAMA"], "big")
    if abs(gamma - SRGB_GAMMA) > 0.02 * SRGB_GAMMA:
        raise _refused(
            path,
            f"a PNG of gamma {gamma / 1e5:g} without an ICC profile",
            "Embed the profile, or export as sRGB; linear light belongs into an OpenEXR.",
        )


def _check_tiff(data: bytes, path: Path, grey: bool = False) -> tuple[bytes | None, bool]:
    """A TIFF's ICC profile, and whether what it has beside three colours is no transparency."""
    try:
        with tifffile.TiffFile(io.BytesIO(data)) as file:
            page = file.pages[0]
            tags = {tag.code: tag.value for tag in page.tags}
            photometric, bits = int(page.photometric), int(page.bitspersample)
            samples, format_ = int(page.samplesperpixel), int(page.sampleformat)
            extra = [int(e) for e in page.extrasamples]
            width, height = int(page.imagewidth), int(page.imagelength)
    # Damaged directories end tifffile in errors of many kinds.
    except Exception:
        raise _damaged(path) from None
    if photometric == 5:
        raise _refused(path, "a TIFF in CMYK", _CMYK)
    _check_size(width, height, path)
    plain = grey and photometric == BLACK_IS_ZERO and samples == 1
    if not plain and (photometric not in (RGB, YCBCR) or samples - len(extra) != 3):
        what = "grey" if samples - len(extra) == 1 else f"of colours of kind {photometric}"
        raise _refused(path, f"a TIFF that is {_KINDS.get(photometric, what)}", _KIND_HINT)
    if bits not in BITS or format_ != 1:
        found = f"a TIFF of {bits} bit {'floats' if format_ == 3 else 'numbers'}"
        raise _refused(path, found, "Linear light in floats belongs into an OpenEXR.")
    profile = tags.get(34675)
    return (bytes(profile) if isinstance(profile, bytes) else None), extra == [0]


def _damaged(path: Path) -> FormatError:
    return FormatError(
        path,
        found="a damaged picture",
        expected="a whole JPEG, PNG or TIFF",
        hint="Copy it again; a compression that few programs read must be undone first.",
    )


def _decoded(data: bytes, path: Path) -> np.ndarray:
    """A picture's pixels as OpenCV reads them."""
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        raise _damaged(path) from None
    finally:
        cv2.utils.logging.setLogLevel(level)
    if pixels is None:
        raise _damaged(path)
    return np.asarray(pixels)


def _colours(pixels: np.ndarray, path: Path, *, opaque: bool) -> np.ndarray:
    """(h, w, 3) red, green, blue of what OpenCV read; an opaque fourth channel is left out."""
    if pixels.ndim != 3 or pixels.shape[2] not in (3, 4) or pixels.dtype.itemsize * 8 not in BITS:
        raise _refused(path, f"{pixels.dtype} values of shape {pixels.shape}")
    if pixels.shape[2] == 4 and not opaque:
        clear = pixels[..., 3] < np.iinfo(pixels.dtype).max
        if clear.any():
            raise _refused(
                path,
                f"a picture that is transparent in {100 * float(clear.mean()):.3g} % of its pixels",
                "What is behind is not known: flatten the picture, or take the one before it "
                "was cut out.",
            )
    return pixels[..., 2::-1]
