"""Hair of the face and scalp: brows and lashes drawn hair by hair, stubble and cropped hair."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np

from sim.head.grid import (
    EYE_AZIMUTH_DEG,
    EYE_HALF_DEG,
    ROW_LID_LOW,
    ROW_LID_UP,
    smoothstep,
)
from sim.skin.chart import Chart, curve, draw_lines, empty, signed_place
from sim.skin.parts import Patch

HAIR_PIXEL_MM = 0.08
LASH_PIXEL = 0.02
"""Lashes are drawn over the lid's own coordinates: eye widths across, grid rows upward."""

# Brow: its middle for x >= 0, mm on the fixed face; half its height there; the hairs' direction.
_BROW_X = np.array([10.0, 14.0, 20.0, 28.0, 36.0, 44.0, 50.0, 56.0])
_BROW_Y = np.array([13.2, 14.6, 16.2, 18.2, 19.4, 18.8, 16.6, 13.0])
_BROW_HALF = np.array([2.2, 3.6, 4.0, 3.9, 3.4, 2.6, 1.9, 0.9])
_BROW_DEG = np.array([82.0, 70.0, 48.0, 28.0, 10.0, -12.0, -26.0, -34.0])


@dataclasses.dataclass(frozen=True)
class HairCharts:
    """Drawn hairs: brows of both sides over the face's plane, lashes over the lids."""

    brow: Chart
    lash: Chart


def draw_hair(
    rng: np.random.Generator, fullness: float, texel_mm: float, lashes: float
) -> HairCharts:
    """Draw a person's brows and lashes.

    Args:
        rng: of every hair.
        fullness: of the brows, about 1.
        texel_mm: of the texture that will look them up: charts are softened to it.
        lashes: their strength, about 1.
    """
    pixel = max(HAIR_PIXEL_MM, 0.35 * texel_mm)
    brow = empty(-64, 64, 2, 32, pixel)
    # A pixel wider than a hair takes its share of darkness only.
    thin = HAIR_PIXEL_MM / pixel
    hairs, strengths = [], []
    for side in (-1, 1):
        for _ in range(int(430 * fullness)):
            x = 10 + 45 * rng.beta(1.15, 1.25)
            across = np.clip(rng.normal(0, 0.46), -1.1, 1.1)
            half = np.interp(x, _BROW_X, _BROW_HALF) * (0.75 + 0.25 * fullness)
            y = np.interp(x, _BROW_X, _BROW_Y) + across * half
            # Lower hairs rise and upper hairs fall, toward the brow's ridge.
            lean = np.interp(x, _BROW_X, _BROW_DEG) - 24 * across + rng.normal(0, 9)
            a, length = np.radians(lean), rng.uniform(4.0, 8.0) * (1 - 0.25 * (x > 46))
            turn = a - np.radians(rng.uniform(5, 24))
            middle = (x + 0.5 * length * np.cos(a), y + 0.5 * length * np.sin(a))
            end = (middle[0] + 0.5 * length * np.cos(turn), middle[1] + 0.5 * length * np.sin(turn))
            path = curve([(x, y), middle, end], 7)
            hairs.append(path * (side, 1))
            inner = 0.45 + 0.55 * float(smoothstep(10, 20, np.array(x)))
            strengths.append(np.linspace(1, 0.3, 7) * rng.uniform(0.5, 1.0) * inner * thin)
    draw_lines(brow, hairs, strengths)
    lash = empty(-1.3, 1.3, -2.2, 3.4, LASH_PIXEL)
    hairs, strengths = [], []
    for _ in range(90):
        e = rng.uniform(-0.86, 1.02)
        length = rng.uniform(0.7, 1.5) * (0.6 + 0.4 * float(smoothstep(-0.9, 0.4, np.array(e))))
        tip = (e + 0.10 * (0.25 + e) * length + rng.normal(0, 0.02), 0.1 + length)
        hairs.append(curve([(e, -0.15), ((e + tip[0]) / 2 - 0.01, 0.6 * length), tip], 5))
        strengths.append(lashes * np.linspace(0.9, 0.25, 5) * rng.uniform(0.5, 1))
    for _ in range(46):
        e, length = rng.uniform(-0.75, 1.0), rng.uniform(0.4, 0.9)
        hairs.append(curve([(e, 0.0), (e + 0.08 * (0.2 + e), -length)], 4) - (0, 0.45))
        strengths.append(lashes * np.linspace(0.55, 0.15, 4) * rng.uniform(0.4, 1))
    draw_lines(lash, hairs, strengths)
    brow = brow.softened(0.4 * texel_mm)
    return HairCharts(brow, dataclasses.replace(lash, picture=_soft(lash.picture, texel_mm)))


def _soft(picture: np.ndarray, texel_mm: float) -> np.ndarray:
    """A row of the grid is about a millimetre at the lids, half an eye's width fifteen."""
    across, up = 0.4 * texel_mm / 15 / LASH_PIXEL, 0.4 * texel_mm / LASH_PIXEL
    return cv2.GaussianBlur(picture, (0, 0), max(across, 0.3), sigmaY=max(up, 0.8))


def brow_share(patch: Patch, charts: HairCharts) -> np.ndarray:
    """(h, columns) 0..1, how much of each texel is brow."""
    x, y = signed_place(patch)
    drawn = charts.brow.look_up(x, y)
    side = np.abs(x)
    middle = np.interp(side, _BROW_X, _BROW_Y)
    half = np.interp(side, _BROW_X, _BROW_HALF) * smoothstep(7, 13, side) * smoothstep(60, 52, side)
    shade = np.exp(-(((y - middle) / np.maximum(half, 0.3)) ** 2)) * (half > 0.4)
    front = smoothstep(20, 40, patch.reference[..., 2])
    return np.asarray(np.clip(1.35 * drawn + 0.22 * shade, 0, 0.95) * front, np.float32)


