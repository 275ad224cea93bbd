"""Hair, beard, brows, spots, folds and make-up painted into a subject's own albedo, and glasses.

They lie over the skin as pictures, so that the true albedo has them, in whatever topology: texels
are found by their place around the head's axis, beside the subject's own 68 landmarks.
"""

from __future__ import annotations

import dataclasses
import zlib

import cv2
import numpy as np

from benchmarks.networks_people import Who
from sim.head.grid import smoothstep
from sim.light.texture import raster_uv, texture_of
from sim.people.clothing import dressed
from sim.people.subject import Subject
from sim.people.worn import BROWS, CHIN, dark_lenses, glasses
from sim.skin.chart import Chart, curve, draw_lines, empty

ROUND_MM = 85.0
"""Of the head: an angle around its axis is so many mm times radians."""
EDGE = (-ROUND_MM * np.pi, ROUND_MM * np.pi, -170.0, 170.0)
PIXEL_MM = 0.35
COLOURS = {
    "black": (0.018, 0.014, 0.012),
    "brown": (0.060, 0.034, 0.019),
    "red": (0.20, 0.070, 0.022),
    "blond": (0.26, 0.165, 0.080),
    "grey": (0.20, 0.19, 0.175),
    "white": (0.52, 0.50, 0.46),
}
DARK_TONE = 4
"""From this tone on hair is black, or grey and white with age."""
GREYS = ("grey", "white")
BEARDS = ("none", "stubble", "moustache", "goatee", "full")
FRAME = (0.02, 0.018, 0.016)
LENS_ROUGHNESS = 0.1
NOSE, MOUTH, OUTER, INNER, TOP_LIP = 33, (48, 54), slice(48, 60), slice(60, 68), 51
LIP_COLOURS = ((0.30, 0.03, 0.05), (0.45, 0.10, 0.14), (0.12, 0.015, 0.03))


@dataclasses.dataclass(frozen=True)
class Looks:
    """Marks and hair of a person.

    Attributes:
        hair: colour of the scalp's hair, of `COLOURS`; None for a head as its subject has it.
        brows: colour of brows and beard.
        beard: of `BEARDS`.
        hairline_mm: above the brows, at the middle of the forehead.
        fringe: hair hangs over the forehead.
        spots: moles.
        freckles: how many.
        folds: depth of the lines beside the mouth and on the forehead, 0 to 1.
        lips: (3,) linear colour of make-up; None without.
        glasses: a frame before the eyes.
    """

    hair: str | None
    brows: str
    beard: str
    hairline_mm: float
    fringe: bool
    spots: int
    freckles: int
    folds: float
    lips: tuple[float, float, float] | None
    glasses: bool


def looks_of(who: Who) -> Looks:
    """The same person always has the same."""
    rng = np.random.default_rng([zlib.crc32(f"{who.kind}-{who.name}".encode()), 5])
    traits = None if who.person is None else who.person.traits
    male = traits is None or traits.sex == "male"
    age = 40.0 if traits is None else traits.age_years
    tone = 2 if traits is None else traits.tone
    colours = ("black",) if tone >= DARK_TONE else ("black", "brown", "brown", "red", "blond")
    grey = rng.random() < np.clip((age - 35) / 35, 0, 0.9)
    colour = str(rng.choice(GREYS if grey else colours))
    made_up = not male and rng.random() < 0.6
    return Looks(
        hair=colour if rng.random() < 0.85 else None,
        brows="brown" if colour == "blond" else colour,
        beard=str(rng.choice(BEARDS, p=(0.1, 0.2, 0.15, 0.2, 0.35))) if male else "none",
        hairline_mm=float(rng.uniform(42, 62)),
        fringe=bool(rng.random() < 0.35),
        spots=int(rng.integers(2, 14)),
        freckles=int(rng.integers(60, 260)) if tone <= 3 and rng.random() < 0.5 else 0,
        folds=float(np.clip((age - 25) / 40, 0, 1) * rng.uniform(0.6, 1.0)),
        lips=LIP_COLOURS[int(rng.integers(len(LIP_COLOURS)))] if made_up else None,
        glasses=bool(rng.random() < 0.35),
    )


