"""A picture enlarged by RCAN, exactly, in tiles.

Channel attention pools over a picture, so the part of the network that has it runs over all of it,
at low resolution: 4 bytes for each channel and texel of the input, some six of those at a time.
What follows sees two texels of the input around itself, and runs in tiles. So no tile shows: any
size of tiles gives the same picture but for rounding.
"""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import torch

from learning.encoding import linear_from_srgb, srgb_from_linear
from learning.errors import MapsError
from learning.maps import from_batch, to_batch
from learning.upscale.network import TAIL_REACH_PX, Rcan
from lightstage.commands import ProgressCallback, quiet

TILE_PX = 128
"""Side of a tile, in texels of the input: the last features of one are 256 MB at 64 channels."""
SMALLEST_PX, MOST_TEXELS = 8, 2**21
"""Bounds of an input: a smaller side has no surroundings to learn from, and more texels need 4 GB
at 64 channels."""


def upscale(
    network: Rcan,
    image: np.ndarray,
    where: str | Path = "picture",
    progress: ProgressCallback = quiet,
) -> np.ndarray:
    """Enlarge a linear picture by `network.config.times`.

    Args:
        network: in evaluation mode.
        image: (h, w, 3) linear, finite. Negative values count as 0.
        where: what to name in an error.
        progress: called with tiles.

    Returns:
        (times h, times w, 3) linear float32, at least 0.

    Raises:
        MapsError: a picture of one channel, too small or too large.
    """
    if image.ndim != 3:
        raise MapsError(where, found="one channel", expected="R G B")
    rows, columns = image.shape[:2]
    if min(rows, columns) < SMALLEST_PX or rows * columns > MOST_TEXELS:
        raise MapsError(
            where,
            found=f"{rows} x {columns} texels",
            expected=f"{SMALLEST_PX} or more on each side, at most {MOST_TEXELS / 1e6:.0f} "
            "million in all",
            hint="Cut a larger picture into parts: attention then differs a little from part to "
            "part.",
        )
    encoded = srgb_from_linear(to_batch(image), float("inf"))
    found = enlarge_encoded(network, from_batch(encoded), progress=progress)
    # Band after band, since the curve needs several times as much memory as what it decodes.
    for band in np.array_split(found, max(1, rows // TILE_PX)):
        band[:] = linear_from_srgb(torch.from_numpy(band).clamp_min(0)).numpy()
    return found


def enlarge_encoded(
    network: Rcan,
    image: np.ndarray,
    tile_px: int = TILE_PX,
    offset_px: tuple[int, int] = (0, 0),
    progress: ProgressCallback = quiet,
) -> np.ndarray:
    """Enlarge an sRGB-encoded picture.

    Args:
        network: in evaluation mode.
        image: (h, w, 3).
        tile_px: side of a tile in texels of the input.
        offset_px: row and column at which the first whole tile begins, less than `tile_px`.
        progress: called with tiles.

    Returns:
        (times h, times w, 3) float32.
    """
    device = network.mean_srgb.device
    rows, columns = image.shape[:2]
    times = network.config.times
    tiles = [
        (down, across)
        for down in _spans(rows, tile_px, offset_px[0])
        for across in _spans(columns, tile_px, offset_px[1])
    ]
    made = np.empty((times * rows, times * columns, 3), np.float32)
    with torch.inference_mode():
        picture = to_batch(image).to(device)
        features = network.features(picture)
        for done, (down, across) in enumerate(tiles):
            (top, bottom), (left, right) = down, across
            first, begin = max(0, top - TAIL_REACH_PX), max(0, left - TAIL_REACH_PX)
            seen = (
                ...,
                slice(first, min(rows, bottom + TAIL_REACH_PX)),
                slice(begin, min(columns, right + TAIL_REACH_PX)),
            )
            tile = network.enlarged(features[seen], picture[seen])
            inner = tile[
                ...,
                times * (top - first) : times * (bottom - first),
                times * (left - begin) : times * (right - begin),
            ]
            place = (
                slice(times * top, times * bottom),
                slice(times * left, times * right),
            )
            made[place] = from_batch(inner)
            progress(done + 1, len(tiles))
    return made


def _spans(length: int, tile_px: int, offset_px: int) -> list[tuple[int, int]]:
    """Where tiles begin and end along an axis."""
    cuts = [0, *range(offset_px or tile_px, length, tile_px), length]
    return list(itertools.pairwise(cuts))
