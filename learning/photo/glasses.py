"""Glasses before a photographed face: found by their frame, and which pixels they hide.

The photograph is looked at in the plane of the lenses, which the fitted head gives, in mm. There a
frame is two rims alike, each side of the face's middle, and a bridge. Brows and lids lie where a
rim's upper half may be, so that its lower half, on the cheeks, and the bridge decide: a face
without glasses has no edges along both.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator

import cv2
import numpy as np

from learning.masks import widened
from learning.photo.eyes import EYES
from learning.photo.sampling import sampled
from learning.photo.shape_fit import aside_deg
from lightstage.formats.srgb import LUMINANCE
from lightstage.rig import Camera

BEFORE_EYES_MM = 12.0
"""Distance of the lenses' plane in front of the eyes."""
STEP_MM = 0.5
ASIDE_MM, ABOVE_MM, BELOW_MM = 80.0, 45.0, 50.0
"""Extent of the plane about the middle between the eyes."""
DARKEST = 4e-3
LINE_MM = 0.7
"""Standard deviation of the blur before lines are sought."""
BESIDE_MM = 1.5
"""Distance from a rim within which its edge may be."""
DIRECTIONS = 8
"""Directions of a line that are distinguished, of a half turn."""
SIDE_MM, STRONG = 3.5, 0.25
"""Beside a line skin is seen, so much lighter (or darker) in the natural logarithm where the line
is certain."""
MIDDLES_MM, LEVELS_MM = (28.0, 31.0, 34.0, 37.0), (-11.0, -8.0, -5.0, -2.0, 1.0)
HALF_WIDTHS_MM, HALF_HEIGHTS_MM = (20.0, 23.0, 26.0, 29.0), (13.0, 16.0, 19.0, 22.0, 25.0)
LOWEST_MM, NOSE_MM = (12.0, 38.0), (3.0, 14.0)
"""Of rims below the eyes and beside the nose."""
ROUND = (2.0, 3.0)
"""Exponents of the rims' superellipses: an ellipse, and nearly a rectangle."""
SHIFTS_MM = (-4.0, -2.0, 0.0, 2.0, 4.0)
"""Of both rims to a side: noses are not in the middle of a picture."""
ARC = np.radians(np.linspace(200, 340, 36))
"""Part of a rim that decides, from the person's right to the left below the eye."""
BRIDGE_MM, BRIDGE_LEVELS_MM = 7.0, np.arange(-8.0, 14.1, 1.0)
"""Half of the width of the bridge that must show, and where it may be."""
ROUND_ABOUT = np.linspace(0, 2 * np.pi, 73)
LEAST_SHOWN = 0.72
"""Strength of the lines along both lower rims, and along the bridge, at least. See
docs/notes/photo.md."""
MOST_ASIDE_DEG = 30.0
"""Camera's angle from straight in front, at most: from farther aside the rims are not alike."""
DARK_LENS = 0.9
"""Natural logarithm by which dark lenses are darker than the cheeks."""
LEAST_DARK = 0.9
"""Share of the place of a dark lens below the eye that must be so dark."""
CHEEK_MM = (28.0, 9.0, -36.0)
"""Cheeks below any lens: their middle and half their width aside, and their upper end."""
LENS_MM = (31.0, -7.0, 13.0, 7.0)
"""Place below an eye that any dark lens covers, and no lid: middle and half size."""
LENSES_MM = (68.0, -34.0, 22.0)
"""Beyond which there are no lenses: aside, below and above."""
LENS_BORDER_MM = 2.5
OUTSIDE_MM, INSIDE_MM, AROUND_MM = 5.0, 6.0, 0.8
"""Beside a rim, where its wire and shadow are, and around what is found, for the lens's blur."""
ARMS_MM = (-4.0, 17.0)
"""Height above the eyes at which arms go to the ears."""
EYE_MM = (31.0, 17.0, 8.5)
"""Middle, aside, and half size of an eye with its lids, which are never taken for a frame."""
THICKEST_MM, THIN = 4.5, 0.12
"""Half of a wire's width, at most, and its difference from what is beside, natural logarithm."""
MIRRORED = 0.3
"""Natural logarithm over the skin below a lens from which it mirrors a light."""


