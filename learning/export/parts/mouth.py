"""A mouth's inside behind the lips of our template: teeth, gums, tongue and the bag round them."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable

import numpy as np
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial.transform import Rotation

from learning.export.morphs import PHOTO
from learning.export.parts.opened import Opened, template_lines
from learning.export.parts.part import Part, joined, sheet
from learning.vectors import unit

PIVOT_MM = np.array([0.0, -22.0, 6.0])
"""On the axis about which the template's jaw turns."""
MOST_DEG = 35.0
UPPER = ((8.4, 9.5), (6.6, 8.5), (7.5, 9.5), (7.0, 8.0), (6.8, 7.5), (10.0, 7.0), (9.5, 6.5))
LOWER = ((5.2, 8.0), (5.8, 8.2), (6.7, 9.0), (6.9, 7.8), (7.0, 7.5), (10.6, 7.0), (10.0, 6.5))
"""Width and height of the crowns from the middle, mm, as dental anatomy has them; from memory."""
HALF_MM, DEPTH_MM = (29.0, 26.5), (44.0, 42.0)
"""Half axes of the upper and the lower arch, which is half an ellipse."""
BEHIND_MM, EDGE_MM = (5.5, 7.8), (-3.2, -1.2)
"""Distance of the front teeth, upper and lower, behind the lips' line, and their edges' height."""
ENAMEL, GUM = np.array([0.80, 0.72, 0.59]), np.array([0.42, 0.14, 0.13])
TONGUE, BAG = np.array([0.50, 0.17, 0.16]), np.array([0.17, 0.035, 0.03])
CHIN = (6, 7, 8, 9, 10)
UNDER_MM, DEEP_MM = 1.5, {"tongue": 5.0}
"""Least depth under the skin, and by name of parts that lie deeper."""


def jaw_turn(places: np.ndarray, offsets: np.ndarray, pivot: np.ndarray) -> Rotation:
    """A morph's turn of the jaw about the x axis: the chin's movement, by least squares."""
    chin = template_lines().landmarks[list(CHIN)]
    arm = places[chin] - pivot
    across = np.stack([np.zeros(len(arm)), -arm[:, 2], arm[:, 1]], axis=1)
    angle = (offsets[chin] * across).sum() / (across**2).sum()
    return Rotation.from_euler("x", float(np.clip(angle, 0, np.radians(MOST_DEG))))


