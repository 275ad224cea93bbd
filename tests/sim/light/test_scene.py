"""What cameras and points see: rays against shapes with known answers."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy import ndimage

from lightstage.formats.mesh import Mesh
from lightstage.patterns import pattern_levels
from lightstage.rig import Light
from sim.errors import SimError
from sim.light.lamps import LampConfig, lamps_of, light_weights, point_lamps
from sim.light.scene import Scene
from sim.light.transmittance import transmittance
from sim.light.world import World
from sim.people.subject import Subject


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
    """One light, diffuse part only: Lambert's law below the interface."""
    matt = dataclasses.replace(ball, specular_albedo=0 * ball.specular_albedo)
    world = World(matt, tiny_rig, lamps=point_lamps(tiny_rig.positions_mm))
    weights = np.zeros((len(tiny_rig.lights), 3))
    light = int(np.argmax(tiny_rig.positions_mm[:, 2]))
    weights[light] = [1.0, 0.5, 0.25]
    surface = world.surfaces["cam0"]
    found = world.pixels("cam0", weights[None])[0]
    place = tiny_rig.positions_mm[light]
    toward = place - surface.position.astype(float)
    distance = np.linalg.norm(toward, axis=1, keepdims=True)
    cosine = np.sum(surface.normal * toward / distance, axis=1, keepdims=True)
    inward, mean = transmittance(cosine, surface.roughness[:, None])
    outward, _ = transmittance(
        np.sum(surface.normal * surface.view, axis=1, keepdims=True), surface.roughness[:, None]
    )
    known = surface.albedo * weights[light] * cosine * (np.linalg.norm(place) / distance) ** 2
    known *= inward * outward / mean
    clear = cosine[:, 0] > 0.05
    np.testing.assert_allclose(found[clear], known[clear], rtol=1e-4, atol=1e-6)


def test_rays_cast_in_tiles_find_the_same_lights(ball, tiny_rig, monkeypatch):
    scene = Scene(with_lid(ball))
    surface = scene.surface(tiny_rig.camera("cam0"))
    whole = scene.visible_lights(surface, tiny_rig.positions_mm)
    monkeypatch.setattr("sim.light.scene.TILE_POINTS", 137)
    np.testing.assert_array_equal(scene.visible_lights(surface, tiny_rig.positions_mm), whole)


def test_more_rays_a_pixel_smooth_the_silhouette_alone(ball, tiny_rig):
    """Nine rays: edge pixels hold the share of the ball in them, all others stay as they are."""
    flat = dataclasses.replace(
        ball, diffuse_albedo=0 * ball.diffuse_albedo + 0.5, specular_albedo=0 * ball.specular_albedo
    )
    camera = tiny_rig.camera("cam0")
    levels = np.ones((1, len(tiny_rig.lights)))
    one = World(flat, tiny_rig)
    plain = one.photograph("cam0", levels)[0, ..., 0]
    fine = World(flat, tiny_rig, samples=3).photograph("cam0", levels)[0, ..., 0]
    seen = one.surfaces["cam0"].picture(np.ones(len(one.surfaces["cam0"].pixel)))
    edge, _ = one.scene.edge_samples(one.surfaces["cam0"], 3)
    kept = np.delete(np.arange(plain.size), edge)
    assert len(kept) > 0.7 * plain.size
    np.testing.assert_array_equal(fine.ravel()[kept], plain.ravel()[kept])
    border = (ndimage.minimum_filter(seen, 3) == 0) & (ndimage.maximum_filter(seen, 3) > 0)
    # A plain picture draws a pixel on the border whole or not at all.
    known = np.zeros_like(plain)
    big = tiny_rig.scaled(15)
    shape = (camera.height_px, 15, camera.width_px, 15)
    dense = Scene(flat).surface(big.camera("cam0"))
    share = dense.picture(np.ones(len(dense.pixel))).reshape(shape).mean(axis=(1, 3))
    known[border] = share[border] * ndimage.maximum_filter(plain, 3)[border]
    error_fine, error_plain = (np.abs(p[border] - known[border]).mean() for p in (fine, plain))
    assert error_fine < 0.4 * error_plain


def test_coloured_levels_light_each_channel_by_its_own(ball, tiny_rig):
    world = World(ball, tiny_rig)
    levels = np.random.default_rng(4).random((2, len(tiny_rig.lights), 3))
    coloured = world.photograph("cam1", levels)
    for channel in range(3):
        one = world.photograph("cam1", levels[:, :, channel])
        np.testing.assert_allclose(coloured[..., channel], one[..., channel], rtol=1e-5, atol=1e-7)


