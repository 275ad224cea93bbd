"""Heads and faces of adults as surveys measured them: means, deviations and correlations.

Distances and arcs in mm. [Zhuang2005] measured 3,997 users of respirators in the USA, 18 to 66
years old and weighted to the country's groups, with callipers and tape; [Gordon2014] 6,068 soldiers
of 17 to 58 years; [Farkas1994] North American whites of 18 to 25. Figures of the first and the last
are quoted from memory, the texts were not at hand: check them before citing them elsewhere. The
mean of 62 men of the soldiers' public file (all of two stretches of it) is near the respirators'
users: chin arc 331 and 331, circumference 576 and 576, breadth 154 and 153, interpupillary distance
64.5 and 64.5, menton to sellion 120 and 123, length 199 and 197.
"""

from __future__ import annotations

import dataclasses

import numpy as np


@dataclasses.dataclass(frozen=True)
class Surveyed:
    """A measure of men and of women.

    Attributes:
        name: as [Zhuang2005] has it.
        men: mean and standard deviation, mm.
        women: the same.
        source: of `BIBLIOGRAPHY.bib`.
        met: whether the population is moved to it. The others are measured on the template in
            another way than on people: the jaw's angles are under skin, and the tape of the chin's
            arc lies on soft parts.
    """

    name: str
    men: tuple[float, float]
    women: tuple[float, float]
    source: str
    met: bool = True


SURVEYED = (
    Surveyed("head length", (197.3, 7.4), (187.5, 7.2), "Zhuang2005"),
    Surveyed("head breadth", (153.0, 6.0), (146.8, 5.6), "Zhuang2005"),
    Surveyed("head circumference", (575.7, 17.1), (554.9, 18.2), "Zhuang2005"),
    Surveyed("tragion to top of head", (131.1, 6.2), (126.5, 6.5), "Gordon2014"),
    Surveyed("bizygomatic breadth", (143.5, 6.9), (135.1, 6.5), "Zhuang2005"),
    Surveyed("bigonial breadth", (120.4, 10.4), (110.1, 8.9), "Zhuang2005", met=False),
    Surveyed("menton to sellion", (122.7, 7.0), (113.4, 6.1), "Zhuang2005"),
    Surveyed("subnasale to sellion", (52.0, 4.1), (48.2, 3.8), "Zhuang2005"),
    Surveyed("nose protrusion", (21.1, 2.7), (19.8, 2.7), "Zhuang2005"),
    Surveyed("nose breadth", (36.6, 4.1), (33.2, 3.9), "Zhuang2005"),
    Surveyed("lip length", (51.1, 4.2), (48.0, 4.0), "Zhuang2005"),
    Surveyed("interpupillary distance", (64.5, 3.6), (61.9, 3.5), "Zhuang2005"),
    Surveyed("biocular breadth", (91.2, 3.0), (87.8, 3.2), "Farkas1994"),
    Surveyed("intercanthal breadth", (33.3, 2.7), (31.8, 2.3), "Farkas1994"),
    Surveyed("subnasale to menton", (72.6, 4.5), (64.3, 4.0), "Farkas1994"),
    Surveyed("upper lip's height", (22.3, 2.1), (20.1, 2.0), "Farkas1994"),
    Surveyed("upper vermilion", (8.0, 1.4), (8.7, 1.3), "Farkas1994"),
    Surveyed("lower vermilion", (9.3, 1.6), (9.4, 1.5), "Farkas1994"),
    # Deviations of women's arcs are the men's, by the ratio of the means.
    Surveyed("bitragion chin arc", (331.2, 15.5), (303.7, 14.2), "Zhuang2005", met=False),
    Surveyed("bitragion subnasale arc", (294.8, 13.2), (277.0, 12.4), "Zhuang2005"),
    Surveyed("bitragion frontal arc", (304.3, 13.1), (287.0, 12.4), "Zhuang2005"),
    Surveyed("bitragion coronal arc", (350.7, 13.9), (339.2, 13.4), "Zhuang2005"),
)
NAMES = tuple(each.name for each in SURVEYED)
CORRELATED = (
    "bitragion chin arc",
    "bizygomatic breadth",
    "head breadth",
    "head circumference",
    "head length",
    "interpupillary distance",
    "menton to sellion",
    "tragion to top of head",
)
CORRELATIONS = np.array(
    [
        [1.00, 0.56, 0.34, 0.49, 0.39, 0.33, 0.34, 0.04],
        [0.56, 1.00, 0.69, 0.33, 0.04, 0.44, 0.05, 0.12],
        [0.34, 0.69, 1.00, 0.47, 0.01, 0.32, -0.03, 0.22],
        [0.49, 0.33, 0.47, 1.00, 0.81, 0.42, 0.27, 0.35],
        [0.39, 0.04, 0.01, 0.81, 1.00, 0.31, 0.38, 0.26],
        [0.33, 0.44, 0.32, 0.42, 0.31, 1.00, 0.15, 0.10],
        [0.34, 0.05, -0.03, 0.27, 0.38, 0.15, 1.00, 0.07],
        [0.04, 0.12, 0.22, 0.35, 0.26, 0.10, 0.07, 1.00],
    ]
)
"""Of `CORRELATED`, of 62 men of the soldiers' public file [Gordon2014]: right to about .12."""


def means() -> np.ndarray:
    """(q,) of as many men as women, mm, in the order of `SURVEYED`."""
    return np.array([(each.men[0] + each.women[0]) / 2 for each in SURVEYED])


def deviations() -> np.ndarray:
    """(q,) of as many men as women, mm."""
    return np.sqrt(np.diag(covariance(np.eye(len(SURVEYED)))))


def covariance(correlation: np.ndarray) -> np.ndarray:
    """(q, q) of as many men as women, mm2.

    Args:
        correlation: (q, q) within a sex, positive definite; that of `CORRELATED` is put in its
            place, and what the other measures have beside these stays (Jeffrey's rule).
    """
    here = [NAMES.index(name) for name in CORRELATED]
    old = correlation[np.ix_(here, here)]
    learned = np.linalg.solve(old, correlation[here]).T
    mixed = correlation + learned @ (CORRELATIONS - old) @ learned.T
    size = np.sqrt(np.diag(mixed))
    within = np.sqrt([(each.men[1] ** 2 + each.women[1] ** 2) / 2 for each in SURVEYED])
    apart = np.array([each.men[0] - each.women[0] for each in SURVEYED])
    found: np.ndarray = (
        mixed / np.outer(size, size) * np.outer(within, within) + np.outer(apart, apart) / 4
    )
    return found
