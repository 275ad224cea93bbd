"""Measures of heads, and a population that is moved to those of surveys."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from lightstage.formats.population import Population
from lightstage.formats.template import Template, default_template_path, load_template
from processing.errors import ProcessingError
from processing.template.config import PopulationConfig
from processing.template.measures import HeadMeasures
from processing.template.surveyed import moved
from processing.template.surveys import (
    CORRELATIONS,
    NAMES,
    SURVEYED,
    covariance,
    deviations,
    means,
)

MET = np.array([each.met for each in SURVEYED])


@pytest.fixture(scope="module")
def template() -> Template:
    return load_template(default_template_path())


def test_a_larger_head_has_larger_measures_by_the_same_ratio(template: Template) -> None:
    mesh = template.mesh.vertices.astype(float)
    measures = HeadMeasures(template, mesh)
    ratio = measures.of(1.1 * mesh) / measures.of(mesh)
    # The frontal arc crosses the forehead a fixed distance above the glabella.
    assert ratio == pytest.approx(np.full(len(NAMES), 1.1), rel=0.01)


def test_the_circumference_is_the_mean_width_of_its_plane_times_pi(template: Template) -> None:
    # Cauchy: the perimeter of a convex outline is its width integrated over half a turn.
    mesh = template.mesh.vertices.astype(float)
    ball = 90 * mesh / np.linalg.norm(mesh, axis=1)[:, None] * [1.0, 1.0, 1.25]
    found = HeadMeasures(template, mesh).of(ball)[NAMES.index("head circumference")]
    turn = np.pi * (np.arange(2000) + 0.5) / 2000
    ellipse = 2 * np.sqrt((90 * np.cos(turn)) ** 2 + (112.5 * np.sin(turn)) ** 2)
    # The plane leaves the middle of the head by a few millimetres, so its outline is shorter.
    assert 0.93 < found / (ellipse.mean() * np.pi) <= 1.001


def test_distances_between_landmarks_are_those_of_the_landmarks(template: Template) -> None:
    mesh = template.mesh.vertices.astype(float)
    marks = mesh[template.landmarks]
    found = dict(zip(NAMES, HeadMeasures(template, mesh).of(mesh), strict=True))
    for name, (one, other) in {"lip length": (48, 54), "biocular breadth": (36, 45)}.items():
        assert found[name] == pytest.approx(np.sqrt(((marks[one] - marks[other]) ** 2).sum()))


def test_a_template_without_ears_is_refused(template: Template) -> None:
    deaf = dataclasses.replace(template, regions={})
    with pytest.raises(ProcessingError, match="no ear"):
        HeadMeasures(deaf, template.mesh.vertices)


def test_surveyed_covariance_is_one_and_has_the_correlations_and_both_sexes() -> None:
    found = covariance(np.eye(len(NAMES)))
    assert np.linalg.eigvalsh(found).min() > 0
    length = SURVEYED[NAMES.index("head length")]
    expected = (length.men[1] ** 2 + length.women[1] ** 2) / 2
    expected += ((length.men[0] - length.women[0]) / 2) ** 2
    assert deviations()[NAMES.index("head length")] ** 2 == pytest.approx(expected)
    np.testing.assert_array_equal(CORRELATIONS, CORRELATIONS.T)
    assert np.linalg.eigvalsh(CORRELATIONS).min() > 0


def test_people_who_are_too_narrow_and_too_alike_are_moved_to_the_surveys(
    template: Template,
) -> None:
    people = template.population
    assert people is not None
    narrow = Population(people.mean_mm * [0.93, 1.05, 1.0], 0.5 * people.identity_mm, "", "")
    found, facts = moved(template, narrow, PopulationConfig())
    assert facts["off_deviations"] < 0.5 * facts["before_deviations"]
    measures = HeadMeasures(template, found.mean_mm)
    off = ((measures.of(found.mean_mm) - means()) / deviations())[MET]
    assert np.sqrt((off**2).mean()) == pytest.approx(facts["off_deviations"], abs=0.05)
    assert 0.8 < facts["kept_share"] < 1.2


def test_our_population_measures_as_people_do(template: Template) -> None:
    people = template.population
    assert people is not None
    measures = HeadMeasures(template, people.mean_mm)
    off = ((measures.of(people.mean_mm) - means()) / deviations())[MET]
    assert np.abs(off).max() < 0.7
    assert np.sqrt((off**2).mean()) < 0.3
