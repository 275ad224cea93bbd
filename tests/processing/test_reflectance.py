"""Lights, normals, lobes and albedo against a ball lit in plain float64."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.formats.mesh import Mesh
from lightstage.formats.session import Calibration, Session
from lightstage.patterns import pattern_levels
from lightstage.rig import Rig
from processing.albedo import specular_evidence
from processing.frames.read import Frames
from processing.lighting.fresnel import fresnel
from processing.lighting.interface import skin_interface
from processing.lighting.lights import (
    PatternLights,
    far_field,
    fix_normals,
    irradiance_vectors,
    no_shadows,
    octahedral_cell,
    octahedral_normals,
    pattern_lights,
)
from processing.lighting.lobe import transport
from processing.normals import ratio_normals, solve_far_normals, solve_normals
from processing.readings import px_per_mm
from processing.refinement.config import RefineConfig
from processing.refinement.every_pixel import solve_view
from processing.refinement.gloss_search import find_gloss
from processing.refinement.scene import prepare_scene, read_view
from processing.separation.config import SeparateConfig
from processing.separation.view_readings import Pixels
from tests.processing import lit_ball, shots
from tests.processing.lit_ball import PATTERNS, Ball, angle_deg
from tests.processing.one_pass import separate_at_once

RIG = lit_ball.small_rig()
CAMERA = RIG.cameras[0]


def lights_of(rig: Rig, patterns: tuple[str, ...] = PATTERNS) -> PatternLights:
    levels = {name: pattern_levels(name, rig) for name in patterns}
    return pattern_lights(
        cast(
            Session,
            SimpleNamespace(
                rig=rig,
                levels=levels.__getitem__,
                file=SimpleNamespace(patterns={}, calibration=Calibration()),
            ),
        ),
        patterns,
    )


LIGHTS = lights_of(RIG)
FAR = far_field(LIGHTS)


def ball_mesh(ball: Ball, subdivisions: int = 4) -> Mesh:
    import trimesh

    shape = trimesh.creation.icosphere(subdivisions, ball.radius_mm)
    return Mesh(np.asarray(shape.vertices) + ball.centre_mm, np.asarray(shape.faces, np.int32))


def separated(ball: Ball, change: float = 0.0) -> tuple[lit_ball.Sight, np.ndarray]:
    sight = lit_ball.see(ball, CAMERA)
    rgb = lit_ball.photograph(ball, sight, RIG).astype(np.float32)
    return sight, rgb + np.float32(change)


def test_white_facing_the_front_reads_one_under_full() -> None:
    front = np.array([[0.0, 0.0, 1.0]])
    e, _ = transport(LIGHTS, np.zeros((1, 3)), front, front, 0.25, no_shadows(1, LIGHTS))
    np.testing.assert_allclose(e[0, 0], 1.0, rtol=1e-6)


def test_irradiance_and_lobe_agree_with_the_plain_twin() -> None:
    ball = Ball(centre_mm=(12.0, -20.0, 5.0))
    sight = lit_ball.see(ball, CAMERA)
    full = pattern_levels("x+", RIG)
    irradiance, mirror = lit_ball.shade(ball, sight, RIG, full)
    points = (sight.points_mm, sight.normals, sight.views)
    e, lobe = transport(LIGHTS, *points, ball.roughness, no_shadows(len(sight.normals), LIGHTS))
    np.testing.assert_allclose(e[:, 1], irradiance, atol=2e-6)
    found = ball.specular * lobe[:, 1]
    np.testing.assert_allclose(found, mirror, atol=0.01 * mirror.max())


def test_irradiance_below_skins_interface_agrees_with_the_plain_twin() -> None:
    """Theirs integrates over facets, ours over directions of light."""
    for roughness in (0.2, 0.3):
        ball = Ball(centre_mm=(12.0, -20.0, 5.0), roughness=roughness, coated=True)
        sight = lit_ball.see(ball, CAMERA)
        seen = (sight.points_mm, sight.normals, sight.views)
        irradiance, _ = lit_ball.shade(ball, sight, RIG, pattern_levels("x+", RIG))
        open_sky = no_shadows(len(sight.normals), LIGHTS)
        e, _ = transport(LIGHTS, *seen, roughness, open_sky, skin_interface())
        # The last six degrees to the rim are coarse in both; nothing is trusted there.
        inner = (sight.normals * sight.views).sum(axis=1) > 0.1
        known = irradiance[inner]
        np.testing.assert_allclose(e[inner, 1], known, atol=0.01 * known.max())


def test_skins_interface_mirrors_as_a_dielectric_and_keeps_its_mean() -> None:
    found = skin_interface()
    smooth = 1 - fresnel(((1.4 - 1) / (1.4 + 1)) ** 2, np.array([0.5, 1.0]))
    # A smooth surface and the smoothest row differ at the grazing end alone.
    np.testing.assert_allclose(found.table[0][[20, 40]], smooth, atol=0.01)
    assert (np.diff(found.table, axis=1) > 0).all()
    assert (found.table[:, 0] < 0.8).all()
    cosines = np.linspace(0, 1, 2001)
    grid = np.linspace(0, 1, found.table.shape[1])
    for row, mean in zip(found.table, found.mean, strict=True):
        known = np.trapezoid(2 * cosines * np.interp(cosines, grid, row), cosines)
        np.testing.assert_allclose(mean, known, rtol=1e-3)


def test_irradiance_vectors_give_the_irradiance_of_their_own_normal() -> None:
    sight = lit_ball.see(Ball(), CAMERA)
    vectors = irradiance_vectors(
        LIGHTS, sight.points_mm, sight.normals, no_shadows(len(sight.normals), LIGHTS)
    )
    for index, name in enumerate(PATTERNS):
        irradiance, _ = lit_ball.shade(Ball(), sight, RIG, pattern_levels(name, RIG))
        found = np.einsum("nk,nk->n", vectors[:, index], sight.normals)
        np.testing.assert_allclose(found, irradiance, atol=3e-6)


def test_every_direction_falls_into_a_cell_that_points_its_way() -> None:
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(500, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    table = octahedral_normals(96)
    cells = [octahedral_cell(*n, 96) for n in normals]
    assert angle_deg(table[cells], normals).max() < 2.6


def test_far_normals_are_exact_at_the_centre_and_ratios_are_not() -> None:
    sight = lit_ball.see(Ball(), CAMERA)
    tiny = lit_ball.Sight(sight.mask, sight.points_mm * 1e-4, sight.normals, sight.views)
    signal = np.stack(
        [lit_ball.shade(Ball(), tiny, RIG, pattern_levels(n, RIG))[0] for n in PATTERNS], axis=1
    ).astype(np.float32)
    found = solve_far_normals(signal, FAR, sight.views, 5)
    assert angle_deg(found, sight.normals).max() < 0.1
    assert angle_deg(ratio_normals(signal, PATTERNS), sight.normals).mean() > 5


def test_fresnel_has_the_known_values_of_skin() -> None:
    angles = np.radians([0, 45, 60, 70, 75])
    f0 = ((1.4 - 1) / (1.4 + 1)) ** 2
    known = [0.0278, 0.037, 0.072, 0.150, 0.231]
    np.testing.assert_allclose(fresnel(f0, np.cos(angles)), known, rtol=0.02)


def test_coarse_separation_of_a_glossy_ball_errs_by_the_near_field_alone() -> None:
    ball = Ball(coated=True)
    sight, rgb = separated(ball)
    valid = np.ones(len(rgb), bool)
    scale = px_per_mm(CAMERA)
    maps = separate_at_once(
        Pixels(rgb, valid, sight.views, sight.mask, scale), LIGHTS, SeparateConfig()
    )
    inner = (sight.normals * sight.views).sum(axis=1) > 0.3
    assert angle_deg(maps.diffuse_normal, sight.normals)[inner].mean() < 1.5
    assert np.abs(maps.albedo - ball.albedo)[inner].mean() < 0.02
    assert abs(maps.specular[inner].mean() - ball.specular) < 0.006
    assert maps.confidence[inner].mean() > 0.9


def refined(ball: Ball, noise: float = 0.0, **told: float) -> tuple[np.ndarray, ...]:
    truth = lit_ball.see(ball, CAMERA)
    images = np.zeros((len(PATTERNS), *truth.mask.shape, 3), np.float32)
    images[:, truth.mask] = lit_ball.photograph(ball, truth, RIG).transpose(1, 0, 2)
    rng = np.random.default_rng(1)
    images += np.float32(noise) * rng.normal(0, 1, images.shape).astype(np.float32)
    frames = Frames.of(PATTERNS, images, np.ones(truth.mask.shape, bool))
    config = RefineConfig(
        shadow_offset_mm=0.3,
        smoothing_mm=0,
        occlusion_directions=64,
        finest_mm=4.0,
        bounce_rays=0,
        noise_sensor=max(noise, 0.001),
    )
    config = dataclasses.replace(config, **told)
    scene = prepare_scene(ball_mesh(ball), LIGHTS, [(CAMERA, truth.mask)], config)
    view = read_view(frames, CAMERA, truth.mask, scene, config)
    scene, found, _ = find_gloss(scene, [view], config)
    maps = solve_view(scene, frames, CAMERA, truth.mask, view, found[0], config).maps.pixel_maps()
    normals = np.zeros((*truth.mask.shape, 3))
    normals[truth.mask] = truth.normals
    sight = view.sight
    inner = (normals[sight.mask] * sight.views).sum(axis=1) > 0.4
    inner &= maps.confidence > 0.5
    assert inner.sum() > 1500
    return (
        angle_deg(maps.diffuse_normal, normals[sight.mask])[inner],
        angle_deg(maps.specular_normal, normals[sight.mask])[inner],
        maps.albedo[inner],
        maps.specular[inner],
        maps.roughness[inner],
        sight.occlusion[inner],
    )


@pytest.mark.parametrize(("specular", "roughness"), [(0.028, 0.25), (0.02, 0.3), (0.04, 0.22)])
def test_refine_recovers_normals_albedo_gloss_and_open_sky_of_a_ball(
    specular: float, roughness: float
) -> None:
    place = (15.0, -25.0, 10.0)
    ball = Ball(specular=specular, roughness=roughness, centre_mm=place, coated=True)
    matte, glossy, albedo, found, width, occlusion = refined(ball)
    assert matte.mean() < 0.1
    assert glossy.mean() < 0.05
    assert np.abs(albedo - ball.albedo).mean() < 0.002
    assert abs(found.mean() - specular) < 0.001
    assert abs(np.median(width) - roughness) < 0.005
    np.testing.assert_allclose(occlusion, 1.0, atol=0.02)


def test_refine_of_a_noisy_ball_takes_its_relief_from_all_channels() -> None:
    ball = Ball(coated=True)
    matte, glossy, albedo, found, _, _ = refined(ball, noise=0.004)
    alone = refined(ball, noise=0.004, apart_deg=1e4)[0]  # chroma alone: about 1.7 degrees
    assert glossy.mean() < 1.0
    assert glossy.mean() < 0.5 * alone.mean()
    assert matte.mean() < 0.8 * alone.mean()
    assert np.sqrt(((albedo - ball.albedo) ** 2).mean()) < 0.01
    assert abs(found.mean() - ball.specular) < 0.004


def test_specular_evidence_agrees_with_least_squares_in_both_unknowns() -> None:
    rng = np.random.default_rng(0)
    e, lobe = (rng.uniform(0.1, 1, (40, 7)) for _ in range(2))
    mean = 0.4 * e + 0.03 * lobe + rng.normal(0, 0.01, e.shape)
    evidence = specular_evidence(mean, e, lobe)
    for i in range(len(e)):
        system = np.stack([e[i], lobe[i]], axis=1)
        known, residual, _, _ = np.linalg.lstsq(system, mean[i], rcond=None)
        s = evidence.weighed[i] / evidence.weight[i]
        np.testing.assert_allclose(s, known[1], rtol=1e-9, atol=1e-12)
        left = evidence.power[i] - evidence.weighed[i] ** 2 / evidence.weight[i]
        np.testing.assert_allclose(left, residual[0], rtol=1e-6, atol=1e-12)


def bad_pixels(kind: str, rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    valid = np.ones(len(rgb), bool)
    out = rgb.copy()
    if kind == "black":
        out[:] = 0
    elif kind == "grey":
        out[:] = out.mean(axis=2, keepdims=True)
    elif kind == "dead channel":
        out[:, :, 1] = 0
    elif kind == "clipped":
        valid[:] = False
    elif kind == "negative":
        out[:] = -np.abs(out)
    elif kind == "nan":
        out[:, 3, 0] = np.nan
    elif kind == "infinite":
        out[:, 2] = np.inf
    return out, valid


KINDS = ("black", "grey", "dead channel", "clipped", "negative", "nan", "infinite")


@pytest.mark.parametrize("kind", KINDS)
def test_pixels_that_cannot_be_solved_are_zero_with_no_confidence(kind: str) -> None:
    sight, good = separated(Ball())
    bad = np.zeros(len(good), bool)
    bad[::2] = True
    rgb, valid = bad_pixels(kind, good)
    rgb, valid = np.where(bad[:, None, None], rgb, good), valid | ~bad
    scale = px_per_mm(CAMERA)
    maps = separate_at_once(
        Pixels(rgb, valid, sight.views, sight.mask, scale), LIGHTS, SeparateConfig()
    )
    for values in (maps.diffuse_normal, maps.albedo, maps.specular, maps.confidence):
        assert np.isfinite(values).all()
        assert not values[bad].any()
    assert maps.confidence[~bad].mean() > 0.8


@given(
    scale=st.floats(-6, 6).map(lambda power: 10.0**power),
    tilt=st.floats(0, 1.2),
    turn=st.floats(0, 6.28),
)
@settings(max_examples=40, deadline=None)
def test_solved_normals_do_not_depend_on_scale(scale: float, tilt: float, turn: float) -> None:
    normal = np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
    directions = LIGHTS.position_mm / LIGHTS.radius_mm[:, None]
    irradiance = LIGHTS.strength @ np.maximum(directions @ normal, 0)
    signal = (scale * irradiance).astype(np.float32)[None]
    far = solve_far_normals(signal, FAR, np.array([[0.0, 0.0, 1.0]]), 6)
    assert angle_deg(far[0], normal) < 0.3
    above = directions @ normal > 0
    vectors = (LIGHTS.strength * above) @ directions
    system = np.linalg.lstsq(vectors, signal[0].astype(float), rcond=None)[0]
    exact = solve_normals(signal.astype(float), vectors[None])[0]
    np.testing.assert_allclose(exact, system / np.linalg.norm(system), atol=1e-6)


@given(
    st.lists(
        st.floats(-1e6, 1e6) | st.sampled_from([0.0, np.nan, np.inf, -np.inf]),
        min_size=7,
        max_size=7,
    )
)
@settings(max_examples=40, deadline=None)
def test_solved_normals_are_unit_or_zero_whatever_is_read(values: list[float]) -> None:
    signal = np.array([values], np.float32)
    table = FAR
    for found in (
        solve_far_normals(signal, table, np.array([[0.0, 0.0, 1.0]]), 4),
        solve_normals(signal.astype(float), table[:1]),
    ):
        length = np.linalg.norm(found)
        assert length == 0 or abs(length - 1) < 1e-6


def test_vectors_that_lie_in_a_plane_are_not_solved() -> None:
    vectors = np.random.default_rng(0).normal(size=(1, 7, 3))
    vectors[:, :, 2] = 0
    assert not solve_normals(np.ones((1, 7)), vectors).any()


def test_three_directions_in_all_channels_fix_normals() -> None:
    assert fix_normals(lights_of(RIG, PATTERNS))
    assert fix_normals(lights_of(RIG, tuple(f"{name}@parallel" for name in PATTERNS)))
    assert not fix_normals(lights_of(RIG, ("full", "x+", "x-")))
    coloured = shots.coloured_rig(RIG)
    assert not fix_normals(shots.rig_lights(coloured, ("mux-1", "mux-2")))
