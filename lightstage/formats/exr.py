"""OpenEXR pictures: scene-linear maps with channels R G B or Y."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import OpenEXR

from lightstage.counting import counted
from lightstage.errors import FormatError
from lightstage.failures import free_bytes
from lightstage.formats.files import atomic_path
from lightstage.formats.paths import require_utf8

MAGIC = bytes((0x76, 0x2F, 0x31, 0x01))
MOST_PIXELS = 2**28
"""Of a picture around a file's window: a damaged header states any."""
OTHER_LAYOUT = 0x1A
"""Bits of the version's second byte: tiles, deep pixels, several parts [OpenEXR24]."""
BLOCK_LINES = (1, 1, 1, 16, 32, 16, 32, 32, 32, 256)
"""Lines of one block, by the header's number of the compression [OpenEXR24]."""
LONGEST_NAME = 255
PRIVATE = ("owner", "comments", "latitude", "longitude")
"""Standard attributes that may name a person or a place [OpenEXR24]."""
SRGB_PRIMARIES = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)
"""Chromaticities x, y of sRGB's red, green, blue and white [IEC61966]."""
MOST_SHOWN = 100
"""Characters of the parts' names that a message repeats."""
FULL_BYTES = 2**20
"""A disk with less room than this after a picture was written may have been full before its end."""


def write_exr(path: Path, image: np.ndarray, *, half: bool = True) -> Path:
    """Write a picture atomically.

    Args:
        path: target, ending in .exr.
        image: (h, w), (h, w, 1) or (h, w, 3), any float; row 0 is the top of the picture. Half
            floats are written as they are.
        half: 16-bit floats (eleven bits of precision, at most 65504); else 32-bit.

    Returns:
        `path`.

    Raises:
        FormatError: another shape, or values that do not fit into half floats.
    """
    pixels = np.asarray(image)
    if pixels.ndim == 3 and pixels.shape[2] == 1:
        pixels = pixels[:, :, 0]
    if not (pixels.ndim == 2 or (pixels.ndim == 3 and pixels.shape[2] == 3)) or pixels.size == 0:
        raise FormatError(path, found=f"shape {pixels.shape}", expected="(h, w), (h, w, 1 or 3)")
    pixels = _narrowed(pixels, path) if half else _floats(pixels)
    channels = {"Y": pixels} if pixels.ndim == 2 else {"RGB": pixels}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with atomic_path(path) as beside, OpenEXR.File(header, channels) as file:
        file.write(str(beside))
        if free_bytes(path) < FULL_BYTES and not _is_whole(beside, pixels.shape[:2]):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
    return path


def _is_whole(path: Path, size: tuple[int, ...]) -> bool:
    """Whether a picture can be read back: OpenEXR passes over a disk that is full at the end."""
    try:
        return _stored(path).shape[:2] == size
    except FormatError:
        return False


def read_exr(path: Path, *, finite: bool = False) -> np.ndarray:
    """Read a picture.

    Args:
        path: the file.
        finite: refuse NaN and infinities.

    Returns:
        (h, w, 3) or (h, w) float32.

    Raises:
        FormatError: missing, truncated, other channels than R G B or Y or several parts with them,
            or not finite.
    """
    stored = _stored(path)
    if stored.dtype == np.float16:
        from lightstage.formats.half import float_from_half

        image, whole = float_from_half(stored)
    else:
        image = np.array(stored, np.float32, order="C")
        whole = not finite or bool(np.isfinite(image).all())
    if finite and not whole:
        require_finite(image, path)
    return image


def read_half_exr(path: Path) -> np.ndarray:
    """Read a picture as it is stored, in half floats: half the memory of `read_exr`.

    Args:
        path: the file; wider numbers are rounded.

    Returns:
        (h, w, 3) or (h, w) float16, finite.

    Raises:
        FormatError: as `read_exr`, or beyond what half floats hold.
    """
    stored = _stored(path)
    if stored.dtype == np.float16:
        from lightstage.formats.half import is_finite

        half = np.ascontiguousarray(stored)
        if not is_finite(half):
            require_finite(half, path)
        return half
    wide = np.array(stored, np.float32, order="C")
    require_finite(wide, path)
    return _narrowed(wide, path)


def _floats(image: np.ndarray) -> np.ndarray:
    """The picture in float32, C-contiguous; what is too large becomes infinite."""
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(image, np.float32)


