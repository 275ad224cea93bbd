"""Measures of one photograph, from its raw counts: a small linear picture, noise, detail."""

from __future__ import annotations

import dataclasses
import hashlib
import math
from pathlib import Path
from typing import Literal

import numpy as np

from lightstage.checks.noise import DIFFERENCE_GAIN, fit_noise
from lightstage.errors import FormatError, unreadable_file
from lightstage.formats.exr import MAGIC, read_exr
from lightstage.formats.orientation import UNTURNED, Orientation, of_libraw

BAYER = np.array([[0, 1], [1, 2]])
PILE_FROM, PILE_SHARE = 0.85, 1e-4
"""Many pixels of one greatest count, from this share of white on: the sensor is full before white
[as some are at low ISO]. A photograph that is not full has a few of them at most."""
COARSE_PX = 32
"""Longer side of the coarse cells, on which light and noise are compared."""
LIT_SHARE = 0.1
"""Share of the brightest percent's level above which a cell shows lit subject."""
MIN_QUADS = 4
"""A photograph of fewer quads a side is no photograph."""


@dataclasses.dataclass(frozen=True)
class Photo:
    """What is kept of a photograph.

    Attributes:
        encoding: ``raw`` or ``linear``.
        size_px: width and height as the camera is held.
        cell_px: side of a cell of `light`, pixels of the photograph.
        light: (rows, columns, 3) float32, mean above black as a share of white; the sensor's own
            red, green and blue, no white balance.
        full: (rows, columns) bool, cells that hold a clipped pixel.
        clipped: (3,) share of the lit pixels of each colour that are clipped.
        clipped_all: share of all pixels.
        mean: of all pixels, share of white.
        signal: the brightest percent's green, share of white.
        noise: (2,) variance of a green pixel in shares of white: what it is without light, and its
            rise with light.
        snr: of a green pixel at the lit cells' median.
        detail: (r, c, 2) float32 on coarse cells, squared second difference of greens at steps of
            one and three quads, less the noise, share of white squared.
        coarse: (r, c, 3) float32 mean of `light` on coarse cells.
        spread: (r, c) float32 standard deviation of `coarse`'s green by noise.
        wild: pixels that are not finite.
        digest: of the sums; two different exposures never have the same.
    """

    encoding: Literal["raw", "linear"]
    size_px: tuple[int, int]
    cell_px: float
    light: np.ndarray
    full: np.ndarray
    clipped: np.ndarray
    clipped_all: float
    mean: float
    signal: float
    noise: np.ndarray
    snr: float
    detail: np.ndarray
    coarse: np.ndarray
    spread: np.ndarray
    wild: int
    digest: str

    @property
    def flat(self) -> bool:
        """Whether the picture holds a single value, so that its digest identifies nothing."""
        return bool(np.ptp(self.light) == 0)

    @property
    def usable(self) -> np.ndarray:
        """(r, c) bool, coarse cells without a clipped pixel."""
        pool = pool_size(self.light.shape[:2])
        return pooled(self.full.astype(float), pool) == 0


def measure_photo(path: Path, thumbnail_px: int = 192) -> Photo:
    """Measure a RAW, DNG or OpenEXR photograph.

    No picture is developed: the raw counts are summed in one pass. Memory is the file's counts and
    a few hundred kilobytes.

    Args:
        path: the file.
        thumbnail_px: longer side of the small picture, at most.

    Raises:
        FormatError: not there, unreadable, or of less than 8 x 8 pixels.
    """
    try:
        with path.open("rb") as handle:
            begins = handle.read(4)
    except OSError as error:
        raise unreadable_file(path, error) from None
    if begins == MAGIC:
        return measure_image(read_exr(path), path, thumbnail_px)
    return _measure_raw(path, thumbnail_px)


def measure_image(image: np.ndarray, where: Path, thumbnail_px: int = 192) -> Photo:
    """Measure a scene-linear picture (h, w) or (h, w, 3), in which 1 counts as white.

    Raises:
        FormatError: less than 8 x 8 pixels.
    """
    size = image.shape[1], image.shape[0]
    return measure_counts(_mosaic(image), BAYER, 0.0, math.inf, size, "linear", where, thumbnail_px)