@dataclasses.dataclass(frozen=True)
class Frame:
    """A frame in the plane of its lenses, mm right and up of the middle between the eyes.

    Attributes:
        middle: of each lens, aside.
        level: of their middles.
        half: width and height.
        power: of the superellipse.
        shift: of both lenses.
        bridge: height of the bridge.
        shown: strength of the lines along the parts that decide, the weakest of them, 0..1.
    """

    middle: float
    level: float
    half: tuple[float, float]
    power: float
    shift: float
    bridge: float
    shown: float

    def rims(self, angle: np.ndarray, wider: float = 0.0) -> np.ndarray:
        """(2, n, 2) points of both rims at angles from the face's left, so much wider."""
        return np.stack(
            [
                _rim(self.power, self.half[0] + wider, self.half[1] + wider, angle)
                + np.array([self.shift + side * self.middle, self.level])
                for side in (-1, 1)
            ]
        )


def _rim(power: float, wide: float, high: float, angle: np.ndarray) -> np.ndarray:
    """(n, 2) superellipse."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.stack(
        [
            wide * np.sign(cosine) * np.abs(cosine) ** (2 / power),
            high * np.sign(sine) * np.abs(sine) ** (2 / power),
        ],
        axis=-1,
    )


class LensPlane:
    """A photograph in the plane of the lenses: rows go down, columns to the face's left."""

    def __init__(self, rgb_linear: np.ndarray, marks_mm: np.ndarray, camera: Camera) -> None:
        """The plane.

        Args:
            rgb_linear: (h, w, 3).
            marks_mm: (68, 3) landmarks of the fitted head, head frame.
            camera: of the photograph.
        """
        middle = np.mean([marks_mm[eye].mean(axis=0) for eye in EYES], axis=0)
        self._x, self._y = np.meshgrid(
            np.arange(-ASIDE_MM, ASIDE_MM + 1e-6, STEP_MM),
            np.arange(ABOVE_MM, -BELOW_MM - 1e-6, -STEP_MM),
        )
        self.shape = self._x.shape
        x, y = self._x, self._y
        place = np.stack([x, y, np.full_like(x, BEFORE_EYES_MM)], axis=-1) + middle
        self._pixel = camera.project(place.reshape(-1, 3))[0].reshape(*self.shape, 2)
        seen = sampled(rgb_linear, self._pixel.reshape(-1, 2))
        light = np.log(np.maximum(seen, DARKEST)) @ LUMINANCE
        self.light: np.ndarray = light.reshape(self.shape).astype(np.float32)
        self._size = rgb_linear.shape[1::-1]

    def at(self, points_mm: np.ndarray) -> np.ndarray:
        """(..., 2) column and row of places."""
        return (points_mm - (-ASIDE_MM, ABOVE_MM)) / (STEP_MM, -STEP_MM)

    def mask(self, outlines_mm: np.ndarray) -> np.ndarray:
        """(rows, columns) bool, what (k, n, 2) outlines enclose."""
        inside = np.zeros(self.shape, np.uint8)
        for outline in self.at(outlines_mm):
            cv2.fillPoly(inside, [np.round(16 * outline).astype(np.int32)], 1, shift=4)
        return inside > 0

    def frame(self) -> Frame | None:
        """The likeliest frame, of dark or of bright lines; None where none is certain."""
        found = [frame for lines in _lines(self) if (frame := _best(self, lines)) is not None]
        return max(found, key=lambda frame: frame.shown, default=None)

    def dark_lenses(self) -> np.ndarray | None:
        """(rows, columns) bool, lenses that nothing is seen through; None where there are none."""
        x, y, light = self._x, self._y, self.light
        cheeks = (np.abs(np.abs(x) - CHEEK_MM[0]) < CHEEK_MM[1]) & (y < CHEEK_MM[2])
        dark = light < np.median(light[cheeks]) - DARK_LENS
        for side in (-1, 1):
            below = (
                np.hypot((x - side * LENS_MM[0]) / LENS_MM[2], (y - LENS_MM[1]) / LENS_MM[3]) < 1
            )
            if dark[below].mean() < LEAST_DARK:
                return None
        near = dark & (np.abs(x) < LENSES_MM[0]) & (y > LENSES_MM[1]) & (y < LENSES_MM[2])
        return widened(near, round(LENS_BORDER_MM / STEP_MM))

    def hidden_by(self, frame: Frame, dark: bool) -> np.ndarray:
        """(rows, columns) bool, a frame, its shadow and, in clear lenses, what they mirror."""
        outer, around, lenses, within, inner = (
            self.mask(frame.rims(ROUND_ABOUT, by)) for by in (OUTSIDE_MM, 1, 0, -1, -INSIDE_MM)
        )
        x, y, light = self._x - frame.shift, self._y, self.light
        edge = frame.middle + frame.half[0]
        arms = (np.abs(x) > edge - INSIDE_MM) & (y > ARMS_MM[0]) & (y < ARMS_MM[1])
        bridge = (np.abs(x) < frame.middle - frame.half[0] + OUTSIDE_MM) & (
            np.abs(y - frame.bridge) < OUTSIDE_MM
        )
        eyes = np.hypot((np.abs(x) - EYE_MM[0]) / EYE_MM[1], y / EYE_MM[2]) < 1
        size = 2 * round(THICKEST_MM / STEP_MM) + 1
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
        thin = cv2.morphologyEx(light, cv2.MORPH_BLACKHAT, kernel) > THIN
        thin |= cv2.morphologyEx(light, cv2.MORPH_TOPHAT, kernel) > THIN
        found = thin & ((outer & ~inner) | arms | bridge) & ~eyes
        # The rim itself in any case, where its colour is skin's.
        found |= around & ~within & ~eyes
        if not dark:
            below = outer & ~lenses & (y < frame.level)
            skin = np.median(light[below & ~thin]) if (below & ~thin).any() else np.inf
            found |= lenses & ~eyes & (light > skin + MIRRORED)
        return found

    def in_photograph(self, mask: np.ndarray) -> np.ndarray:
        """(h, w) bool, pixels of a (rows, columns) mask in the plane, and their neighbours."""
        corners = np.array([[0, 0], [0, -1], [-1, -1], [-1, 0]])
        pixel = self._pixel[corners[:, 0], corners[:, 1]].astype(np.float32)
        rows, columns = self.shape
        ends = np.array([[0, 0], [columns - 1, 0], [columns - 1, rows - 1], [0, rows - 1]])
        # A pixel's middle is at a half.
        way = cv2.getPerspectiveTransform(ends.astype(np.float32), pixel - 0.5)
        found = cv2.warpPerspective(mask.astype(np.float32), way, self._size)
        return np.asarray(cv2.dilate(found, np.ones((3, 3))) > 0.3)