def _narrowed(image: np.ndarray, where: Path) -> np.ndarray:
    from lightstage.formats.half import half_from_float, has_infinity

    if image.dtype == np.float16:
        half = np.ascontiguousarray(image)
        fits = not has_infinity(half)
    else:
        half, fits = half_from_float(_floats(image))
    if not fits:
        raise FormatError(where, found="values above 65504", expected="values that half can hold")
    return half


def _stored(path: Path) -> np.ndarray:
    """The channels R G B or Y as the file has them."""
    if not path.is_file():
        raise FormatError(path, found="no such file", expected="an OpenEXR picture")
    require_utf8(path)
    with path.open("rb") as handle:
        begins = handle.read(len(MAGIC))
    if begins != MAGIC:
        raise FormatError(path, found="something else", expected="an OpenEXR picture")
    if _is_cut(path):
        raise FormatError(
            path,
            found=f"an OpenEXR picture that ends after {path.stat().st_size} bytes",
            expected="all of its lines",
            hint="Was it cut short? Copy or render it again.",
        )
    try:
        with OpenEXR.File(str(path)) as file:
            parts = [
                (
                    str(part.name()),
                    {name: channel.pixels for name, channel in part.channels.items()},
                    [part.header.get(name) for name in ("dataWindow", "displayWindow")],
                )
                for part in file.parts
            ]
    except Exception as error:  # OpenEXR raises bare RuntimeError and ValueError on damage
        if "pixel type" in str(error):
            raise FormatError(
                path,
                found="channels of one picture in half and in full floats",
                expected="all of them in half floats, or all in full",
                hint="Export it again with one type for all channels.",
            ) from None
        raise FormatError(
            path,
            found=str(error).strip().splitlines()[-1],
            expected="a whole OpenEXR file",
            hint="Is the file truncated? Copy or render it again.",
        ) from None
    pixels, windows = _picture(parts, path)
    return _displayed(pixels[:, :, :3] if pixels.ndim == 3 else pixels, windows)


def _picture(
    parts: list[tuple[str, dict[str, np.ndarray], list[Any]]], path: Path
) -> tuple[np.ndarray, list[Any]]:
    """The pixels and windows of the part that holds the picture: the one with R G B, else with Y.

    Programs write depth, masks and other layers as parts of their own, in any order.

    Args:
        parts: of the file: name, pixels by channel, data window and display window.
        path: the file, for errors.

    Raises:
        FormatError: no such part, or several; deep pixels; luminance and chroma.
    """
    for keys in (("RGB", "RGBA"), ("Y",)):
        holding = [part for part in parts if set(keys) & part[1].keys()]
        if len(holding) > 1:
            raise FormatError(
                path,
                found=f"{len(holding)} parts that hold {' '.join(keys[0])}: "
                + ", ".join(ascii(name) for name, _, _ in holding)[:MOST_SHOWN],
                expected="one part with R G B, or with Y",
                hint="Export the part that is meant as a file of its own.",
            )
        for _, channels, windows in holding:
            if {"RY", "BY"} & channels.keys():
                raise FormatError(
                    path,
                    found="luminance and chroma (Y RY BY)",
                    expected="R G B or Y",
                    hint="Export it again as RGB.",
                )
            if {"X", "Y"} <= channels.keys():  # Y alone is one of three here
                raise _other_channels(parts, path)
            pixels = channels[next(key for key in keys if key in channels)]
            if pixels.dtype == object:
                raise FormatError(
                    path,
                    found="deep pixels, of several samples each",
                    expected="one value a pixel",
                    hint="Flatten the picture and export it again.",
                )
            return pixels, windows
    raise _other_channels(parts, path)


def _other_channels(
    parts: list[tuple[str, dict[str, np.ndarray], list[Any]]], path: Path
) -> FormatError:
    """The error of a file whose channels have other names, which it lists as the file has them."""
    names: set[str] = set()
    for _, channels, _ in parts:
        for name, pixels in channels.items():
            colours = "RGBA"[: pixels.shape[2]] if pixels.ndim == 3 else ""
            names |= {f"{name}.{colour}" for colour in colours} or {name}
    return FormatError(
        path,
        found=f"channels {' '.join(sorted(names))}"[:MOST_SHOWN],
        expected="R G B or Y, by these names",
        hint="Rename its channels, or export the layer that is meant alone: capital letters "
        "without a layer's name before them.",
    )


