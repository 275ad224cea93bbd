"""A photograph as a face is searched for in it: sRGB of 8 bits, upright, whatever else it holds."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from lightstage.developed import developed_kind
from lightstage.errors import FormatError
from lightstage.formats.values import open_regular

EXPECTED = "a JPEG, PNG or TIFF"


def read_photo(path: Path) -> np.ndarray:
    """Read a JPEG, PNG or TIFF for the detector.

    What the detector does not need is removed: grey becomes colour, 16 bits become 8,
    transparency is left out, and a colour profile counts for nothing. A JPEG is turned by its own
    mark.

    Returns:
        (h, w, 3) uint8, red green blue.

    Raises:
        FormatError: another kind of file, or a damaged one.
    """
    import cv2

    # Its type is checked before it is opened: a pipe would be waited for.
    os.close(open_regular(path, EXPECTED))
    kind = developed_kind(path)
    if kind is None:
        raise FormatError(
            path,
            found="another kind of file",
            expected=EXPECTED,
            hint="Develop a RAW, or export linear light, to one of these first.",
        )
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        picture = cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), cv2.IMREAD_COLOR_RGB)
    except cv2.error:
        picture = None
    finally:
        cv2.utils.logging.setLogLevel(level)
    if picture is None or picture.dtype != np.uint8 or picture.ndim != 3:
        raise FormatError(
            path,
            found=f"a {kind} that cannot be read",
            expected="a whole JPEG, PNG or TIFF",
            hint="Is it damaged? Open it in another program and save it again.",
        )
    return np.asarray(picture)
