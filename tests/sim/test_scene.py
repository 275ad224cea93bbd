"""What cameras and points see: rays against shapes with known answers."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from lightstage.formats.mesh import Mesh
from sim.scene import Scene
from sim.subject import Subject
from sim.world import World


def seen_lights(bits: np.ndarray, count: int) -> np.ndarray:
    return np.unpackbits(bits, axis=1, count=count, bitorder="little").astype(bool)


def with_lid(ball: Subject) -> Subject:
    """The ball with a small square held 60 mm above its front, so that it throws a shadow."""
    mesh = ball.mesh
    assert mesh.uvs is not None
    assert mesh.face_uvs is not None
    corners = np.array([[-20, 60, 90], [20, 60, 90], [20, 90, 60], [-20, 90, 60]], float)
    first = len(mesh.vertices)
    lid = np.array([[first, first + 1, first + 2, first + 3]], np.int32)
    uvs = np.concatenate([mesh.uvs, np.full((4, 2), 0.5)])
    lid_uvs = lid - first + len(mesh.uvs)
    return dataclasses.replace(
        ball,
        mesh=Mesh(
            np.concatenate([mesh.vertices, corners]),
            np.concatenate([mesh.faces, lid]),
            uvs,
            np.concatenate([mesh.face_uvs, lid_uvs.astype(np.int32)]),
        ),
    )


def test_a_camera_sees_the_ball_where_it_is(ball, tiny_rig):
    camera = tiny_rig.camera("cam1")
    surface = Scene(ball).surface(camera)
    radius = np.linalg.norm(surface.position, axis=1)
    # The ball is made of flat quads: its faces lie up to 0.2 mm inside.
    assert radius.max() <= 80.001
    assert radius.min() > 79.7
    outward = surface.position / radius[:, None]
    # Normals come from a texture of 96 rows: within a texel of the analytic ones.
    assert np.degrees(np.arccos(np.sum(outward * surface.normal, axis=1).clip(-1, 1))).max() < 1.0
    pixels, _ = camera.project(surface.position)
    row, column = np.divmod(surface.pixel, camera.width_px)
    np.testing.assert_allclose(pixels, np.stack([column, row], axis=1) + 0.5, atol=2e-3)
    to_camera = camera.centre_mm - surface.position
    to_camera /= np.linalg.norm(to_camera, axis=1, keepdims=True)
    np.testing.assert_allclose(surface.view, to_camera, atol=1e-5)


def test_a_ball_alone_shadows_nothing_above_its_horizon(ball, tiny_rig):
    scene = Scene(ball)
    surface = scene.surface(tiny_rig.camera("cam0"))
    lights = tiny_rig.positions_mm
    found = seen_lights(scene.visible_lights(surface, lights), len(lights))
    toward = lights[None] - surface.position[:, None]
    cosine = np.einsum("nmk,nk->nm", toward, surface.geometric)
    cosine /= np.linalg.norm(toward, axis=-1)
    # Within 1.5 degrees of the horizon the ball's flat faces may hide a light.
    assert found[cosine > 0.026].all()
    assert not found[cosine < 0].any()


def test_shadow_of_a_lid_falls_where_geometry_says(ball, tiny_rig):
    scene = Scene(with_lid(ball))
    surface = scene.surface(tiny_rig.camera("cam0"))
    light = np.array([[0.0, 600.0, 1000.0]])
    found = seen_lights(scene.visible_lights(surface, light), 1)[:, 0]
    # The segment to the light meets the lid's plane (y + z = 150) inside the square.
    on_ball = np.linalg.norm(surface.position, axis=1) < 80.5
    start = surface.position[on_ball].astype(float)
    share = (150 - start[:, 1] - start[:, 2]) / (1600 - start[:, 1] - start[:, 2])
    met = start + share[:, None] * (light - start)
    across, along = np.abs(met[:, 0]), (met[:, 1] - met[:, 2]) / 2
    inside = np.maximum(across / 20, np.abs(along) / 15)
    above = np.sum(start * (light - start), axis=1) > 0
    assert not found[on_ball][inside < 0.9].any()
    assert found[on_ball][above & (inside > 1.1)].mean() > 0.995
    assert (inside < 0.9).sum() > 20


def test_coarse_shadow_rays_answer_as_every_ray_does(ball, tiny_rig):
    """On the lid's shadow, the only place where coarse neighbours disagree."""
    scene = Scene(with_lid(ball))
    for camera in tiny_rig.cameras:
        big = camera.scaled(3.0)
        surface = scene.surface(big)
        fast = scene.visible_lights(surface, tiny_rig.positions_mm)
        plain = scene.visible_lights(surface, tiny_rig.positions_mm, coarse_px=1)
        count = len(tiny_rig.lights)
        different = seen_lights(fast, count) != seen_lights(plain, count)
        assert different.mean() < 2e-4
        assert not seen_lights(plain, count).all()


def test_the_inside_of_an_open_mesh_is_background(ball, tiny_rig):
    mesh = ball.mesh
    centre = mesh.vertices[mesh.faces].mean(axis=1)
    back = centre[:, 2] < 0
    assert mesh.face_uvs is not None
    half = Mesh(mesh.vertices, mesh.faces[back], mesh.uvs, mesh.face_uvs[back])
    surface = Scene(dataclasses.replace(ball, mesh=half)).surface(tiny_rig.camera("cam0"))
    assert len(surface.pixel) == 0


def test_photographs_add_up_as_light_does(ball, tiny_rig):
    world = World(ball, tiny_rig)
    rng = np.random.default_rng(1)
    one, two = rng.random((2, len(tiny_rig.lights))) / 2
    pictures = world.photograph("cam0", np.stack([one, two, one + two, 0 * one]))
    np.testing.assert_allclose(pictures[0] + pictures[1], pictures[2], atol=1e-5)
    assert pictures[3].max() == 0
    assert pictures[2].max() > 0.05


def test_a_photograph_of_the_ball_is_the_closed_form(ball, tiny_rig):
    """One light, diffuse part only, straight from Lambert's law."""
    matt = dataclasses.replace(ball, specular_albedo=0 * ball.specular_albedo)
    world = World(matt, tiny_rig)
    weights = np.zeros((len(tiny_rig.lights), 3))
    light = int(np.argmax(tiny_rig.positions_mm[:, 2]))
    weights[light] = [1.0, 0.5, 0.25]
    surface = world.surfaces["cam0"]
    found = world.pixels("cam0", weights[None])[0]
    place = tiny_rig.positions_mm[light]
    toward = place - surface.position.astype(float)
    distance = np.linalg.norm(toward, axis=1, keepdims=True)
    cosine = np.sum(surface.normal * toward / distance, axis=1, keepdims=True)
    known = surface.albedo * weights[light] * cosine * (np.linalg.norm(place) / distance) ** 2
    clear = cosine[:, 0] > 0.05
    np.testing.assert_allclose(found[clear], known[clear], rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("quantile", [0.5, 0.999])
def test_skin_peak_is_between_darkest_and_brightest_skin(ball, tiny_rig, quantile):
    world = World(ball, tiny_rig)
    pictures = world.photograph("cam0", np.ones((1, len(tiny_rig.lights))))[0]
    peak = world.skin_peak(quantile)
    assert (peak > 0).all()
    assert (peak <= pictures.max(axis=(0, 1)) * 1.1).all()