def other_primaries(path: Path) -> str:
    """What a readable OpenEXR file gives as its colours where they are not sRGB's; else nothing.

    A file without the attribute has the primaries of sRGB [OpenEXR24].
    """
    with OpenEXR.File(str(path), header_only=True) as file:
        given = [part.header.get("chromaticities") for part in file.parts]
    for values in given:
        if values is not None and np.abs(np.subtract(values, SRGB_PRIMARIES)).max() > 0.003:
            pairs = np.reshape(values, (4, 2))
            colours = zip(("red", "green", "blue", "white"), pairs, strict=True)
            return ", ".join(f"{name} ({x:.4g}, {y:.4g})" for name, (x, y) in colours)
    return ""


def private_attributes(path: Path) -> tuple[str, ...]:
    """Names of the attributes of a readable OpenEXR file that may reveal who or where."""
    with OpenEXR.File(str(path), header_only=True) as file:  # which empties them at its end
        headers = [dict(part.header) for part in file.parts]
    return tuple(
        name for name in PRIVATE if any(header.get(name) not in (None, "") for header in headers)
    )


def _displayed(pixels: np.ndarray, windows: list[Any]) -> np.ndarray:
    """The whole picture of which a file holds a window: black around it, nothing beyond.

    A window of the picture's own size is the picture, wherever it is said to be.
    """
    if any(window is None for window in windows):
        return pixels
    (left, top), (right, bottom) = (np.asarray(corner, int) for corner in windows[0])
    (first_x, first_y), (last_x, last_y) = (np.asarray(corner, int) for corner in windows[1])
    rows, columns = last_y - first_y + 1, last_x - first_x + 1
    if (rows, columns) == pixels.shape[:2] or not 0 < rows * columns <= MOST_PIXELS:
        return pixels
    out = np.zeros((rows, columns, *pixels.shape[2:]), pixels.dtype)
    y0, x0 = max(top, first_y), max(left, first_x)
    y1, x1 = min(bottom, last_y) + 1, min(right, last_x) + 1
    if y1 > y0 and x1 > x0:
        part = pixels[y0 - top : y1 - top, x0 - left : x1 - left]
        out[y0 - first_y : y1 - first_y, x0 - first_x : x1 - first_x] = part
    return out


def _is_cut(path: Path) -> bool:
    """Whether a scan-line picture ends before all of its blocks of lines.

    OpenEXR would report it too, but prints lines of its own to the terminal beside. It is used
    where the header is damaged or of another layout.
    """
    size = path.stat().st_size
    with path.open("rb") as handle:
        if size < 8 or handle.read(8)[5] & OTHER_LAYOUT:
            return size < 8
        header: dict[bytes, bytes] = {}
        while name := _text(handle):
            _text(handle)
            header[name] = handle.read(int.from_bytes(handle.read(4), "little"))
        if handle.tell() >= size:
            return True
        window, compression = header.get(b"dataWindow", b""), header.get(b"compression", b"")
        if len(window) != 16 or len(compression) != 1 or compression[0] >= len(BLOCK_LINES):
            return False
        _, top, _, bottom = np.frombuffer(window, "<i4").tolist()
        blocks = -(-(bottom - top + 1) // BLOCK_LINES[compression[0]])
        if blocks < 1:
            return False
        table = handle.read(8 * min(blocks, size))
        starts = np.frombuffer(table[: len(table) // 8 * 8], "<u8").tolist()
        if len(starts) < blocks or not all(starts):
            return True
        handle.seek(min(max(starts) + 4, size))
        return max(starts) + 8 + int.from_bytes(handle.read(4), "little") > size


def _text(handle: BinaryIO) -> bytes:
    """The next zero-terminated string of a header, cut at the longest that there may be."""
    found = b""
    while (byte := handle.read(1)) not in (b"", b"\0") and len(found) < LONGEST_NAME:
        found += byte
    return found


def require_finite(image: np.ndarray, where: str | Path) -> None:
    """FormatError when a (h, w[, c]) array holds NaN or an infinity; it names the first place."""
    bad = ~np.isfinite(image)
    if bad.any():
        first = tuple(int(i) for i in np.argwhere(bad)[0])
        raise FormatError(
            where,
            field=f"element {first}",
            found=counted(int(bad.sum()), "NaN or infinite value"),
            expected="finite numbers",
            hint="Mask such texels (0) before passing the map on.",
        )
