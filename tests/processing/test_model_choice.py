"""The model of light: what families of lobes reflect, and that the right one is found."""

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
from processing.lighting.lobe import SKIN_F0, fresnel_table, transport
from processing.lighting.polarisers import diffuse_of_normals, mirrored_of_lamps
from processing.refinement import model_choice
from processing.refinement.config import RefineConfig
from processing.refinement.model_choice import (
    MARGIN,
    SIDES,
    Fitted,
    Sample,
    Step,
    best_model,
    compared,
    left_out_groups,
    sampled,
)
from processing.refinement.scattering import scattered, unscattered
from processing.refinement.scene import Scene, View, faces_camera, prepare_scene
from processing.surface import see
from tests.processing import lit_ball

FAMILIES = (
    BECKMANN,
    Facets(tails=True),
    Facets(stretch=1.44),
    Facets(stretch=0.7),
    Facets(covers=False),
    Facets(rises=False),
    Facets(True, rises=False, covers=False),
)
RIG = lit_ball.small_rig(1, 0.045)
LIGHTS = lit_ball.lights_of_rig(RIG)
ALBEDO = np.array([0.55, 0.33, 0.22])
CONFIG = RefineConfig(choice_pixels=9_000, scattering=(0.0,))


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
        mirrored=mirrored_of_lamps(LIGHTS, camera),
        diffuse=diffuse_of_normals(LIGHTS, camera),
    )


def chosen(
    scene: Scene, seen: View, bounced: np.ndarray | None = None, config: RefineConfig = CONFIG
) -> tuple[Scene, dict[str, Step]]:
    """The scene with its model, and what each step was worth."""
    around = unscattered(len(seen.rgb), len(LIGHTS.patterns))
    found, steps = best_model(scene, [seen], [around], bounced, config)
    return found, {step.name: step for step in steps}


@pytest.mark.parametrize("facets", FAMILIES, ids=lambda each: each.name)
def test_the_family_that_was_photographed_is_found(scene: Scene, facets: Facets) -> None:
    found, _ = chosen(scene, view(scene, facets))
    assert found.facets.tails == facets.tails
    assert found.facets.stretch == pytest.approx(facets.stretch, rel=0.03)
    assert found.facets.rises == facets.rises
    assert found.facets.covers == facets.covers


@pytest.mark.parametrize("facets", [BECKMANN, Facets(tails=True)], ids=lambda each: each.name)
@pytest.mark.parametrize("noise", [0.002, 0.004])
def test_the_family_is_found_in_noisy_photographs(
    scene: Scene, facets: Facets, noise: float
) -> None:
    config = dataclasses.replace(CONFIG, noise_sensor=noise, noise_floor=1.0)
    found, _ = chosen(scene, view(scene, facets, noise), config=config)
    assert found.facets == facets


