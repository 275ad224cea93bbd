"""Eyeballs behind the lids of our template, and the lids' rims that reach them."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

from learning.export.morphs import PHOTO
from learning.export.parts.opened import CENTRE_MM, RADIUS_MM, template_lines
from learning.export.parts.part import Part, sheet
from learning.vectors import unit

IRIS_MM, PUPIL_MM = 5.9, 1.8
"""Radii, from the eye's axis."""
BULGE_MM = 0.9
"""Height of the cornea over the ball."""
CLEAR_MM, BACK_MM = 0.5, 4.0
"""Between ball and lids; as far as the ball may move back for it."""
BROWN = np.array([0.09, 0.045, 0.02])
SCLERA, LID = np.array([0.52, 0.46, 0.43]), np.array([0.30, 0.165, 0.145])
ABOVE_MM = 0.6
"""Height of the pupil over the middle of the lids' opening."""
LOOKS = {"Up": (-25.0, 0), "Down": (30.0, 0), "In": (0, -32.0), "Out": (0, 32.0)}
"""Degrees about x and about y of the left eye at a weight of 1; about y the right one mirrors."""
FOLLOW = {"Up": -0.12, "Down": 0.45}
"""Share of a blink by which the lids follow a look."""
FRONT, BACK, COLUMNS = 48, 24, 64
"""Rings of an eyeball before and behind the border of the cornea, and vertices on each."""


def look_names() -> list[str]:
    """ARKit's names of the looks [ARKit17]."""
    return [f"eyeLook{look}{side}" for look in LOOKS for side in ("Left", "Right")]


def lids_of_looks(morphs: dict[str, np.ndarray], count: int) -> dict[str, np.ndarray]:
    """(count, 3) offsets of the skin by look, mm."""
    found = {}
    for name in look_names():
        look, side = name.removeprefix("eyeLook"), "Left" if name.endswith("Left") else "Right"
        blink = morphs.get(f"eyeBlink{side}", np.zeros((count, 3)))
        found[name] = FOLLOW.get(look.removesuffix(side), 0.0) * blink
    return found


def eyes(places: np.ndarray, morphs: dict[str, np.ndarray], iris: np.ndarray) -> list[Part]:
    """Both eyeballs and the rims of their lids.

    Args:
        places: (n, 3) of the skin's vertices in the template's axes, mm.
        morphs: by name (n, 3) of the skin.
        iris: (3,) linear albedo.
    """
    found = []
    for eye, (side, sign) in enumerate((("Right", -1), ("Left", 1))):
        ring = _ring(eye)
        centre = _centre(eye, places, [morphs.get(f"eyeBlink{side}"), morphs.get(PHOTO)])
        ball = _ball(f"eye{side}", centre, iris)
        ball = dataclasses.replace(
            ball, places=_gaze(eye, places, centre).apply(ball.places - centre) + centre
        )
        for look, (up, out) in LOOKS.items():
            turn = Rotation.from_euler("xy", [up, sign * out], degrees=True)
            ball.morphs[f"eyeLook{look}{side}"] = (
                turn.apply(ball.places - centre) - ball.places + centre
            )
        rim = _rim(places[ring], centre)
        shown = Part(f"lids{side}", rim, sheet(3, len(ring), True), _rim_colours(eye), 0.35)
        for name, offsets in morphs.items():
            moved = _rim(places[ring] + offsets[ring], centre) - rim
            if np.abs(moved).max() > 1e-3:
                shown.morphs[name] = moved
        found += [ball, shown]
    return found


def _ring(eye: int) -> np.ndarray:
    """Vertices of the skin round the opening of an eye, in order."""
    top, bottom, first, last = template_lines().eyes[eye]
    grid = template_lines().grid
    return np.concatenate(
        [
            grid[top, first:last],
            grid[top:bottom, last],
            grid[bottom, last:first:-1],
            grid[bottom:top:-1, first],
        ]
    )


