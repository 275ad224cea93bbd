"""Melanin and blood of each texel, and the colour that follows from them."""

from __future__ import annotations

import dataclasses

import numpy as np

from sim.head.grid import smoothstep
from sim.head.maps import over_grid
from sim.head.mesh import neutral_mesh
from sim.skin.complexion import Complexion
from sim.skin.noise import spots
from sim.skin.parts import Patch
from sim.skin.pigments import PigmentConfig, paint_pigments
from sim.skin.places import PLACE_COLUMNS, PLACE_ROWS, place_masks

ARTERIAL = PigmentConfig(oxygenated=0.96)


@dataclasses.dataclass(frozen=True)
class Spots:
    """Round spots of a person: (k, 3) mm on our base head, (k,) radii mm and strengths."""

    centres: np.ndarray
    radii: np.ndarray
    strengths: np.ndarray

    def on(self, patch: Patch) -> np.ndarray:
        """(h, columns) sum of the spots."""
        flat = np.ascontiguousarray(patch.reference.reshape(-1, 3))
        return spots(flat, self.centres, self.radii, self.strengths).reshape(patch.shape)


@dataclasses.dataclass(frozen=True)
class Marks:
    """What is on a person's skin: moles and age spots (melanin), pimples (blood)."""

    moles: Spots
    age_spots: Spots
    pimples: Spots


def person_marks(c: Complexion, rng: np.random.Generator) -> Marks:
    """Draw a person's marks; they are at the same places at every texture size."""
    points = over_grid(neutral_mesh().vertices, PLACE_ROWS, PLACE_COLUMNS)
    masks = place_masks()
    front = (masks["skin"] > 0.99) & (points[..., 2] > -20)
    upper = front & (points[..., 1] > -110)

    def some(count: int, where: np.ndarray, low: float, high: float, depth: float) -> Spots:
        rows, columns = np.nonzero(where)
        chosen = rng.integers(len(rows), size=count)
        radii = low * (high / low) ** rng.uniform(size=count) ** 2
        return Spots(
            points[rows[chosen], columns[chosen]].astype(np.float64),
            radii,
            depth * rng.uniform(0.35, 1.0, count),
        )

    temples = upper & (masks["temples"] + masks["cheeks"] + masks["forehead"] > 0.25)
    return Marks(
        some(c.moles, front, 0.55, 2.0, 1.0),
        some(round(26 * c.age_spots), temples, 1.0, 4.5, 0.75),
        some(round(3 + 9 * c.redness), upper, 0.6, 2.2, 0.8),
    )


def skin_colour(patch: Patch, c: Complexion, marks: Marks, relief_mm: np.ndarray) -> np.ndarray:
    """(h, columns, 3) linear albedo of bare skin and lips.

    Args:
        patch: where.
        c: the person's pigments.
        marks: the person's moles and spots.
        relief_mm: (h, columns) pores and net: little light leaves their bottom.
    """
    lips = patch.mask("lips")
    melanin = c.melanin * np.exp(_melanin_logs(patch, c))
    melanin += lips * (0.018 - 0.15 * melanin)
    moles = np.clip(marks.moles.on(patch), 0, 1)
    melanin += moles * (0.10 + 0.5 * c.melanin)
    blood = _blood(patch, c) * (1 + 1.6 * np.clip(marks.pimples.on(patch), 0, 1.2))
    lip_blood = c.lips * np.exp(0.16 * patch.noise(3.0, 2, 8) + 0.10 * patch.noise(1.1, 2, 16))
    blood += lips * (lip_blood - blood)
    melanin, blood = melanin.astype(np.float32), blood.astype(np.float32)
    albedo = paint_pigments(melanin, blood, c.eumelanin)
    # Where much blood flows most of it is arterial.
    flush = np.clip(
        lips + c.redness * (0.45 * patch.mask("cheeks") + 0.4 * patch.mask("nose")), 0, 1
    )
    albedo += flush[..., None] * (paint_pigments(melanin, blood, c.eumelanin, ARTERIAL) - albedo)
    # Veins and the thin skin below the eyes let deeper blood shine through, bluish.
    ridge = 1 - np.abs(patch.noise(16.0, 2, 17))
    veins = smoothstep(0.88, 1.0, ridge) * np.maximum(
        patch.mask("temples"), 0.4 * patch.mask("lids")
    )
    blue = c.veins * (0.5 * veins + 0.9 * patch.mask("below_eyes") + 0.35 * patch.mask("lids"))
    blue = blue + 0.25 * c.stubble * patch.mask("beard")
    tint = np.array([0.13, 0.055, -0.02], np.float32)
    albedo *= 1 - blue[..., None].astype(np.float32) * tint
    hollow = np.clip(relief_mm, -0.12, 0.03)
    albedo *= (1 + 1.7 * hollow)[..., None]
    return albedo


def _melanin_logs(patch: Patch, c: Complexion) -> np.ndarray:
    """(h, columns) natural logarithm of melanin over the person's own."""
    dark = smoothstep(0.05, 0.2, np.array(c.melanin))
    m = patch.mask
    logs = 0.03 * patch.noise(38.0, 2, 1) + 0.014 * patch.noise(8.0, 3, 2)
    logs += 0.025 * patch.noise(1.7, 2, 3) + 0.02 * patch.noise(0.5, 1, 15)
    logs += (0.06 + 0.20 * dark) * m("forehead") - (0.06 + 0.10 * dark) * m("cheeks")
    logs += 0.06 * m("nose") + (0.10 + 0.06 * dark) * m("below_eyes") + 0.07 * m("lids")
    logs += (0.03 + 0.16 * dark) * m("around_mouth") - 0.10 * m("neck")
    logs += 0.10 * m("temples") * (1 - dark)

    def freckle(distance: np.ndarray, label: np.ndarray) -> np.ndarray:
        # Few large and many small; each cell's number decides how dark.
        return smoothstep(1.35, 0.5, distance / (0.22 + 0.55 * label**2)) * (0.35 + 0.65 * label)

    if c.freckles > 0:
        where = np.clip(m("freckled") * (1 + 0.5 * patch.noise(12.0, 2, 18)) * c.freckles, 0, 1)
        spread = 1.7 * patch.pits(2.3, 4, freckle) + 1.3 * patch.pits(1.25, 14, freckle)
        logs += where * spread * (m("skin") > 0.5)
    return np.asarray(logs)


def _blood(patch: Patch, c: Complexion) -> np.ndarray:
    """(h, columns) blood's volume fraction in the skin."""
    m = patch.mask
    logs = 0.85 * m("cheeks") + 0.25 * m("cheek_sides") + 0.80 * m("nose") + 0.30 * m("wings")
    logs += 0.75 * m("ears") + 0.35 * m("chin") + 0.25 * m("glabella") + 0.35 * m("lids")
    logs += 0.30 * m("below_eyes") + 0.2 * m("bridge") - 0.12 * m("forehead")
    logs *= c.redness
    logs += 0.06 * patch.noise(26.0, 2, 7) + 0.045 * patch.noise(7.0, 3, 5)
    logs += 0.07 * patch.noise(1.9, 2, 6) + 0.05 * patch.noise(0.6, 1, 19)
    if c.capillaries > 0:
        # Widened vessels of cheeks and nose: thin branching lines.
        thread = smoothstep(0.86, 1.0, 1 - np.abs(patch.noise(4.0, 2, 13)))
        where = np.maximum(m("cheeks"), m("wings")) * smoothstep(-0.4, 1.0, patch.noise(9.0, 2, 12))
        logs += 0.8 * c.capillaries * thread * where
    return np.asarray(c.blood * np.exp(logs))
