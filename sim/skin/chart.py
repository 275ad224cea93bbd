"""Charts: hairs and creases drawn once in a flat picture of a place, then looked up by texels."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import cv2
import numpy as np

from sim.skin.parts import Patch

_SHIFT = 4


@dataclasses.dataclass(frozen=True)
class Chart:
    """A picture over a rectangle of a plane, here of the face seen from the front.

    Attributes:
        picture: (h, w) float32; zero at its border, since that is what is beyond.
        left: plane's first coordinate of the left edge, mm.
        top: second coordinate of the upper edge, mm; it falls downward.
        pixel: size of a pixel, mm.
    """

    picture: np.ndarray
    left: float
    top: float
    pixel: float

    def look_up(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """(h, w) float32 values at places, zero outside; not finite places give zero too."""
        column = (x - np.float32(self.left)) / np.float32(self.pixel) - np.float32(0.5)
        row = (np.float32(self.top) - y) / np.float32(self.pixel) - np.float32(0.5)
        height, width = self.picture.shape
        near = (column > -2) & (column < width + 1) & (row > -2) & (row < height + 1)
        lines = np.flatnonzero(near.any(axis=1))
        out = np.zeros(x.shape, np.float32)
        if len(lines):
            # Most strips see few rows of a chart.
            part = slice(lines[0], lines[-1] + 1)
            outside = np.float32(-9)
            out[part] = cv2.remap(
                self.picture,
                np.where(near[part], column[part], outside).astype(np.float32),
                np.where(near[part], row[part], outside).astype(np.float32),
                cv2.INTER_CUBIC,
                borderMode=cv2.BORDER_CONSTANT,
                borderValue=0.0,
            )
        return out

    def softened(self, sigma_mm: float) -> Chart:
        """Blurred, so that texels of that size do not alias."""
        sigma = sigma_mm / self.pixel
        if sigma < 0.3:
            return self
        return dataclasses.replace(self, picture=cv2.GaussianBlur(self.picture, (0, 0), sigma))


def signed_place(patch: Patch) -> tuple[np.ndarray, np.ndarray]:
    """First and second coordinate (h, columns) on the fixed face seen from the front, mm."""
    place = patch.place
    return np.copysign(place[..., 0], patch.reference[..., 0]), place[..., 1]


def empty(left: float, right: float, bottom: float, top: float, pixel: float) -> Chart:
    """A chart without anything on it."""
    shape = (round((top - bottom) / pixel), round((right - left) / pixel))
    return Chart(np.zeros(shape, np.float32), left, top, pixel)


def draw_lines(chart: Chart, lines: Sequence[np.ndarray], strengths: Sequence[np.ndarray]) -> None:
    """Draw lines a pixel wide onto a chart, in place; crossing lines keep the stronger.

    Args:
        chart: drawn on.
        lines: each (k, 2) mm.
        strengths: each (k,) 0..1, or (1,) for the whole line.
    """
    for line, strength in zip(lines, strengths, strict=True):
        place = np.empty((len(line), 2))
        place[:, 0] = (line[:, 0] - chart.left) / chart.pixel - 0.5
        place[:, 1] = (chart.top - line[:, 1]) / chart.pixel - 0.5
        low = np.maximum(np.floor(place.min(axis=0)).astype(int) - 3, 0)
        high = np.ceil(place.max(axis=0)).astype(int) + 4
        part = chart.picture[low[1] : high[1], low[0] : high[0]]
        if part.size == 0:
            continue
        layer = np.zeros(part.shape, np.uint8)
        fixed = np.round((place - low) * 2**_SHIFT).astype(np.int32)
        levels = np.broadcast_to(strength, (len(line),))
        greys = np.clip(127.5 * (levels[1:] + levels[:-1]), 0, 255).round().astype(int).tolist()
        ends = fixed.tolist()
        for k, grey in enumerate(greys):
            cv2.line(layer, ends[k], ends[k + 1], grey, 1, cv2.LINE_AA, _SHIFT)
        np.maximum(part, layer.astype(np.float32) / 255, out=part)


def curve(points: Sequence[tuple[float, float]], count: int = 24) -> np.ndarray:
    """(count, 2) smooth line through the given points (Catmull-Rom, even in parameter)."""
    p = np.array(points, float)
    if len(p) == 2:
        t = np.linspace(0, 1, count)[:, None]
        return p[0] * (1 - t) + p[1] * t
    padded = np.concatenate([[2 * p[0] - p[1]], p, [2 * p[-1] - p[-2]]])
    t = np.linspace(0, len(p) - 1 - 1e-9, count)
    k, f = t.astype(int), (t % 1.0)[:, None]
    a, b, c, d = (padded[k + i] for i in range(4))
    return np.asarray(
        0.5 * (2 * b + (c - a) * f + (2 * a - 5 * b + 4 * c - d) * f**2)
        + 0.5 * (3 * b - a - 3 * c + d) * f**3
    )
