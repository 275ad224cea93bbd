"""Pictures of light, skies and studios: light is kept, and comes from where it should."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.errors import FormatError
from lightstage.formats.exr import write_exr
from lightstage.formats.srgb import LUMINANCE
from sim.errors import SimError
from sim.light.environments import (
    FAR_MM,
    Panorama,
    add_sun,
    directions,
    load_panorama,
    panorama_lights,
    rotated,
    solid_angles,
    texel_of,
)
from sim.light.sky import SkyConfig, air_mass, clear_sky, mitsuba_sky, sun_direction, sun_irradiance
from sim.light.street import StreetConfig, street
from sim.light.studio import STUDIOS, Panel, panel_points, studio


def sky_picture(rows: int = 32) -> Panorama:
    rng = np.random.default_rng(1)
    radiance = rng.uniform(0, 1, size=(rows, 2 * rows, 3)) ** 4
    add_sun(radiance, np.array([0.6, 0.64, 0.48]), np.array([3.0, 2.5, 2.0]))
    return Panorama("test", radiance)


def irradiance(lights_mm: np.ndarray, rgb: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(n, 3) what white diffusers of these normals at the origin read."""
    toward = lights_mm / np.linalg.norm(lights_mm, axis=1, keepdims=True)
    return np.maximum(normals @ toward.T, 0) @ rgb


def panorama_irradiance(picture: Panorama, normals: np.ndarray) -> np.ndarray:
    toward = directions(len(picture.radiance)).reshape(-1, 3)
    given_ = picture.radiance * solid_angles(len(picture.radiance))[:, None, None] / np.pi
    return np.maximum(normals @ toward.T, 0) @ given_.reshape(-1, 3)


def ball(count: int = 200) -> np.ndarray:
    z = 1 - 2 * (np.arange(count) + 0.5) / count
    turn = np.pi * (3 - np.sqrt(5)) * np.arange(count)
    flat = np.sqrt(1 - z * z)
    return np.stack([flat * np.cos(turn), z, flat * np.sin(turn)], axis=1)


def test_texels_cover_the_whole_sphere_once() -> None:
    assert 128 * solid_angles(64).sum() == pytest.approx(4 * np.pi, rel=1e-12)
    toward = directions(64)
    np.testing.assert_allclose(np.linalg.norm(toward, axis=-1), 1, atol=1e-12)
    for row, column in ((0, 0), (10, 3), (40, 127), (63, 64)):
        assert texel_of(toward[row, column], 64) == (row, column)


def test_the_middle_column_looks_along_z_and_columns_grow_toward_x() -> None:
    assert texel_of(np.array([0.01, 0.0, 1.0]), 64) == (32, 64)
    assert texel_of(np.array([1.0, 0.01, 0.0]), 64)[1] == 96
    assert texel_of(np.array([0.0, 1.0, 0.0]), 64)[0] == 0


@pytest.mark.parametrize("count", [1, 2, 7, 64, 500])
def test_cutting_keeps_all_light_of_every_channel(count: int) -> None:
    picture = sky_picture()
    lights = panorama_lights(picture, count)
    whole = picture.radiance * solid_angles(32)[:, None, None] / np.pi
    assert len(lights.rgb) <= count
    np.testing.assert_allclose(lights.rgb.sum(axis=0), whole.sum(axis=(0, 1)), rtol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(lights.position_mm, axis=1), FAR_MM, rtol=1e-12)


def test_more_lights_come_nearer_to_what_the_picture_gives() -> None:
    picture, normals = sky_picture(), ball()
    known = panorama_irradiance(picture, normals)
    errors = []
    for count in (4, 16, 64, 256):
        lights = panorama_lights(picture, count)
        found = irradiance(lights.position_mm, lights.rgb, normals)
        errors.append(np.abs(found - known).mean() / known.mean())
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 0.004


def test_a_uniform_picture_is_a_white_furnace() -> None:
    lights = panorama_lights(Panorama("white", np.ones((64, 128, 3))), 256)
    found = irradiance(lights.position_mm, lights.rgb, ball())
    np.testing.assert_allclose(found, 1.0, atol=0.005)


def test_a_sun_of_one_texel_is_one_directional_light() -> None:
    radiance = np.zeros((64, 128, 3))
    toward = directions(64)[20, 90]
    add_sun(radiance, toward, np.array([2.0, 1.0, 0.5]))
    lights = panorama_lights(Panorama("sun", radiance), 100)
    assert len(lights.rgb) == 1
    np.testing.assert_allclose(lights.position_mm[0], FAR_MM * toward, rtol=1e-9)
    np.testing.assert_allclose(lights.rgb[0], np.array([2.0, 1.0, 0.5]) / np.pi, rtol=1e-12)


def test_every_texel_its_own_light_is_the_picture() -> None:
    picture = Panorama("small", np.random.default_rng(0).uniform(0.1, 1, size=(4, 8, 3)))
    lights = panorama_lights(picture, 1000)
    assert len(lights.rgb) == 32
    found = irradiance(lights.position_mm, lights.rgb, ball())
    np.testing.assert_allclose(found, panorama_irradiance(picture, ball()), rtol=1e-9)


