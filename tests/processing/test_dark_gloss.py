"""Gloss and albedo of dark, shiny skin: its highlights turn normals while gloss is unknown."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.patterns import SEQUENCES, pattern_levels
from processing.frames.read import Frames
from processing.lighting.facets import BECKMANN
from processing.refinement.config import RefineConfig
from processing.refinement.every_pixel import solve_view
from processing.refinement.finish import Maps
from processing.refinement.gloss_search import find_gloss
from processing.refinement.joint import NOISE_APART, near_matte
from processing.refinement.joint_kernels import Solved
from processing.refinement.scene import Scene, prepare_scene, read_view
from sim.light.world import World
from tests.processing import lit_ball, shots
from tests.processing.lit_ball import angle_deg
from tests.sim.conftest import ball_subject

RIG = lit_ball.small_rig(factor=0.02)
CAMERA = RIG.cameras[0]
PATTERNS = SEQUENCES["binary"]
CONFIG = RefineConfig(
    occlusion_directions=16, bounce_rays=0, scattering=(0.0,), finest_mm=4.0, edge_px=1.0,
    choice_pixels=0, noise_sensor=2e-4,
)  # fmt: skip


def refined(
    tone: np.ndarray, specular: float, roughness: float, config: RefineConfig
) -> tuple[Scene, Maps, np.ndarray]:
    """Scene, maps and cosines to the camera of a simulated ball of one skin."""
    ball = ball_subject()
    ball = dataclasses.replace(
        ball,
        diffuse_albedo=np.broadcast_to(tone, ball.diffuse_albedo.shape),
        specular_albedo=np.full_like(ball.specular_albedo, specular),
        roughness=np.full_like(ball.roughness, roughness),
    )
    levels = np.stack([pattern_levels(name, RIG) for name in PATTERNS])
    images = World(ball, RIG).photograph(CAMERA.id, levels)
    lit = images.max(axis=(0, 3)) > 0
    frames, lights = Frames.of(PATTERNS, images, lit), shots.rig_lights(RIG, PATTERNS)
    scene = prepare_scene(ball.mesh, lights, [(CAMERA, lit)], config)
    grid = read_view(frames, CAMERA, lit, scene, config)
    scene, found, _ = find_gloss(scene, [grid], config)
    solved = solve_view(scene, frames, CAMERA, lit, grid, found[0], config)
    facing = np.zeros(lit.shape)
    sight = lit_ball.see(lit_ball.Ball(radius_mm=80.0), CAMERA)
    facing[sight.mask] = (sight.normals * sight.views).sum(axis=1)
    return scene, solved.maps, facing[solved.mask]


@pytest.mark.parametrize(
    ("albedo", "roughness", "within"),
    [
        ((0.12, 0.07, 0.05), 0.2, 0.06),
        ((0.12, 0.07, 0.05), 0.3, 0.06),
        ((0.06, 0.035, 0.025), 0.3, 0.15),
    ],
)
def test_dark_skin_with_strong_gloss_is_as_dark_aslant_as_from_the_front(
    albedo: tuple[float, float, float], roughness: float, within: float
) -> None:
    tone, specular = np.float32(albedo), 0.06
    _, maps, facing = refined(tone, specular, roughness, CONFIG)
    for steep in ((facing > 0.35) & (facing < 0.7), facing > 0.7):
        off = maps.albedo[steep] / tone - 1
        assert np.sqrt((off**2).mean()) < within
        assert maps.specular[steep].mean() == pytest.approx(specular, rel=0.04)
        assert maps.roughness[steep].mean() == pytest.approx(roughness, rel=0.04)


@pytest.mark.parametrize("albedo", [(0.65, 0.45, 0.35), (0.12, 0.07, 0.05)])
@pytest.mark.parametrize("roughness", [0.06, 0.09])
def test_the_lobe_of_oil_on_skin_is_found(
    albedo: tuple[float, float, float], roughness: float
) -> None:
    config = dataclasses.replace(CONFIG, choice_pixels=9_000)
    scene, maps, facing = refined(np.float32(albedo), 0.028, roughness, config)
    seen = facing > 0.35
    assert scene.facets == BECKMANN
    assert np.median(maps.roughness[seen]) == pytest.approx(roughness, abs=0.01)
    assert np.median(maps.specular[seen]) == pytest.approx(0.028, rel=0.05)
    assert maps.albedo[seen].mean() == pytest.approx(np.mean(albedo), rel=0.06)


def solved_of(
    normal: np.ndarray, matte: np.ndarray, turn2: np.ndarray, misfit: float = 1.0
) -> Solved:
    """Normals as a step found them; the rest is not asked for."""
    three, one = np.zeros((len(normal), 3), np.float32), np.ones(len(normal), np.float32)
    normal, matte, turn2 = (np.asarray(x, np.float32) for x in (normal, matte, turn2))
    return Solved(normal, matte, three, three, np.float32(misfit) * one, three, one, turn2)


@given(
    seed=st.integers(0, 2**31),
    noise_deg=st.floats(0, 30),
    misfit=st.sampled_from([0.0, 0.5, 16.0, 256.0, 1e9]),
)
@settings(max_examples=40, deadline=None)
def test_normals_are_turned_back_on_the_shortest_way_as_far_as_noise_allows(
    seed: int, noise_deg: float, misfit: float
) -> None:
    rng = np.random.default_rng(seed)
    normal, matte = rng.normal(size=(2, 30, 3))
    normal[:10] = matte[:10] + 0.05 * normal[:10]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    matte /= np.linalg.norm(matte, axis=1, keepdims=True)
    turn2 = np.full(30, np.radians(noise_deg) ** 2)
    before = solved_of(normal, matte, turn2, misfit)
    after = near_matte(before, 2.0).normal
    believed = {0.0: 1, 0.5: 1, 16.0: 0.5, 256.0: 0.25, 1e9: 0.25}[misfit]
    most = 2.0 + believed * NOISE_APART * noise_deg
    were, are = angle_deg(normal, matte), angle_deg(after, matte)
    np.testing.assert_allclose(are, np.minimum(were, most), atol=0.05)
    np.testing.assert_allclose(angle_deg(after, normal) + are, were, atol=0.1)
    near = were < most - 0.05
    np.testing.assert_array_equal(after[near], before.normal[near])


def test_a_normal_without_a_matte_one_stays_and_what_is_no_number_is_not_spread() -> None:
    normal = np.array([[0, 0, 1.0], [0, 0, 1.0], [0, 0, 0], [0, 0, 1.0], [0, 0, 1.0], [0, 0, 1.0]])
    matte = np.array([[0, 0, 0], [1.0, 0, 0], [1.0, 0, 0], [1.0, 0, 0], [0, 0, -1.0], [1.0, 0, 0]])
    turn2 = np.array([0, np.nan, 0, 1e6, 0, 0])
    found = near_matte(solved_of(normal, matte, turn2), 2.0).normal
    np.testing.assert_array_equal(found[:5], normal[:5])
    assert angle_deg(found[5], matte[5]) == pytest.approx(2.0, abs=0.01)