class _Canvas:
    """The head's unrolled front, and a subject's texels on it."""

    def __init__(self, subject: Subject) -> None:
        mesh, motion = subject.mesh, subject.head_from_world
        marks = subject.landmarks_mm @ motion[:, :3].T + motion[:, 3]
        self._axis = np.array([marks[:, 0].mean(), 0.0, (marks[0, 2] + marks[16, 2]) / 2])
        self.marks = self._flat(marks)
        face, weights = raster_uv(mesh, *subject.skin.shape)
        vertices = mesh.vertices @ motion[:, :3].T + motion[:, 3]
        self._inside = face >= 0
        self._texels = self._flat(texture_of(vertices, mesh.triangles(), face, weights))

    def _flat(self, points: np.ndarray) -> np.ndarray:
        away = points - self._axis
        around = ROUND_MM * np.arctan2(away[..., 0], away[..., 2])
        return np.stack([around, away[..., 1]], axis=-1)

    def texels(self, chart: Chart) -> np.ndarray:
        """(rows, columns, 1) 0..1 of a chart at the texels."""
        across, up = np.moveaxis(self._texels.astype(np.float32), -1, 0)
        return np.asarray(np.clip(chart.look_up(across, up), 0, 1) * self._inside)[..., None]

    def area(self, outline: np.ndarray, soft_mm: float) -> Chart:
        """The area that (n, 2) mm encloses, with a soft edge."""
        chart = empty(*EDGE, PIXEL_MM)
        place = (outline - (chart.left, chart.top)) / (PIXEL_MM, -PIXEL_MM)
        cv2.fillPoly(chart.picture, [np.round(place).astype(np.int32)], 1.0)
        return chart.softened(soft_mm)

    def hairs(
        self,
        rng: np.random.Generator,
        area: Chart,
        count: int,
        way: tuple[float, float],
        strength: float,
    ) -> Chart:
        """Hairs rooted in an area, as (dx, dy) mm long, a tenth of a radian apart."""
        rows, columns = np.nonzero(area.picture > rng.random(area.picture.shape))
        chart = empty(*EDGE, PIXEL_MM)
        lines, strengths = [], []
        for k in rng.integers(len(rows), size=count if len(rows) else 0):
            root = (chart.left + PIXEL_MM * columns[k], chart.top - PIXEL_MM * rows[k])
            length, turn = rng.uniform(0.6, 1.3), rng.normal(0, 0.25)
            cosine, sine = np.cos(turn), np.sin(turn)
            to = np.array([cosine * way[0] - sine * way[1], sine * way[0] + cosine * way[1]])
            bend = rng.normal(0, 0.15) * length * np.array([-to[1], to[0]])
            lines.append(curve([root, root + length * to / 2 + bend, root + length * to], 5))
            strengths.append(strength * np.linspace(1, 0.3, 5) * rng.uniform(0.5, 1))
        draw_lines(chart, lines, strengths)
        return chart


def painted(subject: Subject, looks: Looks, seed: int) -> Subject:
    """A subject with its looks on the skin; hair of the scalp and a fringe are no skin any more."""
    rng = np.random.default_rng([seed, 61])
    canvas = _Canvas(subject)
    marks = canvas.marks
    albedo, skin = subject.diffuse_albedo.astype(np.float32).copy(), subject.skin.copy()
    covered = np.zeros((*skin.shape, 1), np.float32)

    def over(chart: Chart, colour: tuple[float, float, float] | np.ndarray) -> np.ndarray:
        nonlocal albedo, covered
        share = canvas.texels(chart)
        albedo = albedo + share * (np.array(colour, np.float32) - albedo)
        return share

    def darker(chart: Chart, rgb: tuple[float, float, float]) -> None:
        nonlocal albedo
        albedo = albedo * (1 - canvas.texels(chart) * np.array(rgb, np.float32))

    darker(_dots(rng, canvas, looks.freckles, (0.3, 0.7)), (0.22, 0.38, 0.42))
    darker(_dots(rng, canvas, looks.spots, (0.7, 2.0)), (0.55, 0.68, 0.72))
    if looks.folds:
        darker(_folds(rng, marks, looks.folds), (0.30, 0.38, 0.38))
    if looks.lips is not None:
        lips = canvas.area(marks[OUTER], 0.6)
        mouth = canvas.area(marks[INNER], 0.3)
        chart = dataclasses.replace(lips, picture=0.75 * lips.picture * (1 - mouth.picture))
        over(chart, looks.lips)
    brows = _colour(rng, looks.brows)
    for side, line in ((-1, marks[17:22]), (1, marks[22:27])):
        path = curve([(float(x), float(y)) for x, y in line])
        # The first brow ends at the nose, the second begins there.
        half = np.interp(np.linspace(0, 1, len(path)), (0, 0.5, 1), (1.2, 2.6, 2.6))[::-side]
        half = half[:, None]
        outline = np.concatenate([path + half * [0, 1], (path - half * [0, 1])[::-1]])
        area = canvas.area(outline, 0.8)
        drawn = canvas.hairs(rng, area, 420, (side * 5.0, 1.5), 0.9)
        shade = dataclasses.replace(area, picture=0.35 * area.picture)
        covered = np.maximum(covered, np.maximum(over(shade, brows), over(drawn, brows)))
    if looks.beard != "none":
        covered = np.maximum(covered, _beard(rng, canvas, looks.beard, over, brows))
    if looks.hair is not None:
        colour = _colour(rng, looks.hair)
        cap = _scalp(rng, canvas, looks)
        strands = canvas.hairs(rng, cap, 9000, (0.0, -14.0), 0.8)
        share = over(cap, 0.6 * colour)
        hung = over(strands, 1.25 * colour)
        share = np.maximum(share, hung)
        skin &= share[..., 0] < 0.3
        covered = np.maximum(covered, share)
    kept = 1 - 0.45 * covered[..., 0]
    return dataclasses.replace(
        subject, diffuse_albedo=albedo, skin=skin, specular_albedo=subject.specular_albedo * kept
    )


