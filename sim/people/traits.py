"""Who a person is, apart from chance: what head, skin and the table of people agree on."""

from __future__ import annotations

import dataclasses

import numpy as np

SEXES = ("female", "male")
TONES = (1, 2, 3, 4, 5, 6)
LOOKS = ("plain", "ggx", "anisotropic", "oily", "dry", "make-up", "freckled")
AGE_RANGE = (16.0, 85.0)


@dataclasses.dataclass(frozen=True)
class Traits:
    """What the table of people counts.

    Attributes:
        sex: one of `SEXES`.
        age_years: 16 to 85.
        tone: skin's tone, 1 (lightest) to 6 (darkest), after Fitzpatrick's types.
        look: one of `LOOKS`; ``plain`` is what our own model describes, the others leave it.
    """

    sex: str
    age_years: float
    tone: int
    look: str = "plain"


def random_traits(rng: np.random.Generator) -> Traits:
    """A person of any sex, tone and adult age, all equally likely; always of the plain look."""
    return Traits(
        sex=SEXES[int(rng.integers(len(SEXES)))],
        age_years=float(rng.uniform(18.0, 75.0)),
        tone=int(rng.choice(TONES)),
    )
