"""Gloss of a simulated ball that was photographed through polarisers."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from lightstage.patterns import SEQUENCES, pattern_levels
from processing.frames.read import Frames
from processing.refinement.config import RefineConfig
from processing.refinement.gloss_search import find_gloss
from processing.refinement.scene import prepare_scene, read_view
from sim.light.polarised import PolarisedWorld, PolariserConfig
from sim.light.world import World
from tests.processing import lit_ball, shots
from tests.sim.conftest import ball_subject

RIG = lit_ball.small_rig(factor=0.02)
PATTERNS = SEQUENCES["binary-polarised"]
CONFIG = RefineConfig(
    occlusion_directions=16, bounce_rays=0, scattering=(0.0,), finest_mm=4.0, edge_px=1.0,
    choice_pixels=0, gloss_spread=0.02,
)  # fmt: skip


@pytest.mark.parametrize(
    ("albedo", "specular"), [((0.65, 0.45, 0.35), 0.014), ((0.12, 0.07, 0.05), 0.028)]
)
def test_polarised_photographs_show_gloss_without_a_bias_at_all_tones_and_angles(
    albedo: tuple[float, float, float], specular: float
) -> None:
    ball, camera = ball_subject(), RIG.cameras[0]
    tone = np.broadcast_to(np.float32(albedo), ball.diffuse_albedo.shape)
    same = np.full_like(ball.specular_albedo, specular)
    ball = dataclasses.replace(ball, diffuse_albedo=tone, specular_albedo=same)
    world = PolarisedWorld(World(ball, RIG), PolariserConfig(np.inf, np.inf))
    levels = np.stack([pattern_levels(name, RIG) for name in PATTERNS])
    images = world.photograph(camera.id, levels)
    lit = images.max(axis=(0, 3)) > 0
    frames = Frames.of(PATTERNS, images, lit)
    lights = shots.rig_lights(RIG, PATTERNS)
    scene = prepare_scene(ball.mesh, lights, [(camera, lit)], CONFIG)
    grid = read_view(frames, camera, lit, scene, CONFIG)
    scene, _, _ = find_gloss(scene, [grid], CONFIG)
    seen = np.unique(grid.sight.shadows.corners)
    normals = scene.surface.vertices[seen] / 80
    facing = normals @ camera.centre_mm / np.linalg.norm(camera.centre_mm)
    for steep in ((facing > 0.3) & (facing < 0.6), facing > 0.6):
        assert scene.gloss.specular[seen][steep].mean() == pytest.approx(specular, rel=0.015)
        assert scene.gloss.roughness[seen][steep].mean() == pytest.approx(0.3, rel=0.05)
