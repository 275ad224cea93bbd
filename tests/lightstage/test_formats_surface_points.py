"""Points on a template's surface: they move with it, and damaged files are refused."""

from __future__ import annotations

import copy
import json

import numpy as np
import pytest

from lightstage.errors import FormatError
from lightstage.formats.surface_points import (
    SurfacePoints,
    read_surface_points,
    write_surface_points,
)
from lightstage.formats.template import default_template_path, load_template, save_template


@pytest.fixture
def points() -> SurfacePoints:
    rng = np.random.default_rng(0)
    weights = rng.dirichlet([1, 1, 1], 468)
    triangles = rng.integers(0, 50, (468, 3))
    spread = rng.uniform(0, 3, 468)
    triangles[7], weights[7], spread[7] = -1, np.nan, np.nan
    return SurfacePoints("mediapipe468", triangles, weights, spread)


def test_points_are_what_their_triangles_are(points):
    vertices = np.random.default_rng(1).normal(size=(50, 3))
    on = points.on(vertices)
    assert np.isnan(on[7]).all()
    for index in (0, 1, 467):
        expected = sum(
            w * vertices[v]
            for w, v in zip(points.weights[index], points.triangles[index], strict=True)
        )
        assert np.allclose(on[index], expected)
    moved = points.on(2 * vertices + 3)
    assert np.allclose(moved[:7], 2 * on[:7] + 3)


def test_what_is_written_is_read(points, tmp_path):
    path = write_surface_points(points, tmp_path / "mediapipe468.json")
    again = read_surface_points(path, 50)
    assert np.array_equal(again.triangles, points.triangles)
    assert np.allclose(again.weights, points.weights, atol=1e-6, equal_nan=True)
    assert np.allclose(again.spread_mm, points.spread_mm, atol=1e-3, equal_nan=True)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("scheme", "ibug68", "scheme: found 'ibug68'"),
        ("scheme", ["mediapipe468"], r"scheme: found \['mediapipe468'\]"),
        ("triangles", [], "triangles: found 0, expected 468 entries"),
        ("triangles", {}, "triangles: found dict"),
        ("triangles.0", [0, 1, 50], r"triangles\[0\].*three vertex indices below 50"),
        ("triangles.0", [0, 1, 1.0], r"triangles\[0\]"),
        ("triangles.0", [-1, 1, 1], r"triangles\[0\]"),
        ("triangles.0", None, r"triangles\[0\]: found None"),
        ("weights.0", [0.5, 0.5, 0.5], r"weights\[0\].*three shares of 1"),
        ("weights.0", [2.0, -1.0, 0.0], r"weights\[0\]"),
        ("weights.0", ["1", 0, 0], r"weights\[0\]"),
        ("spread_mm.0", -1.0, r"spread_mm\[0\].*mm, 0 or more"),
        ("spread_mm.0", "far", r"spread_mm\[0\]"),
        ("spread_mm.0", [1.0], r"spread_mm\[0\]"),
        ("weights.0", {"a": 1}, r"weights\[0\]"),
    ],
)
def test_damaged_points_are_refused_by_name(points, tmp_path, field, value, message):
    path = write_surface_points(points, tmp_path / "mediapipe468.json")
    stored = copy.deepcopy(json.loads(path.read_text()))
    name, _, index = field.partition(".")
    if index:
        stored[name][int(index)] = value
    else:
        stored[name] = value
    path.write_text(json.dumps(stored))
    with pytest.raises(FormatError, match=message):
        read_surface_points(path, 50)


def test_the_shipped_templates_points_lie_on_its_face(tmp_path):
    template = load_template(default_template_path())
    points = template.face_points
    assert points is not None
    assert (points.triangles[:, 0] >= 0).sum() > 430
    assert np.nanmedian(points.spread_mm) < 3
    on = points.on(template.mesh.vertices)
    marks = template.mesh.vertices[template.landmarks]
    # The tip of the nose, the corners of the mouth, the outer corners of the eyes.
    for mesh, ibug in ((4, 30), (61, 48), (291, 54), (33, 36), (263, 45)):
        assert np.linalg.norm(on[mesh] - marks[ibug]) < 6
    save_template(template, tmp_path / "T")
    again = load_template(tmp_path / "T").face_points
    assert again is not None
    assert np.array_equal(again.triangles, points.triangles)
