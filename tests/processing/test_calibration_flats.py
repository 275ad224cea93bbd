"""Flats and darks of made-up cameras whose vignetting, black and hot pixels are known."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from lightstage.errors import FormatError
from lightstage.formats.flats import FlatField, read_flats, write_flats
from lightstage.formats.orientation import OF_TIFF
from lightstage.rig import default_rig
from processing.calibration.colour.config import FlatConfig
from processing.calibration.colour.flats import fit_flat, read_darks
from processing.calibration.picture import Mosaic, flattened
from processing.errors import ProcessingError

WIDTH, HEIGHT = 480, 320
CAMERA = dataclasses.replace(
    default_rig().cameras[0], width_px=WIDTH, height_px=HEIGHT, cx_px=251.0, cy_px=152.0
)
CHANNELS = np.array([[0, 1], [1, 2]])
TRUE = dataclasses.replace(FlatField.even(CAMERA), radial=np.array([-0.3, -0.12, 0.05]))


def mosaic(level, clipped=None):
    cut = np.zeros(level.shape, bool) if clipped is None else clipped
    return Mosaic(level.astype(np.float32), cut, CHANNELS, None)


def card(slope=(0.0, 0.0), light=(0.3, 0.6, 0.4), seed=0, noise=0.002, gain=1.0):
    """An uneven card through the lens: (h, w) levels."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    x, y = (columns - 240) / 300, (rows - 160) / 300
    share = TRUE.share(np.stack([columns.ravel(), rows.ravel()], 1) + 0.5).reshape(HEIGHT, WIDTH)
    colour = np.array(light)[np.tile(CHANNELS, (HEIGHT // 2, WIDTH // 2))]
    level = colour * (1 + slope[0] * x + slope[1] * y) * share * gain
    return level * (1 + noise * np.random.default_rng(seed).standard_normal(level.shape))


@pytest.mark.parametrize("slope", [(0.0, 0.0), (0.3, -0.2)])
def test_vignetting_is_the_lens_s_alone_however_the_card_is_lit(slope):
    flats = [mosaic(card(slope)), mosaic(card((-slope[1], slope[0]), (0.2, 0.5, 0.5), seed=1))]
    field, facts = fit_flat(flats, CAMERA, FlatConfig(), "flat")
    off = field.gain((HEIGHT, WIDTH)) / TRUE.gain((HEIGHT, WIDTH)) - 1
    assert TRUE.gain((HEIGHT, WIDTH)).max() > 1.5
    assert np.abs(off).max() < 0.004
    assert facts["residual_rms"] < 0.0005
    assert facts["light_at_the_corner"] == pytest.approx(TRUE.share(np.zeros((1, 2)))[0], abs=0.004)


def test_each_pixel_s_own_gain_is_found_where_it_is_asked_for():
    own = 1 + 0.02 * np.random.default_rng(7).standard_normal((HEIGHT, WIDTH))
    own[40:50, 60:70] *= 0.9  # dust
    flats = [mosaic(card((0.1, 0.0), seed=k, gain=own)) for k in range(4)]
    field, facts = fit_flat(flats, CAMERA, FlatConfig(per_pixel=True), "flat")
    off = field.gain((HEIGHT, WIDTH)) * own / TRUE.gain((HEIGHT, WIDTH)) - 1
    assert off.std() < 0.002
    assert facts["per_pixel_rms"] == pytest.approx(0.02, rel=0.2)
    plain, _ = fit_flat(flats, CAMERA, FlatConfig(), "flat")
    assert plain.per_pixel is None


@pytest.mark.parametrize(
    ("level", "message"),
    [(np.full((HEIGHT, WIDTH), 0.001), "its mean at 0.1 % of white"), (card()[:300], "480 x 300")],
)
def test_a_flat_that_will_not_do_is_refused(level, message):
    with pytest.raises(ProcessingError, match=message):
        fit_flat([mosaic(level)], CAMERA, FlatConfig(), "flat, cam0")
    clipped = np.zeros((HEIGHT, WIDTH), bool)
    clipped[:30] = True
    with pytest.raises(ProcessingError, match=r"9\.38 % of the card at the white level"):
        fit_flat([mosaic(card(), clipped)], CAMERA, FlatConfig(), "flat, cam0")


def test_a_shadow_over_half_the_card_is_no_lens():
    shadow = card()
    shadow[:, :200] *= 0.02
    shadow[:90] *= 0.02
    with pytest.raises(ProcessingError, match=r"between 0\.1 and 3"):
        fit_flat([mosaic(shadow)], CAMERA, FlatConfig(), "flat, cam0")


def dark(seed, offset=(0.0, 0.0, 0.0, 0.0), hot=()):
    level = 1e-4 * np.random.default_rng(seed).standard_normal((HEIGHT, WIDTH))
    for place, value in enumerate(offset):
        level[place // 2 :: 2, place % 2 :: 2] += value
    for row, column in hot:
        level[row, column] += 0.02
    return mosaic(np.round(level * 15783) / 15783)


def test_black_and_hot_pixels_are_found_and_what_flashed_once_is_not():
    hot = [(3, 4), (100, 201), (319, 479)]
    offset = (5e-4, -2e-4, 0.0, 1e-3)
    darks = [dark(k, offset, [*hot, (50 + k, 60)]) for k in range(4)]
    field, facts = read_darks(darks, FlatField.even(CAMERA), FlatConfig(), "dark")
    np.testing.assert_array_equal(field.hot_pixels, sorted(hot))
    np.testing.assert_allclose(field.black_offset, offset, atol=5e-6)
    assert facts["hot_pixels"] == 3
    assert facts["noise"] == pytest.approx(1e-4, rel=0.1)


@pytest.mark.parametrize("crop", [slice(0, 318), slice(2, None)])
def test_darks_of_another_size_than_the_camera_are_refused(crop):
    """Their hot pixels would be mended at other places."""
    cropped = [mosaic(dark(k).level[crop]) for k in range(3)]
    with pytest.raises(ProcessingError, match=r"dark, cam0: found 480 x 318 .* expected 480 x 320"):
        read_darks(cropped, FlatField.even(CAMERA), FlatConfig(), "dark, cam0")


def test_light_in_a_dark_is_refused():
    with pytest.raises(ProcessingError, match="lens caps"):
        read_darks([mosaic(card())], FlatField.even(CAMERA), FlatConfig(), "dark, cam0")


def test_flats_are_read_as_written_and_a_window_is_part_of_the_whole(tmp_path):
    own = np.random.default_rng(3).uniform(0.9, 1.1, (HEIGHT, WIDTH)).astype(np.float32)
    hot = np.array([[1, 2], [300, 400]])
    field = dataclasses.replace(
        TRUE, per_pixel=own, black_offset=np.array([1e-4, 0, 0, -1e-4]), hot_pixels=hot
    )
    path = write_flats({"cam0": field, "cam1": TRUE}, tmp_path / "flats.json", {})
    found = read_flats(path, ["cam0", "cam1", "cam2"])
    assert set(found) == {"cam0", "cam1"}
    whole = found["cam0"].gain((HEIGHT, WIDTH))
    np.testing.assert_allclose(whole, field.gain((HEIGHT, WIDTH)), rtol=6e-4)  # half floats
    np.testing.assert_array_equal(found["cam0"].gain((50, 70), (33, 44)), whole[33:83, 44:114])
    np.testing.assert_array_equal(found["cam0"].hot_pixels, hot)
    np.testing.assert_array_equal(found["cam0"].black_offset, field.black_offset)
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    twin = 1 / TRUE.share(np.stack([columns.ravel(), rows.ravel()], 1) + 0.5)
    single = found["cam1"].gain((HEIGHT, WIDTH))
    assert single.dtype == np.float32
    np.testing.assert_allclose(single, twin.reshape(HEIGHT, WIDTH), rtol=2e-6)


def test_gains_with_one_changed_byte_are_named(tmp_path):
    own = np.random.default_rng(3).uniform(0.9, 1.1, (HEIGHT, WIDTH)).astype(np.float32)
    field = dataclasses.replace(TRUE, per_pixel=own)
    path = write_flats({"cam0": field}, tmp_path / "flats.json", {})
    (gains,) = tmp_path.glob("*.npz")
    good = gains.read_bytes()
    for place in range(200, 2200, 200):
        gains.write_bytes(good[:place] + bytes([good[place] ^ 0xFF]) + good[place + 1 :])
        with pytest.raises(FormatError, match="cam0"):
            read_flats(path, ["cam0"])


@pytest.mark.parametrize("shape", [(HEIGHT // 2, WIDTH // 2), (WIDTH, HEIGHT), (HEIGHT, WIDTH - 1)])
def test_gains_of_another_size_are_named_and_not_laid_over_a_corner(tmp_path, shape):
    field = dataclasses.replace(TRUE, per_pixel=np.full(shape, 1.5, np.float32))
    path = write_flats({"cam0": field}, tmp_path / "flats.json", {})
    with pytest.raises(FormatError, match="no usable flat of cam0"):
        read_flats(path, ["cam0"])


@pytest.mark.parametrize(
    "change",
    [
        {"radial": [0.1, 0.2]},
        {"radial": [0.1, None, 0]},
        {"radial": [-1.2, 0, 0]},
        {"radial": [-4.0, 4.0, 0]},
        {"radius_px": 0},
        {"hot_pixels": [[HEIGHT, 0]]},
        {"black_offset": [1, 2, 3]},
        {"per_pixel": "flats-cam7.npz"},
        {"centre_px": None},
    ],
)
def test_an_unusable_flat_is_named(tmp_path, change):
    path = write_flats({"cam0": TRUE, "cam1": TRUE}, tmp_path / "flats.json", {})
    value = json.loads(path.read_text())
    value["cameras"]["cam1"] |= change
    path.write_text(json.dumps(value))
    assert set(read_flats(path, ["cam0"])) == {"cam0"}
    with pytest.raises(FormatError, match="no usable flat of cam1"):
        read_flats(path, ["cam0", "cam1"])


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_camera_on_its_side_has_its_flat_where_the_sensor_reads_it(orientation):
    """Pictures are upright as in rig.json; what belongs to pixels belongs to the sensor's."""
    read = mosaic(card(noise=0.0))
    upright = read.upright(OF_TIFF[orientation])
    height, width = upright.level.shape
    x, y = {
        1: (251, 152),
        2: (WIDTH - 251, 152),
        3: (WIDTH - 251, HEIGHT - 152),
        4: (251, HEIGHT - 152),
        5: (152, 251),
        6: (HEIGHT - 152, 251),
        7: (HEIGHT - 152, WIDTH - 251),
        8: (152, WIDTH - 251),
    }[orientation]
    camera = dataclasses.replace(CAMERA, width_px=width, height_px=height, cx_px=x, cy_px=y)
    field, _ = fit_flat([upright], camera, FlatConfig(), "flat")
    np.testing.assert_allclose(field.centre_px, [251, 152])
    np.testing.assert_allclose(field.radial, TRUE.radial, atol=0.005)
    darks = [dark(0, (1e-3, 0, 0, 0), [(7, 9)]).upright(OF_TIFF[orientation])]
    field, _ = read_darks(darks, field, FlatConfig(), "dark")
    np.testing.assert_array_equal(field.hot_pixels, [(7, 9)])
    even = flattened(upright, dataclasses.replace(field, black_offset=None)).cells()
    np.testing.assert_allclose(even / even.mean(axis=(0, 1)), 1, atol=0.002)


@pytest.mark.parametrize("orientation", [1, 6])
def test_hot_pixels_are_mended_where_chart_and_balls_are_read(orientation):
    """One alone, one in a corner, and two that are neighbours of one colour."""
    plain = mosaic(card(noise=0.0))
    hot = np.array([(7, 9), (0, 0), (100, 101), (102, 101)])
    level, clipped = plain.level.copy(), plain.clipped.copy()
    level[tuple(hot.T)] = 1
    clipped[tuple(hot.T)] = True
    clipped[40:60, 40:60] = True
    hot = np.vstack([hot, [(50, 50)]])
    field = dataclasses.replace(FlatField.even(CAMERA), hot_pixels=hot)
    bad = dataclasses.replace(plain, level=level, clipped=clipped).upright(OF_TIFF[orientation])
    made = flattened(bad, field).as_read()
    np.testing.assert_allclose(made.level, plain.level, rtol=0.02)
    np.testing.assert_array_equal(np.argwhere(made.clipped).min(axis=0), (40, 40))
    np.testing.assert_array_equal(np.argwhere(made.clipped).max(axis=0), (59, 59))
    assert made.clipped[50, 50]
