"""Colour: sRGB's curve against a library, and what a colour calibration may hold."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.errors import FormatError
from processing.colour import linear_from_srgb, read_colour, srgb_from_linear


def test_srgb_curve_is_that_of_colour_science() -> None:
    colour = pytest.importorskip("colour", reason="needs the extra `reference`")
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
    np.testing.assert_array_equal(read_colour(path, ["a"])["a"], np.eye(3))
    with pytest.raises(FormatError, match="b, c"):
        read_colour(path, ["a", "b", "c"])
