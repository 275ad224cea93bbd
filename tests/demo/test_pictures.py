"""Drawings show what they are given, where it is."""

from __future__ import annotations

import numpy as np
import pytest

from demo.pictures import labelled, line_chart, marks, mesh_picture, stage_picture, wireframe
from lightstage.formats.mesh import Mesh
from lightstage.patterns import pattern_levels
from lightstage.rig import Camera, default_rig

RED = (255, 0, 0)


@pytest.fixture(scope="module")
def camera() -> Camera:
    return default_rig().cameras[0].scaled(0.06)


def ball(radius_mm: float, steps: int = 24) -> Mesh:
    """A sphere at the origin, quads facing outward."""
    polar, around = np.meshgrid(
        np.linspace(0.05, np.pi - 0.05, steps), np.linspace(0, 2 * np.pi, steps), indexing="ij"
    )
    points = radius_mm * np.stack(
        [np.sin(polar) * np.sin(around), np.cos(polar), np.sin(polar) * np.cos(around)], axis=-1
    )
    index = np.arange(steps * steps).reshape(steps, steps)
    quads = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], axis=-1)
    return Mesh(points.reshape(-1, 3), quads.reshape(-1, 4).astype(np.int32))


def yellow(image: np.ndarray) -> np.ndarray:
    return (image[:, :, 0] > 150) & (image[:, :, 2] < 110)


def test_lit_lamps_lie_on_the_side_of_the_pattern() -> None:
    rig = default_rig()
    left = yellow(stage_picture(rig, pattern_levels("x-", rig)))
    right = yellow(stage_picture(rig, pattern_levels("x+", rig)))
    up = yellow(stage_picture(rig, pattern_levels("y+", rig)))
    assert np.nonzero(left)[1].mean() < 200 < 280 < np.nonzero(right)[1].mean()
    assert np.nonzero(up)[0].mean() < 200
    assert not yellow(stage_picture(rig, np.zeros(len(rig.lights)))).any()


def test_a_ball_is_a_disc_of_its_projected_size(camera: Camera) -> None:
    shown = mesh_picture(ball(60), camera, camera.height_px)
    disc = (shown < 250).any(axis=2)
    # A sphere's outline lies on the tangent cone: tan(asin(r / d)).
    distance = np.linalg.norm(camera.centre_mm)
    radius_px = camera.fx_px * np.tan(np.arcsin(60 / distance))
    assert disc.sum() == pytest.approx(np.pi * radius_px**2, rel=0.03)
    rows, columns = np.nonzero(disc)
    assert rows.mean() == pytest.approx(camera.cy_px, abs=1)
    assert columns.mean() == pytest.approx(camera.cx_px, abs=1)


def test_colours_of_vertices_are_seen(camera: Camera) -> None:
    mesh = ball(60)
    blue = np.tile([0.0, 0.0, 1.0], (len(mesh.vertices), 1))
    shown = mesh_picture(mesh, camera, camera.height_px, blue)
    centre = shown[round(camera.cy_px), round(camera.cx_px)]
    assert centre[2] > 120
    assert centre[:2].max() == 0


def test_marks_lie_where_points_project(camera: Camera) -> None:
    white = np.full((camera.height_px * 2, camera.width_px * 2, 3), 255, np.uint8)
    points = np.array([[20.0, 30.0, 10.0], [np.nan, 0, 0]])
    shown = marks(white, points, camera, RED)
    rows, columns = np.nonzero(shown[:, :, 1] < 128)
    place = camera.project(points[:1])[0][0] * 2
    assert [columns.mean() + 0.5, rows.mean() + 0.5] == pytest.approx(place, abs=1)


def test_wires_cover_the_side_that_is_seen_and_no_other(camera: Camera) -> None:
    white = np.full((camera.height_px, camera.width_px, 3), 255, np.uint8)
    mesh = ball(60)
    shown = wireframe(white, mesh, camera)
    assert (shown < 255).any()
    behind = Mesh(mesh.vertices, mesh.faces[mesh.vertices[mesh.faces[:, 0], 2] < -20])
    # Only the far half is left: what could be seen of it is its inside.
    np.testing.assert_array_equal(wireframe(white, behind, camera), white)


def drawn_curve(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(h, w) bool: pixels of the only curve's blue, without the legend's."""
    shown = line_chart({"loss": (x, y)}, "s").astype(int)
    blue = (shown[:, :, 2] > 120) & (shown[:, :, 0] < 120)
    blue[:40, 480:] = False
    return blue


def test_a_falling_curve_falls() -> None:
    x = np.linspace(0, 10, 50)
    blue = drawn_curve(x, np.exp(-x))
    first = np.nonzero(blue[:, 100])[0].mean()
    last = np.nonzero(blue[:, 600])[0].mean()
    assert first + 100 < last


def test_a_constant_curve_is_drawn() -> None:
    blue = drawn_curve(np.arange(5.0), np.ones(5))
    columns = np.nonzero(blue.any(axis=0))[0]
    assert columns[-1] - columns[0] > blue.shape[1] / 2
    assert blue.any(axis=0)[columns[0] : columns[-1]].all()
    assert np.ptp(np.nonzero(blue)[0]) < 10


def test_labels_add_a_strip() -> None:
    assert labelled(np.zeros((50, 80, 3), np.uint8), "words").shape == (74, 80, 3)