def test_pictures_of_single_lights_add_up_to_any_photograph(ball, tiny_rig):
    world = World(with_lid(ball), tiny_rig, lamps=lamps_of(tiny_rig, LampConfig(0.1, 0.1), 3))
    names = ("full", "x+", "lin-y-", "olat-003")
    levels = np.stack([pattern_levels(name, tiny_rig) for name in names])
    total = np.zeros((len(names), 96, 64, 3))
    ids = []
    for level, (light, picture) in zip(levels.T, world.single_lights("cam0"), strict=True):
        total += level[:, None, None, None] * picture
        ids.append(light)
    assert ids == [light.id for light in tiny_rig.lights]
    np.testing.assert_allclose(world.photograph("cam0", levels), total, rtol=1e-5, atol=1e-6)


def test_pixels_without_face_are_black_and_cost_nothing(ball, tiny_rig):
    world = World(ball, tiny_rig)
    surface = world.surfaces["cam0"]
    picture = world.photograph("cam0", np.ones((1, len(tiny_rig.lights))))[0].reshape(-1, 3)
    assert 0 < len(surface.pixel) < len(picture)
    assert np.delete(picture, surface.pixel, axis=0).max() == 0
    assert (picture[surface.pixel].min(axis=1) > 0).mean() > 0.99


def test_lamps_that_leave_the_rigs_figures_are_seeded(tiny_rig):
    config = LampConfig(gain_spread=0.1, colour_spread=0.05)
    one, same, other = (lamps_of(tiny_rig, config, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.weights, same.weights)
    assert not np.allclose(one.weights, other.weights)
    plain = lamps_of(tiny_rig)
    np.testing.assert_array_equal(plain.weights, light_weights(tiny_rig))
    np.testing.assert_allclose(plain.axes @ [0, 0, 1], -plain.positions_mm[:, 2] / 1250)
    many = np.concatenate(
        [lamps_of(tiny_rig, config, s).weights / plain.weights for s in range(60)]
    )
    logs = np.log(many)
    assert np.log(many.mean(axis=1)).std() == pytest.approx(0.1, rel=0.1)
    assert (logs - logs.mean(axis=1, keepdims=True)).std() == pytest.approx(
        0.05 * np.sqrt(2 / 3), rel=0.1
    )


@pytest.mark.parametrize("value", [-0.1, np.nan, np.inf])
def test_a_spread_that_cannot_be_is_refused(value):
    with pytest.raises(SimError, match="gain_spread"):
        LampConfig(gain_spread=value)


def test_a_subject_of_stretched_ggx_facets_shines_its_own_way(ball, tiny_rig):
    levels = np.ones((1, len(tiny_rig.lights)))
    round_one = World(ball, tiny_rig).photograph("cam0", levels)
    wide = dataclasses.replace(ball, distribution="ggx")
    zero = dataclasses.replace(ball, anisotropy=np.zeros_like(ball.roughness))
    brushed = dataclasses.replace(ball, anisotropy=np.full_like(ball.roughness, 0.8))
    np.testing.assert_allclose(
        World(zero, tiny_rig).photograph("cam0", levels), round_one, rtol=1e-5, atol=1e-7
    )
    for other in (wide, brushed):
        picture = World(other, tiny_rig).photograph("cam0", levels)
        assert np.isfinite(picture).all()
        assert 1e-4 < np.abs(picture - round_one).max() < 1


def test_brushing_along_u_widens_the_highlight_along_u(ball, tiny_rig):
    """One light at the camera: the highlight is broad where the facets are rougher."""
    black = dataclasses.replace(ball, diffuse_albedo=0 * ball.diffuse_albedo)
    brushed = dataclasses.replace(black, anisotropy=np.full_like(ball.roughness, 0.8))
    camera = tiny_rig.camera("cam0")
    lamp = Light(0, "lamp", tuple(1250 * camera.centre_mm / 1100), "horizontal")
    rig = dataclasses.replace(tiny_rig, lights=(lamp,))
    light = World(brushed, rig).photograph("cam0", np.ones((1, 1)))[0, ..., 1]
    rows, columns = np.mgrid[: light.shape[0], : light.shape[1]]
    spread = [np.average((p - np.average(p, weights=light)) ** 2, weights=light) for p in
              (columns, rows)]  # fmt: skip
    # The ball's u runs around its upright axis: across the picture.
    assert spread[0] > 1.5 * spread[1]


@pytest.mark.parametrize("quantile", [0.5, 0.999])
def test_skin_peak_is_between_darkest_and_brightest_skin(ball, tiny_rig, quantile):
    world = World(ball, tiny_rig)
    pictures = world.photograph("cam0", np.ones((1, len(tiny_rig.lights))))[0]
    peak = world.skin_peak(quantile)
    assert (peak > 0).all()
    assert (peak <= pictures.max(axis=(0, 1)) * 1.1).all()