def _colour(rng: np.random.Generator, name: str) -> np.ndarray:
    return np.array(COLOURS[name]) * np.exp(rng.normal(0, 0.15))


def _dots(
    rng: np.random.Generator, canvas: _Canvas, count: int, radius_mm: tuple[float, float]
) -> Chart:
    """Spots on the face, from the ears to below the chin."""
    chart = empty(*EDGE, PIXEL_MM / 2)
    marks = canvas.marks
    low, high = marks[CHIN, 1] - 5, marks[list(BROWS), 1].max() + 45
    half = 0.8 * np.abs(marks[[0, 16], 0]).min()
    for _ in range(count):
        place = np.array([rng.uniform(-half, half), rng.uniform(low, high)])
        at = (place - (chart.left, chart.top)) / (chart.pixel, -chart.pixel)
        radius = rng.uniform(*radius_mm) / chart.pixel
        axes = (round(16 * radius), round(16 * radius * rng.uniform(0.7, 1)))
        fixed = [round(16 * float(c)) for c in at]
        turn = float(rng.uniform(0, 180))
        strength = float(rng.uniform(0.5, 1))
        cv2.ellipse(chart.picture, fixed, axes, turn, 0, 360, strength, -1, shift=4)
    return chart.softened(0.25)


def _folds(rng: np.random.Generator, marks: np.ndarray, depth: float) -> Chart:
    """Lines from nose to mouth, over the forehead, beside the eyes."""
    chart = empty(*EDGE, PIXEL_MM)
    lines, strengths = [], []
    for side, wing, corner, eye in ((-1, 31, 48, 36), (1, 35, 54, 45)):
        start, end = marks[wing] + np.array([5 * side, 3]), marks[corner] + np.array([6 * side, -1])
        middle = (start + end) / 2 + np.array([4 * side, 0])
        lines.append(curve([tuple(start), tuple(middle), tuple(end)]))
        strengths.append(depth * np.linspace(1, 0.4, 24))
        for rise in (-5.0, -1.0, 3.0):
            begin = marks[eye] + np.array([5 * side, 0.4 * rise])
            stop = begin + np.array([rng.uniform(7, 13) * side, rise + rng.normal(0, 1)])
            lines.append(curve([tuple(begin), tuple(stop)]))
            strengths.append(depth * np.linspace(0.7, 0.1, 24))
    level, half = marks[list(BROWS), 1].max(), 0.8 * np.ptp(marks[list(BROWS), 0]) / 2
    for k in range(3):
        high = level + 11 + 9 * k + rng.normal(0, 1.5)
        points = [(x, high + rng.normal(0, 1.0)) for x in np.linspace(-half, half, 6)]
        lines.append(curve(points))
        strengths.append(0.6 * depth * np.sin(np.linspace(0.2, np.pi - 0.2, 24)))
    draw_lines(chart, lines, strengths)
    # Lines of a pixel become as wide as folds are, and keep their darkness.
    soft = cv2.GaussianBlur(chart.picture, (0, 0), 0.7 / PIXEL_MM)
    return dataclasses.replace(chart, picture=np.clip(3.0 * soft, 0, 1))


