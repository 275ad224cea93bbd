"""Pictures for the page, made from the photographs on the disk, in processes of their own.

A small picture is the preview in the file where there is one, else every few counts of the sensor
averaged: nothing is developed. A large one has clipped pixels painted, its histogram and how fine
its detail is.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import multiprocessing
import multiprocessing.connection
import os
import threading
from pathlib import Path

import cv2
import numpy as np

from lightstage.checks.photo_measures import full_level
from lightstage.errors import FormatError, LightstageError
from lightstage.formats.exr import MAGIC, read_exr
from lightstage.formats.orientation import of_libraw

BINS = 64
SAMPLES = 4
"""Quads a side of a cell whose counts are averaged for a small picture."""
GAIN = 1.6
"""One factor for every picture, so that patterns compare; `full` is exposed with room above it."""
QUALITY = 85
STRIPE_PX = 6
NICE = 5


@dataclasses.dataclass(frozen=True)
class Facts:
    """Figures of a photograph, shown beside its large picture.

    Attributes:
        width_px: of the photograph.
        height_px: the same.
        clipped: share of each colour's pixels that are at white, of those read; None of a
            photograph that was developed already, in which they have no mark.
        mean: of all pixels, share of white.
        brightest: the brightest percent's green, share of white.
        histogram: (3, BINS) share of each colour's pixels, from black to white.
    """

    width_px: int
    height_px: int
    clipped: tuple[float, float, float] | None
    mean: float
    brightest: float
    histogram: tuple[tuple[float, ...], ...]


@dataclasses.dataclass(frozen=True)
class Focus:
    """How sharp a photograph is.

    Attributes:
        figure: differences of close pixels over those of far ones, higher is sharper
            (`checks.sharpness.fineness`); None where the subject shows too little of them.
        against: ratio of the same to that of another photograph of the camera; 1 is as sharp.
    """

    figure: float | None
    against: float | None


@dataclasses.dataclass(frozen=True)
class Counts:
    """A photograph's counts in cells, upright.

    Attributes:
        rgb: (h, w, 3) shares of white.
        full: (h, w, 3) whether a cell holds a clipped count.
        clipped: (3,) share of each colour's counts that are clipped, of those read; or None.
        size_px: width and height of the photograph.
        balance: (3,) white balance, green 1.
    """

    rgb: np.ndarray
    full: np.ndarray
    clipped: np.ndarray | None
    size_px: tuple[int, int]
    balance: np.ndarray


def behind() -> None:
    """Yield the processor to a capture, and end when the server ends, also where it is killed.

    Called in each process that makes pictures: one that waits for work would not notice by itself
    that its server was killed.
    """
    os.nice(NICE)
    cv2.setNumThreads(1)
    server = multiprocessing.parent_process()
    if server is not None:
        threading.Thread(target=_end_with, args=(server.sentinel,), daemon=True).start()


def _end_with(sentinel: int) -> None:
    multiprocessing.connection.wait([sentinel])
    os._exit(0)


def thumbnail(path: Path, longest_px: int) -> bytes:
    """A small JPEG of a photograph.

    Args:
        path: a camera RAW, DNG or OpenEXR picture.
        longest_px: its longer side, at most.

    Raises:
        FormatError: a file that is not there, or that is no photograph.
    """
    preview = _preview(path, longest_px)
    if preview is not None:
        return jpeg(preview, path)
    return jpeg(_shown(read_counts(path, longest_px, SAMPLES)), path)


def large(path: Path, longest_px: int) -> tuple[bytes, Facts]:
    """A large JPEG with clipped pixels painted in stripes, and what it shows in figures.

    Args:
        path: as `thumbnail`.
        longest_px: the same.

    Raises:
        FormatError: as `thumbnail`.
    """
    counts = read_counts(path, longest_px, 2)
    picture = _painted(_shown(counts), np.any(counts.full, axis=2))
    data = jpeg(picture, path)
    rgb = counts.rgb
    edges = np.linspace(0.0, 1.0, BINS + 1)
    histogram = tuple(
        tuple((np.histogram(np.clip(rgb[..., c], 0, 1), edges)[0] / rgb[..., c].size).tolist())
        for c in range(3)
    )
    clipped = None
    if counts.clipped is not None:
        red, green, blue = (float(share) for share in counts.clipped)
        clipped = red, green, blue
    width, height = counts.size_px
    brightest = float(np.quantile(rgb[..., 1], 0.99))
    mean = float(rgb.mean())
    return data, Facts(width, height, clipped, mean, brightest, histogram)


def focus(path: Path, other: Path | None = None) -> Focus:
    """How sharp a photograph is; the first one that a process measures takes seconds to import.

    Args:
        path: as `thumbnail`.
        other: a photograph of the same camera to compare with.

    Raises:
        FormatError: as `thumbnail`.
    """
    from lightstage.checks.photo_measures import measure_photo
    from lightstage.checks.sharpness import fineness, sharpness

    photo = measure_photo(path)
    fine = fineness(photo)
    known = fine[np.isfinite(fine)]
    figure = float(np.sqrt(np.median(known))) if known.size else None
    against = None
    if other is not None:
        with contextlib.suppress(LightstageError):  # a broken one gives no ratio
            against = sharpness(photo, measure_photo(other))
    return Focus(figure, against)


def _preview(path: Path, longest_px: int) -> np.ndarray | None:
    """(h, w, 3) BGR of the JPEG that many cameras put into their RAW; None where there is none."""
    import rawpy

    try:
        with path.open("rb") as file:
            if file.read(4) == MAGIC:
                return None
        with rawpy.imread(str(path)) as raw:
            flip = raw.sizes.flip
            thumb = raw.extract_thumb()
    except OSError as error:
        raise FormatError(path, found=error.strerror or str(error)) from None
    except rawpy.LibRawError:
        return None
    if thumb.format != rawpy.ThumbFormat.JPEG:
        return None
    data = np.frombuffer(thumb.data, np.uint8)
    picture = cv2.imdecode(data, cv2.IMREAD_REDUCED_COLOR_4 | cv2.IMREAD_IGNORE_ORIENTATION)
    if picture is None or max(picture.shape[:2]) < longest_px // 2:
        return None
    scale = min(1.0, longest_px / max(picture.shape[:2]))
    size = (max(1, round(picture.shape[1] * scale)), max(1, round(picture.shape[0] * scale)))
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    return np.ascontiguousarray(of_libraw(flip).upright(small))


def read_counts(path: Path, longest_px: int, samples: int) -> Counts:
    """A photograph's counts in cells, so that the longer side has at most `longest_px` of them."""
    try:
        with path.open("rb") as file:
            begins = file.read(4)
    except OSError as error:
        raise FormatError(path, found=error.strerror or str(error)) from None
    return _linear(path, longest_px) if begins == MAGIC else _raw(path, longest_px, samples)


