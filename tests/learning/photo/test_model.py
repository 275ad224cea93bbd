"""The shapes that a fit may take begin at the population's mean, where a template has one."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from learning.photo.config import FitConfig
from learning.photo.model import shape_model
from learning.photo.shape_fit import Photograph, Places, detector_places, fit_shape
from lightstage.formats.template import Template
from tests.learning.photo.scene import FOCAL_PX, HEIGHT_PX, SMALL, WIDTH_PX, camera_at, on


def alone(template: Template) -> Template:
    """The template without its population."""
    return dataclasses.replace(template, population=None)


def test_the_mean_lies_between_the_people_and_the_mesh(template: Template) -> None:
    people = template.population
    assert people is not None
    mesh = shape_model(alone(template), SMALL).mean
    for share in (0.0, 0.3, 1.0):
        model = shape_model(template, dataclasses.replace(SMALL, mesh_share=share))
        assert np.allclose(model.mean, people.mean_mm + share * (mesh - people.mean_mm))
    toward = shape_model(template, SMALL).identity[0]
    assert np.allclose(toward, SMALL.mesh_deviation * (mesh - people.mean_mm))


def test_a_template_without_people_has_the_model_that_it_had(template: Template) -> None:
    model = shape_model(alone(template), SMALL)
    with_people = shape_model(template, SMALL)
    assert template.population is not None
    more = 1 + len(template.population.identity_mm)
    assert with_people.named_modes == model.named_modes + more
    assert len(with_people.identity) == len(model.identity) + more


def test_the_detectors_points_are_those_of_the_peoples_mean(template: Template) -> None:
    people = template.population
    assert people is not None
    assert people.face_points is not None
    found = detector_places(template)
    assert found is not None
    places, there = found
    assert there.shape == (468,)
    assert np.array_equal(places.triangles, people.face_points.triangles[there])
    plain = detector_places(alone(template))
    assert plain is not None
    assert template.face_points is not None
    assert np.array_equal(plain[0].triangles, template.face_points.triangles[plain[1]])
    unknown = dataclasses.replace(people, face_points=None)
    fallen = detector_places(dataclasses.replace(template, population=unknown))
    assert fallen is not None
    assert np.array_equal(fallen[0].triangles, plain[0].triangles)
    assert detector_places(dataclasses.replace(alone(template), face_points=None)) is None


@pytest.mark.parametrize("seed", [1, 2])
def test_people_of_the_population_are_found_nearer_than_without_it(
    template: Template, places: Places, seed: int
) -> None:
    people = template.population
    assert people is not None
    rng = np.random.default_rng(seed)
    true = people.mean_mm + np.tensordot(
        rng.normal(size=len(people.identity_mm)), people.identity_mm, 1
    )
    points, _ = camera_at(10.0).project(on(places, true))
    empty = np.zeros((HEIGHT_PX, WIDTH_PX, 3), np.float32)
    shot = Photograph("one", empty, points, FOCAL_PX)
    off = []
    for one in (template, alone(template)):
        model = shape_model(one, FitConfig())
        found = fit_shape([shot], one, places, FitConfig(), model).neutral.vertices[model.face]
        first, second = found - found.mean(axis=0), true[model.face] - true[model.face].mean(axis=0)
        scale = np.linalg.norm(second) / np.linalg.norm(first)
        off.append(np.linalg.norm(scale * first - second, axis=1).mean())
    assert off[0] < 0.6 * off[1]
