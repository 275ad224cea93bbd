"""Noise from the photographs, and what it does to confidence."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.refinement.config import RefineConfig
from processing.refinement.finish import limits_of
from processing.refinement.joint import Noise
from processing.refinement.noise import measured_noise, times_as_noisy
from tests.processing.lit_ball import PATTERNS

ASSUMED = Noise(sensor=0.001, model=0.003, shade=0.01)


def readings(sensor: float, floor: float, count: int = 20_000, bright: float = 0.8) -> np.ndarray:
    """(n, P, 3) of a face whose gradients sum to `full`, with noise."""
    rng = np.random.default_rng(1)
    rgb = np.zeros((count, len(PATTERNS), 3))
    rgb[:, 0] = rng.uniform(0.02, bright, (count, 3))
    for k in (1, 3, 5):
        share = rng.uniform(size=(count, 1))
        rgb[:, k], rgb[:, k + 1] = rgb[:, 0] * share, rgb[:, 0] * (1 - share)
    noise = sensor * np.sqrt(floor + rgb) * rng.normal(size=rgb.shape)
    return np.asarray(rgb + noise, np.float32)


@pytest.mark.parametrize(
    ("sensor", "floor"), [(0.001, 0.25), (0.008, 0.02), (0.0005, 8.0), (0.004, 0.25)]
)
@pytest.mark.parametrize("bright", [0.8, 0.15])
def test_the_noise_that_was_put_in_comes_out(sensor: float, floor: float, bright: float) -> None:
    found, measured = measured_noise(
        [readings(sensor, floor, bright=bright)], PATTERNS, [PATTERNS], ASSUMED
    )
    assert measured
    level = np.array([0.05, bright / 2, bright])
    known = sensor * np.sqrt(floor + level)
    np.testing.assert_allclose(found.sensor * np.sqrt(found.floor + level), known, rtol=0.08)
    assert (found.model, found.shade) == (ASSUMED.model, ASSUMED.shade)


def test_motion_at_some_edges_is_no_noise() -> None:
    rgb = readings(0.001, 0.25)
    rgb[::10, 1] += 0.2
    found, _ = measured_noise([rgb], PATTERNS, [PATTERNS], ASSUMED)
    assert found.sensor * np.sqrt(found.floor + 0.4) == pytest.approx(0.00081, rel=0.25)


def test_pictures_made_of_others_show_no_noise() -> None:
    rgb = readings(0.005, 0.25)
    for k in (2, 4, 6):
        rgb[:, k] = rgb[:, 0] - rgb[:, k - 1]
    found, measured = measured_noise([rgb], PATTERNS, [("full", "x+", "y+", "z+")], ASSUMED)
    assert not measured
    assert found == ASSUMED
    # Of another view all were photographed: its own count, these do not.
    whole = readings(0.005, 0.25)
    owns = [("full", "x+", "y+", "z+"), PATTERNS]
    assert measured_noise([rgb, whole], PATTERNS, owns, ASSUMED) == measured_noise(
        [whole], PATTERNS, [PATTERNS], ASSUMED
    )
    assert measured_noise([rgb[:, 1:]], PATTERNS[1:], [PATTERNS], ASSUMED) == (ASSUMED, False)


def test_a_face_without_noise_is_given_what_rounding_leaves() -> None:
    found, measured = measured_noise([readings(0.0, 0.25)], PATTERNS, [PATTERNS], ASSUMED)
    assert measured
    assert 0 < found.sensor * np.sqrt(found.floor + 0.4) < 0.001


def test_noise_is_compared_by_the_variance_of_a_typical_reading() -> None:
    louder = dataclasses.replace(ASSUMED, sensor=0.01)
    assert times_as_noisy(ASSUMED, ASSUMED) == pytest.approx(1)
    assert 20 < times_as_noisy(louder, ASSUMED) < 100


def test_normals_of_noisy_chroma_lean_on_all_readings_however_the_noise_is_known() -> None:
    config = RefineConfig()
    measured = limits_of(config, doubt=1.0, noisier=16.0).apart2
    residuals_showed = limits_of(config, doubt=16.0, noisier=1.0).apart2
    # Where noise was measured, what it turns chroma's normals by is told 16 times as large.
    assert measured / 16 == pytest.approx(residuals_showed, rel=1e-6)


@given(
    values=st.lists(
        st.floats(-(2.0**99), 2.0**99, width=32)
        | st.sampled_from([0.0, 1e-30, 1e30, np.nan, np.inf, -np.inf]),
        min_size=21,
        max_size=21,
    ),
    share=st.floats(0, 1),
)
@settings(max_examples=40, deadline=None)
def test_whatever_is_read_noise_is_a_number_above_zero(values: list[float], share: float) -> None:
    rgb = readings(0.001, 0.25, 2000)
    rgb[: int(share * len(rgb))] = np.array(values, np.float32).reshape(7, 3)
    with np.errstate(all="ignore"):
        found, _ = measured_noise([rgb], PATTERNS, [PATTERNS], ASSUMED)
    assert np.isfinite(found.sensor)
    assert np.isfinite(found.floor)
    assert found.sensor > 0
    assert found.floor > 0