def mouth(skin: Opened, places: np.ndarray, morphs: dict[str, np.ndarray]) -> list[Part]:
    """The bag, gums, teeth and tongue.

    Args:
        skin: with the openings.
        places: (n', 3) of its vertices in the template's axes, mm.
        morphs: by name (n', 3) of it.
    """
    lines = template_lines()
    own, lip = lines.mesh.vertices, places[skin.upper]
    wide = np.ptp(own[skin.upper[[0, -1]], 0])
    scale = float(np.clip(np.ptp(lip[[0, -1], 0]) / wide, 0.85, 1.15))
    middle = lip[len(lip) // 2]
    pivot = PIVOT_MM + (places[: len(own)] - own).mean(axis=0)
    front = places[:, 2] > middle[2] - 60
    front &= np.abs(places[:, 1] - middle[1]) < 45
    # Neither the neutral face nor the photograph's smile shows what is behind the lips.
    smiles = [places, *([places + morphs[PHOTO]] if PHOTO in morphs else [])]
    walls = [LinearNDInterpolator(each[front, :2], each[front, 2]) for each in smiles]

    def under(points: np.ndarray, least: float) -> np.ndarray:
        """Points moved back to where the skin covers them."""
        depth = np.min([np.nan_to_num(wall(points[:, :2]), nan=1e3) for wall in walls], axis=0)
        out = points.copy()
        out[:, 2] = np.minimum(out[:, 2], depth - least)
        return out

    def lit(points: np.ndarray) -> np.ndarray:
        """(k, 1) share of light that comes in between the lips."""
        depth = middle[2] - points[:, 2]
        return np.clip(1.05 - depth / 38, 0.06, 0.85)[:, None]

    found = []
    for part in (*_arch(0), *_arch(1), _tongue()):
        at = under(scale * part.places + middle, DEEP_MM.get(part.name, UNDER_MM))
        found.append(dataclasses.replace(part, places=at, colours=part.colours * lit(at)))
    turns = {name: jaw_turn(places, offsets, pivot) for name, offsets in morphs.items()}
    for part in found:
        if part.name.startswith("upper"):
            continue
        for name, turn in turns.items():
            if turn.magnitude() > 1e-3:
                part.morphs[name] = turn.apply(part.places - pivot) + pivot - part.places
    return [*found, _bag(skin, places, morphs, turns, pivot, under, lit, scale)]


@functools.cache
def _on_arch(lower: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lengths along half an arch from its middle, its places (x, z) there and outward normals."""
    angle = np.linspace(0, np.pi / 2, 400)
    a, b = HALF_MM[lower], DEPTH_MM[lower]
    place = np.stack([a * np.sin(angle), b * (np.cos(angle) - 1)], axis=1)
    place[:, 1] -= BEHIND_MM[lower]
    normal = unit(np.stack([np.sin(angle) / a, np.cos(angle) / b], axis=1))
    steps = np.linalg.norm(np.diff(place, axis=0), axis=1)
    return np.concatenate([[0], np.cumsum(steps)]), place, normal


def _at(lower: int, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places (k, 2) and outward normals of an arch; left of the middle `along` is above 0."""
    length, place, normal = _on_arch(lower)
    side = np.where(along < 0, -1, 1)[:, None] * (1, 0) + (0, 1)
    both = [
        np.stack([np.interp(abs(along), length, each[:, k]) for k in (0, 1)], axis=1) * side
        for each in (place, normal)
    ]
    return both[0], both[1]


def _arch(lower: int) -> tuple[Part, Part]:
    """Teeth and gum of a jaw; the lips' middle is the origin."""
    name, up = ("lower", -1) if lower else ("upper", 1)
    teeth, ends = [], [0.0]
    for number, (width, height) in enumerate((UPPER, LOWER)[lower]):
        middle = ends[-1] + width / 2
        ends.append(ends[-1] + width)
        for side in (-1, 1):
            teeth.append(_tooth(lower, side * middle, width, height, number, up))
    along = np.linspace(-ends[-1], ends[-1], 181)
    heights = np.interp(
        abs(along), ends, [(UPPER, LOWER)[lower][0][1], *(h for _, h in (UPPER, LOWER)[lower])]
    )
    cut = np.min([abs(abs(along) - end) for end in ends], axis=0)
    neck = heights - 0.8 - 2.2 * np.exp(-(cut**2) / 1.8)
    place, normal = _at(lower, along)
    rows = []
    for out, high in ((-8, 7), (-8, 0), (-4, 0), (0.1, 0), (0.7, 0.9), (0.5, 4), (-1.5, 8)):
        x, z = (place + out * normal).T
        rows.append(np.stack([x, EDGE_MM[lower] + up * (neck + high), z], axis=1))
    at = np.concatenate(rows)
    gum = Part(
        f"{name}Gum", at, sheet(len(rows), len(along), False), np.tile(GUM, (len(at), 1)), 0.3
    )
    return joined(f"{name}Teeth", teeth), gum


def _tooth(lower: int, along: float, width: float, height: float, number: int, up: int) -> Part:
    """A crown with rounded edges, from within the gum to its biting edge."""
    high = np.array([1.25, 1.0, 0.8, 0.55, 0.3, 0.14, 0.05, 0.012, 0.0])
    across = np.array([0.66, 0.74, 0.86, 0.96, 1.0, 0.98, 0.91, 0.72, 0.0])
    thick = np.interp(
        high, [0, 0.05, 0.3, 1], [0.3, 0.55, 0.75, 1.0] if number < 3 else [0.6, 0.85, 1, 1]
    )
    thick[-1] = 0
    deep = (5.5, 5.0, 6.0, 7.5, 7.5, 9.0, 9.0)[number]
    if number < 3:
        deep -= 0.8 * lower
    around = 2 * np.pi * np.arange(20) / 20
    c, s = (np.sign(f) * abs(f) ** 0.65 for f in (np.cos(around), np.sin(around)))
    side = along + 0.485 * width * across[:, None] * c
    # The outer face stays on the arch and bends in a little toward the edge.
    inward = 0.5 * deep * thick[:, None] * (s - 1) - 0.6 * (1 - across[:, None])
    inward = inward - 0.7 * c**2 * (across[:, None] > 0)
    place, normal = _at(lower, side.ravel())
    x, z = (place + inward.reshape(-1, 1) * normal).T
    y = EDGE_MM[lower] + up * np.repeat(height * high + (0.5 if number == 1 else 0), 20)
    colours = np.tile(ENAMEL, (len(x), 1))
    colours[:, 2] *= np.repeat(np.interp(high, [0, 1], [1.05, 0.8]), 20)
    return Part("", np.stack([x, y, z], axis=1), sheet(9, 20, True), colours, 0.18)


def _tongue() -> Part:
    """A flat body behind the lower teeth; the lips' middle is the origin."""
    back = np.linspace(0.02, 1, 24)[:, None]
    around = 2 * np.pi * np.arange(32) / 32
    size = np.sqrt(1 - (1 - np.minimum(back / 0.55, 1)) ** 2)
    x = 18.5 * size * np.cos(around)
    y = 5.5 * size * np.sin(around) - 10 + 4 * np.sin(np.pi * back * 0.8)
    y = y - 1.6 * np.exp(-((x / 3) ** 2)) * (np.sin(around) > 0)
    z = np.broadcast_to(-15 - 36 * back, x.shape)
    places = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    return Part("tongue", places, sheet(24, 32, True), np.tile(TONGUE, (len(places), 1)), 0.3)


def _bag(
    skin: Opened,
    places: np.ndarray,
    morphs: dict[str, np.ndarray],
    turns: dict[str, Rotation],
    pivot: np.ndarray,
    under: Callable[[np.ndarray, float], np.ndarray],
    lit: Callable[[np.ndarray], np.ndarray],
    scale: float,
) -> Part:
    """The wall from the lips' edges back to the throat."""
    ring = np.concatenate([skin.upper, skin.lower[-2:0:-1]])
    count = len(skin.upper)
    along = np.concatenate([np.linspace(0, 1, count), np.linspace(1, 0, count)[1:-1]])
    height = np.sin(np.pi * along) ** 0.5
    low = np.concatenate([np.zeros(count), np.ones(count - 2)]) * height
    sign = np.where(low > 0, -1, 1) * height
    lip = places[ring]
    middle = places[skin.upper][count // 2]
    # Out of the lips' line, back, and how far the jaw rather than the lips moves it.
    table = ((0, 0, 0, 1), (7, 2.5, 0.3, 1.0), (15, 8, 0.8, 1.02), (18, 22, 1, 1.0),
             (15, 40, 1, 0.8), (9, 54, 1, 0.5), (0, 58, 1, 0.02))  # fmt: skip
    rows, weights = [], []
    for out, back, share, wide in table:
        at = lip.copy()
        at[:, 0] = middle[0] + wide * (lip[:, 0] - middle[0])
        at[:, 1] += scale * out * sign
        at[:, 2] -= scale * back
        rows.append(at if not out and not back else under(at, 1.2))
        weights.append(np.full(len(ring), share))
    at, jaw = np.concatenate(rows), np.concatenate(weights)[:, None]
    lows = np.tile(low, len(rows))[:, None]
    part = Part("mouth", at, sheet(len(rows), len(ring), True), BAG * lit(at), 0.45)
    for name, offsets in morphs.items():
        turned = turns[name].apply(at - pivot) + pivot - at
        half = np.where(np.tile(sign == 0, len(rows))[:, None], 0.5, lows)
        moved = (1 - jaw) * np.tile(offsets[ring], (len(rows), 1)) + jaw * half * turned
        if np.abs(moved).max() > 1e-3:
            part.morphs[name] = moved
    return part
