"""iBUG's landmarks of the 468, a template's own of them, and which the head hides."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.faces import Face, schemes
from lightstage.faces.of_template import (
    MISSED_MM,
    landmark_weights,
    template_landmarks,
)
from lightstage.formats.template import default_template_path, load_template


@pytest.fixture(scope="module")
def template():
    return load_template(default_template_path())


def seen(template, yaw_deg: float, scale: float = 2.0) -> Face:
    """The template's own points as a face, in parallel projection."""
    points = template.face_points.on(template.mesh.vertices)
    yaw = np.deg2rad(yaw_deg)
    x = np.cos(yaw) * points[:, 0] - np.sin(yaw) * points[:, 2]
    z = np.sin(yaw) * points[:, 0] + np.cos(yaw) * points[:, 2]
    # Points without a place on the template lie anywhere; none of these tests asks for them.
    x, y, z = (np.where(np.isfinite(c), c, 0.0) for c in (x, points[:, 1], z))
    return Face(scale * np.column_stack([x, -y]), -scale * z, 1.0, (0, 0, 1, 1))


def test_left_and_right_of_ibug_are_left_and_right_of_the_mesh(template):
    points = schemes.ibug68(template.face_points.on(template.mesh.vertices))
    for right, left in ((0, 16), (17, 26), (21, 22), (31, 35), (36, 45), (39, 42), (48, 54)):
        if np.isfinite(points[[right, left]]).all():
            assert points[right, 0] < points[left, 0]
            assert abs(points[right, 1] - points[left, 1]) < 4
    assert np.all(np.diff(points[[27, 28, 29, 30, 33, 51, 57, 8], 1]) < 0)


def test_landmarks_come_out_where_the_template_has_them(template):
    vertices = template.mesh.vertices
    weights = landmark_weights(template.face_points.on(vertices), vertices[template.landmarks])
    stated = weights.any(axis=1)
    assert stated[17:].all()
    assert np.allclose(weights[stated].sum(axis=1), 1)
    found = template_landmarks(seen(template, 0.0), weights)
    expected = 2.0 * vertices[template.landmarks][:, :2] * [1, -1]
    away = np.linalg.norm(found - expected, axis=1) / 2.0
    assert np.isfinite(away[17:]).sum() > 45
    assert np.nanmax(away) < MISSED_MM + 0.5
    assert np.nanmean(away) < 1.0


@given(st.floats(1e-3, 1e3), st.integers(0, 2**16))
def test_weights_are_the_plain_minimum_of_their_cost(scale, seed):
    rng = np.random.default_rng(seed)
    points = scale * rng.normal(size=(30, 3))
    place = scale * rng.normal(size=(1, 3)) * 0.2
    weights = landmark_weights(points, place)[0]
    if not weights.any():
        return
    near = np.flatnonzero(weights)
    offset = points[near] - place

    def cost(share):
        return np.sum((share @ offset) ** 2) + share**2 @ (1 + np.sum(offset**2, axis=1))

    least = cost(weights[near])
    for _ in range(5):
        other = rng.normal(size=len(near))
        other -= other.mean()
        assert cost(weights[near] + 1e-3 * other) >= least - 1e-9 * (1 + least)


def test_landmarks_without_points_near_them_are_not_reported():
    nothing = np.full((468, 3), np.nan)
    assert not landmark_weights(nothing, np.zeros((2, 3))).any()
    far = np.tile([500.0, 0, 0], (468, 1))
    assert not landmark_weights(far, np.zeros((2, 3))).any()


def test_a_turned_head_hides_its_far_side(template):
    ahead = schemes.visible(seen(template, 0.0))
    left, right = (schemes.visible(seen(template, yaw)) for yaw in (-60.0, 60.0))
    there = template.face_points.triangles[:, 0] >= 0
    assert ahead[there].mean() > 0.85
    x = template.face_points.on(template.mesh.vertices)[:, 0]
    far_right, far_left = (there & (x < -40)), (there & (x > 40))
    # Turned to one side, the face shows one of its sides only.
    assert right[far_right].mean() < 0.3 or right[far_left].mean() < 0.3
    assert left[far_right].mean() > 0.8 or left[far_left].mean() > 0.8
    assert (right[far_left].mean() > 0.8) == (left[far_right].mean() > 0.8)