def test_turning_a_picture_turns_its_light() -> None:
    lights = panorama_lights(sky_picture(), 50)
    turned = rotated(lights, 90.0)
    np.testing.assert_allclose(turned.position_mm[:, 0], lights.position_mm[:, 2], atol=1e-6)
    np.testing.assert_allclose(turned.position_mm[:, 1], lights.position_mm[:, 1])
    np.testing.assert_allclose(rotated(turned, -90.0).position_mm, lights.position_mm, atol=1e-6)


@settings(max_examples=60, deadline=None)
@given(
    values=st.lists(st.sampled_from([0.0, 1e-6, 1.0, 1e6]), min_size=32, max_size=32),
    count=st.integers(1, 40),
)
def test_any_light_however_bright_or_sparse_is_kept(values: list[float], count: int) -> None:
    radiance = np.repeat(np.array(values).reshape(4, 8, 1), 3, axis=2)
    if not radiance.any():
        radiance[0, 0] = 1.0
    lights = panorama_lights(Panorama("odd", radiance), count)
    whole = (radiance * solid_angles(4)[:, None, None] / np.pi).sum(axis=(0, 1))
    assert np.isfinite(lights.position_mm).all()
    np.testing.assert_allclose(lights.rgb.sum(axis=0), whole, rtol=1e-9)


@pytest.mark.parametrize(
    ("shape", "fill", "message"),
    [
        ((4, 7, 3), 1.0, "twice as many columns"),
        ((4, 8), 1.0, None),
        ((4, 8, 3), np.nan, "NaN or infinite"),
        ((4, 8, 3), np.inf, "NaN or infinite"),
        ((4, 8, 3), -0.1, "negative"),
        ((4, 8, 3), 0.0, "no light at all"),
    ],
)
def test_pictures_that_are_no_light_are_refused(
    tmp_path: Path, shape: tuple[int, ...], fill: float, message: str | None
) -> None:
    pixels = np.ones(shape, np.float32)
    pixels[..., 0] = fill if fill != 0 else 1.0
    if fill == 0:
        pixels[:] = 0
    write_exr(tmp_path / "e.exr", pixels, half=False)
    if message is None:
        assert load_panorama(tmp_path / "e.exr").radiance.shape == (4, 8, 3)
        return
    with pytest.raises(FormatError, match=message):
        load_panorama(tmp_path / "e.exr")


def test_radiance_hdr_files_are_read(tmp_path: Path) -> None:
    light = sky_picture(16).radiance.astype(np.float32)
    cv2.imwrite(str(tmp_path / "e.hdr"), light[:, :, ::-1])
    found = load_panorama(tmp_path / "e.hdr").radiance
    np.testing.assert_allclose(found, light, atol=light.max() / 100)
    assert np.abs(found - light).max() <= 0.01 * light.max(axis=2, keepdims=True).max()


def test_other_and_broken_files_are_refused(tmp_path: Path) -> None:
    for name in ("e.hdr", "e.exr"):
        (tmp_path / name).write_bytes(b"not a picture")
        with pytest.raises(FormatError, match="something else"):
            load_panorama(tmp_path / name)
    with pytest.raises(FormatError, match=r"A light set is \.json"):
        load_panorama(tmp_path / "e.hdr")
    with pytest.raises(FormatError, match=r"\.exr or \.hdr"):
        load_panorama(tmp_path / "e.png")
    with pytest.raises(FormatError, match="no such file"):
        load_panorama(tmp_path / "none.exr")
    with pytest.raises(SimError, match="at least 1"):
        panorama_lights(sky_picture(), 0)


def test_a_lower_sun_is_dimmer_and_redder() -> None:
    suns = [sun_irradiance(SkyConfig(elevation_deg=e)) for e in (60.0, 20.0, 3.0)]
    assert suns[0].sum() > suns[1].sum() > suns[2].sum()
    assert suns[0][0] / suns[0][2] < suns[1][0] / suns[1][2] < suns[2][0] / suns[2][2]
    assert air_mass(90.0) == pytest.approx(1.0, abs=0.001)
    assert air_mass(0.0) == pytest.approx(37.9, abs=0.5)


def test_the_sky_is_brightest_beside_the_sun_and_blue_overhead() -> None:
    config = SkyConfig(elevation_deg=30.0, azimuth_deg=0.0)
    sun, up = sun_direction(config), np.array([0.0, 1.0, 0.0])
    away = sun * [1, 1, -1]
    light = clear_sky(config, np.stack([sun, up, away]))
    bright = light @ LUMINANCE
    assert bright[0] > bright[2] > bright[1] > 0
    assert light[1, 2] > 1.3 * light[1, 0]
    assert np.isfinite(clear_sky(config, ball())).all()