def eye_place(patch: Patch) -> tuple[np.ndarray, np.ndarray]:
    """Across an eye (-1 inner to 1 outer corner) and the grid's row: (h, columns) each."""
    across = (patch.azimuth_deg() - EYE_AZIMUTH_DEG) / EYE_HALF_DEG
    return across.astype(np.float32), patch.row


def lash_share(patch: Patch, charts: HairCharts) -> np.ndarray:
    """(h, columns) 0..1, how much of each texel is lash or the dark line they spring from."""
    rows = patch.row
    if rows.max() < ROW_LID_UP - 6 or rows.min() > ROW_LID_LOW + 6:
        return np.zeros(patch.shape, np.float32)
    across, row = eye_place(patch)
    upper, lower = ROW_LID_UP - row, row - ROW_LID_LOW
    drawn = charts.lash.look_up(across, np.where(upper > lower, upper, -lower - 0.45))
    inside = smoothstep(1.06, 0.94, np.abs(across))
    line = 0.75 * smoothstep(0.75, 0.1, np.abs(upper - 0.1))
    line = np.maximum(line, 0.30 * smoothstep(0.7, 0.1, np.abs(lower)))
    near = smoothstep(6, 4, np.maximum(upper, lower))
    return np.asarray(np.clip(np.maximum(drawn, line * inside), 0, 0.9) * near, np.float32)


def stubble_share(patch: Patch, strength: float) -> np.ndarray:
    """(h, columns) 0..1, how much of each texel is cut hair of the beard, dots and short strokes.

    Args:
        patch: where.
        strength: 0 none, .5 a shadow, 1 some days' growth.
    """
    here = patch.mask("beard")
    if strength <= 0 or here.max() < 0.02:
        return np.zeros(patch.shape, np.float32)
    density = here * (0.86 + 0.10 * patch.noise(13.0, 2, 61))
    width = 0.075 + 0.03 * strength
    # Dots smaller than a texel keep their darkness, not their size.
    drawn = max(width, 0.45 * patch.face.texel_mm)

    def root(distance: np.ndarray, label: np.ndarray) -> np.ndarray:
        return np.asarray(np.exp(-0.5 * (distance / drawn) ** 2) * (0.4 + 0.6 * label))

    def along(place: np.ndarray) -> np.ndarray:
        return place * np.array([1.0, 1.0 - 0.5 * strength, 1.0 - 0.3 * strength], np.float32)

    dots = patch.pits_of(along, 0.52, 62, root) * (width / drawn) ** 2
    shadow = 0.10 + 0.16 * strength
    share = smoothstep(0.02, 0.95, density) * (shadow + (0.5 + 0.5 * strength) * dots)
    return np.asarray(np.clip(share * (0.35 + 0.65 * strength), 0, 0.9), np.float32)


def scalp_share(patch: Patch, recession_mm: float, cover: float) -> tuple[np.ndarray, np.ndarray]:
    """Cropped hair on the scalp.

    Args:
        patch: where.
        recession_mm: how far the hairline is behind the usual one.
        cover: 0 shaven to 1 dense.

    Returns:
        (h, columns) 0..1 how much of each texel is hair, and strands -1..1 that shade it.
    """
    behind = patch.mask("hairline") - recession_mm * smoothstep(40, 70, patch.reference[..., 1])
    if behind.max() < -8:
        return np.zeros(patch.shape, np.float32), np.zeros(patch.shape, np.float32)
    edge = behind + 1.8 * patch.noise(9.0, 3, 52)
    density = smoothstep(-6.0, 13.0, edge) * (1 - smoothstep(0.05, 0.5, patch.mask("ears")))
    strands = patch.noise_of(_combed, 0.9, 3, 53)
    fine = patch.noise_of(_combed, 0.42, 2, 54)
    tufts = patch.noise_of(_combed_softly, 6.0, 2, 55)
    mixed = 0.55 * strands + 0.6 * fine
    # Toward the hairline fewer and fewer strands are there at all.
    threshold = 1.7 - 4.3 * density * (0.55 + 0.45 * cover)
    strand = smoothstep(-0.7, 0.9, mixed - threshold)
    # Between the strands others are deeper: part of the cover is even.
    share = (0.62 * strand + 0.38 * density**1.5) * smoothstep(0.0, 0.55, density)
    shade = 0.45 * mixed + 0.25 * tufts
    return (
        np.asarray(share * (0.2 + 0.76 * float(smoothstep(0.0, 0.6, np.array(cover)))), np.float32),
        np.asarray(np.clip(shade, -1, 1), np.float32),
    )


_CROWN_MM = np.array([0.0, 20.0, -20.0], np.float32)
_CROWN_AXIS = np.array([0.0, 0.88, -0.47], np.float32)
_AHEAD = np.array([0.0, 0.47, 0.88], np.float32)


def _flow(place: np.ndarray, stretch: float) -> np.ndarray:
    """Places in coordinates along and across hair that falls from the crown, mm."""
    away = place - _CROWN_MM
    up = away @ _CROWN_AXIS
    aside, ahead = away[..., 0], away @ _AHEAD
    ring = np.hypot(aside, ahead)
    along = np.arctan2(ring, up) * (90.0 / stretch)
    safe = np.maximum(ring, 1.0)
    return np.stack([along, 85.0 * aside / safe, 85.0 * ahead / safe], axis=-1).astype(np.float32)


def _combed(place: np.ndarray) -> np.ndarray:
    return _flow(place, 7.0)


def _combed_softly(place: np.ndarray) -> np.ndarray:
    return _flow(place, 2.0)
