"""A shape from landmarks: slopes, recovery, robustness, and what photographs do not tell."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from learning.errors import MapsError
from learning.limits import require_within
from learning.photo.config import FitConfig
from learning.photo.landmark_fit import Problem, Sighting, Unknowns
from learning.photo.model import ShapeModel, smooth_changes
from learning.photo.shape_fit import Photograph, Places, Shape, fit_shape, without_similarity
from lightstage.errors import ConfigError
from lightstage.formats.template import Template
from tests.learning.photo.scene import FOCAL_PX, HEIGHT_PX, SMALL, WIDTH_PX, camera_at, on

EMPTY = np.zeros((HEIGHT_PX, WIDTH_PX, 3), np.float32)
SHARP = FitConfig(landmark_percent=0.3)


def other_person(model: ShapeModel, seed: int) -> np.ndarray:
    """(n, 3) vertices of a person whom the model can take exactly."""
    rng = np.random.default_rng(seed)
    return model.vertices(0.7 * rng.normal(size=len(model.identity)), np.zeros(6))


def seen(
    vertices: np.ndarray, places: Places, yaw_deg: float, focal_px: float | None = FOCAL_PX
) -> Photograph:
    """A photograph's true landmarks."""
    points, _ = camera_at(yaw_deg).project(on(places, vertices))
    return Photograph(f"from {yaw_deg:g}", EMPTY, points, focal_px)


def off_mm(found: np.ndarray, true: np.ndarray) -> float:
    """Mean distance after the best rigid motion and scale."""
    one, two = found - found.mean(axis=0), true - true.mean(axis=0)
    turn, _ = Rotation.align_vectors(two, one)
    one = turn.apply(one)
    return float(np.linalg.norm(one * (one * two).sum() / (one**2).sum() - two, axis=1).mean())


def test_slopes_are_those_of_differences(model: ShapeModel, places: Places) -> None:
    there = model.at(places.triangles, places.weights)
    points = seen(model.mean, places, 20.0).landmarks_px
    problem = Problem(there, [Sighting(points, WIDTH_PX, HEIGHT_PX)], FitConfig(), None, None)
    rng = np.random.default_rng(3)
    size = len(model.identity) + 13
    here: Unknowns = problem.begin().moved(0.01 * rng.normal(size=size))
    _, slopes, _ = problem._photo(here, 0)
    step = 1e-6
    for index in range(0, size, 7):
        direction = step * np.eye(size)[index]
        moved, _, _ = problem._photo(here.moved(direction), 0)
        backward, _, _ = problem._photo(here.moved(-direction), 0)
        np.testing.assert_allclose(
            (moved - backward) / (2 * step), slopes[:, :, index], atol=1e-4, rtol=1e-4
        )


def test_an_expression_of_less_than_none_is_less_likely_than_one_of_more(
    model: ShapeModel, places: Places
) -> None:
    """Eyes may be closed, but hardly be wider than open."""
    there = model.at(places.triangles, places.weights)
    points = seen(model.mean, places, 0.0).landmarks_px
    problem = Problem(there, [Sighting(points, WIDTH_PX, HEIGHT_PX)], FitConfig())
    here = problem.begin()
    step = 0.3 * np.eye(problem.size)[-1]
    more, less = (
        sum((value / spread) ** 2 for value, spread in problem._priors(here.moved(sign * step), 0))
        for sign in (1, -1)
    )
    assert less == pytest.approx(9 * more)


def test_three_photographs_give_a_face_that_is_none_of_the_templates(
    model: ShapeModel, template: Template, places: Places
) -> None:
    person = other_person(model, 1)
    shots = [seen(person, places, yaw) for yaw in (0.0, 35.0, -35.0)]
    found = fit_shape(shots, template, places, SHARP, model)
    face = model.face
    mean = off_mm(template.mesh.vertices[face], person[face])
    assert mean > 3
    assert off_mm(found.meshes[0].vertices[face], person[face]) < 0.25 * mean
    for camera, yaw in zip(found.cameras, (0.0, 35.0, -35.0), strict=True):
        true = camera_at(yaw)
        turn = Rotation.from_matrix(camera.cam_from_world[:, :3] @ true.cam_from_world[:, :3].T)
        assert np.degrees(turn.magnitude()) < 2
        assert camera.fx_px == pytest.approx(FOCAL_PX, rel=0.05)


def test_an_unknown_focal_length_is_found_within_the_fits_deviation(
    model: ShapeModel, template: Template, places: Places
) -> None:
    person = model.vertices(np.zeros(len(model.identity)), np.zeros(6))
    found = fit_shape([seen(person, places, 20.0, None)], template, places, SHARP, model)
    place = len(model.identity)
    deviation = float(np.sqrt(found.landmarks.covariance[place, place]))
    assert abs(np.log(found.cameras[0].fx_px / FOCAL_PX)) < 3 * deviation
    assert 0.005 < deviation < FitConfig().focal_spread