def test_a_look_at_few_pixels_compares_models_that_were_both_fitted_to_these(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A model that was fitted to more pixels predicts better, whichever model it is."""
    pairs: list[tuple[int, int]] = []
    compare = model_choice.compared
    fit = model_choice.fitted
    fitted_to: dict[int, int] = {}

    def fitting(scene: Scene, model: object, samples: list[Sample], *others: object) -> Fitted:
        found = fit(scene, model, samples, *others)  # type: ignore[arg-type]
        fitted_to[id(found)] = sum(len(sample.band) for sample in samples)
        kept.append(found)
        return found

    def comparing(name: str, simple: Fitted, rich: Fitted, *others: object) -> Step:
        pairs.append((fitted_to[id(simple)], fitted_to[id(rich)]))
        return compare(name, simple, rich, *others)  # type: ignore[arg-type]

    kept: list[Fitted] = []
    monkeypatch.setattr(model_choice, "fitted", fitting)
    monkeypatch.setattr(model_choice, "compared", comparing)
    chosen(scene, view(scene, Facets(tails=True)))
    assert len({few for few, _ in pairs}) == 2
    assert all(simple == rich for simple, rich in pairs)


def test_a_stretch_that_one_side_of_the_face_alone_asks_for_is_not_taken(scene: Scene) -> None:
    seen = view(scene, BECKMANN)
    around = unscattered(len(seen.rgb), len(LIGHTS.patterns))
    sample = next(sampled([seen], [around], CONFIG, side=3))
    asked = sample.part[1::2]
    usual = np.ones(len(asked))
    simple = Fitted(scene, 6 * [usual])

    def step(better: np.ndarray, oriented: bool) -> Step:
        rich = Fitted(scene, 6 * [np.where(better, 0.5, usual)])
        return compared("wider sideways", simple, rich, 6 * [sample], oriented)

    everywhere, one_side = np.full(len(asked), True), asked % SIDES == 1
    assert step(everywhere, oriented=True).taken
    assert step(one_side, oriented=False).taken
    assert not step(one_side, oriented=True).taken
    assert step(one_side, oriented=True).gain > MARGIN


def hollow_light(scene: Scene) -> np.ndarray:
    """(V, P, 3) light from other skin, more of it where the ball looks down."""
    near = 1 - scene.surface.vertices[:, 1] / 190
    patterns = np.linspace(0.04, 0.1, len(LIGHTS.patterns))
    return (near[:, None, None] * patterns[:, None] * ALBEDO / ALBEDO.max()).astype(np.float32)


@pytest.mark.parametrize("there", [True, False])
def test_light_from_skin_to_skin_is_taken_where_it_is_photographed_alone(
    scene: Scene, there: bool
) -> None:
    bounced, seen = hollow_light(scene), view(scene, BECKMANN)
    if there:
        shadows = seen.sight.shadows
        at = np.einsum("nc,ncpk->npk", shadows.weights, bounced[shadows.corners])
        seen = dataclasses.replace(seen, rgb=(seen.rgb + ALBEDO * at).astype(np.float32))
    found, steps = chosen(scene, seen, bounced)
    step = steps["light from skin to skin"]
    assert bool(found.bounces) == there
    assert step.taken == there
    # The cost of either mistake stands in the facts, beyond what parts of the face differ by.
    assert abs(step.gain) > 2 * step.error


def test_dark_skin_without_an_interface_is_given_no_light_from_elsewhere(scene: Scene) -> None:
    """A Lambertian skin under a mirror with long tails, too dark to tell: no step stands in."""
    seen = view(scene, BECKMANN)
    sight = seen.sight
    rng = np.random.default_rng(3)
    normals = sight.normals + 0.02 * rng.normal(size=sight.normals.shape)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    e, _ = transport(LIGHTS, sight.points_mm, normals, sight.views, 0.27, sight.shadows)
    _, b = transport(
        LIGHTS, sight.points_mm, normals, sight.views, 0.22, sight.shadows,
        skin_interface(Facets(tails=True)),
    )  # fmt: skip
    rgb = 0.15 * ALBEDO * e[:, :, None] + 0.04 * b[:, :, None]
    rgb = (rgb + 0.001 * rng.normal(size=rgb.shape)).astype(np.float32)
    config = dataclasses.replace(CONFIG, scattering=(0.0, 0.25, 0.5))
    seen = dataclasses.replace(seen, rgb=rgb)
    around = scattered(e, sight.mask, 1.0, 1.0)
    found, _ = best_model(scene, [seen], [around], hollow_light(scene), config)
    assert not found.bounces
    assert found.scattering == 0
    assert found.facets.stretch == 1


def test_where_nothing_can_be_asked_the_model_is_the_simplest(scene: Scene) -> None:
    dark = view(scene, BECKMANN)
    dark = dataclasses.replace(dark, usable=np.zeros(len(dark.rgb), bool))
    found, steps = chosen(scene, dark, hollow_light(scene))
    assert found.facets == BECKMANN
    assert not found.bounces
    assert not any(step.taken for step in steps.values())


def test_patterns_that_tell_each_other_are_left_out_together() -> None:
    found = left_out_groups(("full", "x+", "y-", "x-", "lamp-3", "full@cross", "x+@cross", "y+"))
    assert found.tolist() == [-1, 0, 1, 0, 2, -1, 0, 1]


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


@given(tails=st.booleans(), stretch=st.floats(0.5, 2), rises=st.booleans())
@settings(max_examples=20, deadline=None)
def test_facets_that_cover_nothing_let_all_light_in(
    tails: bool, stretch: float, rises: bool
) -> None:
    found = skin_interface(Facets(tails, stretch, rises, covers=False))
    assert (found.table == 1).all()
    assert found.entered_share(0.28) == 1
    assert found.facets == Facets(tails, stretch, rises, covers=False)
    # Whether the mirror rises changes nothing of what enters.
    below = skin_interface(Facets(tails, stretch, rises))
    np.testing.assert_array_equal(below.table, skin_interface(Facets(tails)).table)
    assert below.facets.rises == rises


def test_a_mirror_that_does_not_rise_reflects_less_of_grazing_light() -> None:
    table, flat = fresnel_table(), fresnel_table(rises=False)
    assert (flat == 1).all()
    assert table[-1] == pytest.approx(1, abs=1e-3)
    assert table[0] == pytest.approx(1 / SKIN_F0, rel=1e-3)
    assert (table >= flat - 1e-3).all()


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


def test_names_have_the_family() -> None:
    assert [facets.name for facets in FAMILIES[:2]] == ["Beckmann", "GGX"]
    assert FAMILIES[2].name == "Beckmann, 2.07 times as wide sideways as upward"
    alike = "GGX, the same share at all angles, over skin that all light enters"
    assert FAMILIES[6].name == alike
