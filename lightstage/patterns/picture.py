"""Pictures of patterns as the stage will show them: its lights from two sides, and a lit ball."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import cv2
import numpy as np

from lightstage.patterns.weights import solid_angles_sr
from lightstage.rig import Rig

BANK_RGB = {"horizontal": (255, 176, 84), "vertical": (96, 178, 255), None: (200, 200, 204)}
GROUND, INK, FAINT, EMPTY = (22, 23, 27), (236, 236, 240), (150, 152, 160), (44, 46, 53)
SHIFT = 4
"""OpenCV draws at sixteenths of a pixel."""
FONT = "sans"


@dataclasses.dataclass(frozen=True)
class SheetConfig:
    """How a sheet of patterns looks.

    Attributes:
        width_px: of the sheet, about; narrower where there are few patterns.
        side_px: diameter of one view of the lights, at most; smaller where there are many.
        least_px: the same, at least.
    """

    width_px: int = 1600
    side_px: int = 190
    least_px: int = 64


def pattern_sheet(
    rig: Rig,
    patterns: Sequence[tuple[str, np.ndarray]],
    title: str,
    config: SheetConfig | None = None,
) -> np.ndarray:
    """A sheet of patterns, each with its lights from the front and from behind, and a white ball.

    The views keep areas, so a lamp's disc is as large as the solid angle it represents: a level
    that goes with the solid angle is a small bright disc, not a large dim one. From the front +x is
    at the right, from behind at the left; +y is up in both. The ball is a white diffuser at the
    centre seen from the front, on one exposure for the whole sheet.

    Args:
        rig: the lights.
        patterns: name and (n,) levels of each.
        title: above them.
        config: sizes.

    Returns:
        (h, w, 3) uint8 sRGB.
    """
    config = config or SheetConfig()
    count = len(patterns)
    side = _side(count, config)
    gap = max(6, side // 14)
    ball_px = int(side * 0.72)
    cell_w, cell_h = 2 * side + ball_px + 4 * gap, side + 3 * gap + 18
    columns = max(1, min(count, config.width_px // cell_w))
    rows = -(-count // columns)
    head, foot = 52, 40
    width = max(columns * cell_w + 2 * gap, 640)
    sheet = np.full((head + rows * cell_h + foot, width, 3), GROUND, np.uint8)
    _write(sheet, title, (2 * gap, 33), INK, 20, 600)
    balls = _balls([levels for _, levels in patterns], rig, ball_px)
    views = _views(rig, side)
    for index, (name, levels) in enumerate(patterns):
        left = gap + (index % columns) * cell_w
        top = head + (index // columns) * cell_h
        lit = int((levels > 0).sum())
        end = _write(sheet, name, (left + gap, top + 15), INK, 15, 600)
        caption = f"{lit} lit, mean {levels.mean():.3g}"
        if end + 12 + 7 * len(caption) < left + cell_w:
            _write(sheet, caption, (end + 12, top + 15), FAINT, 13, 400)
        top += 18 + gap
        for k, seen in enumerate(views):
            place = np.array([left + gap + k * (side + gap) + side / 2, top + side / 2])
            _lights(sheet, place, side, seen, levels)
        x, y = left + 2 * side + 3 * gap, top + (side - ball_px) // 2
        sheet[y : y + ball_px, x : x + ball_px] = balls[index]
    _legend(sheet, rig, 2 * gap, len(sheet) - 16)
    return sheet


def _side(count: int, config: SheetConfig) -> int:
    """Diameter of a view: as large as leaves the sheet about as high as wide."""
    for side in range(config.side_px, config.least_px, -2):
        cell_w, cell_h = int(2.72 * side) + 4 * (side // 14), side + 18 + 3 * (side // 14)
        columns = max(1, config.width_px // cell_w)
        if -(-count // columns) * cell_h <= 0.8 * config.width_px:
            return side
    return config.least_px


@dataclasses.dataclass(frozen=True)
class _View:
    """Half of the lights as one view shows them.

    Attributes:
        label: what it is seen from.
        index: (k,) which lights.
        place: (k, 2) in the unit disc, x to the right, y down.
        radius: (k,) of their discs, 1 for the view's.
        colour: (k, 3) sRGB of the light itself at its full level, 0..1.
        bank: (k, 3) of its bank.
    """

    label: str
    index: np.ndarray
    place: np.ndarray
    radius: np.ndarray
    colour: np.ndarray
    bank: np.ndarray


def _views(rig: Rig, side: int) -> tuple[_View, _View]:
    toward = rig.positions_mm / np.linalg.norm(rig.positions_mm, axis=1, keepdims=True)
    angles = solid_angles_sr(rig)
    gains = rig.rgb_gains
    most = gains.max(axis=1, keepdims=True)
    own = np.where(most > 0, gains / np.where(most > 0, most, 1.0), 1.0)
    bank = np.array([BANK_RGB[light.bank] for light in rig.lights]) / 255.0
    # Half the sphere has 2 pi; the discs leave gaps between them, and are never lost.
    radius = np.clip(0.8 * np.sqrt(angles / (2 * np.pi)), 1.4 / side, 0.16)
    views = []
    for label, sign in (("front", 1.0), ("behind", -1.0)):
        index = np.flatnonzero(toward[:, 2] >= 0 if sign > 0 else toward[:, 2] < 0)
        x, y, z = toward[index].T
        # Lambert's azimuthal projection, which keeps areas: 1 at the rim of the half sphere.
        scale = 1 / np.sqrt(1 + np.abs(z))
        place = 0.93 * np.stack([sign * x * scale, -y * scale], axis=1)
        views.append(
            _View(label, index, place, 0.93 * radius[index], _encoded(own[index]), bank[index])
        )
    return views[0], views[1]


def _lights(
    sheet: np.ndarray, place: np.ndarray, side: int, view: _View, levels: np.ndarray
) -> None:
    """Draw one view of the lights around a place."""
    _disc(sheet, place, side / 2, (12, 13, 16))
    cv2.circle(sheet, *_fixed(place, side / 2), (62, 64, 72), 1, cv2.LINE_AA, SHIFT)
    level = levels[view.index]
    shown = _encoded(level)[:, None]
    fill = 255 * (shown * view.colour + (1 - shown) * (0.06 + 0.10 * view.bank))
    ring = 255 * view.bank * np.where(level > 0, 1.0, 0.38)[:, None]
    # From dim to bright, so that where discs touch the lit one is whole.
    for k in np.argsort(level, kind="stable"):
        at, radius = place + view.place[k] * side / 2, view.radius[k] * side / 2
        if radius > 2:
            _disc(sheet, at, radius, ring[k])
            _disc(sheet, at, radius - max(0.8, 0.16 * radius), fill[k])
        else:  # too small for a ring
            tinted = fill[k] * (0.6 + 0.4 * view.bank[k])
            _disc(sheet, at, radius, tinted if level[k] > 0 else ring[k] * 0.6)
    if side >= 120:
        _write(
            sheet, view.label, (int(place[0] - side / 2), int(place[1] + side / 2)), FAINT, 11, 400
        )


def _balls(states: list[np.ndarray], rig: Rig, size: int) -> list[np.ndarray]:
    """(size, size, 3) uint8 of a white ball under each state, seen from +z."""
    grid = 48
    line = (np.arange(grid) + 0.5) / grid * 2.2 - 1.1
    x, y = np.meshgrid(line, -line)
    flat = np.hypot(x, y)
    # Beyond the rim the rim's own normal: it is cut to the disc after enlarging.
    x, y = x / np.maximum(flat, 1.0), y / np.maximum(flat, 1.0)
    normals = np.stack([x, y, np.sqrt(np.maximum(0, 1 - x**2 - y**2))], axis=-1).reshape(-1, 3)
    far = np.linalg.norm(rig.positions_mm, axis=1)
    toward = rig.positions_mm / far[:, None]
    strength = rig.rgb_gains * ((np.median(far) / far) ** 2)[:, None]
    sent = np.stack(states, axis=1)[:, :, None] * strength[:, None]  # (n, states, 3)
    received = np.zeros((len(normals), sent.shape[1] * 3))
    for part in np.array_split(np.arange(len(far)), max(1, len(far) // 512)):
        facing = np.maximum(normals @ toward[part].T, 0.0)
        received += facing @ sent[part].reshape(len(part), -1)
    received = received.reshape(grid, grid, len(states), 3)
    peak = received.max()
    middle = (np.arange(size) + 0.5) / size * 2 - 1
    inside = np.clip((0.97 - np.hypot(*np.meshgrid(middle, middle))) * size / 2 + 0.5, 0, 1)
    at = ((middle + 1.1) / 2.2 * grid - 0.5).astype(np.float32)
    columns, rows = np.meshgrid(at, at)
    balls = []
    for k in range(len(states)):
        light = (received[:, :, k] / (peak if peak > 0 else 1.0)).astype(np.float32)
        fine = cv2.remap(light, columns, rows, cv2.INTER_LINEAR)
        shaded = 255 * _encoded(0.95 * np.clip(fine, 0, 1))
        shaded = np.maximum(shaded, 14)  # a ball in the dark is still seen to be there
        share = inside[:, :, None]
        balls.append((shaded * share + np.array(GROUND) * (1 - share)).round().astype(np.uint8))
    return balls


def _legend(sheet: np.ndarray, rig: Rig, x: int, y: int) -> None:
    for bank, colour in BANK_RGB.items():
        if any(light.bank == bank for light in rig.lights):
            _disc(sheet, np.array([x + 6.0, y - 5.0]), 6, colour)
            _disc(sheet, np.array([x + 6.0, y - 5.0]), 4.4, EMPTY)
            x = (
                _write(
                    sheet, f"{bank} bank" if bank else "not polarised", (x + 18, y), FAINT, 13, 400
                )
                + 22
            )
    for level in (0.0, 0.25, 0.5, 1.0):
        shade = 255 * float(_encoded(np.array(level))) * np.ones(3)
        _disc(sheet, np.array([x + 6.0, y - 5.0]), 6, tuple(np.maximum(shade, 40)))
        x = _write(sheet, f"{level:g}", (x + 16, y), FAINT, 13, 400) + 12
    _write(sheet, "level; ball: white, one exposure for all", (x + 2, y), FAINT, 13, 400)


def _encoded(value: np.ndarray) -> np.ndarray:
    """Linear 0..1 to sRGB's curve. Source: [IEC61966]."""
    curve = 1.055 * np.power(np.maximum(value, 0.0031308), 1 / 2.4) - 0.055
    return np.where(np.asarray(value) <= 0.0031308, 12.92 * np.asarray(value), curve)


def _fixed(place: np.ndarray, radius: float) -> tuple[tuple[int, int], int]:
    x, y = (np.asarray(place) * 2**SHIFT).astype(int).tolist()
    return (x, y), int(radius * 2**SHIFT)


def _disc(image: np.ndarray, place: np.ndarray, radius: float, colour: Sequence[float]) -> None:
    shade = [float(c) for c in colour]
    cv2.circle(image, *_fixed(place, radius), shade, -1, cv2.LINE_AA, SHIFT)


def _write(
    image: np.ndarray, text: str, place: tuple[int, int], colour: Sequence[int], px: int, heft: int
) -> int:
    """Write words; returns the column where they end."""
    face = cv2.FontFace(FONT)
    end, _ = cv2.putText(image, text, place, list(colour), face, px, heft)
    return int(end[0])
