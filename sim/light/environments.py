"""Latitude-longitude pictures of light, and the few directional lights that stand for one.

Row 0 looks up (+y); the middle column looks along +z and columns grow toward +x:
direction = (sin t sin p, cos t, sin t cos p), t = pi row / h, p = 2 pi (column / w - 1/2).

A picture is cut into rectangles of about equal light, each of which becomes one light far away
[Debevec2005]. Light is kept exactly, per channel: what each texel would give a white diffuser that
faces it goes to its rectangle's light. What a surface receives differs only because the light of
a rectangle comes from one place, its centre of light.
"""

from __future__ import annotations

import dataclasses
import heapq
from pathlib import Path

import numpy as np

from lightstage.formats.environment import LightSet
from lightstage.formats.panorama import read_panorama, require_panorama
from lightstage.formats.srgb import LUMINANCE
from sim.errors import SimError

FAR_MM = 100_000.0
"""Lights of a picture stand this far away: a head turns them by less than 0.1 degrees."""


@dataclasses.dataclass(frozen=True)
class Panorama:
    """Light from everywhere.

    Attributes:
        name: what it is called.
        radiance: (h, 2 h, 3) float64, linear, at least 0.
    """

    name: str
    radiance: np.ndarray

    def __post_init__(self) -> None:
        """FormatError when the shape is not 1:2, or a value is NaN, infinite or negative."""
        require_panorama(self.radiance, self.name)


def load_panorama(path: Path) -> Panorama:
    """Read a latitude-longitude picture, OpenEXR or Radiance HDR; FormatError where it is none."""
    return Panorama(path.stem, read_panorama(path))


def directions(rows: int) -> np.ndarray:
    """(rows, 2 rows, 3) unit directions of the texels' centres."""
    polar = np.pi * (np.arange(rows) + 0.5) / rows
    azimuth = 2 * np.pi * ((np.arange(2 * rows) + 0.5) / (2 * rows) - 0.5)
    sine = np.sin(polar)[:, None]
    return np.stack(
        [
            sine * np.sin(azimuth),
            np.repeat(np.cos(polar)[:, None], 2 * rows, axis=1),
            sine * np.cos(azimuth),
        ],
        axis=-1,
    )


def solid_angles(rows: int) -> np.ndarray:
    """(rows,) steradians of one texel of each row; over the picture they sum to 4 pi."""
    edges = np.cos(np.pi * np.arange(rows + 1) / rows)
    return (edges[:-1] - edges[1:]) * np.pi / rows


def add_sun(radiance: np.ndarray, direction: np.ndarray, irradiance: np.ndarray) -> None:
    """Put a small bright disc into the one texel that it falls on.

    Args:
        radiance: (h, 2 h, 3), changed.
        direction: (3,) unit, to the sun.
        irradiance: (3,) on a surface that faces it.
    """
    row, column = texel_of(direction, len(radiance))
    radiance[row, column] += np.asarray(irradiance) / solid_angles(len(radiance))[row]


def texel_of(direction: np.ndarray, rows: int) -> tuple[int, int]:
    """Row and column that a (3,) unit direction falls on."""
    x, y, z = (float(part) for part in direction)
    row = int(np.arccos(np.clip(y, -1, 1)) / np.pi * rows)
    column = int((np.arctan2(x, z) / (2 * np.pi) + 0.5) * 2 * rows)
    return min(row, rows - 1), column % (2 * rows)