def _beard(
    rng: np.random.Generator, canvas: _Canvas, kind: str, over: object, colour: np.ndarray
) -> np.ndarray:
    """Paint a beard; how much of each texel it covers."""
    assert callable(over)
    marks = canvas.marks
    wide = abs(marks[54, 0] - marks[48, 0]) / 2
    middle, nose, corner = marks[NOSE, 0], marks[NOSE, 1] - 2.5, marks[list(MOUTH), 1].mean()
    chin = marks[CHIN, 1]
    half = wide + 7
    if kind == "moustache":
        rim = [(-half, corner - 1), (-half + 4, corner + 3), (0, nose), (half - 4, corner + 3)]
        rim += [(half, corner - 1)]
    elif kind == "goatee":
        rim = [(-half, corner), (-half + 4, corner + 4), (0, nose), (half - 4, corner + 4)]
        rim += [(half, corner), (half - 3, chin + 4), (0, chin - 18), (3 - half, chin + 4)]
    else:
        side = np.abs(marks[[1, 15], 0]).min() - 4
        ears = marks[[0, 16], 1].mean() + 8
        rim = [(-side - 14, ears), (-side + 4, ears), (-side + 12, corner + 22)]
        rim += [(-half - 8, corner + 8), (4 - half, corner + 5), (0, nose), (half - 4, corner + 5)]
        rim += [(half + 8, corner + 8), (side - 12, corner + 22), (side - 4, ears)]
        rim += [(side + 14, ears), (side + 8, marks[3, 1] - 4), (60, chin - 10), (0, chin - 28)]
        rim += [(-60, chin - 10), (-side - 8, marks[3, 1] - 4)]
    area = canvas.area(np.array(rim) + np.array([middle, 0]), 2.5)
    lips = canvas.area(marks[OUTER] + np.sign(marks[OUTER] - marks[OUTER].mean(0)), 0.8)
    area = dataclasses.replace(area, picture=area.picture * (1 - np.clip(lips.picture, 0, 1)))
    short = kind == "stubble"
    size = float((area.picture > 0.5).sum() * PIXEL_MM**2)
    way = (0.0, -1.2) if short else (0.0, -6.0)
    drawn = canvas.hairs(rng, area, int(size * (0.8 if short else 0.6)), way, 0.75)
    shade = dataclasses.replace(area, picture=(0.18 if short else 0.7) * area.picture)
    return np.maximum(over(shade, colour), over(drawn, (1.15 if not short else 1.0) * colour))


def _scalp(rng: np.random.Generator, canvas: _Canvas, looks: Looks) -> Chart:
    """Where the scalp's hair is: above a hairline that falls at the temples to the ears."""
    marks = canvas.marks
    level = marks[list(BROWS), 1].mean()
    temple = np.abs(marks[[17, 26], 0]).min() + 8
    ears = marks[[0, 16], 1].mean() + 12
    line = level + looks.hairline_mm
    around = np.array([0, 0.55 * temple, 0.95 * temple, temple + 6, temple + 10, 140, 400])
    heights = np.array([line, line + 2, line - 6, line - 22, ears, ears + 4, ears - 60])
    if looks.fringe:
        heights[:3] = level + rng.uniform(8, 28) + np.array([0, rng.normal(0, 4), 4])
    chart = empty(*EDGE, PIXEL_MM)
    rows, columns = chart.picture.shape
    across = chart.left + PIXEL_MM * (np.arange(columns) + 0.5)
    up = chart.top - PIXEL_MM * (np.arange(rows) + 0.5)
    jagged = cv2.GaussianBlur(rng.normal(size=(1, columns)), (0, 0), 2.0 / PIXEL_MM)
    edge = np.interp(np.abs(across), around, heights) + 3.0 * (jagged[0] / jagged.std())
    share = smoothstep(-2.0, 4.0, up[:, None] - edge)
    chart.picture[:] = 0.93 * share
    return chart


def worn(subject: Subject, dark: bool = False) -> Subject:
    """The subject with glasses, which shadow the skin and hide some; with dark lenses or clear."""
    wearing = dressed(subject, glasses(subject), FRAME, 0.04)
    if not dark:
        return wearing
    return dressed(wearing, dark_lenses(subject), FRAME, 0.04, LENS_ROUGHNESS)
