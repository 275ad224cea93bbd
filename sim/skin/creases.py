"""Creases of one face: lines that age has drawn, and that expressions deepen at the same places.

Each person has one set of lines, drawn in the plane of the face seen from the front (mm of
`skin_places.canonical`, signed). An expression does not draw new lines: it deepens its groups, as
the muscle below gathers the same skin each time.
"""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np

from sim.head.grid import smoothstep
from sim.skin.chart import Chart, curve, draw_lines, empty, signed_place
from sim.skin.parts import Face, Patch

PIXEL_MM = 0.15
_BOUNDS = (-76.0, 76.0, -168.0, 76.0)

# Group: half width of its lines (sigma, mm) and depth that full age gives, mm.
GROUPS: dict[str, tuple[float, float]] = {
    "forehead": (0.55, 0.26),
    "glabella": (0.60, 0.34),
    "bridge": (0.50, 0.10),
    "crow": (0.38, 0.20),
    "under_eyes": (0.42, 0.16),
    "folds": (1.15, 0.50),
    "marionette": (0.90, 0.36),
    "lips": (0.34, 0.14),
    "neck": (0.85, 0.40),
    "crepe": (0.28, 0.07),
}
# What an expression adds, mm at the age of 0 and at the age of 1.
DEEPENS: dict[str, dict[str, tuple[float, float]]] = {
    "smile": {
        "crow": (0.14, 0.40),
        "folds": (0.35, 0.60),
        "under_eyes": (0.08, 0.22),
        "crepe": (0.02, 0.06),
    },
    "brow_raise": {"forehead": (0.16, 0.50)},
    "brow_furrow": {"glabella": (0.28, 0.60), "bridge": (0.16, 0.34), "crow": (0.02, 0.06)},
    "pucker": {"lips": (0.16, 0.36), "marionette": (0.04, 0.12)},
    "jaw_open": {"folds": (0.05, 0.15), "under_eyes": (0.02, 0.06)},
    "eyes_closed": {"crow": (0.02, 0.08), "under_eyes": (0.02, 0.06)},
}


_UNDER_EYES = (
    (((17.0, -15.0), (26.0, -20.5), (38.0, -19.5), (45.0, -15.0)), 0.9),
    (((20.0, -20.0), (30.0, -26.0), (43.0, -24.0)), 0.6),
)


@dataclasses.dataclass(frozen=True)
class Line:
    """One crease.

    Attributes:
        group: of `GROUPS`.
        points: (k, 2) mm, along it.
        strength: (k,) 0..1, tapering at both ends.
    """

    group: str
    points: np.ndarray
    strength: np.ndarray


def person_lines(rng: np.random.Generator) -> tuple[Line, ...]:
    """All lines of a person, whatever the age: how deep they are is for `crease_depths`."""
    lines: list[Line] = []

    def add(group: str, points: list[tuple[float, float]], strength: float = 1.0) -> None:
        wobble = rng.normal(0, 0.35, (len(points), 2))
        path = curve(
            [(x + a, y + b) for (x, y), (a, b) in zip(points, wobble.tolist(), strict=True)]
        )
        along = np.linspace(0, 1, len(path))
        broken = 1 - 0.55 * np.abs(np.sin(along * rng.uniform(3, 9) + rng.uniform(0, 6))) ** 4
        taper = smoothstep(0.0, 0.22, along) * smoothstep(1.0, 0.78, along)
        lines.append(Line(group, path, np.clip(strength * broken * taper, 0, 1)))

    height = rng.uniform(28, 31)
    for k in range(int(rng.integers(3, 6))):
        height += rng.uniform(6.0, 9.0)
        half, shift = rng.uniform(30, 46), rng.normal(0, 4)
        cut = rng.uniform(-18, 18) if rng.uniform() < 0.6 else None
        spans = [(-half, half)] if cut is None else [(-half, cut - 2), (cut + 2, half)]
        for low, high in spans:
            xs = np.linspace(low, high, 7)
            arch = 2.2 * np.exp(-(((np.abs(xs) - 25) / 13) ** 2)) - 2.0 * (xs / 46) ** 2
            add(
                "forehead",
                [(float(a), float(b)) for a, b in zip(xs + shift, height + arch, strict=True)],
                1 - 0.13 * k,
            )
    for side in (-1, 1):
        x = side * rng.uniform(4.5, 7.0)
        add("glabella", [(x * 0.85, 9), (x, 17), (x * 1.25, 26)], rng.uniform(0.6, 1))
        if rng.uniform() < 0.4:
            add("glabella", [(1.9 * x, 13), (2.1 * x, 22)], 0.5)
        rays = np.linspace(42, -40, int(rng.integers(4, 7))) + rng.normal(0, 4)
        for a in np.radians(rays).tolist():
            start = (50.5 + 1.5 * np.cos(a), -8.5 + 3.0 * np.sin(a))
            reach, bend = rng.uniform(8, 15), rng.normal(-1.5, 1.0)
            middle = (start[0] + 0.5 * reach * np.cos(a), start[1] + 0.5 * reach * np.sin(a))
            end = (start[0] + reach * np.cos(a), start[1] + reach * np.sin(a) + bend)
            add("crow", [(side * px, py) for px, py in (start, middle, end)], rng.uniform(0.5, 1))
        for arc, strength in _UNDER_EYES:
            add("under_eyes", [(side * px, py) for px, py in arc], strength)
        drop = rng.normal(0, 1.5)
        fold = [(17.5, -44), (23, -53), (29, -65 + drop), (32.5, -77 + drop)]
        add("folds", [(side * px, py) for px, py in fold], rng.uniform(0.7, 1))
        corner = [(27.5, -79), (30.5, -87), (31, -99)]
        add("marionette", [(side * px, py) for px, py in corner], rng.uniform(0.6, 1))
        for _ in range(26):
            px, py = rng.uniform(16, 50), rng.uniform(-24, -14)
            lean = rng.normal(-0.5, 0.5)
            tip = (px + 4, py + 4 * np.tan(lean))
            add("crepe", [(side * px, py), (side * tip[0], tip[1])], rng.uniform(0.3, 1))
    for y in (4.5, 7.0):
        add("bridge", [(-7, y - 0.8), (0, y), (7, y - 0.8)], 0.9)
    for px in np.linspace(-19, 19, 13) + rng.normal(0, 0.7, 13):
        fan = 0.16 * px
        rise = rng.uniform(4, 8)
        add("lips", [(px, -68.5), (px + fan * rise / 6, -68.5 + rise)], rng.uniform(0.4, 1))
        drop = rng.uniform(2.5, 5)
        add("lips", [(px, -86.5), (px + fan * drop / 6, -86.5 - drop)], rng.uniform(0.2, 0.6))
    for y in (-131, -143, -155):
        y += rng.normal(0, 3)
        sag = rng.uniform(3, 7)
        add("neck", [(-44, y + sag), (-20, y + 0.8), (0, y), (20, y + 0.8), (44, y + sag)], 0.9)
    return tuple(lines)


