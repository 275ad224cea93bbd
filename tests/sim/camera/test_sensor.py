"""The simulated sensor and its DNG files, read back by LibRaw."""

from __future__ import annotations

import dataclasses
import io

import numba
import numpy as np
import pytest
import rawpy
import scipy.stats
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.camera.chart import CHART_SRGB, calibrate_colour
from sim.camera.dng import LINEAR_FROM_XYZ, Exif, dng_bytes
from sim.camera.noise import count_kernel
from sim.camera.sensor import Sensor, SensorConfig, make_sensor
from sim.errors import SimError

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


def test_libraw_reads_what_the_camera_wrote(sensor):
    mosaic = np.full((54, 36), 700, np.uint16)
    with rawpy.imread(io.BytesIO(dng_bytes(mosaic, sensor, EXIF))) as raw:
        assert raw.other.iso_speed == sensor.config.iso
        assert raw.other.shutter_speed == pytest.approx(sensor.exposure_s, rel=1e-5)
        assert raw.other.aperture == pytest.approx(16.0)
        assert raw.other.focal_length == pytest.approx(105.0)
        assert raw.other.timestamp.isoformat() == "2000-01-01T12:00:00"
        assert raw.other.artist == ""


def test_libraw_takes_the_colour_matrix_as_camera_to_srgb(sensor):
    """LibRaw keeps no `rgb_xyz_matrix` of a DNG; it makes `color_matrix` of ColorMatrix1."""
    mosaic = np.full((54, 36), 700, np.uint16)
    camera = sensor.raw_from_linear
    known = np.linalg.inv(camera / camera.sum(axis=1, keepdims=True))
    with rawpy.imread(io.BytesIO(dng_bytes(mosaic, sensor, EXIF))) as raw:
        np.testing.assert_allclose(raw.color_matrix[:, :3], known, atol=5e-4)


def test_libraw_develops_a_colour_to_what_it_was(sensor):
    """White balance and colour matrix together, through LibRaw's own development."""
    colour = np.array([0.30, 0.18, 0.10])
    mosaic = sensor.expose(flat(colour), np.random.default_rng(16))
    with rawpy.imread(io.BytesIO(dng_bytes(mosaic, sensor, EXIF))) as raw:
        developed = raw.postprocess(
            gamma=(1, 1), no_auto_bright=True, use_camera_wb=True, output_bps=16, half_size=True
        )
    found = developed[20:-20, 20:-20].mean(axis=(0, 1))
    np.testing.assert_allclose(found / found[1], colour / colour[1], rtol=0.01)


def test_the_file_is_a_tiff_to_another_reader_and_states_no_name_or_place(sensor):
    mosaic = np.random.default_rng(17).integers(0, 16384, (54, 36)).astype(np.uint16)
    with tifffile.TiffFile(io.BytesIO(dng_bytes(mosaic, sensor, EXIF))) as file:
        page = file.pages[0]
        np.testing.assert_array_equal(page.asarray(), mosaic)
        tags = {tag.name: tag.value for tag in page.tags.values()}
        matrix = np.array(tags["ColorMatrix1"]).reshape(9, 2)
        exif = tags["ExifTag"]
    known = sensor.raw_from_linear @ LINEAR_FROM_XYZ
    np.testing.assert_allclose(
        (matrix[:, 0] / matrix[:, 1]).reshape(3, 3), known / np.abs(known).max(), atol=2e-6
    )
    assert (tags["Make"], tags["Model"]) == ("Nikon", "Nikon DSC D750")
    assert tags["CameraSerialNumber"] == exif["BodySerialNumber"] == "6012345"
    assert exif["FNumber"] == (16, 1)
    assert exif["ISOSpeedRatings"] == 100
    assert exif["DateTimeOriginal"] == "2000:01:01 12:00:00"
    assert not {"GPSTag", "Artist", "Copyright", "CameraOwnerName"} & (set(tags) | set(exif))


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