@dataclasses.dataclass(frozen=True)
class Worn:
    """Glasses in a photograph.

    Attributes:
        hidden: (h, w) bool, pixels of the frame, its shadow and what the lenses mirror; and dark
            lenses.
        dark: nothing is seen through the lenses.
    """

    hidden: np.ndarray
    dark: bool

    @property
    def name(self) -> str:
        """For messages."""
        return "sunglasses" if self.dark else "glasses"


def worn_before(rgb_linear: np.ndarray, marks_mm: np.ndarray, camera: Camera) -> Worn | None:
    """Find the glasses that a photograph shows; None where none are certain.

    Args:
        rgb_linear: (h, w, 3).
        marks_mm: (68, 3) landmarks of the fitted head, head frame.
        camera: of the photograph.
    """
    if aside_deg(camera) > MOST_ASIDE_DEG:
        return None
    plane = LensPlane(rgb_linear, marks_mm, camera)
    dark, frame = plane.dark_lenses(), plane.frame()
    if dark is None and frame is None:
        return None
    hidden = np.zeros(plane.shape, bool) if dark is None else dark
    if frame is not None:
        hidden = hidden | plane.hidden_by(frame, dark is not None)
    pixels = plane.in_photograph(widened(hidden, round(AROUND_MM / STEP_MM)))
    return Worn(pixels, dark is not None)


