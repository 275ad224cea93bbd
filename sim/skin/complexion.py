"""Complexion: what makes one person's skin, drawn from who the person is."""

from __future__ import annotations

import dataclasses

import numpy as np

from sim.people.traits import Traits, random_traits

MELANIN_OF_TONE = {
    1: (0.026, 0.034),
    2: (0.034, 0.047),
    3: (0.047, 0.068),
    4: (0.068, 0.110),
    5: (0.125, 0.215),
    6: (0.230, 0.420),
}
"""Melanin's volume fraction of each tone, least and most: ITA of about 60 down to -50 degrees."""

_Colour = tuple[float, float, float]

_BLACK, _BROWN = np.array([0.020, 0.016, 0.0145]), np.array([0.060, 0.034, 0.019])
_BLOND, _RED = np.array([0.26, 0.165, 0.080]), np.array([0.20, 0.070, 0.022])
_GREY = np.array([0.27, 0.255, 0.235])
_EYES = {
    "dark": np.array([0.045, 0.022, 0.012]),
    "brown": np.array([0.095, 0.046, 0.020]),
    "hazel": np.array([0.125, 0.085, 0.036]),
    "green": np.array([0.110, 0.125, 0.070]),
    "blue": np.array([0.120, 0.175, 0.225]),
    "grey": np.array([0.150, 0.170, 0.180]),
}


@dataclasses.dataclass(frozen=True)
class Complexion:
    """What makes one person's skin.

    Attributes:
        melanin: its volume fraction in the epidermis at rest (C_m).
        blood: its volume fraction in the dermis where the face is palest (C_h).
        eumelanin: share of eumelanin (B_m).
        redness: how much cheeks, nose and ears are redder than the rest, about 1.
        lips: blood's fraction in the lips.
        veins: how much deeper blood shines through thin skin, about 1.
        capillaries: 0 none to 1 many widened vessels.
        stubble: 0 none to 1 some days' beard.
        freckles: 0 none to 1 many.
        age_spots: 0 none to 1 many.
        moles: how many.
        pores: strength of the relief, about 1.
        age: 0 smooth to 1 lined.
        brow: fullness of the brows, about 1.
        lashes: their strength, about 1.
        recession_mm: how far the hairline has moved back.
        hair_cover: 0 shaven to 1 dense.
        hair: linear albedo of the scalp's hair.
        brow_hair: linear albedo of brows, lashes and beard.
        iris: linear albedo.
        look: one of `sim.people.traits.LOOKS`.
    """

    melanin: float
    blood: float
    eumelanin: float
    redness: float
    lips: float
    veins: float
    capillaries: float
    stubble: float
    freckles: float
    age_spots: float
    moles: int
    pores: float
    age: float
    brow: float
    lashes: float
    recession_mm: float
    hair_cover: float
    hair: _Colour
    brow_hair: _Colour
    iris: _Colour
    look: str = "plain"


def random_complexion(rng: np.random.Generator, traits: Traits | None = None) -> Complexion:
    """Draw a person's colours: hair and eyes that go with the tone, beard with the sex.

    Args:
        rng: what chance decides; always the same number of draws.
        traits: who the person is; None draws that too.
    """
    who = random_traits(rng) if traits is None else traits
    u = rng.uniform(size=24)
    low, high = MELANIN_OF_TONE[who.tone]
    melanin = float(low * (high / low) ** u[0])
    # 1 for the fairest, 0 from the middle tones on.
    fair = float(np.clip(1 - (melanin - 0.026) / 0.05, 0, 1))
    years = who.age_years
    age = float(np.clip((years - 20) / 58, 0, 1) ** 1.15)
    male = who.sex == "male"
    hair, brow_hair = _hair(u[1:5], fair, years)
    bearded = male and u[5] < 0.75
    freckled = float(u[6] < 0.15 + 0.3 * fair) * (0.25 + 0.75 * u[7]) * (0.2 + 0.8 * fair)
    return Complexion(
        melanin=melanin,
        blood=float(0.0050 * 2.2 ** (u[8] - 0.5)),
        eumelanin=float(np.clip(0.12 + 0.65 * (1 - fair) + 0.2 * (u[9] - 0.5), 0.05, 0.95)),
        redness=float(0.65 + 0.7 * u[10]),
        lips=float((0.045 + 0.035 * u[11]) * (1 - 0.3 * age) * (0.8 if male else 1.0)),
        veins=float(0.5 + 0.8 * u[12]),
        capillaries=float(
            np.clip(1.2 * age * u[13] + 0.2 * fair * u[13], 0, 1) * (0.3 + 0.7 * fair)
        ),
        stubble=float(bearded * (0.15 + 0.85 * u[14] ** 1.5)),
        freckles=max(freckled, 0.9) if who.look == "freckled" else freckled,
        age_spots=float(np.clip((years - 42) / 35, 0, 1) * (0.3 + 0.7 * u[15])),
        moles=int(2 + 14 * u[16] ** 2),
        pores=float(0.75 + 0.5 * u[17]) * (1.12 if male else 0.95),
        age=age,
        brow=float((0.85 + 0.5 * u[18]) * (1.15 if male else 0.8) * (1 - 0.25 * age)),
        lashes=float((0.55 if male else 0.85) + 0.25 * u[19]),
        recession_mm=float(male * 26 * u[20] ** 2 * np.clip((years - 22) / 40, 0, 1)),
        hair_cover=float(0.65 + 0.35 * u[21] if u[22] > 0.12 else 0.15 * u[21]),
        hair=hair,
        brow_hair=brow_hair,
        iris=_iris(u[23], fair),
        look=who.look,
    )


def _hair(u: np.ndarray, fair: float, years: float) -> tuple[_Colour, _Colour]:
    """Colour of the scalp's hair, and of brows, which stay darker and grey later."""
    lightness = fair * u[0]
    base = _BLACK + (_BROWN - _BLACK) * min(1.0, 1.6 * lightness + 0.25 * u[1] * (fair > 0))
    base = base + (_BLOND - base) * max(0.0, 2.2 * lightness - 1.2)
    if fair > 0.5 and u[2] < 0.12:
        base = _RED
    grey = float(np.clip((years - 38 - 14 * u[3]) / 22, 0, 0.95))
    hair = base + grey * (_GREY - base)
    brow = 0.75 * base
    brow = brow + 0.5 * max(0.0, grey - 0.3) * (_GREY - brow)
    return _triple(hair), _triple(brow)


def _iris(u: float, fair: float) -> _Colour:
    """Light eyes come with fair skin only."""
    if u < 0.62 * fair:
        names = ("blue", "grey", "green", "blue", "hazel")
        return _triple(_EYES[names[int(u / max(0.62 * fair, 1e-9) * len(names)) % len(names)]])
    dark, brown = _EYES["dark"], _EYES["brown"]
    mix = (0.2 + 0.8 * fair) * (1 - u) + 0.5 * fair
    return _triple(dark + (brown - dark) * min(1.0, mix))


def _triple(colour: np.ndarray) -> _Colour:
    return float(colour[0]), float(colour[1]), float(colour[2])
