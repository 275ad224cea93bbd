"""Families of mirror lobes: what they reflect, and that the right one is found."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.formats.mesh import Mesh
from processing.lighting.facets import BECKMANN, Facets, horizontal, unmasked
from processing.lighting.interface import mirrored, skin_interface, smith
from processing.lighting.lobe import transport
from processing.refinement.config import RefineConfig
from processing.refinement.family import best_facets, unexplained
from processing.refinement.scene import Scene, View, faces_camera, prepare_scene
from processing.surface import see
from tests.processing import lit_ball

FAMILIES = (BECKMANN, Facets(tails=True), Facets(stretch=1.44), Facets(stretch=0.7))
RIG = lit_ball.small_rig(1, 0.06)
LIGHTS = lit_ball.lights_of_rig(RIG)
ALBEDO = np.array([0.55, 0.33, 0.22])
CONFIG = RefineConfig(choice_pixels=900)


@pytest.fixture(scope="module")
def scene() -> Scene:
    ball = trimesh.creation.icosphere(4, 95.0)
    mesh = Mesh(np.asarray(ball.vertices), np.asarray(ball.faces, np.int32))
    camera = RIG.cameras[0]
    every = np.ones((camera.height_px, camera.width_px), bool)
    config = dataclasses.replace(CONFIG, finest_mm=50.0, occlusion_directions=8)
    return prepare_scene(mesh, LIGHTS, [(camera, every)], config)


def view(scene: Scene, facets: Facets, noise: float = 0.001) -> View:
    """A ball of skin of a family, whose relief turns the normals by a degree or two."""
    camera = RIG.cameras[0]
    sight = see(scene.surface, camera, np.ones((camera.height_px, camera.width_px), bool), 1)
    rng = np.random.default_rng(0)
    normals = sight.normals + 0.02 * rng.normal(size=sight.normals.shape)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    e, b = transport(
        LIGHTS, sight.points_mm, normals, sight.views, 0.27, sight.shadows, skin_interface(facets)
    )
    rgb = ALBEDO * e[:, :, None] + 0.03 * b[:, :, None]
    rgb = rgb + noise * rng.normal(size=rgb.shape)
    count = len(rgb)
    return View(
        sight,
        rgb.astype(np.float32),
        np.full(count, 0.5),
        np.ones(count, bool),
        px_per_mm=1.0,
        mirrored=np.ones(len(LIGHTS.weight)),
    )


@pytest.mark.parametrize("facets", FAMILIES, ids=lambda each: each.name)
def test_the_family_that_was_photographed_is_found(scene: Scene, facets: Facets) -> None:
    found = best_facets(scene, [view(scene, facets)], CONFIG)
    assert found.tails == facets.tails
    assert found.stretch == pytest.approx(facets.stretch, rel=0.03)


def test_where_nothing_can_be_asked_the_lobe_is_round(scene: Scene) -> None:
    dark = view(scene, BECKMANN)
    dark = dataclasses.replace(dark, usable=np.zeros(len(dark.rgb), bool))
    assert unexplained(scene, [dark], BECKMANN, CONFIG) == 0
    assert best_facets(scene, [dark], CONFIG) == BECKMANN


@pytest.mark.parametrize("facets", FAMILIES, ids=lambda each: each.name)
@pytest.mark.parametrize("m", [0.15, 0.3])
def test_half_vectors_are_spread_as_a_distribution_is(facets: Facets, m: float) -> None:
    # The lobe over all directions of light, without shadowing and Fresnel, is a sum over half
    # vectors: of D cos over the hemisphere it must be 1.
    slope = np.tan((np.arange(1500) + 0.5) / 1500 * np.pi / 2)
    turn = (np.arange(256) + 0.5) / 256 * 2 * np.pi
    q = slope[:, None] ** 2 / m**2
    q = q * ((np.cos(turn) / facets.stretch) ** 2 + (np.sin(turn) * facets.stretch) ** 2)
    density = 1 / (1 + q) ** 2 if facets.tails else np.exp(-q)
    density = density * (1 + slope[:, None] ** 2) ** 2 / (np.pi * m**2)
    angle = np.arctan(slope)[:, None]
    total = (density * np.cos(angle) * np.sin(angle)).sum() * np.pi / 3000 * 2 * np.pi / 256
    assert total == pytest.approx(1, abs=1e-3)


@given(
    cosine=st.floats(1e-6, 1),
    m=st.floats(1e-6, 2),
    tails=st.booleans(),
)
@settings(max_examples=60, deadline=None)
def test_masking_is_that_of_the_interface(cosine: float, m: float, tails: bool) -> None:
    found = unmasked(cosine, m * np.sqrt(1 - cosine**2), tails)
    # The fit is above 1 by 1e-4 where it ends.
    assert 0 <= found <= 1.0002
    known = 1 / (1 + smith(np.array(cosine), m, tails))
    assert found == pytest.approx(float(known), abs=2e-3)


@given(
    angle=st.floats(-np.pi, np.pi), height=st.floats(-1, 1) | st.sampled_from([1.0, -1.0, 1 - 1e-9])
)
@settings(max_examples=60, deadline=None)
def test_the_tangent_is_level_and_across_the_normal(angle: float, height: float) -> None:
    flat = np.sqrt(1 - height**2)
    nx, nz = flat * np.sin(angle), flat * np.cos(angle)
    tx, tz = horizontal(nx, nz)
    assert np.hypot(tx, tz) == pytest.approx(1)
    assert nx * tx + nz * tz == pytest.approx(0, abs=2e-6)


def test_long_tails_mirror_more_of_grazing_light_and_stretching_changes_no_table() -> None:
    assert mirrored(0.2, 0.3, True) != pytest.approx(mirrored(0.2, 0.3), rel=0.01)
    plain, stretched = skin_interface(Facets(True)), skin_interface(Facets(True, 1.44))
    np.testing.assert_array_equal(plain.table, stretched.table)
    assert stretched.facets == Facets(True, 1.44)
    assert np.abs(plain.table - skin_interface().table).max() > 1e-3


def test_a_normal_turned_from_the_camera_is_not_used(scene: Scene) -> None:
    sight = view(scene, BECKMANN).sight
    assert faces_camera(sight).all()
    normals = sight.normals.copy()
    normals[::3] *= -1
    normals[1] = 0
    found = faces_camera(dataclasses.replace(sight, normals=normals))
    assert not found[::3].any()
    assert not found[1]
    assert found.sum() == len(normals) - len(normals[::3]) - 1


def test_names_tell_the_family() -> None:
    assert [facets.name for facets in FAMILIES[:2]] == ["Beckmann", "GGX"]
    assert FAMILIES[2].name == "Beckmann, 2.07 times as wide sideways as upward"
