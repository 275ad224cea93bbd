"""Colour: sRGB's curve against a library, and what a colour calibration may hold."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from lightstage.errors import FormatError
from lightstage.formats.srgb import linear_from_srgb
from processing.colour import (
    ColourCorrection,
    read_colour,
    root_terms,
    srgb_from_linear,
)
from processing.colour_difference import colour_science


def test_srgb_curve_is_that_of_colour_science() -> None:
    colour = colour_science()
    values = np.linspace(0, 1, 4097)
    np.testing.assert_allclose(
        srgb_from_linear(values), colour.cctf_encoding(values, function="sRGB"), atol=1e-7
    )


@given(st.floats(0, 1))
def test_srgb_decodes_to_what_was_encoded(value: float) -> None:
    # The standard's two pieces meet within 1e-5.
    assert float(linear_from_srgb(srgb_from_linear(np.array(value)))) == pytest.approx(
        value, abs=1e-5
    )


def test_srgb_clips_what_a_screen_cannot_show() -> None:
    found = srgb_from_linear(np.array([-1.0, 0.0, 1.0, 1e6, np.inf]))
    np.testing.assert_allclose(found, [0, 0, 1, 1, 1], atol=1e-12)


def test_every_unusable_camera_is_named_at_once(tmp_path: Path) -> None:
    path = tmp_path / "colour.json"
    eye = np.eye(3).tolist()
    cameras = {"a": {"linear_from_raw": eye}, "b": {"linear_from_raw": np.zeros((3, 3)).tolist()}}
    path.write_text(json.dumps({"schema": "lightstage.colour/1", "cameras": cameras}))
    np.testing.assert_array_equal(read_colour(path, ["a"])["a"].matrix, np.eye(3))
    with pytest.raises(FormatError, match="b, c"):
        read_colour(path, ["a", "b", "c"])


def test_root_terms_are_those_of_colour_science() -> None:
    colour = colour_science()
    raw = np.random.default_rng(2).uniform(0, 2, (50, 4, 3))
    expected = colour.characterisation.polynomial_expansion_Finlayson2015(raw, 2, True)
    np.testing.assert_allclose(root_terms(raw), expected, atol=1e-14)


@given(
    arrays(np.float64, (5, 3), elements=st.floats(-1e-3, 1)),
    st.sampled_from([1e-6, 1e-3, 1.0, 1e3, 1e6]),
    st.booleans(),
)
def test_a_correction_grows_with_the_light_in_single_as_in_double(
    raw: np.ndarray, scale: float, bent: bool
) -> None:
    rng = np.random.default_rng(5)
    matrix = np.eye(3) + 0.1 * rng.standard_normal((3, 3))
    terms = 0.3 * rng.standard_normal((3, 6)) if bent else None
    colour = ColourCorrection(matrix, terms)
    twin = np.zeros((5, 3))
    for row, (r, g, b) in enumerate(raw):
        p, q, s = (np.sqrt(max(v, 0.0)) for v in (r, g, b))
        twin[row] = colour.coefficients @ np.array([r, g, b, p * q, q * s, p * s])
    tolerance = 1e-12 + 1e-12 * np.abs(twin).max()
    np.testing.assert_allclose(colour.apply(raw), twin, atol=tolerance)
    np.testing.assert_allclose(colour.apply(raw * scale), twin * scale, atol=tolerance * scale)
    np.testing.assert_allclose(
        colour.scaled(scale).apply(raw), twin * scale, atol=tolerance * scale
    )
    single = colour.apply((raw * scale).astype(np.float32))
    assert single.dtype == np.float32
    np.testing.assert_allclose(single, twin * scale, atol=1e-5 * scale)


def test_what_is_no_number_stays_none_and_the_rest_is_untouched() -> None:
    colour = ColourCorrection(np.eye(3), np.full((3, 6), 0.2))
    raw = np.array([[0.1, np.nan, 0.2], [0.1, 0.2, 0.3], [-0.1, 0.0, 0.0]])
    found = colour.apply(raw)
    assert np.isnan(found[0]).all()
    assert np.isfinite(found[1:]).all()


@pytest.mark.parametrize(
    "entry",
    [
        {"root_polynomial": [[1, 0, 0]] * 3},
        {"root_polynomial": [[1, 0, 0]] * 6},
        {"root_polynomial": [[1, 0, 0, 0, 0, float("inf")]] * 3},
        {"exposure": 0},
        {"exposure": "long"},
    ],
)
def test_an_unusable_root_polynomial_or_exposure_is_refused(
    tmp_path: Path, entry: dict[str, object]
) -> None:
    path = tmp_path / "colour.json"
    camera = {"linear_from_raw": np.eye(3).tolist()}
    cameras = {"a": camera, "b": {**camera, **entry}}
    path.write_text(json.dumps({"schema": "lightstage.colour/1", "cameras": cameras}))
    with pytest.raises(
        FormatError, match=r"no usable linear_from_raw for b|cameras\.b\.root_polynomial"
    ):
        read_colour(path, ["a", "b"])