def panorama_lights(panorama: Panorama, count: int) -> LightSet:
    """The directional lights that stand for a picture.

    The rectangle whose light times squared extent is largest is halved, across its longer side,
    where its light is, until there are `count`: a small sun is cut no further, and a wide sky is,
    however dim.

    Args:
        panorama: the picture.
        count: lights at most; fewer where texels run out.

    Returns:
        Lights `FAR_MM` away. Their sum is the picture's own to rounding, in each channel.

    Raises:
        SimError: a count below 1.
    """
    if count < 1:
        raise SimError("lights of a picture", found=str(count), expected="at least 1")
    rows = len(panorama.radiance)
    given = panorama.radiance * solid_angles(rows)[:, None, None] / np.pi
    weight = given @ LUMINANCE
    toward = directions(rows)
    cut = _Cutter(weight)
    boxes = cut.boxes(count)
    place, rgb = [], []
    for top, bottom, left, right in boxes:
        part = (slice(top, bottom), slice(left, right))
        light = given[part].sum(axis=(0, 1))
        if not light.any():
            continue
        # The luminance's centre; a colour without luminance does not occur, as all of it is >= 0.
        centre = np.einsum("rc,rck->k", weight[part], toward[part])
        length = float(np.linalg.norm(centre))
        if not length > 1e-9 * weight[part].sum():
            centre = toward[(top + bottom) // 2, (left + right) // 2]
            length = 1.0
        place.append(FAR_MM * centre / length)
        rgb.append(light)
    return LightSet(panorama.name, np.array(place), np.array(rgb), np.zeros(3))


class _Cutter:
    """Cuts a picture of weights into rectangles."""

    def __init__(self, weight: np.ndarray) -> None:
        self.rows = len(weight)
        self.table = np.zeros((weight.shape[0] + 1, weight.shape[1] + 1))
        self.table[1:, 1:] = weight.cumsum(axis=0).cumsum(axis=1)

    def boxes(self, count: int) -> list[tuple[int, int, int, int]]:
        """At most `count` rectangles (top, bottom, left, right)."""
        queue = [self._entry((0, self.rows, 0, 2 * self.rows))]
        done: list[tuple[int, int, int, int]] = []
        while queue and len(queue) + len(done) < count:
            _, box = heapq.heappop(queue)
            halves = self._halved(box)
            if len(halves) == 1:
                done.append(box)
            for half in halves if len(halves) == 2 else []:
                heapq.heappush(queue, self._entry(half))
        return sorted(done + [box for _, box in queue])

    def _entry(self, box: tuple[int, int, int, int]) -> tuple[float, tuple[int, int, int, int]]:
        top, bottom, left, right = box
        extent2 = sum(side * side for side in self._sides(box))
        t = self.table
        light = t[bottom, right] - t[top, right] - t[bottom, left] + t[top, left]
        return -float(light) * extent2, box

    def _sides(self, box: tuple[int, int, int, int]) -> tuple[float, float]:
        """Height and width in texels of the equator."""
        top, bottom, left, right = box
        middle = np.pi * 0.5 * (top + bottom) / self.rows
        return float(bottom - top), float((right - left) * np.sin(middle))

    def _halved(self, box: tuple[int, int, int, int]) -> list[tuple[int, int, int, int]]:
        """Two rectangles of about half the light each; the same one where it is one texel."""
        top, bottom, left, right = box
        high, wide = bottom - top, right - left
        tall, broad = self._sides(box)
        if high == 1 and wide == 1:
            return [box]
        t = self.table
        if wide == 1 or (high > 1 and tall >= broad):
            sums = t[top : bottom + 1, right] - t[top : bottom + 1, left]
            at = top + _middle(sums)
            return [(top, at, left, right), (at, bottom, left, right)]
        sums = t[bottom, left : right + 1] - t[top, left : right + 1]
        at = left + _middle(sums)
        return [(top, bottom, left, at), (top, bottom, at, right)]


def _middle(sums: np.ndarray) -> int:
    """Where a running sum (n + 1,) reaches its half, between 1 and n - 1."""
    half = 0.5 * (sums[0] + sums[-1])
    return int(np.clip(np.argmin(np.abs(sums - half)), 1, len(sums) - 2))


def rotated(lights: LightSet, angle_deg: float) -> LightSet:
    """The same lights turned about +y, from +z toward +x."""
    a = np.radians(angle_deg)
    turn = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    return dataclasses.replace(lights, position_mm=lights.position_mm @ turn.T)
