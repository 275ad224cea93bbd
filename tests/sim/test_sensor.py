"""The simulated sensor and its DNG files, read back by LibRaw."""

from __future__ import annotations

import io

import numpy as np
import pytest
import rawpy
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.chart import CHART_SRGB, calibrate_colour
from sim.dng import Exif, dng_bytes
from sim.sensor import Sensor, SensorConfig, make_sensor

PEAK = np.array([0.9, 0.7, 0.6])
EXIF = Exif("Nikon DSC D750", "6012345", 16.0, 105.0)


@pytest.fixture
def sensor() -> Sensor:
    return make_sensor(SensorConfig(), PEAK, np.random.default_rng(1))


def planes(counts: np.ndarray) -> list[np.ndarray]:
    """R, G, G, B pixels of an RGGB mosaic."""
    return [counts[0::2, 0::2], counts[0::2, 1::2], counts[1::2, 0::2], counts[1::2, 1::2]]


def flat(colour: object, side: int = 200) -> np.ndarray:
    return np.broadcast_to(np.array(colour, np.float32), (side, side, 3))


def test_libraw_reads_exactly_the_counts_written(sensor):
    mosaic = np.random.default_rng(2).integers(0, 16384, (54, 36)).astype(np.uint16)
    with rawpy.imread(io.BytesIO(dng_bytes(mosaic, sensor, EXIF))) as raw:
        np.testing.assert_array_equal(raw.raw_image_visible, mosaic)
        assert raw.black_level_per_channel == [600] * 4
        assert raw.white_level == 16383
        assert "".join("RGBG"[i] for i in raw.raw_pattern.ravel()) == "RGGB"
        gains = np.array(raw.camera_whitebalance[:3])
        np.testing.assert_allclose(gains * sensor.neutral / gains[1], sensor.neutral[1], rtol=1e-3)


def test_darkness_reads_the_black_level_with_its_noise(sensor):
    counts = sensor.expose(flat([0, 0, 0]), np.random.default_rng(3)).astype(float)
    config = sensor.config
    assert counts.mean() == pytest.approx(config.black_dn, abs=0.05)
    # Rounding to whole counts adds 1/12.
    known = np.sqrt((config.noise_e / config.gain_e_per_dn) ** 2 + 1 / 12)
    assert counts.std() == pytest.approx(known, rel=0.02)


def test_counts_are_linear_in_light(sensor):
    rng = np.random.default_rng(4)
    colour = np.array([0.30, 0.25, 0.2])
    span = sensor.config.white_dn - sensor.config.black_dn
    known = sensor.raw_from_linear @ colour * span
    for factor in (0.25, 1.0, 2.0):
        means = [p.mean() - sensor.config.black_dn for p in planes(sensor.expose(
            flat(factor * colour), rng))]  # fmt: skip
        np.testing.assert_allclose(means, factor * known[[0, 1, 1, 2]], rtol=2e-3)


def test_noise_is_that_of_counted_photons(sensor):
    counts = sensor.expose(flat([0.4, 0.4, 0.4], 400), np.random.default_rng(5)).astype(float)
    config = sensor.config
    for plane in planes(counts):
        electrons = (plane.mean() - config.black_dn) * config.gain_e_per_dn
        known = np.sqrt(electrons + config.noise_e**2) / config.gain_e_per_dn
        assert plane.std() == pytest.approx(known, rel=0.02)


def test_brightest_skin_stays_below_white_and_brighter_light_clips(sensor):
    rng = np.random.default_rng(6)
    white = sensor.config.white_dn
    assert sensor.expose(flat(PEAK), rng).max() < white
    assert planes(sensor.expose(flat(1.3 * PEAK), rng))[1].min() == white


@settings(max_examples=40, deadline=None)
@given(st.floats(-1e6, 1e6), st.floats(0, 1e6))
def test_counts_never_leave_the_sensor_range(first, second):
    made = make_sensor(SensorConfig(), PEAK, np.random.default_rng(1))
    counts = made.expose(flat([first, second, 0], 8), np.random.default_rng(7))
    assert counts.dtype == np.uint16
    assert counts.max() <= made.config.white_dn


def test_the_chart_photograph_gives_the_matrix_back(sensor):
    """Noise and clipped patches cost less than half a percent of any chart colour."""
    matrix = calibrate_colour(sensor, np.random.default_rng(8))
    encoded = CHART_SRGB / 255
    chart = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    found = chart @ (matrix @ sensor.raw_from_linear).T
    np.testing.assert_allclose(found, chart, atol=0.004 * chart.max())
    np.testing.assert_allclose(matrix @ sensor.raw_from_linear @ np.ones(3), 1.0, rtol=4e-3)
    exact = np.linalg.inv(sensor.raw_from_linear)
    assert not np.array_equal(matrix, exact)


def test_cameras_differ_a_little_and_share_one_exposure():
    made = [make_sensor(SensorConfig(), PEAK, np.random.default_rng(k)) for k in (1, 2)]
    assert made[0].exposure_s == made[1].exposure_s
    ratio = made[0].raw_from_linear / made[1].raw_from_linear
    assert 1e-4 < np.abs(ratio - 1).max() < 0.08
