"""Sums are found among any patterns, and their fit tells which part was exposed otherwise."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.checks.photo_measures import BAYER, measure_counts
from lightstage.checks.sharpness import own_sharpness, sharpness
from lightstage.checks.subject_motion import sum_shift
from lightstage.checks.sums import find_sums, fit_sum
from lightstage.patterns import pattern_levels
from lightstage.rig import default_rig

NAMES = ["full", "x+", "x-", "y+", "y-", "z+", "z-", "dark", "lin-z+", "lin-z-", "olat-003"]


def photo(light, scale=1.0, noise=0.0, seed=0):
    """Measures of a picture (h, w) without colour."""
    rng = np.random.default_rng(seed)
    counts = (scale * (light + noise * rng.normal(size=light.shape))).astype(np.float32)
    size = light.shape[1], light.shape[0]
    return measure_counts(counts, BAYER, 0.0, np.inf, size, "linear", Path("p"), 64, scale)


def blob(seed, shape=(128, 96), finest=6.0):
    """A smooth, positive picture on a black ground."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: shape[0], : shape[1]]
    out = np.zeros(shape)
    for _ in range(12):
        cx, cy = rng.uniform(0.3, 0.7, 2) * (shape[1], shape[0])
        size = rng.uniform(finest, 4 * finest)
        out += rng.random() * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * size**2))
    return out / out.max()


def test_sums_are_found_by_levels_and_not_across_polarisers():
    rig = default_rig()
    names = [*NAMES, *(f"{name}@{kind}" for name in NAMES[:3] for kind in ("parallel", "cross"))]
    found = {str(one) for one in find_sums({name: pattern_levels(name, rig) for name in names})}
    plain = {"x+ + x- = full", "y+ + y- = full", "z+ + z- = full", "lin-z+ + lin-z- = full"}
    polarised = {f"x+@{k} + x-@{k} = full@{k}" for k in ("parallel", "cross")}
    assert found == plain | polarised


def test_a_thousand_single_lights_and_their_sums():
    levels = {f"olat-{k}": np.eye(168)[k % 168] * (0.5 + k / 2000) for k in range(1000)}
    levels |= {"pair": levels["olat-5"] + levels["olat-11"], "none": np.zeros(168)}
    assert [str(one) for one in find_sums(levels)] == ["olat-5 + olat-11 = pair"]


@settings(max_examples=30)
@given(
    first=st.floats(0.2, 5.0),
    second=st.floats(0.2, 5.0),
    scale=st.sampled_from([1e-6, 1.0, 1e6]),
    seed=st.integers(0, 99),
)
def test_gains_of_both_parts_are_recovered_as_by_plain_least_squares(first, second, scale, seed):
    a, b = blob(seed), blob(seed + 1000)
    parts = photo(first * a, scale), photo(second * b, scale)
    whole = photo(a + b, scale)
    fit = fit_sum(*parts, whole)
    assert fit is not None
    np.testing.assert_allclose(fit.gains, [1 / first, 1 / second], rtol=1e-3)
    assert fit.misfit < 1e-3
    design = np.stack([part.coarse[..., 1].ravel().astype(float) for part in parts], axis=1)
    twin = np.linalg.lstsq(design, whole.coarse[..., 1].ravel().astype(float), rcond=None)[0]
    np.testing.assert_allclose(fit.gains, twin, rtol=1e-3)


def test_another_picture_is_a_misfit_and_no_gain_explains_it():
    a, b, other = blob(1), blob(2), blob(3)
    good = fit_sum(photo(a), photo(b), photo(a + b))
    bad = fit_sum(photo(other), photo(b), photo(a + b))
    assert good is not None
    assert bad is not None
    assert good.misfit < 1e-6 < 0.03 < bad.misfit


def test_light_without_a_lamp_is_reported_as_a_share_and_known_dark_is_taken_off():
    a, b = blob(1), blob(2)
    room = 0.03 * (a + b)
    fit = fit_sum(photo(a + room), photo(b + room), photo(a + b + room))
    assert fit is not None
    np.testing.assert_allclose(fit.ambient, 0.03 / 1.03, rtol=0.02)
    dark = photo(room).coarse
    again = fit_sum(photo(a + room), photo(b + room), photo(a + b + room), dark)
    assert again is not None
    np.testing.assert_allclose(again.ambient, 0, atol=1e-5)
    np.testing.assert_allclose(again.gains, 1, atol=1e-5)


@pytest.mark.parametrize("shape", [(8, 8), (40, 8)])
def test_pictures_with_nothing_to_compare_give_none(shape):
    black = photo(np.zeros(shape))
    assert fit_sum(black, black, black) is None
    assert sum_shift(black, black, black) is None
    assert own_sharpness(black) is None
    assert fit_sum(photo(blob(1)), black, photo(blob(1))) is None


@settings(max_examples=20)
@given(x=st.floats(-6, 6), y=st.floats(-6, 6), scale=st.sampled_from([1e-6, 1.0, 1e6]))
def test_a_parts_shift_is_recovered_in_pixels(x, y, scale):
    a, b = blob(4), blob(5)
    rows, columns = np.fft.fftfreq(a.shape[0])[:, None], np.fft.fftfreq(a.shape[1])
    turn = np.exp(-2j * np.pi * (rows * y + columns * x))
    moved = np.real(np.fft.ifft2(np.fft.fft2(a) * turn))
    shift = sum_shift(photo(moved, scale), photo(b, scale), photo(a + b, scale))
    assert shift is not None
    np.testing.assert_allclose(shift.first_px, [x, y], atol=0.3)
    np.testing.assert_allclose(shift.second_px, 0, atol=0.3)


def test_sharpness_falls_with_blur_whatever_the_light():
    import cv2

    rng = np.random.default_rng(0)
    skin = 1 + 0.2 * cv2.GaussianBlur(rng.normal(size=(256, 192)), (0, 0), 1.5)
    frontal, side = skin * (0.2 + blob(1, (256, 192), 20)), skin * (0.2 + blob(2, (256, 192), 20))
    noise = 1e-3
    reference = photo(frontal, noise=noise)
    seen = [
        sharpness(photo(cv2.GaussianBlur(side, (0, 0), sigma), noise=noise, seed=1), reference)
        for sigma in (0.01, 1.5, 3.0, 6.0)
    ]
    assert None not in seen
    assert seen[0] == pytest.approx(1.0, abs=0.1)
    assert seen[0] > 1.2 * seen[1] > 1.2 * seen[2]
    assert seen[2] < 0.6