def _linear(path: Path, longest_px: int) -> Counts:
    image = np.asarray(read_exr(path), np.float32)
    image = image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2)
    height, width = image.shape[:2]
    step = max(1, math.ceil(max(height, width) / longest_px))
    rgb = np.nan_to_num(image[::step, ::step, :3])
    return Counts(rgb, np.zeros(rgb.shape, bool), None, (width, height), np.ones(3))


def _raw(path: Path, longest_px: int, samples: int) -> Counts:
    import rawpy

    from lightstage.raw_errors import unreadable_raw

    try:
        with rawpy.imread(str(path)) as raw:
            counts, sizes = raw.raw_image_visible, raw.sizes
            black = np.array(raw.black_level_per_channel, np.float32)
            white, letters = float(raw.white_level), raw.color_desc
            balance = np.array(raw.camera_whitebalance[:3], float)
            top, left = sizes.top_margin, sizes.left_margin
            kinds = [[int(raw.raw_color(top + y, left + x)) for x in (0, 1)] for y in (0, 1)]
            if counts.ndim != 2 or min(counts.shape) < 2:
                raise ValueError("no mosaic of a sensor")
            cells = _cells(counts, kinds, letters, black, white, longest_px, samples)
    except (rawpy.LibRawError, ValueError, OSError, TypeError) as error:
        raise unreadable_raw(path, error) from None
    rgb, full, clipped = cells
    turn = of_libraw(sizes.flip)
    rows, columns = turn.shape((sizes.height, sizes.width))
    good = np.isfinite(balance).all() and (balance > 0).all()
    balance = balance / balance[1] if good else np.ones(3)
    return Counts(turn.upright(rgb), turn.upright(full), clipped, (columns, rows), balance)


