"""Environments on the stage's lights: nothing is lost, everything falls where it should."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.errors import FormatError
from lightstage.formats.environment import LightSet, write_lights
from lightstage.formats.exr import write_exr
from lightstage.patterns.surroundings import surroundings_flux
from lightstage.patterns.weights import irradiance, solid_angles_sr
from lightstage.rig import default_rig
from tests.lightstage.patterns.rigs import any_rig, rig_at

OCTAHEDRON = rig_at(np.concatenate([np.eye(3), -np.eye(3)]) * 1000.0)
GREEN = 0.7152


def texels(rows):
    """Directions and solid angles of a picture's texels, from the format's own words."""
    polar = np.pi * (np.arange(rows) + 0.5) / rows
    azimuth = 2 * np.pi * ((np.arange(2 * rows) + 0.5) / (2 * rows) - 0.5)
    t, p = np.meshgrid(polar, azimuth, indexing="ij")
    toward = np.stack([np.sin(t) * np.sin(p), np.cos(t), np.sin(t) * np.cos(p)], axis=-1)
    edges = np.cos(np.pi * np.arange(rows + 1) / rows)
    return toward, np.repeat(((edges[:-1] - edges[1:]) * np.pi / rows)[:, None], 2 * rows, axis=1)


def flux(tmp_path, picture, rig, **turn):
    return surroundings_flux(write_exr(tmp_path / "e.exr", picture, half=False), rig, **turn)


@settings(max_examples=30)
@given(any_rig(), st.integers(1, 20), st.sampled_from([1e-6, 1.0, 1e6]), st.integers(0, 9))
def test_no_light_is_lost_at_any_size_or_scale(tmp_path_factory, rig, rows, scale, seed):
    picture = np.random.default_rng(seed).random((rows, 2 * rows, 3)) * scale
    found = flux(tmp_path_factory.mktemp("e"), picture, rig)
    luminance = picture.astype(np.float32) @ [0.2126, 0.7152, 0.0722]
    assert found.sum() == pytest.approx((luminance * texels(rows)[1]).sum(), rel=1e-5)
    assert (found >= 0).all()


@pytest.mark.parametrize(
    ("row", "column", "light"),
    [(0, 3, 1), (31, 40, 4), (16, 32, 2), (16, 48, 0), (16, 0, 5), (16, 16, 3)],
    ids=["up", "down", "front", "+x", "behind", "-x"],
)
def test_a_texel_goes_to_the_light_it_points_to(tmp_path, row, column, light):
    picture = np.zeros((32, 64, 3))
    picture[row, column, 1] = 7.0
    found = flux(tmp_path, picture, OCTAHEDRON)
    assert np.flatnonzero(found).tolist() == [light]
    assert found[light] == pytest.approx(7 * GREEN * texels(32)[1][row, column])


def test_a_turn_goes_from_front_to_the_right(tmp_path):
    picture = np.zeros((32, 64, 3))
    picture[16, 32] = 1.0
    assert np.flatnonzero(flux(tmp_path, picture, OCTAHEDRON, rotate_deg=90.0)).tolist() == [0]
    assert np.flatnonzero(flux(tmp_path, picture, OCTAHEDRON, rotate_deg=-90.0)).tolist() == [3]


def test_an_even_sky_gives_each_light_its_solid_angle(tmp_path):
    rig = default_rig()
    found = flux(tmp_path, np.full((64, 128, 3), 3.0), rig)
    assert np.allclose(found, 3 * solid_angles_sr(rig), rtol=0.06)


def test_a_large_picture_is_gathered_without_loss_and_a_sun_stays_in_its_cell(tmp_path):
    rows = 1200  # 2.9 million texels are gathered two by two
    rng = np.random.default_rng(1)
    picture = rng.random((rows, 2 * rows, 1)).astype(np.float32).repeat(3, axis=2)
    found = flux(tmp_path, picture, OCTAHEDRON)
    toward, sr = texels(rows)
    nearest = (toward.reshape(-1, 3) @ (OCTAHEDRON.positions_mm.T / 1000)).argmax(axis=1)
    known = np.bincount(nearest, (picture[..., 0] * sr).ravel())
    assert np.allclose(found, known, rtol=2e-3)
    sun = np.zeros((rows, 2 * rows, 3), np.float32)
    sun[600, 900] = 5.0
    lit = flux(tmp_path, sun, OCTAHEDRON)
    assert np.flatnonzero(lit).tolist() == [np.argmax(toward[600, 900] @ OCTAHEDRON.positions_mm.T)]


def test_the_stage_lights_a_white_ball_as_the_place_does(tmp_path):
    """Irradiance under the driven lights beside that of the picture itself."""
    rows = 32
    toward, sr = texels(rows)
    sky = 1 + 0.8 * toward[..., 1] + 0.5 * toward[..., 0] ** 2
    rig = default_rig()
    found = flux(tmp_path, np.repeat(sky[..., None], 3, axis=2), rig)
    normals = np.concatenate([np.eye(3), -np.eye(3)])
    known = [(sky * sr * np.maximum(toward @ n, 0)).sum() for n in normals]
    assert np.allclose(irradiance(rig, found, normals), known, rtol=0.03)


def test_lights_in_one_direction_share_what_comes_from_there(tmp_path):
    places = np.concatenate([OCTAHEDRON.positions_mm, OCTAHEDRON.positions_mm[:1] * 2])
    found = flux(tmp_path, np.ones((16, 32, 3)), rig_at(places))
    assert found[0] == found[6]
    assert found[0] == pytest.approx(found[1] / 2, rel=0.05)


def test_a_radiance_picture_is_read_in_its_own_order_of_colours(tmp_path):
    picture = np.zeros((32, 64, 3), np.float32)
    picture[16, 32] = (0.25, 0.5, 2.0)  # blue, green, red as OpenCV writes it
    cv2.imwrite(str(tmp_path / "e.hdr"), picture)
    found = surroundings_flux(tmp_path / "e.hdr", OCTAHEDRON)
    known = 0.2126 * 2 + 0.7152 * 0.5 + 0.0722 * 0.25
    assert found[2] == pytest.approx(known * texels(32)[1][16, 32], rel=0.02)


def test_a_light_set_gives_its_lights_to_their_cells_and_its_ambient_to_all(tmp_path):
    lights = LightSet(
        "two",
        np.array([[0, 0, 500.0], [30.0, 900, 0]]),
        np.array([[0, 1.0, 0], [0, 2.0, 0]]),
        np.array([0.0, 0.5, 0]),
    )
    found = surroundings_flux(write_lights(lights, tmp_path / "e.json"), OCTAHEDRON)
    even = 0.5 * GREEN * 4 * np.pi / 6
    known = even + GREEN * np.pi * np.array([0, 2, 1, 0, 0, 0])
    assert np.allclose(found, known)
    # A diffuser facing +z reads the ambient light and the first light's own figure.
    read = irradiance(OCTAHEDRON, found, np.array([[0, 0, 1.0]])) / np.pi
    assert read == pytest.approx([GREEN * (0.5 * 2 / 3 + 1)])


@pytest.mark.parametrize(
    ("value", "message"),
    [(np.nan, "NaN or infinite"), (np.inf, "NaN or infinite"), (-0.5, "negative")],
)
def test_a_bad_value_is_refused_with_its_place(tmp_path, value, message):
    picture = np.ones((8, 16, 3))
    picture[2, 5, 2] = value
    with pytest.raises(FormatError, match=f"row 2, column 5, B: found 1 {message} value"):
        flux(tmp_path, picture, OCTAHEDRON)


def test_other_shapes_files_and_darkness_are_refused(tmp_path):
    with pytest.raises(
        FormatError, match="found 8 x 9 x 3, expected rows x columns x 3, twice as many"
    ):
        flux(tmp_path, np.ones((8, 9, 3)), OCTAHEDRON)
    with pytest.raises(FormatError, match="no light at all"):
        flux(tmp_path, np.zeros((8, 16, 3)), OCTAHEDRON)
    (tmp_path / "e.hdr").write_bytes(b"#?RADIANCE\nbroken")
    with pytest.raises(FormatError, match="a whole Radiance HDR picture"):
        surroundings_flux(tmp_path / "e.hdr", OCTAHEDRON)
    (tmp_path / "cut.exr").write_bytes((tmp_path / "e.exr").read_bytes()[:200])
    with pytest.raises(FormatError, match=r"cut\.exr"):
        surroundings_flux(tmp_path / "cut.exr", OCTAHEDRON)
    (tmp_path / "e.json").write_text("{}")
    with pytest.raises(FormatError, match=r"e\.json"):
        surroundings_flux(tmp_path / "e.json", OCTAHEDRON)


def test_a_grey_picture_is_light_too(tmp_path):
    found = flux(tmp_path, np.ones((8, 16)), OCTAHEDRON)
    assert found.sum() == pytest.approx(4 * np.pi)