def test_wrong_landmarks_lose_their_weight(
    model: ShapeModel, template: Template, places: Places
) -> None:
    person = other_person(model, 2)
    shot = seen(person, places, 0.0)
    marks = shot.landmarks_px.copy()
    rng = np.random.default_rng(0)
    wrong = rng.permutation(len(marks))[:40]
    marks[wrong] += rng.normal(size=(40, 2)) * 60
    config = FitConfig(landmark_percent=1.0)
    plain = fit_shape([shot], template, places, config, model)
    found = fit_shape(
        [dataclasses.replace(shot, landmarks_px=marks)], template, places, config, model
    )
    face = model.face
    assert off_mm(found.neutral.vertices[face], plain.neutral.vertices[face]) < 0.5
    assert np.median(found.landmarks.photographs[0].used[wrong]) < 0.01


def test_what_one_photograph_from_in_front_does_not_show_is_depth(
    model: ShapeModel, template: Template, places: Places
) -> None:
    person = other_person(model, 4)

    def told(shape: Shape) -> np.ndarray:
        modes = without_similarity(model.identity, model.mean, model.face)
        spread: np.ndarray = shape.landmarks.deviation_mm(modes)[model.face].mean(axis=0)
        return spread

    one = told(fit_shape([seen(person, places, 0.0)], template, places, SHARP, model))
    three = told(
        fit_shape(
            [seen(person, places, yaw) for yaw in (0.0, 35.0, -35.0)],
            template,
            places,
            SHARP,
            model,
        )
    )
    assert one[2] > 2 * max(one[0], one[1])
    assert three[2] < 0.6 * one[2]


def test_moving_turning_and_scaling_a_face_is_no_change_of_shape(model: ShapeModel) -> None:
    turned = np.cross([0.1, 0.2, -0.3], model.mean)
    mode = (turned + 0.05 * model.mean + [1.0, 2.0, 3.0])[None]
    left = without_similarity(mode, model.mean, model.face)
    assert np.abs(left[:, model.face]).max() < 1e-8


def test_smooth_changes_have_the_deviation_and_the_symmetry_they_are_asked_for(
    template: Template,
) -> None:
    mean = template.mesh.vertices
    face = np.linalg.norm(mean - mean[template.landmarks[30]], axis=1) < 80
    modes = smooth_changes(mean, face, 400, [(2.0, 40.0)], 0.0)
    deviation = np.sqrt((modes[:, face] ** 2).sum(axis=0))
    # Near the plane of symmetry both sides add up, to 1.4 times as much.
    np.testing.assert_allclose(np.median(deviation), 2.0, rtol=0.15)
    # On the plane of symmetry nothing moves sideways where both sides do the same.
    middle = face & (np.abs(mean[:, 0]) < 1e-6)
    assert middle.any()
    assert np.abs(modes[:, middle, 0]).max() < 1e-6
    assert smooth_changes(mean, np.zeros_like(face), 5, [(1.0, 10.0)], 0.1).shape[0] == 0


@given(
    seed=st.integers(0, 1000),
    scale=st.sampled_from([1e-6, 1.0, 1e6]),
    kind=st.sampled_from(["noise", "one place", "line", "few", "far"]),
)
@settings(max_examples=12, deadline=None)
def test_any_points_give_a_finite_head_or_one_clear_refusal(
    small: ShapeModel, template: Template, places: Places, seed: int, scale: float, kind: str
) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(len(places.triangles), 2)) * scale
    if kind == "one place":
        points[:] = 5.0
    elif kind == "line":
        points[:, 1] = 2 * points[:, 0]
    elif kind == "few":
        points[7:] = np.nan
    elif kind == "far":
        points += 1e9
    shot = Photograph("points", EMPTY, points)
    try:
        found = fit_shape([shot], template, places, SMALL, small)
    except MapsError:
        return
    assert np.isfinite(found.neutral.vertices).all()
    assert np.isfinite(found.deviation_mm).all()
    assert np.isfinite(found.cameras[0].cam_from_world).all()


@pytest.mark.parametrize(
    ("values", "word"),
    [
        ({"rows": 200}, "multiple of 3"),
        ({"landmark_percent": float("nan")}, "0.1 or more, at most 50"),
        ({"free_mm": (1.0,)}, "as many as free_mm"),
        ({"rounds": 0}, "1 or more, at most 5"),
    ],
)
def test_a_configuration_out_of_bounds_is_refused(values: dict[str, Any], word: str) -> None:
    with pytest.raises(ConfigError, match=word):
        require_within(FitConfig(**values), "F.toml", "fit")
