"""Many people of the model measure as adults do, and sex and age show."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from sim.head.eyes import eye_centres
from sim.head.grid import EYE_AZIMUTH_DEG, EYE_HALF_DEG, ROW_LID_LOW, ROW_LID_UP, face_azimuth_deg
from sim.head.mesh import grid_vertices, landmarks, neutral_mesh
from sim.head.modes import EXPRESSIONS
from sim.head.parametric import random_head
from sim.people.traits import SEXES, Traits

PEOPLE = 60

# Mean and standard deviation in mm of young adults, women then men: [Farkas1994] (North American
# whites), the distance of the pupils [Dodgson2004]. Quoted from memory, the books were not at hand:
# check them before citing these figures elsewhere.
ADULTS = {
    "face width": ((129.9, 5.3), (137.1, 4.3)),
    "face height": ((111.4, 4.8), (121.3, 6.8)),
    "lower face height": ((64.3, 4.0), (72.6, 4.5)),
    "nose height": ((50.6, 3.1), (54.8, 3.3)),
    "nose width": ((31.4, 2.0), (34.9, 2.1)),
    "jaw width": ((91.1, 5.9), (97.1, 5.8)),
    "between inner corners": ((31.8, 2.3), (33.3, 2.7)),
    "between outer corners": ((87.8, 3.2), (91.2, 3.0)),
    "mouth width": ((50.2, 3.5), (54.5, 3.0)),
    "between pupils": ((62.3, 3.6), (64.7, 3.7)),
}


def measures(vertices: np.ndarray) -> dict[str, float]:
    marks = vertices[landmarks()]
    grid = vertices[grid_vertices()]
    azimuth = np.abs(face_azimuth_deg())
    centres = eye_centres(grid, neutral_mesh().vertices[grid_vertices()])

    def between(a: int, b: int) -> float:
        return float(np.linalg.norm(marks[a] - marks[b]))

    return {
        "face width": float(np.ptp(grid[52:66][:, (azimuth > 45) & (azimuth < 72), 0])),
        "face height": between(27, 8),
        "lower face height": between(33, 8),
        "nose height": between(27, 33),
        "nose width": between(31, 35),
        "jaw width": between(4, 12),
        "between inner corners": between(39, 42),
        "between outer corners": between(36, 45),
        "mouth width": between(48, 54),
        "between pupils": float(centres[1, 0] - centres[0, 0]),
    }


@functools.cache
def people(sex: str, age_years: float) -> dict[str, np.ndarray]:
    traits = Traits(sex, age_years, tone=3)
    drawn = [
        measures(random_head(np.random.default_rng(k), None, traits).vertices)
        for k in range(PEOPLE)
    ]
    return {name: np.array([one[name] for one in drawn]) for name in ADULTS}


@pytest.mark.parametrize("name", ADULTS)
@pytest.mark.parametrize("sex", SEXES)
def test_young_adults_measure_as_published(sex, name):
    mean, deviation = ADULTS[name][SEXES.index(sex)]
    found = people(sex, 25.0)[name]
    assert found.mean() == pytest.approx(mean, rel=0.08)
    assert 0.55 * deviation < found.std() < 1.6 * deviation


def test_men_have_larger_faces_jaws_and_noses_than_women():
    women, men = people("female", 25.0), people("male", 25.0)
    for name in ("face width", "face height", "nose width", "jaw width", "mouth width"):
        assert men[name].mean() > women[name].mean() + 2.0


def test_age_lengthens_the_nose_and_ears_and_thins_the_lips():
    def mean_head(age_years: float) -> np.ndarray:
        return np.mean(
            [
                random_head(np.random.default_rng(k), None, Traits("female", age_years, 3)).vertices
                for k in range(12)
            ],
            axis=0,
        )

    young, old = mean_head(20.0), mean_head(80.0)

    def height(vertices: np.ndarray, upper: int, lower: int) -> float:
        return float(vertices[landmarks()[upper], 1] - vertices[landmarks()[lower], 1])

    assert height(old, 27, 30) > height(young, 27, 30) + 1.0
    assert height(old, 51, 57) < height(young, 51, 57) - 1.0
    assert height(old, 37, 41) < height(young, 37, 41)
    # Jowls: the jaw's border before its angle hangs lower than the chin does, compared with youth.
    assert height(old, 8, 6) > height(young, 8, 6) - 1.0


def test_the_same_draw_is_the_same_person_whatever_the_expression():
    traits = Traits("male", 40.0, 2)
    still = random_head(np.random.default_rng(5), "neutral", traits).vertices
    again = random_head(np.random.default_rng(5), None, traits).vertices
    assert np.array_equal(still, again)
    back = grid_vertices()[30:70, :6]
    for expression in EXPRESSIONS:
        moved = random_head(np.random.default_rng(5), expression, traits).vertices
        assert np.abs(moved - still).max() > 1.0
        assert np.abs(moved - still)[back].max() < 1e-3


@pytest.mark.parametrize("sex", SEXES)
@pytest.mark.parametrize("age_years", [16.0, 50.0, 85.0])
def test_closed_eyes_are_closed_on_everyone(sex, age_years):
    for seed in range(3):
        traits = Traits(sex, age_years, 3)
        opened, closed = (
            random_head(np.random.default_rng(seed), e, traits).vertices[grid_vertices()]
            for e in (None, "eyes_closed")
        )
        place = (np.abs(face_azimuth_deg()) - EYE_AZIMUTH_DEG) / EYE_HALF_DEG
        inside = np.abs(place) < 0.7
        gap = [
            np.linalg.norm(g[ROW_LID_UP, inside] - g[ROW_LID_LOW, inside], axis=1)
            for g in (opened, closed)
        ]
        assert gap[0].min() > 3.0
        assert gap[1].max() < 0.9


def test_eyeballs_stay_round_on_everyone():
    middle = (ROW_LID_UP + ROW_LID_LOW) // 2
    azimuth = face_azimuth_deg()
    inside = np.flatnonzero(np.abs(azimuth - EYE_AZIMUTH_DEG) / EYE_HALF_DEG < 0.4)
    neutral = neutral_mesh().vertices[grid_vertices()]
    for seed in range(8):
        grid = random_head(np.random.default_rng(seed)).vertices[grid_vertices()]
        centre = eye_centres(grid, neutral)[1]
        ball = grid[middle - 1 : middle + 2][:, inside]
        distance = np.linalg.norm(ball - centre, axis=-1)
        assert 11.9 < distance.min() <= distance.max() < 13.6
