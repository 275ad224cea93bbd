"""PNG files of 8-bit and 16-bit pictures: encoded in memory, then written whole.

OpenCV's own writer returns False where a disk is full or a folder is missing; the bytes written
here raise the system's own error.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from lightstage.errors import FormatError
from lightstage.formats.files import write_bytes


def write_png(path: Path, pixels: np.ndarray, options: Sequence[int] = ()) -> Path:
    """Write a picture as PNG, atomically.

    Args:
        path: the file.
        pixels: (h, w), (h, w, 3) red green blue, or (h, w, 4) with alpha last; uint8 or uint16.
        options: OpenCV's `IMWRITE_PNG_..` in pairs.

    Returns:
        `path`.

    Raises:
        FormatError: another type or shape.
        DiskFullError: no room for it.
    """
    return write_bytes(path, png_bytes(pixels, path, options))


def png_bytes(pixels: np.ndarray, where: str | Path, options: Sequence[int] = ()) -> bytes:
    """A picture as the bytes of a PNG file; arguments and errors as `write_png`.

    Args:
        pixels: (h, w[, c]), the picture.
        where: what to name in an error.
        options: OpenCV's.
    """
    channels = pixels.shape[2] if pixels.ndim == 3 else 1
    kept = pixels.dtype in (np.uint8, np.uint16)
    if not kept or pixels.ndim not in (2, 3) or channels not in (1, 3, 4):
        raise FormatError(
            where,
            found=f"{pixels.dtype} {pixels.shape}",
            expected="uint8 or uint16 of (h, w), (h, w, 3) or (h, w, 4)",
        )
    order = {1: [0], 3: [2, 1, 0], 4: [2, 1, 0, 3]}[channels]
    turned = pixels if pixels.ndim == 2 else pixels[:, :, order]
    done, data = (False, None) if pixels.size == 0 else cv2.imencode(".png", turned, options)
    if not done or data is None:
        raise FormatError(where, found=f"shape {pixels.shape}", expected="a picture PNG can hold")
    return bytes(data.tobytes())
