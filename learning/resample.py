"""A texture brought to the size that a network was trained on.

Pores and freckles have one size in texels for a network, so a texture of another size is resampled
before it is inferred from, and the maps come out in the network's size.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from learning.errors import MapsError
from learning.infer_checks import require_size


def resampled_texture(
    image: np.ndarray, rows: int, where: str | Path
) -> tuple[np.ndarray, list[str]]:
    """Resample a texture to a number of rows, its proportions kept.

    Black texels were not photographed: they are left out of every mean, so that the borders of
    what was photographed do not darken, and stay black where they are the larger part.

    Args:
        image: (h, w, 3) linear.
        rows: of the result.
        where: what to name in an error.

    Returns:
        (rows, round(w rows / h), 3) float32, and what was done in words, for the command's facts.

    Raises:
        MapsError: a texture so narrow that nothing of it would be left, or so wide that the result
            would be too large.
    """
    height, width = image.shape[:2]
    if height == rows:
        return image, []
    columns = round(width * rows / height)
    require_size(rows, columns, where)
    if columns < 1:
        raise MapsError(where, found=f"{height} x {width} texels", expected="a whole texture")
    # Means over what a texel covers where it shrinks; straight lines between texels where it grows.
    how = cv2.INTER_AREA if rows < height else cv2.INTER_LINEAR
    seen = (image.max(axis=2) > 0).astype(np.float32)
    share = cv2.resize(seen, (columns, rows), interpolation=how)
    mean = cv2.resize(image.astype(np.float32), (columns, rows), interpolation=how)
    kept = share >= 0.5
    made = np.where(kept[..., None], mean / np.where(kept, share, 1.0)[..., None], 0.0)
    note = f"resampled from {height} x {width} texels to the {rows} rows the network was trained on"
    return made.astype(np.float32), [note]