def _cells(
    counts: np.ndarray,
    kinds: list[list[int]],
    letters: bytes,
    black: np.ndarray,
    white: float,
    longest_px: int,
    samples: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cells of quads as shares of white, which of them hold a clipped count, and its share.

    Of a large cell, `samples` x `samples` quads are read: a small picture needs no more.
    """
    high, wide = counts.shape[0] // 2, counts.shape[1] // 2
    cell = max(1, math.ceil(max(high, wide) / longest_px))
    rows, columns = high // cell, wide // cell
    places = np.unique(np.linspace(0, cell - 1, min(samples, cell)).round().astype(int))
    total = np.zeros((rows, columns, 3), np.float32)
    number = np.zeros(3)
    clipped = np.zeros(3)
    full = np.zeros((rows, columns, 3), bool)
    greatest = counts.max()
    level = full_level(float(greatest), int((counts == greatest).sum()), counts.size, white)
    for y in (0, 1):
        for x in (0, 1):
            kind = kinds[y][x]
            letter = chr(letters[kind]) if kind < len(letters) else "G"
            colour = {"R": 0, "B": 2}.get(letter, 1)
            span = max(white - float(black[kind % len(black)]), 1.0)
            for down in places:
                for right in places:
                    part = counts[2 * down + y :: 2 * cell, 2 * right + x :: 2 * cell]
                    part = part[:rows, :columns]
                    total[..., colour] += (part - black[kind % len(black)]) / span
                    is_full = part >= level
                    full[..., colour] |= is_full
                    clipped[colour] += is_full.mean()
                    number[colour] += 1
    clipped /= np.maximum(number, 1)
    known = number > 0
    total[..., known] /= number[known].astype(np.float32)
    # A colour that the sensor lacks, as a grey one does, gets the mean of the others.
    total[..., ~known] = total[..., known].mean(axis=2, keepdims=True)
    return total, full, clipped


def _shown(counts: Counts) -> np.ndarray:
    """(h, w, 3) BGR uint8, sRGB [IEC61966], of one gain for all photographs."""
    linear = np.clip(counts.rgb * (GAIN * counts.balance).astype(np.float32), 0.0, 1.0)
    curve = 1.055 * np.power(np.maximum(linear, 0.0031308), 1 / 2.4) - 0.055
    image = np.where(linear <= 0.0031308, 12.92 * linear, curve)
    return np.ascontiguousarray(np.round(255 * image[..., ::-1]).astype(np.uint8))


def _painted(picture: np.ndarray, full: np.ndarray) -> np.ndarray:
    """Clipped pixels in stripes of magenta and black, which no skin has."""
    rows, columns = np.indices(full.shape)
    stripe = (rows + columns) // STRIPE_PX % 2 == 0
    painted = picture.copy()
    painted[full & stripe] = (255, 0, 255)
    painted[full & ~stripe] = (0, 0, 0)
    return painted


def jpeg(picture: np.ndarray, where: Path) -> bytes:
    """A picture (h, w, 3) BGR uint8 as JPEG."""
    done, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    if not done:
        raise FormatError(where, found=f"shape {picture.shape}", expected="a picture")
    return bytes(data.tobytes())
