"""Light from skin to skin: in hollow spheres and between plates, whose answers are known."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from lightstage.formats.mesh import Mesh
from processing.lighting.interface import BARE
from processing.refinement.bounces import (
    bounced_light,
    cosine_directions,
    mesh_triangles,
    other_skin,
    vertex_irradiance,
)
from processing.surface import LitSurface, lit_surface
from tests.processing import lit_ball

RIG = lit_ball.small_rig()
ALBEDO = np.array([0.6, 0.3, 0.1])


LIGHTS = lit_ball.lights_of_rig(RIG)


def surface_of(mesh: Mesh, finest_mm: float = 1e3) -> LitSurface:
    return lit_surface(
        mesh, LIGHTS, offset_mm=0.1, smoothing_mm=0, directions=16, most_faces=10**6,
        finest_mm=finest_mm,
    )  # fmt: skip


def hollow_sphere() -> Mesh:
    """Seen from within: its normals point inward."""
    import trimesh

    shape = trimesh.creation.icosphere(3, 50.0)
    return Mesh(np.asarray(shape.vertices), np.asarray(shape.faces, np.int32)[:, ::-1].copy())


def plate(height_mm: float, up: bool, half_mm: float = 20.0, cells: int = 8) -> Mesh:
    """A square plate that faces up or down."""
    line = np.linspace(-half_mm, half_mm, cells + 1)
    x, y = np.meshgrid(line, line, indexing="ij")
    vertices = np.stack([x.ravel(), y.ravel(), np.full(x.size, height_mm)], axis=1)
    corner = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    a, b, c, d = corner, corner + cells + 1, corner + cells + 2, corner + 1
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return Mesh(vertices, (triangles if up else triangles[:, ::-1]).astype(np.int32))


def together(first: Mesh, second: Mesh) -> Mesh:
    vertices = np.concatenate([first.vertices, second.vertices])
    triangles = np.concatenate([first.triangles(), second.triangles() + len(first.vertices)])
    return Mesh(vertices, triangles.astype(np.int32))


def parallel_plate(half_mm: float, apart_mm: float) -> float:
    """Share of its sky that a point below the middle of a square plate has from it.

    Four times the textbook's corner-to-rectangle factor.
    """
    a = half_mm / apart_mm
    root = np.sqrt(1 + a * a)
    return float(4 / (2 * np.pi) * 2 * a / root * np.arctan(a / root))


def test_cosine_directions_are_unit_and_as_dense_as_the_cosine() -> None:
    found = cosine_directions(4000)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, rtol=1e-12)
    np.testing.assert_allclose(found.mean(axis=0), [0, 0, 2 / 3], atol=2e-3)
    assert (found[:, 2] > 0).all()


def test_a_hollow_sphere_hides_its_whole_sky_and_shares_light_evenly() -> None:
    surface = surface_of(hollow_sphere())
    between = other_skin(surface, 256)
    rows = between.sum(axis=1)
    assert rows.max() <= 1 + 1e-6
    assert rows.min() > 0.98
    # A point of a sphere receives the mean of what all others send, wherever they are.
    spot = np.zeros((surface.coarse, 1))
    spot[surface.vertices[: surface.coarse, 2] > 25] = 1
    albedo = np.tile(ALBEDO, (surface.coarse, 1))
    once = bounced_light(surface, between, spot, albedo, times=1)
    np.testing.assert_allclose(once[:, 0], np.tile(ALBEDO * spot.mean(), (len(once), 1)), rtol=0.15)
    np.testing.assert_allclose(once[:, 0].mean(axis=0), ALBEDO * spot.mean(), rtol=0.02)


@pytest.mark.parametrize("times", [1, 2, 5])
def test_bounces_in_a_hollow_sphere_add_up_as_a_series(times: int) -> None:
    surface = surface_of(hollow_sphere())
    between = other_skin(surface, 64)
    entered = np.full((surface.coarse, 2), [1.0, 3.0])
    albedo = np.tile(ALBEDO, (surface.coarse, 1))
    found = bounced_light(surface, between, entered, albedo, times=times)
    series = sum(ALBEDO**n for n in range(1, times + 1))
    known = np.array([1.0, 3.0])[:, None] * series
    np.testing.assert_allclose(found, np.tile(known, (len(found), 1, 1)), rtol=0.03)


@pytest.mark.parametrize("apart_mm", [5.0, 20.0, 60.0])
def test_facing_plates_see_each_other_as_the_textbook_says(apart_mm: float) -> None:
    surface = surface_of(together(plate(0.0, up=True), plate(apart_mm, up=False)))
    between = other_skin(surface, 2048)
    rows = between.sum(axis=1)
    middle = np.flatnonzero(np.abs(surface.vertices[:, :2]).max(axis=1) < 1e-9)
    assert len(middle) == 2
    # Rays start .3 mm off the mesh.
    known = parallel_plate(20.0, apart_mm - 0.3)
    np.testing.assert_allclose(rows[middle], known, atol=0.01)
    half = surface.coarse // 2
    assert between[:half, :half].nnz == 0
    assert rows.max() <= 1 + 1e-6


def test_plates_that_face_away_send_each_other_nothing() -> None:
    backs = surface_of(together(plate(0.0, up=False), plate(20.0, up=True)))
    assert other_skin(backs, 64).nnz == 0
    over = surface_of(together(plate(0.0, up=True), plate(20.0, up=True)))
    assert other_skin(over, 64).nnz == 0


@pytest.mark.parametrize("finest_mm", [100.0, 3.0, 1.4, 0.7])
def test_splits_keep_the_mesh_and_its_light(finest_mm: float) -> None:
    mesh = plate(0.0, up=True)
    surface = surface_of(mesh, finest_mm)
    np.testing.assert_array_equal(mesh_triangles(surface), mesh.triangles())
    assert len(surface.triangles) == 4**surface.splits * len(mesh.triangles())
    assert surface.splits == {100.0: 0, 3.0: 1, 1.4: 2, 0.7: 3}[finest_mm]
    between = other_skin(surface, 16)
    entered = np.ones((surface.coarse, 1))
    found = bounced_light(surface, between, entered, np.tile(ALBEDO, (surface.coarse, 1)))
    assert found.shape == (len(surface.vertices), 1, 3)
    assert not found.any()


def test_a_white_plate_at_the_centre_receives_one_under_full() -> None:
    surface = surface_of(plate(0.0, up=True))
    middle = np.flatnonzero(np.abs(surface.vertices[:, :2]).max(axis=1) < 1e-9)
    entered = vertex_irradiance(surface, LIGHTS, BARE, 0.28)
    np.testing.assert_allclose(entered[middle, 0], 1.0, rtol=1e-5)
    assert (entered >= 0).all()
    # What lights the skin is the same whatever stands before the lens.
    polarised = dataclasses.replace(LIGHTS, diffuse_share=np.full(len(LIGHTS.patterns), 0.5))
    np.testing.assert_allclose(vertex_irradiance(surface, polarised, BARE, 0.28), entered)
