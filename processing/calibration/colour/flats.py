"""Flat and dark photographs of one camera: vignetting, dust, black level, hot pixels."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from lightstage.counting import counted
from lightstage.formats.flats import FlatField
from lightstage.rig import Camera
from processing.calibration.colour.config import FlatConfig
from processing.calibration.picture import Mosaic
from processing.errors import ProcessingError


def fit_flat(
    flats: list[Mosaic], camera: Camera, config: FlatConfig, where: str
) -> tuple[FlatField, dict[str, Any]]:
    """A camera's vignetting, from photographs of an even card that fills the picture.

    The card need not be lit quite evenly: what changes along a line is the card's, what grows with
    the distance from the principal point is the lens's.

    Args:
        flats: at least one.
        camera: whose principal point the vignetting is centred on.
        config: see there.
        where: to name in errors.

    Returns:
        The field, and facts: residual, light at the corners.

    Raises:
        ProcessingError: clipped, faint, or of another size than the camera's.
    """
    for flat in flats:
        _require_usable(flat, camera, config, where)
    field = FlatField.even(camera, flats[0].orientation)
    flats = [flat.as_read() for flat in flats]
    side = max(config.grid_px // 2 * 2, 2)
    columns, rows = _square_middles(flats[0].level.shape, side)
    x, y = (
        (place - middle) / field.radius_px
        for place, middle in zip((columns, rows), field.centre_px, strict=True)
    )
    # (n, F * 3): R, G, B of each card in turn.
    seen = np.concatenate([_squares(flat, side) for flat in flats], axis=1)
    radial, light, residual = _vignetting(seen, x, y)
    field = dataclasses.replace(field, radial=radial)
    corner = field.share(np.array([[0.0, 0.0]]))[0]
    _require_falling(field, where)
    facts = {
        "flats": len(flats),
        "residual_rms": round(float(np.sqrt(np.mean(residual**2))), 6),
        "light_at_the_corner": round(float(corner), 4),
    }
    if config.per_pixel:
        own = _per_pixel(flats, field, light)
        field = dataclasses.replace(field, per_pixel=own)
        facts["per_pixel_rms"] = round(float(np.std(own)), 6)
    return field, facts


def read_darks(
    darks: list[Mosaic], field: FlatField, config: FlatConfig, where: str
) -> tuple[FlatField, dict[str, Any]]:
    """The field with what darks show: black level beside the file's, and hot pixels.

    Raises:
        ProcessingError: light in them, or photographs of another size than the field's.
    """
    darks = [dark.as_read() for dark in darks]
    width, height = (side // 2 * 2 for side in field.size_px)
    for dark in darks:
        rows, columns = dark.level.shape
        if (rows, columns) != (height, width):
            raise ProcessingError(
                where,
                found=f"{columns} x {rows} pixels as the sensor reads them",
                expected=f"{width} x {height}, as rig.json and the flats have it",
            )
    level = float(np.mean([dark.level.mean() for dark in darks]))
    lowest = np.min([dark.level for dark in darks], axis=0)
    places = [(i // 2, i % 2) for i in range(4)]
    offset = np.zeros(4)
    sigma = 0.0
    for index, (row, column) in enumerate(places):
        stack = np.stack([dark.level[row::2, column::2] for dark in darks])
        middle = np.median(stack)
        # Counts are whole numbers: the median finds which, the mean near it the place in between.
        spread = 1.4826 * float(np.median(np.abs(stack - middle)))
        near = np.abs(stack - middle) <= max(5 * spread, 1e-4)
        offset[index] = float(stack[near].mean())
        sigma = max(sigma, float(stack[near].std()))
    threshold = max(config.hot_level, config.hot_sigmas * sigma)
    for index, (row, column) in enumerate(places):
        lowest[row::2, column::2] -= np.float32(offset[index])
    hot = np.argwhere(lowest > threshold)
    if level > config.max_dark_level or len(hot) > config.max_hot_share * lowest.size:
        raise ProcessingError(
            where,
            found=f"{100 * level:.2f} % of white in the mean, {counted(len(hot), 'bright pixel')}",
            expected=f"at most {100 * config.max_dark_level:g} %, and "
            f"{100 * config.max_hot_share:g} % of the pixels",
            hint="Put the lens caps on and take the darks again.",
        )
    facts = {
        "darks": len(darks),
        "black_offset": [round(float(value), 7) for value in offset],
        "noise": round(sigma, 7),
        "hot_pixels": len(hot),
    }
    return dataclasses.replace(field, black_offset=offset, hot_pixels=hot.astype(int)), facts


def _require_usable(flat: Mosaic, camera: Camera, config: FlatConfig, where: str) -> None:
    height, width = flat.level.shape
    clipped, level = float(flat.clipped.mean()), float(flat.level.mean())
    if (height, width) != (camera.height_px // 2 * 2, camera.width_px // 2 * 2):
        raise ProcessingError(
            where,
            found=f"{width} x {height} pixels",
            expected=f"{camera.width_px} x {camera.height_px} as in rig.json",
        )
    if clipped > config.max_clipped_share or level < config.min_level:
        raise ProcessingError(
            where,
            found=f"{100 * clipped:.2f} % of the card at the white level, its mean at "
            f"{100 * level:.1f} % of white",
            expected=f"at most {100 * config.max_clipped_share:g} %, and a mean of at least "
            f"{100 * config.min_level:g} %",
            hint="Take the flats again with another exposure.",
        )


def _require_falling(field: FlatField, where: str) -> None:
    """No lens sends a tenth of its light or three times as much to some part of the picture."""
    grid = np.stack(
        [
            a.ravel()
            for a in np.meshgrid(
                np.linspace(0, field.size_px[0], 33), np.linspace(0, field.size_px[1], 33)
            )
        ],
        axis=1,
    )
    share = field.share(grid)
    if share.min() < 0.1 or share.max() > 3.0:
        raise ProcessingError(
            where,
            found=f"light between {share.min():.2f} and {share.max():.2f} of the middle's",
            expected="between 0.1 and 3",
            hint="Did the card fill the picture, without a shadow?",
        )


def _square_middles(shape: tuple[int, ...], side: int) -> tuple[np.ndarray, np.ndarray]:
    """(n,) columns and rows of the squares' middles, in pixels."""
    rows = (np.arange(shape[0] // side) + 0.5) * side
    columns = (np.arange(shape[1] // side) + 0.5) * side
    grid = np.meshgrid(columns, rows)
    return grid[0].ravel(), grid[1].ravel()


def _squares(flat: Mosaic, side: int) -> np.ndarray:
    """(n, 3) means of R, G, B over squares."""
    cells = flat.cells()
    half = side // 2
    height, width = cells.shape[0] // half, cells.shape[1] // half
    means = cells[: height * half, : width * half].reshape(height, half, width, half, 3)
    return np.asarray(means.mean(axis=(1, 3), dtype=float).reshape(height * width, 3))


def _vignetting(
    seen: np.ndarray, x: np.ndarray, y: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fit v = (a + b x + c y)(1 + k1 r^2 + k2 r^4 + k3 r^6), one k, and an a, b, c a column.

    Gauss-Newton on shares: what is dark counts as much as what is bright.

    Args:
        seen: (n, m) means of squares.
        x: (n,) of their middles against the principal point.
        y: the same.

    Returns:
        (3,) k; (3, m) a, b, c; (n, m) residuals as shares.
    """
    r2 = x * x + y * y
    powers = np.stack([r2, r2**2, r2**3], axis=1)
    card = np.stack([np.ones_like(x), x, y], axis=1)
    count = seen.shape[1]
    lit = np.zeros((3, count))
    lit[0] = seen.mean(axis=0)
    k = np.zeros(3)
    for _ in range(20):
        share, light = 1 + powers @ k, card @ lit
        model = light * share[:, None]
        rows = np.zeros((*seen.shape, 3 * count + 3))
        for column in range(count):
            first = 3 * column
            rows[:, column, first : first + 3] = card * share[:, None]
            rows[:, column, -3:] = powers * light[:, column, None]
        weight = 1 / np.maximum(model, 1e-6)
        step = np.linalg.lstsq(
            (rows * weight[..., None]).reshape(-1, rows.shape[2]),
            ((seen - model) * weight).ravel(),
            rcond=None,
        )[0]
        lit += step[:-3].reshape(count, 3).T
        k = k + step[-3:]
        if np.abs(step).max() < 1e-9:
            break
    return k, lit, seen / ((card @ lit) * (1 + powers @ k)[:, None]) - 1


def _per_pixel(flats: list[Mosaic], field: FlatField, lit: np.ndarray) -> np.ndarray:
    """(h, w) float32 gain that makes each pixel read as its smooth surroundings do.

    Args:
        flats: F photographs.
        field: their smooth vignetting.
        lit: (3, F * 3) light of the card: constant, along x, along y, for each flat's R, G, B.
    """
    height, width = flats[0].level.shape
    smooth = field.smooth((height, width), (0, 0))
    x = ((np.arange(width) + 0.5 - field.centre_px[0]) / field.radius_px).astype(np.float32)
    y = ((np.arange(height) + 0.5 - field.centre_px[1]) / field.radius_px).astype(np.float32)
    total = np.zeros((height, width), np.float32)
    for index, flat in enumerate(flats):
        for place, channel in enumerate(flat.channels.ravel()):
            part = (slice(place // 2, None, 2), slice(place % 2, None, 2))
            a, b, c = lit[:, 3 * index + channel]
            card = a + b * x[None, part[1]] + c * y[part[0], None]
            total[part] += flat.level[part] * smooth[part] / card.astype(np.float32)
    mean = total / len(flats)
    # A dead pixel has no gain that mends it; it is left as it is.
    return np.where(mean > 0.2, 1 / np.maximum(mean, np.float32(0.2)), np.float32(1))