def test_the_street_has_sun_fronts_and_ground_and_one_seed_is_one_street() -> None:
    config = StreetConfig(rows=64)
    one, again, other = street(1, config), street(1, config), street(2, config)
    assert np.array_equal(one.radiance, again.radiance)
    assert not np.array_equal(one.radiance, other.radiance)
    brightest = np.unravel_index(np.argmax(one.radiance @ LUMINANCE), (64, 128))
    assert tuple(brightest) == texel_of(sun_direction(config.sky), 64)
    bright = one.radiance @ LUMINANCE
    # The ground is darker than the sky overhead; the fronts are neither black nor sky.
    assert np.median(bright[48:]) < np.median(bright[:8])
    assert (one.radiance > 0).all()


@pytest.mark.parametrize("elevation", [60.0, 4.0])
def test_mitsubas_sky_becomes_a_picture_with_one_sun(elevation: float) -> None:
    pytest.importorskip("mitsuba", reason="needs the extra `reference`")
    config = SkyConfig(elevation_deg=elevation, rows=32)
    picture = mitsuba_sky(config, "sky")
    sun = texel_of(sun_direction(config), 32)
    assert np.unravel_index(np.argmax(picture.radiance @ LUMINANCE), (32, 64)) == sun
    rest = picture.radiance.copy()
    rest[sun] = 0
    # The ground is a diffuser under all of it.
    up = panorama_irradiance(picture, np.array([[0.0, 1.0, 0.0]]))[0]
    np.testing.assert_allclose(picture.radiance[-1, 0], 0.25 * up, rtol=0.02)
    high = rest[2].mean(axis=0)
    assert high[2] > 1.5 * high[0]


def test_the_disc_of_mitsubas_sun_is_integrated() -> None:
    """Its irradiance in the picture is the sum of its radiance over the disc, within 2 %."""
    mi = pytest.importorskip("mitsuba", reason="needs the extra `reference`")
    config = SkyConfig(elevation_deg=50.0, rows=32)
    picture = mitsuba_sky(config, "sky")
    sun = sun_direction(config)
    row, column = texel_of(sun, 32)
    mi.set_variant("scalar_rgb")
    disc = mi.load_dict(
        {
            "type": "sunsky",
            "sun_direction": [float(sun[2]), float(sun[0]), float(sun[1])],
            "turbidity": 3.0,
            "sky_scale": 0.0,
        }
    )
    place = mi.SurfaceInteraction3f()
    side = np.cross(sun, [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    # Rings around the sun's middle, to beyond the disc's edge.
    step = np.radians(0.3) / 600
    whole = np.zeros(3)
    for angle in step * (np.arange(600) + 0.5):
        x, y, z = np.cos(angle) * sun + np.sin(angle) * side
        place.wi = mi.Vector3f(-z, -x, -y)
        whole += 2 * np.pi * np.sin(angle) * step * np.array(disc.eval(place, True)).ravel()
    found = picture.radiance[row, column] * solid_angles(32)[row]
    np.testing.assert_allclose(found, whole, rtol=0.02)


@pytest.mark.parametrize("name", STUDIOS)
def test_a_studio_gives_what_its_panels_say(name: str) -> None:
    lights = studio(name, 300)
    known = sum(
        np.maximum(np.array(p.centre_mm)[2] / np.linalg.norm(p.centre_mm), 0) * np.array(p.rgb)
        for p in STUDIOS[name]
    )
    facing = irradiance(lights.position_mm, lights.rgb, np.array([[0.0, 0.0, 1.0]]))[0]
    np.testing.assert_allclose(facing, known, rtol=0.05, atol=0.01)
    assert 200 < len(lights.rgb) < 400


def test_a_small_panel_is_a_point_and_a_ring_is_dark_inside() -> None:
    panel = Panel((0.0, 0.0, 1000.0), (1.0, 1.0), (1.0, 1.0, 1.0))
    places, share = panel_points(panel, 9)
    np.testing.assert_allclose(share.sum(), 1.0, atol=1e-5)
    assert np.abs(places - [0, 0, 1000]).max() < 1
    ring = Panel((0.0, 0.0, 1000.0), (400.0, 400.0), (1.0, 1.0, 1.0), 0.5)
    places, _ = panel_points(ring, 100)
    radius = np.linalg.norm(places[:, :2], axis=1)
    assert 100 <= radius.min() < radius.max() <= 200


@pytest.mark.parametrize(
    "make",
    [
        lambda: studio("none"),
        lambda: studio("ring", 0),
        lambda: Panel((0.0, 0.0, 0.0), (1.0, 1.0), (1.0, 1.0, 1.0)),
        lambda: Panel((0.0, 0.0, 9.0), (0.0, 1.0), (1.0, 1.0, 1.0)),
        lambda: SkyConfig(elevation_deg=-5.0),
        lambda: SkyConfig(elevation_deg=float("nan")),
        lambda: StreetConfig(half_width_m=0.0),
        lambda: StreetConfig(height_m=(5.0, 2.0)),
    ],
)
def test_impossible_places_are_refused(make: object) -> None:
    with pytest.raises(SimError, match="expected"):
        make()  # type: ignore[operator]
