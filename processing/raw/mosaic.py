"""A Bayer mosaic to linear colour: one pass over a window, row after row, in one thread.

Green minus red or blue is estimated along rows and along columns at every pixel, smoothed along the
same direction, and the two are weighed by how little each differs from its smoothed self: the idea
of directional colour differences [Zhang2005], with weights and filters of our own. Red and blue are
green minus the differences interpolated between their own pixels.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from processing.frames.window import Window
from processing.raw.bayer import SIDE, develop


@dataclasses.dataclass(frozen=True)
class Development:
    """How counts become linear colour.

    Attributes:
        colours: (2, 2) int64, which of R G B (0, 1, 2) the mosaic's four places see.
        black: (2, 2) float32 counts without light of those places.
        gain: (2, 2) float32, what a count above black is multiplied by before the demosaic: grey
            reads the same in all colours and about 1 at the white level.
        limit: (2, 2) float32, counts from which a place is clipped.
        coefficients: (3, 6) float32 from r, g, b, sqrt(rg), sqrt(gb), sqrt(rb) after `gain` to what
            is written.
    """

    colours: np.ndarray
    black: np.ndarray
    gain: np.ndarray
    limit: np.ndarray
    coefficients: np.ndarray

    @property
    def bent(self) -> bool:
        """Whether the roots are used."""
        return bool(self.coefficients[:, 3:].any())


def development(
    colours: np.ndarray,
    black: np.ndarray,
    white: float,
    span: float,
    clip_share: float,
    coefficients: np.ndarray,
    factor: float,
) -> Development:
    """Put a sensor's levels and a camera's colours into one set of numbers.

    Args:
        colours: (2, 2), see Development.
        black: (2, 2) counts without light.
        white: count at which the sensor is full.
        span: counts that are 1 above black, in all places (`RawFile.span`).
        clip_share: counts of at least this share of the white level (above black) are clipped.
        coefficients: (3, 6) from counts above black as a share of white, and their roots, to linear
            rgb (`ColourCorrection.coefficients`).
        factor: on the results, such as 1 / scale of the half floats.
    """
    balance = neutral_gains(coefficients[:, :3])
    undo = np.sqrt(balance[[0, 1, 0]] * balance[[1, 2, 2]])
    turned = np.concatenate([coefficients[:, :3] / balance, coefficients[:, 3:] / undo], axis=1)
    return Development(
        np.ascontiguousarray(colours, np.int64),
        np.ascontiguousarray(black, np.float32),
        np.ascontiguousarray(balance[colours] / span, np.float32),
        np.ascontiguousarray(black + clip_share * (white - black), np.float32),
        np.ascontiguousarray(turned * factor, np.float32),
    )


def neutral_gains(matrix: np.ndarray) -> np.ndarray:
    """(3,) gains that make what the matrix calls white grey, green's 1; ones where none do."""
    try:
        raw = np.linalg.solve(matrix, np.ones(3))
    except np.linalg.LinAlgError:
        return np.ones(3)
    usable = np.isfinite(raw).all() and raw.min() > 0.02 * abs(raw).max()
    return raw[1] / raw if usable else np.ones(3)


def develop_mosaic(
    counts: np.ndarray,
    origin: tuple[int, int],
    size: tuple[int, int],
    window: Window,
    how: Development,
    flat: np.ndarray | None,
    ambient: np.ndarray | None,
    out: np.ndarray,
    clipped: np.ndarray,
) -> None:
    """Develop a window of a mosaic.

    Args:
        counts: (H', W') uint16, all that the file holds.
        origin: row and column in `counts` of the picture's top left pixel.
        size: rows and columns of the picture.
        window: of the picture.
        how: levels and colours; its 2 x 2 places begin at the picture's top left pixel.
        flat: float32 gains of the pixels of `window.grown(SIDE, size)`; None for 1.
        ambient: (h, w, 3) float32 that is taken off what is written; None for nothing.
        out: (h, w, 3) float16, overwritten.
        clipped: (h, w) uint8; bits 1, 2, 4 are added where red, green, blue is clipped.
    """
    if min(size) < 2:
        raise ValueError(f"a mosaic of {size} pixels")
    if not window.inside(size) or window.empty:
        raise ValueError(f"{window} in a picture of {size}")
    if flat is not None and flat.shape != window.grown(SIDE, size).shape:
        raise ValueError(f"gains of {flat.shape}, wanted {window.grown(SIDE, size).shape}")
    develop(
        np.ascontiguousarray(counts),
        origin,
        size,
        (window.top, window.left, window.height, window.width),
        how.colours,
        how.black,
        how.gain,
        how.limit,
        how.coefficients,
        how.bent,
        np.zeros((0, 0), np.float32) if flat is None else flat,
        np.zeros((0, 0, 0), np.float32) if ambient is None else ambient,
        out.view(np.uint16),
        clipped,
    )