def _centre(eye: int, places: np.ndarray, moved: list[np.ndarray | None]) -> np.ndarray:
    """(3,) of a person's eyeball: moved with the surface round it, and behind the lids."""
    ring = _ring(eye)
    centre = CENTRE_MM * ((-1, 1)[eye], 1, 1)
    centre = centre + (places[ring] - template_lines().mesh.vertices[ring]).mean(axis=0)
    rims = [places[ring], *(places[ring] + each[ring] for each in moved if each is not None)]
    near = np.concatenate(rims)
    for _ in range(round(BACK_MM / 0.1)):
        if np.quantile(np.linalg.norm(near - centre, axis=1), 0.05) >= RADIUS_MM + CLEAR_MM:
            break
        centre = centre - (0, 0, 0.1)
    return np.asarray(centre)


def _gaze(eye: int, places: np.ndarray, centre: np.ndarray) -> Rotation:
    """From straight ahead to the middle of the opening's height, which lies a little lower."""
    top, bottom, first, last = template_lines().eyes[eye]
    middle = template_lines().grid[:, (first + last) // 2]
    height = places[middle[[top, bottom]], 1].mean() + ABOVE_MM - centre[1]
    down = np.arcsin(np.clip(-height / RADIUS_MM, -0.2, 0.2))
    return Rotation.from_euler("x", float(down))


def _ball(name: str, centre: np.ndarray, iris: np.ndarray) -> Part:
    """An eyeball: white, iris and pupil, under a bulging cornea; the tears make it shine."""
    # Rings are dense where colours change; behind the cornea all is white, as far from the axis.
    axial = np.linspace(0.01, IRIS_MM + 1.2, FRONT)
    angle = np.arcsin(axial / RADIUS_MM)
    angle = np.concatenate([angle, np.linspace(angle[-1], 2.6, BACK + 1)[1:]])[:, None]
    axial = np.concatenate([axial, np.full(BACK, np.inf)])[:, None]
    around = 2 * np.pi * np.arange(COLUMNS) / COLUMNS
    bulge = BULGE_MM * np.maximum(0, 1 - (axial / (IRIS_MM + 0.6)) ** 2)
    out = RADIUS_MM * np.sin(angle)
    along = np.broadcast_to(RADIUS_MM * np.cos(angle) + bulge, (FRONT + BACK, COLUMNS))
    places = np.stack([out * np.cos(around), out * np.sin(around), along], axis=-1)
    # The iris has streaks, is lightest beside the pupil and darkest at its border.
    streaks = 1 + 0.25 * np.random.default_rng(3).normal(size=COLUMNS)
    tone = np.interp(axial / IRIS_MM, [0.3, 0.45, 0.75, 0.9, 1.0], [0.8, 1.25, 1.0, 0.75, 0.4])
    white = np.clip((axial - IRIS_MM + 0.25) / 0.5, 0, 1)[..., None]
    colours = (1 - white) * np.clip(tone * streaks, 0.3, 1.6)[..., None] * iris + white * SCLERA
    dark = np.clip((axial - PUPIL_MM) / 0.25, 0, 1)[..., None]
    return Part(
        name,
        places.reshape(-1, 3) + centre,
        sheet(FRONT + BACK, COLUMNS, True),
        (colours * (0.02 + 0.98 * dark)).reshape(-1, 3),
        0.08,
    )


def _rim(ring: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """(3 k, 3) rows from a lid's edge to just within the ball."""
    ray = ring - centre
    inner = centre + unit(ray) * (RADIUS_MM - 0.15)
    return np.concatenate([ring, 0.4 * ring + 0.6 * inner, inner])


def _rim_colours(eye: int) -> np.ndarray:
    """Skin above and below; beside the opening the white goes on to the eye's corners."""
    top, bottom, first, last = template_lines().eyes[eye]
    wide, high = last - first, bottom - top
    beside = np.zeros(2 * (wide + high), bool)
    beside[wide : wide + high + 1] = True
    beside[-high:] = beside[0] = True
    return np.concatenate(
        [np.where(beside[:, None], 0.45 * SCLERA, tone * LID) for tone in (1.0, 0.8, 0.45)]
    )