def _measure_raw(path: Path, thumbnail_px: int) -> Photo:
    import rawpy

    from lightstage.raw_errors import unreadable_raw

    try:
        with rawpy.imread(str(path)) as raw:
            counts = raw.raw_image_visible
            blacks = np.array(raw.black_level_per_channel, float)
            white = float(raw.white_level)
            pattern, letters = raw.raw_pattern, raw.color_desc
            sizes = raw.sizes
            # A portrait camera stores landscape rows and a tag; the rig's rows are upright.
            orientation = of_libraw(sizes.flip)
            rows, columns = orientation.shape((sizes.height, sizes.width))
            size = columns, rows
            bayer = pattern is not None and pattern.shape == (2, 2) and counts.ndim == 2
            if bayer:
                top, left = sizes.top_margin, sizes.left_margin
                kinds = [[raw.raw_color(top + y, left + x) for x in (0, 1)] for y in (0, 1)]
                black = blacks[kinds]
                colours = np.array([["RGB".find(chr(letters[k])) for k in row] for row in kinds])
                bayer = set(colours.ravel().tolist()) == {0, 1, 2}
            if not bayer:  # grey and other mosaics are measured as grey
                counts = counts if counts.ndim == 2 else counts[..., 1]
                colours, black = np.ones((2, 2), np.int64), np.full((2, 2), blacks.mean())
            if not white > black.max():
                raise ValueError(f"white level {white:g} below black level {black.max():g}")
            return measure_counts(
                counts,
                colours,
                black,
                white,
                size,
                "raw",
                path,
                thumbnail_px,
                white - black,
                orientation,
            )
    except (rawpy.LibRawError, ValueError, OSError) as error:
        raise unreadable_raw(path, error) from None