def drawn(mean: float, count: int, noise_e: float = 0.0) -> np.ndarray:
    """Electrons of many pixels of one mean."""
    light = np.full((count // 100, 100, 3), mean, np.float32)
    out, bad = np.empty(light.shape[:2], np.uint16), np.zeros(len(light), np.int64)
    third = np.full((3, 3), 1 / 3)
    count_kernel(light, third, 1e9, noise_e, 1.0, 0.0, 65535.0, np.uint64(9), out, bad)
    return out.ravel().astype(float)


@pytest.mark.parametrize("mean", [0.2, 1.0, 9.5, 10.5, 40.0, 900.0])
def test_photons_are_distributed_as_poisson_says(mean):
    """The whole distribution, against scipy's: a chi-square of all bins with enough counts."""
    found = drawn(mean, 200_000)
    edges = np.unique(scipy.stats.poisson.ppf(np.linspace(0.005, 0.995, 25), mean))
    share = np.diff(np.concatenate([[0.0], scipy.stats.poisson.cdf(edges, mean), [1.0]]))
    seen = np.bincount(np.searchsorted(edges, found), minlength=len(share))
    keep = share > 1e-4
    chance = scipy.stats.chisquare(
        seen[keep], share[keep] / share[keep].sum() * seen[keep].sum()
    ).pvalue
    assert chance > 1e-3


@pytest.mark.parametrize("mean", [30_000.0, 60_000.0])
def test_bright_photons_have_poissons_mean_variance_and_skew(mean):
    found = drawn(mean, 400_000)
    count = len(found)
    assert found.mean() == pytest.approx(mean, abs=5 * np.sqrt(mean / count))
    assert found.var() == pytest.approx(mean, rel=5 * np.sqrt(2 / count))
    assert scipy.stats.skew(found) == pytest.approx(mean**-0.5, abs=5 * np.sqrt(6 / count))


@pytest.mark.parametrize("iso", [100, 800, 6400])
def test_variance_against_mean_is_the_line_of_gain_and_read_noise(iso):
    """The photon transfer: slope 1 / gain, intercept the read noise and a count's rounding."""
    config = SensorConfig(iso=iso)
    made = make_sensor(config, PEAK, np.random.default_rng(1))
    rng = np.random.default_rng(10)
    means, variances = [], []
    for share in np.linspace(0.0, 0.8, 9):
        plane = planes(made.expose(flat(share * PEAK, 400), rng))[1].astype(float)
        means.append(plane.mean() - config.black_dn)
        variances.append(plane.var())
    # A variance's own spread grows with it: weight by its inverse.
    slope, intercept = np.polyfit(means, variances, 1, w=1 / np.array(variances))
    assert slope == pytest.approx(1 / config.gain_e_per_dn, rel=0.02)
    known = (config.noise_e / config.gain_e_per_dn) ** 2 + 1 / 12
    assert intercept == pytest.approx(known, rel=0.03)


def test_higher_iso_takes_a_shorter_exposure_and_has_more_noise():
    low, high = (
        make_sensor(SensorConfig(iso=iso), PEAK, np.random.default_rng(1)) for iso in (100, 1600)
    )
    assert high.exposure_s == pytest.approx(low.exposure_s / 16)
    pictures = [s.expose(flat(PEAK / 2), np.random.default_rng(2)) for s in (low, high)]
    assert planes(pictures[0])[1].mean() == pytest.approx(planes(pictures[1])[1].mean(), rel=2e-3)
    assert planes(pictures[1])[1].std() > 3.5 * planes(pictures[0])[1].std()
    assert high.config.noise_e < low.config.noise_e


def test_pixels_at_the_white_level_are_a_cut_normal_distribution(sensor):
    """At a mean of white itself half of the pixels clip; the rest keep their side of the bell."""
    config = sensor.config
    at_white = np.ones(3) / sensor.raw_from_linear[1].sum()
    counts = planes(sensor.expose(flat(at_white, 800), np.random.default_rng(11)))[1].astype(float)
    electrons = (config.white_dn - config.black_dn) * config.gain_e_per_dn
    sigma = np.sqrt(electrons + config.noise_e**2) / config.gain_e_per_dn
    assert (counts == config.white_dn).mean() == pytest.approx(0.5, abs=0.02)
    assert counts.mean() == pytest.approx(config.white_dn - sigma / np.sqrt(2 * np.pi), rel=2e-5)
    cut = np.minimum(scipy.stats.norm.ppf((np.arange(20_000) + 0.5) / 20_000), 0.0)
    assert scipy.stats.skew(counts, axis=None) == pytest.approx(scipy.stats.skew(cut), rel=0.03)


def test_a_full_well_clips_below_the_white_level(sensor):
    config = dataclasses.replace(sensor.config, full_well_e=20_000.0)
    small = dataclasses.replace(sensor, config=config)
    counts = small.expose(flat(PEAK), np.random.default_rng(12)).astype(float)
    assert planes(counts)[1].mean() == pytest.approx(config.black_dn + 4000, rel=1e-4)
    assert planes(counts)[1].std() == pytest.approx(config.noise_e / 5, rel=0.03)


def test_counts_do_not_depend_on_the_number_of_threads(sensor):
    light = np.random.default_rng(13).random((64, 48, 3)).astype(np.float32)
    before = numba.get_num_threads()
    pictures = []
    for threads in (1, min(2, before)):
        numba.set_num_threads(threads)
        pictures.append(sensor.expose(light, np.random.default_rng(14)))
    numba.set_num_threads(before)
    np.testing.assert_array_equal(pictures[0], pictures[1])


def test_light_that_is_no_number_is_refused_endless_light_clips_and_less_than_none_is_dark(sensor):
    rng = np.random.default_rng(15)
    broken = flat([0.1, 0.1, 0.1]).copy()
    broken[3, 4, 1] = np.nan
    with pytest.raises(SimError, match="row 3: found 1 NaN pixel,"):
        sensor.expose(broken, rng)
    assert sensor.expose(flat([np.inf] * 3), rng).min() == sensor.config.white_dn
    assert sensor.expose(flat([0, np.inf, 0]), rng).min() == sensor.config.white_dn
    dark = sensor.expose(flat([-np.inf, -1e30, -1]), rng)
    assert dark.mean() == pytest.approx(sensor.config.black_dn, abs=0.05)
    with pytest.raises(SimError, match=r"\(h, w, 3\)"):
        sensor.expose(np.zeros((4, 4), np.float32), rng)


@settings(max_examples=40, deadline=None)
@given(st.floats(-1e30, 1e30), st.floats(1e-6, 1e6), st.sampled_from([100, 3200, 102400]))
def test_counts_never_leave_the_sensor_range(first, second, iso):
    made = make_sensor(SensorConfig(iso=iso), PEAK, np.random.default_rng(1))
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
