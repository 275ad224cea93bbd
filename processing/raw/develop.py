"""An opened photograph to linear half floats of a window of the upright picture."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np

from lightstage.formats.flats import FlatField
from lightstage.formats.half import LARGEST
from lightstage.formats.orientation import UNTURNED, Orientation
from processing.colour import ColourCorrection
from processing.frames.drafts import NOT_A_NUMBER
from processing.frames.window import Window
from processing.raw.bayer import CLIP_REACH, REACH, SIDE
from processing.raw.hot_pixels import mend
from processing.raw.mosaic import develop_mosaic, development
from processing.raw.raw_file import RawFile


@dataclasses.dataclass(frozen=True)
class Settings:
    """What turns a camera's counts into light.

    Attributes:
        correction: from counts above black as a share of white to linear rgb.
        factor: on the results: of the exposure, and 1 / scale of the half floats.
        clip_share: counts of at least this share of the white level (above black) are clipped.
        field: flat and dark; None where there is none.
    """

    correction: ColourCorrection
    factor: float
    clip_share: float
    field: FlatField | None = None


def develop(
    raw: RawFile,
    window: Window,
    settings: Settings,
    ambient: np.ndarray | None,
    out: np.ndarray,
    clipped: np.ndarray,
) -> None:
    """Develop a window of the upright picture; other threads run meanwhile.

    Args:
        raw: opened.
        window: of the upright picture.
        settings: see there.
        ambient: (h, w, 3) float32 that is taken off what is written; None for nothing.
        out: (h, w, 3) float16, overwritten.
        clipped: (h, w) uint8; bits 1, 2, 4 are added where red, green, blue is clipped.
    """
    if raw.orientation == UNTURNED:
        _as_read(raw, window, settings, ambient, out, clipped)
        return
    inner = lying(window, raw.size, raw.orientation)
    lit, marks = np.zeros((*inner.shape, 3), np.float16), np.zeros(inner.shape, np.uint8)
    dark = None if ambient is None else np.ascontiguousarray(raw.orientation.as_read(ambient))
    _as_read(raw, inner, settings, dark, lit, marks)
    out[:] = raw.orientation.upright(lit)
    clipped |= raw.orientation.upright(marks)


def lying(window: Window, size: tuple[int, int], orientation: Orientation) -> Window:
    """A window of the upright picture in the rows and columns that the sensor reads.

    Args:
        window: of the upright picture.
        size: rows and columns that the sensor reads.
        orientation: that brings them upright.
    """
    rows, columns = orientation.shape(size)
    corners = (
        orientation.place_as_read(x, y, columns, rows)
        for x, y in (
            (window.left, window.top),
            (window.left + window.width, window.top + window.height),
        )
    )
    (left, right), (top, bottom) = (sorted(map(int, ends)) for ends in zip(*corners, strict=True))
    return Window(top, left, bottom - top, right - left)


def _as_read(
    raw: RawFile,
    window: Window,
    settings: Settings,
    ambient: np.ndarray | None,
    out: np.ndarray,
    clipped: np.ndarray,
) -> None:
    """Develop a window of the picture as the sensor reads it."""
    field, coefficients = settings.field, settings.correction.coefficients
    if raw.colours is None:
        _three(raw, window, settings, ambient, out, clipped)
        return
    wide = window.grown(SIDE, raw.size)
    flat = None if field is None else field.gain(wide.shape, (wide.top, wide.left))
    black = raw.black
    if field is not None:
        if field.black_offset is not None:
            black = black + field.black_offset.reshape(2, 2) * raw.span
        _mend(raw, field.hot_pixels, window)
    how = development(
        raw.colours, black, raw.white, raw.span, settings.clip_share, coefficients, settings.factor
    )
    develop_mosaic(raw.counts, raw.origin, raw.size, window, how, flat, ambient, out, clipped)


def _mend(raw: RawFile, hot: np.ndarray, window: Window) -> None:
    """Replace the hot pixels that a window reaches, in place."""
    near = (
        (hot[:, 0] >= window.top - REACH)
        & (hot[:, 0] < window.top + window.height + REACH)
        & (hot[:, 1] >= window.left - REACH)
        & (hot[:, 1] < window.left + window.width + REACH)
    )
    (top, left), (height, width) = raw.origin, raw.size
    mend(raw.counts[top : top + height, left : left + width], hot, near)


def _three(
    raw: RawFile,
    window: Window,
    settings: Settings,
    ambient: np.ndarray | None,
    out: np.ndarray,
    clipped: np.ndarray,
) -> None:
    """Develop a window in which each pixel has three colours."""
    reach = window.grown(CLIP_REACH, raw.size)
    part = raw.counts[reach.slices].astype(np.float32)
    share = (part - raw.black.astype(np.float32)) / (raw.white - raw.black).astype(np.float32)
    side = 2 * CLIP_REACH + 1
    top, left = window.top - reach.top, window.left - reach.left
    inner = Window(top, left, *window.shape).slices
    for colour in range(3):
        full = (share[..., colour] >= settings.clip_share).astype(np.uint8)
        spread = np.asarray(cv2.dilate(full, np.ones((side, side), np.uint8)), np.uint8)
        clipped |= spread[inner] * np.uint8(1 << colour)
    rgb = share[inner]
    if settings.field is not None:
        rgb = rgb * settings.field.gain(window.shape, (window.top, window.left))[..., None]
    store(settings.correction.scaled(settings.factor).apply(rgb), ambient, out, clipped)


def store(
    rgb: np.ndarray, ambient: np.ndarray | None, out: np.ndarray, clipped: np.ndarray
) -> None:
    """Write (h, w, 3) float32 less `ambient` as halves; what is no number or too large is marked.

    Args:
        rgb: (h, w, 3) float32 on the half floats' scale.
        ambient: the same shape, or None.
        out: (h, w, 3) float16, overwritten, finite.
        clipped: (h, w) uint8, bit `NOT_A_NUMBER` is added.
    """
    less = rgb if ambient is None else rgb - ambient
    good = np.abs(less) <= LARGEST  # false for NaN
    out[:] = np.where(good, less, 0)
    clipped |= np.where(good.all(axis=2), 0, NOT_A_NUMBER).astype(np.uint8)