def measure_counts(
    counts: np.ndarray,
    colours: np.ndarray,
    black: np.ndarray | float,
    white: float,
    size_px: tuple[int, int],
    encoding: Literal["raw", "linear"],
    where: Path,
    thumbnail_px: int = 192,
    span: np.ndarray | float = 1.0,
    orientation: Orientation = UNTURNED,
) -> Photo:
    """Measure a mosaic.

    Args:
        counts: (h, w), as the sensor reads them.
        colours: (2, 2) 0, 1 or 2 for each place in a quad.
        black: counts without light, one number or (2, 2).
        white: counts from which a pixel is clipped; infinity where none is.
        size_px: width and height of the whole, upright.
        encoding: of the file.
        where: what to name in an error.
        thumbnail_px: longer side of the small picture, at most.
        span: from black to white, one number or (2, 2).
        orientation: of the sensor; the small pictures are upright.

    Raises:
        FormatError: fewer than 8 x 8 pixels.
    """
    from lightstage.checks.kernels import cells_kernel

    high, wide = counts.shape[0] // 2, counts.shape[1] // 2
    if min(high, wide) < MIN_QUADS:
        raise FormatError(
            where,
            found=f"{size_px[0]} x {size_px[1]} pixels",
            expected="a photograph",
            hint="Is it a preview, or a file of another program?",
        )
    quads = -(-max(high, wide) // thumbnail_px)
    quads = min(quads, min(high, wide))
    rows, columns = high // quads, wide // quads
    light, detail = np.empty((rows, columns, 3)), np.empty((rows, columns, 3))
    clipped, extremes = np.empty((rows, columns, 3), np.int64), np.empty(4)
    colours = np.ascontiguousarray(colours, np.int64)
    dark = np.full((2, 2), black, float)
    cells_kernel(counts, colours, dark, white, quads, light, detail, clipped, extremes)
    pixels = 4 * quads * quads * rows * columns
    greatest, pile = float(extremes[1]), int(extremes[2])
    span_dn = float(np.mean(span))
    full = full_level(greatest, pile, pixels, white)
    if full < white:
        cells_kernel(counts, colours, dark, full, quads, light, detail, clipped, extremes)
    digest = hashlib.sha256(light.tobytes() + clipped.tobytes()).hexdigest()
    light, detail, clipped = map(orientation.upright, (light, detail, clipped))
    return _photo(
        light / span_dn,
        detail / span_dn**2,
        clipped,
        encoding=encoding,
        size_px=size_px,
        quads=quads,
        per_quad=np.bincount(colours.ravel(), minlength=3),
        wild=int(extremes[3]),
        digest=digest,
    )


def full_level(greatest: float, pile: int, pixels: int, white: float) -> float:
    """The count from which a pixel is clipped: white, or less where a sensor is full before it.

    Args:
        greatest: count of the photograph.
        pile: number of pixels that have it.
        pixels: number of all.
        white: the file's white level, or infinity.
    """
    early = math.isfinite(white) and PILE_FROM * white <= greatest < white
    return greatest if early and pile > max(PILE_SHARE * pixels, 16) else white


def _photo(
    light: np.ndarray,
    detail: np.ndarray,
    clipped: np.ndarray,
    *,
    encoding: Literal["raw", "linear"],
    size_px: tuple[int, int],
    quads: int,
    per_quad: np.ndarray,
    wild: int,
    digest: str,
) -> Photo:
    pool = pool_size(light.shape[:2])
    coarse, fine = pooled(light, pool), pooled(detail, pool)
    green = light[..., 1]
    signal = float(np.quantile(green, 0.99))
    noise = fit_noise(coarse[..., 1], fine[..., 0], quads**2 * pool**2)
    lit = green > max(LIT_SHARE * signal, 0.0)
    level = float(np.median(green[lit])) if lit.any() else 0.0
    deviation = math.sqrt(max(noise[0] + noise[1] * max(level, 0.0), 0.0))
    pixels = np.maximum(per_quad * quads * quads * max(int(lit.sum()), 1), 1)
    variance = np.maximum(noise[0] + noise[1] * np.maximum(coarse[..., 1], 0.0), 0.0)
    # The mean of a quad's greens has a half or a quarter of a pixel's variance.
    energy = fine[..., 1:] - DIFFERENCE_GAIN * variance[..., None] / max(per_quad[1], 1)
    count = max(per_quad[1], 1) * quads**2 * pool**2
    return Photo(
        encoding=encoding,
        size_px=size_px,
        cell_px=2.0 * quads,
        light=light.astype(np.float32),
        full=clipped.sum(axis=2) > 0,
        clipped=clipped[lit].sum(axis=0) / pixels,
        clipped_all=float(clipped.sum() / (4 * quads**2 * green.size)),
        mean=float((light * per_quad).sum() / (per_quad.sum() * green.size)),
        signal=signal,
        noise=noise,
        snr=level / deviation if deviation > 0 else math.inf if level > 0 else 0.0,
        detail=energy.astype(np.float32),
        coarse=coarse.astype(np.float32),
        spread=np.sqrt(variance / count).astype(np.float32),
        wild=wild,
        digest=digest,
    )


def pool_size(shape: tuple[int, ...]) -> int:
    """Cells that make a coarse one."""
    return max(1, round(max(shape) / COARSE_PX))


def pooled(picture: np.ndarray, pool: int) -> np.ndarray:
    """(r, c, ...) mean over whole squares of `pool` cells."""
    rows, columns = picture.shape[0] // pool, picture.shape[1] // pool
    rows, columns = max(rows, 1), max(columns, 1)
    part = picture[: rows * pool, : columns * pool]
    shape = (rows, part.shape[0] // rows, columns, part.shape[1] // columns, *picture.shape[2:])
    return part.reshape(shape).mean(axis=(1, 3))


def _mosaic(image: np.ndarray) -> np.ndarray:
    """(h, w) of a picture (h, w) or (h, w, 3), each pixel one colour: as a sensor would see it."""
    if image.ndim == 2:
        return image
    mosaic = np.array(image[..., 1])
    mosaic[0::2, 0::2] = image[0::2, 0::2, 0]
    mosaic[1::2, 1::2] = image[1::2, 1::2, 2]
    return mosaic