def _normals(line: np.ndarray) -> np.ndarray:
    """(n, 2) across a line of (n, 2) points."""
    along = np.gradient(line, axis=0)
    return np.column_stack([-along[:, 1], along[:, 0]])


def _shapes(shifts: tuple[float, ...]) -> Iterator[tuple[Frame, np.ndarray, np.ndarray]]:
    """Frames with the arcs of both rims that decide, (2, n, 2), and their (n, 2) normals."""
    for wide, high, power in itertools.product(HALF_WIDTHS_MM, HALF_HEIGHTS_MM, ROUND):
        arc = _rim(power, wide, high, ARC)
        normals = _normals(arc)
        for middle, level, shift in itertools.product(MIDDLES_MM, LEVELS_MM, shifts):
            below = high - level
            if LOWEST_MM[0] < below < LOWEST_MM[1] and NOSE_MM[0] < middle - wide < NOSE_MM[1]:
                frame = Frame(middle, level, (wide, high), power, shift, 0.0, 0.0)
                yield frame, frame.rims(ARC), normals


def _best(plane: LensPlane, lines: np.ndarray) -> Frame | None:
    """The frame that lies best on (DIRECTIONS, rows, columns) lines, 0..1.

    Lower rims and bridge must show. Where no bridge does, no rims are sought.
    """

    def shown(points: np.ndarray, normals: np.ndarray) -> float:
        way = np.arctan2(normals[:, 1], normals[:, 0]) / np.pi * DIRECTIONS
        column, row = np.round(plane.at(points)).astype(int).T
        inside = (column >= 0) & (column < plane.shape[1]) & (row >= 0) & (row < plane.shape[0])
        way = np.round(way[inside]).astype(int) % DIRECTIONS
        return float(lines[way, row[inside], column[inside]].sum() / len(points))

    line = np.linspace(-BRIDGE_MM, BRIDGE_MM, 15)
    upright = np.tile((0.0, 1.0), (len(line), 1))
    bridges = {
        shift: max(
            (shown(np.column_stack([line + shift, np.full(15, level)]), upright), float(level))
            for level in BRIDGE_LEVELS_MM
        )
        for shift in SHIFTS_MM
    }
    certain = {shift: bridge for shift, bridge in bridges.items() if bridge[0] >= LEAST_SHOWN}
    best, best_fit = None, -1.0
    for frame, rims, normals in _shapes(tuple(certain)):
        bridge, at = certain[frame.shift]
        least = min(bridge, *(shown(rim, normals) for rim in rims))
        if least < LEAST_SHOWN:
            continue
        # Of frames whose lower rims are alike, the one whose upper rims show too.
        whole = _normals(_rim(frame.power, *frame.half, ROUND_ABOUT))
        fits = least + float(np.mean([shown(rim, whole) for rim in frame.rims(ROUND_ABOUT)]))
        if fits > best_fit:
            best_fit = fits
            best = dataclasses.replace(frame, bridge=at, shown=least)
    return best


def _lines(plane: LensPlane) -> tuple[np.ndarray, np.ndarray]:
    """(DIRECTIONS, rows, columns) strength 0..1 of dark and of bright lines across a direction."""
    soft = cv2.GaussianBlur(plane.light, (0, 0), LINE_MM / STEP_MM)
    reach = 2 * round(BESIDE_MM / STEP_MM) + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach))
    dark: list[np.ndarray] = []
    bright: list[np.ndarray] = []
    for way in range(DIRECTIONS):
        angle = np.pi * way / DIRECTIONS
        step = SIDE_MM / STEP_MM * np.array([np.cos(angle), -np.sin(angle)])
        sides = [
            cv2.warpAffine(
                soft,
                np.array([[1, 0, s * step[0]], [0, 1, s * step[1]]]),
                soft.shape[::-1],
                borderMode=cv2.BORDER_REPLICATE,
            )
            for s in (-1, 1)
        ]
        for kind, line in ((dark, np.minimum(*sides) - soft), (bright, soft - np.maximum(*sides))):
            kind.append(cv2.dilate(np.clip(line / STRONG, 0, 1), kernel))
    return np.array(dark), np.array(bright)
