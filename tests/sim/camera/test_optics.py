"""Lenses: what they blur, shade and bend, against formulas and OpenCV."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.rig import Camera, default_rig, look_at
from sim.camera.flaws import LensConfig
from sim.camera.optics import RADII_PX, Lens, defocus, distorted, make_lens


def camera(width: int = 120, height: int = 180, **over: object) -> Camera:
    made = Camera(
        id="cam0",
        serial="1",
        model="Nikon DSC D750",
        width_px=width,
        height_px=height,
        fx_px=4.4 * width,
        fy_px=4.4 * width,
        cx_px=width / 2,
        cy_px=height / 2,
        dist=(0.0, 0.0, 0.0, 0.0, 0.0),
        cam_from_world=look_at(np.array([0.0, 0.0, 1100.0]), np.zeros(3)),
    )
    return dataclasses.replace(made, **over)


def lens(**config: object) -> Lens:
    return make_lens(camera(), LensConfig(**config), 1)


def random_light(seed: int = 0, shape: tuple[int, int] = (180, 120)) -> np.ndarray:
    return np.random.default_rng(seed).random((*shape, 3)).astype(np.float32)


def test_the_default_lens_changes_nothing():
    light = random_light()
    np.testing.assert_array_equal(lens().form(light, np.full((180, 120), 900.0)), light)


def test_the_default_rigs_lens_is_a_105_mm_lens():
    made = make_lens(default_rig().cameras[0], LensConfig(), 0)
    assert made.focal_mm == pytest.approx(105.0, abs=0.1)


@pytest.mark.parametrize("k", [(0.1, -0.2, 0.003, -0.002, 0.05), (-0.3, 0, 0, 0, 0)])
def test_projection_distorts_as_opencv_does_and_rays_undo_it(k):
    """The renderer casts these rays, so its pictures are distorted as `dist` says."""
    bent = camera(dist=k, fx_px=300.0, fy_px=310.0)
    points = np.random.default_rng(3).uniform(-150, 150, (50, 3))
    found, _ = bent.project(points)
    pose = bent.cam_from_world
    turn, _ = cv2.Rodrigues(pose[:, :3])
    known, _ = cv2.projectPoints(points, turn, pose[:, 3], bent.opencv_matrix, np.array(k))
    np.testing.assert_allclose(found, known[:, 0] + 0.5, atol=1e-8)
    origin, rays = bent.pixel_rays()
    pixels, _ = bent.project(origin + 900 * rays.reshape(-1, 3))
    rows, columns = np.mgrid[:180, :120] + 0.5
    np.testing.assert_allclose(pixels, np.stack([columns, rows], -1).reshape(-1, 2), atol=1e-3)


def test_distortion_is_added_to_the_rigs_own():
    rig = default_rig().scaled(0.01)
    bent = distorted(rig, LensConfig(distortion_k1=-0.2))
    assert {c.dist for c in bent.cameras} == {(-0.2, 0.0, 0.0, 0.0, 0.0)}
    assert distorted(rig, LensConfig()) is rig


def test_blur_spreads_a_point_by_the_stated_sigma_and_keeps_its_light():
    made = lens(blur_um=600.0, diffraction=True)
    light = np.zeros((180, 120, 3), np.float32)
    light[90, 60] = 1.0
    out = made.form(light).astype(float)
    np.testing.assert_allclose(out.sum(axis=(0, 1)), 1.0, rtol=1e-5)
    across = (np.arange(120) - 60.0) ** 2
    for c in range(3):
        found = np.sqrt((out[..., c].sum(axis=0) * across).sum())
        # A pixel gathers over its own width: 1/12 is added.
        assert found == pytest.approx(np.sqrt(made.sigma_px[c] ** 2 + 1 / 12), rel=0.01)
    assert made.sigma_px[0] > made.sigma_px[2]


def test_diffraction_at_full_size_is_the_airy_discs_width():
    """f/16 and green light: the disc's first zero at 1.22 wavelengths f/N is 2.9 sigma."""
    made = make_lens(default_rig().cameras[0], LensConfig(diffraction=True), 0)
    zero_px = 1.22 * 0.54 * 16 / (1000 * made.pitch_mm)
    assert zero_px / made.sigma_px[1] == pytest.approx(2.9, rel=0.01)


def test_vignetting_takes_the_stated_share_in_the_corner_and_nothing_on_the_axis():
    shading = lens(vignetting=0.3).shading
    assert shading[90, 60] == pytest.approx(1.0, abs=1e-3)
    assert shading[0, 0] == pytest.approx(0.7, abs=0.01)
    flat = np.ones((180, 120, 3), np.float32)
    np.testing.assert_array_equal(lens(vignetting=0.3).form(flat)[..., 1], shading)


def test_light_falls_with_the_fourth_power_of_the_field_angles_cosine():
    wide = make_lens(camera(fx_px=80.0, fy_px=80.0), LensConfig(cosine_fourth=True), 0)
    _, rays = wide.camera.pixel_rays()
    cosine = rays @ wide.camera.cam_from_world[2, :3]
    np.testing.assert_allclose(wide.shading, cosine**4, rtol=1e-5)


