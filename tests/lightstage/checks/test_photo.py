"""One photograph's measures: what the sensor did, and what cannot be measured."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.checks.noise import fit_noise
from lightstage.checks.photo_measures import BAYER, measure_counts, measure_photo
from lightstage.errors import FormatError
from lightstage.formats.exr import write_exr
from sim.camera.dng import Exif, dng_bytes
from sim.camera.sensor import SensorConfig, make_sensor

EXIF = Exif("Nikon DSC D750", "6012345", 16.0, 105.0)


def wedge(height=200, width=300):
    """(h, w, 3) light in steps along the rows: cells of many levels, each without detail."""
    ramp = (np.arange(width, dtype=np.float32) // 24 / (width // 24)) ** 2
    return np.repeat(np.broadcast_to(ramp[None, :, None], (height, width, 1)), 3, axis=2)


def measured(counts, config, thumbnail_px=40):
    span = float(config.white_dn - config.black_dn)
    size = counts.shape[1], counts.shape[0]
    black, white = float(config.black_dn), float(config.white_dn)
    return measure_counts(counts, BAYER, black, white, size, "raw", Path("w"), thumbnail_px, span)


@pytest.mark.parametrize("iso", [100, 800, 6400])
def test_noise_of_the_sensor_is_recovered_from_one_photograph(iso):
    config = SensorConfig(iso=iso, headroom=0.8)
    sensor = make_sensor(config, np.ones(3), np.random.default_rng(1))
    photo = measured(sensor.expose(wedge(), np.random.default_rng(2)), config)
    span = config.white_dn - config.black_dn
    dark = ((config.noise_e / config.gain_e_per_dn) ** 2 + 1 / 12) / span**2
    slope = 1 / (config.gain_e_per_dn * span)
    level = 0.3
    wanted = np.sqrt(dark + slope * level)
    assert np.sqrt(photo.noise[0] + photo.noise[1] * level) == pytest.approx(wanted, rel=0.15)
    assert photo.noise[0] == pytest.approx(dark, rel=0.5)


def test_detail_does_not_count_as_noise():
    config = SensorConfig()
    sensor = make_sensor(config, np.ones(3), np.random.default_rng(1))
    light = wedge()
    light[::3, ::2] *= 0.5  # hair, say, on the upper half
    light[100:] = wedge()[100:]
    photo = measured(sensor.expose(light, np.random.default_rng(2)), config)
    wanted = 1 / (config.gain_e_per_dn * (config.white_dn - config.black_dn))
    assert photo.noise[1] == pytest.approx(wanted, rel=0.3)


def test_clipped_pixels_are_counted_where_the_subject_is_lit():
    counts = np.full((200, 300), 700, np.uint16)
    counts[:, 200:] = 9000
    counts[:100:2, 200::2] = 16383  # half of the lit red ones
    photo = measured(counts, SensorConfig())
    assert photo.clipped[0] == pytest.approx(0.5, abs=0.03)
    assert photo.clipped[1] == photo.clipped[2] == 0
    assert photo.clipped_all == pytest.approx(0.5 * 0.25 / 3, abs=0.003)


def test_a_sensor_that_is_full_before_white_is_seen_by_its_pile():
    rng = np.random.default_rng(0)
    counts = np.minimum(rng.normal(14000, 3000, (200, 300)), 15300).clip(600).astype(np.uint16)
    photo = measured(counts, SensorConfig())
    assert photo.clipped.min() > 0.2
    free = rng.normal(12000, 500, (200, 300)).astype(np.uint16)
    assert measured(free, SensorConfig()).clipped.max() == 0


def test_a_dng_is_measured_as_its_counts(tmp_path):
    config = SensorConfig()
    sensor = make_sensor(config, np.ones(3), np.random.default_rng(1))
    counts = sensor.expose(wedge(), np.random.default_rng(2))
    path = tmp_path / "a.dng"
    path.write_bytes(dng_bytes(counts, sensor, EXIF))
    ours, known = measure_photo(path, 40), measured(counts, config)
    assert ours.encoding == "raw"
    assert ours.size_px == (300, 200)
    np.testing.assert_array_equal(ours.light, known.light)
    assert ours.digest == known.digest


def test_a_linear_picture_keeps_its_colours_and_scale(tmp_path):
    image = np.broadcast_to(np.array([0.5, 0.25, 0.125], np.float32), (64, 48, 3))
    photo = measure_photo(write_exr(tmp_path / "a.exr", image), 16)
    assert photo.encoding == "linear"
    np.testing.assert_allclose(photo.light, np.broadcast_to(image[0, 0], photo.light.shape))
    assert (photo.snr, photo.clipped.max(), photo.wild) == (np.inf, 0, 0)


@pytest.mark.parametrize("data", [b"", b"\xff\xd8\xff\xe0" * 9, b"II*\0" + bytes(400)])
def test_what_is_no_photograph_is_refused(tmp_path, data):
    path = tmp_path / "a.dng"
    path.write_bytes(data)
    with pytest.raises(FormatError, match=r"a camera RAW, a DNG or an OpenEXR"):
        measure_photo(path)
    with pytest.raises(FormatError, match="No such file"):
        measure_photo(tmp_path / "none.dng")
    with pytest.raises(FormatError, match="1 x 1 pixels, expected a photograph"):
        measure_photo(write_exr(tmp_path / "one.exr", np.ones((1, 1, 3))))


@settings(max_examples=60)
@given(
    start=st.floats(0, 1e3),
    slope=st.floats(1e-3, 1e3),
    scale=st.sampled_from([1e-6, 1.0, 1e6]),
    seed=st.integers(0, 999),
)
def test_the_noise_line_is_found_below_any_detail(start, slope, scale, seed):
    rng = np.random.default_rng(seed)
    level = scale * rng.random(400)
    variance = start + slope * level / scale
    variance[:100] *= rng.uniform(2, 50, 100)  # cells with detail
    line = fit_noise(level, variance)
    np.testing.assert_allclose(line[0] + line[1] * level[100:], variance[100:], rtol=0.05)


def test_nothing_finite_has_no_noise():
    assert fit_noise(np.full(5, np.nan), np.ones(5)).tolist() == [0, 0]
    assert fit_noise(np.zeros((3, 3)), np.zeros((3, 3))).tolist() == [0, 0]