def crease_depths(age: float, expression: str | None) -> dict[str, float]:
    """Depth of each group's deepest line, mm.

    Args:
        age: 0 smooth to 1 lined.
        expression: as `sim.head.modes.EXPRESSIONS`; None, neutral and unknown ones deepen nothing.
    """
    drawn = {name: depth * age**1.4 for name, (_, depth) in GROUPS.items()}
    for name, (young, old) in DEEPENS.get(expression or "neutral", {}).items():
        drawn[name] += young + (old - young) * age
    return drawn


def crease_chart(
    lines: tuple[Line, ...], depths: dict[str, float], texel_mm: float = PIXEL_MM
) -> Chart:
    """Height in mm of all creases over the plane of the face: furrows with raised sides.

    Args:
        lines: the person's.
        depths: of each group, mm (`crease_depths`).
        texel_mm: of the texture that will look it up; for large texels the chart is coarser.
    """
    pixel = max(PIXEL_MM, 0.4 * texel_mm)
    total = empty(*_BOUNDS, pixel)
    for sigma in sorted({width for width, _ in GROUPS.values()}):
        names = [name for name, (width, _) in GROUPS.items() if width == sigma]
        here = [line for line in lines if line.group in names and depths[line.group] > 0.004]
        if not here:
            continue
        layer = empty(*_BOUNDS, pixel)
        draw_lines(layer, [x.points for x in here], [x.strength * depths[x.group] for x in here])
        pixels = sigma / pixel
        # A line of one pixel, blurred, keeps 1 / (sigma sqrt(2 pi)) of its height.
        furrow = cv2.GaussianBlur(layer.picture, (0, 0), max(pixels, 0.7))
        sides = cv2.GaussianBlur(layer.picture, (0, 0), max(2.6 * pixels, 1.4))
        scale = pixels * np.float32(np.sqrt(2 * np.pi))
        np.add(total.picture, scale * (1.0 * sides - 1.16 * furrow), out=total.picture)
    return total


def crease_height(patch: Patch, chart: Chart) -> np.ndarray:
    """(h, columns) float32 mm of `crease_chart` on the face's front; none on lips and eyes."""
    x, y = signed_place(patch)
    height = chart.look_up(x, y) * smoothstep(-8.0, 12.0, patch.reference[..., 2])
    free = (1 - patch.mask("eyes")) * (1 - patch.mask("lips")) * (1 - patch.mask("ears"))
    return np.asarray(height * free, np.float32)


def add_creases(height_mm: np.ndarray, face: Face, chart: Chart) -> np.ndarray:
    """(rows, columns) float32: a copy of a height map with creases added."""
    out = height_mm.copy()
    for patch in face.strips():
        out[patch.rows] += crease_height(patch, chart)
    return out