def test_cameras_differ_in_vignetting_and_focus_by_seed():
    config = LensConfig(vignetting=0.2, vignetting_spread=0.05, focus_error_mm=10.0)
    cameras = [camera(id=f"cam{k}") for k in range(200)]
    made = [make_lens(c, config, 1) for c in cameras]
    assert np.std([m.corner_loss for m in made]) == pytest.approx(0.05, rel=0.15)
    assert np.std([m.focus_mm for m in made]) == pytest.approx(10.0, rel=0.15)
    assert np.mean([m.focus_mm for m in made]) == pytest.approx(1030.0, abs=3.0)
    assert make_lens(cameras[0], config, 1) == made[0]
    assert make_lens(cameras[0], config, 2) != made[0]


def test_the_circle_of_confusion_is_that_of_the_thin_lens():
    """Two rays through the aperture's rim, traced to the sensor, end this far apart."""
    made = dataclasses.replace(lens(f_number=4.0), focus_mm=1000.0)
    f, aperture = made.focal_mm, made.focal_mm / 4.0
    sensor_mm = 1 / (1 / f - 1 / 1000.0)
    for depth in (700.0, 990.0, 1000.0, 1500.0):
        image_mm = 1 / (1 / f - 1 / depth)
        known = aperture * abs(sensor_mm - image_mm) / image_mm / made.pitch_mm / 2
        assert made.circle_px(np.array([depth]))[0] == pytest.approx(known, abs=1e-9)
    np.testing.assert_array_equal(made.circle_px(np.array([0.0, -5.0])), 0.0)


def test_what_lies_in_the_plane_of_focus_stays_sharp_and_what_does_not_blurs():
    made = lens(f_number=4.0, depth_of_field=True)
    light = random_light(1)
    sharp = made.form(light, np.full((180, 120), made.focus_mm))
    np.testing.assert_allclose(sharp, light, atol=1e-6)
    spread = [
        made.form(light, np.full((180, 120), made.focus_mm + off)).std() for off in (0, -200, -400)
    ]
    assert spread[0] > 1.2 * spread[1] > 1.2 * spread[2]


def test_a_defocused_point_is_a_disc_of_the_stated_radius():
    light = np.zeros((101, 101, 3), np.float32)
    light[50, 50] = 1.0
    for radius in (4.0, 9.0, 12.0):
        out = defocus(light, np.full((101, 101), radius))[..., 0].astype(float)
        rows, columns = np.mgrid[:101, :101] - 50.0
        # A disc's mean squared distance from its middle is half its radius squared.
        assert (out * (rows**2 + columns**2)).sum() == pytest.approx(radius**2 / 2, rel=0.06)


@settings(max_examples=25, deadline=None)
@given(st.floats(0, 1e6), st.floats(0, 60), st.integers(0, 1000))
def test_defocus_loses_no_light_and_makes_none(scale, radius, seed):
    rng = np.random.default_rng(seed)
    light = np.zeros((160, 150, 3), np.float32)
    light[60:90, 60:90] = scale * rng.random((30, 30, 3))
    radii = rng.uniform(0, radius, (160, 150))
    out = defocus(light, radii)
    assert (out >= -1e-4 * scale).all()
    np.testing.assert_allclose(
        out.sum(axis=(0, 1), dtype=float),
        light.sum(axis=(0, 1), dtype=float),
        rtol=2e-4,
        atol=1e-34,
    )


def test_defocus_keeps_a_flat_field_flat_and_ends_at_its_widest_disc():
    flat = np.ones((140, 130, 3), np.float32)
    np.testing.assert_allclose(defocus(flat, np.full((140, 130), 7.3)), 1.0, rtol=1e-5)
    widest = np.full((140, 130), RADII_PX[-1])
    light = random_light(2, (140, 130))
    np.testing.assert_array_equal(defocus(light, 100 * widest), defocus(light, widest))


def test_defocus_is_the_plain_sum_of_discs():
    """The plain twin: each pixel's light put down disc by disc."""
    rng = np.random.default_rng(5)
    light = np.zeros((60, 60, 3), np.float32)
    light[20:40, 20:40] = rng.random((20, 20, 3))
    radii = rng.choice([0.0, 1.5, 4.0, 8.0], (60, 60))
    known = np.zeros((60, 60, 3))
    fine = (np.arange(5) - 2) / 5
    rows, columns = np.mgrid[:60, :60].astype(float)
    for y, x in np.argwhere(light[..., 0] > 0):
        if radii[y, x] == 0:
            known[y, x] += light[y, x]
            continue
        inside = np.zeros((60, 60))
        for dy in fine:
            for dx in fine:
                inside += (rows + dy - y) ** 2 + (columns + dx - x) ** 2 <= radii[y, x] ** 2
        known += inside[..., None] / inside.sum() * light[y, x]
    np.testing.assert_allclose(defocus(light, radii), known, atol=0.02 * known.max())
