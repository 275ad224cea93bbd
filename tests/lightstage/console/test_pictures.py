"""Figures of a photograph: of its counts, not of the cells in which they are shown."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lightstage.checks.photo_measures import full_level
from lightstage.console.pictures import _cells, large
from lightstage.console.showing import look_values
from lightstage.formats.exr import write_exr

BAYER = [[0, 1], [3, 2]]
"""Red, green, green and blue of a quad, as LibRaw numbers them."""


@pytest.mark.parametrize("longest_px", [8, 4, 2])
def test_a_clipped_count_is_one_pixel_of_its_colour_however_large_the_cells_are(
    longest_px: int,
) -> None:
    counts = np.full((16, 16), 500, np.uint16)
    counts[0, 0] = counts[1, 2] = 1000  # a red one and a green one
    black = np.zeros(4, np.float32)
    rgb, full, clipped = _cells(counts, BAYER, b"RGBG", black, 1000.0, longest_px, 8)
    assert rgb.shape == full.shape == (longest_px, longest_px, 3)
    assert full[0, 0, 0]
    assert full.sum() == 2
    np.testing.assert_allclose(clipped, [1 / 64, 1 / 128, 0.0])


def test_a_sensor_that_is_full_before_white_is_clipped_as_the_checks_say() -> None:
    counts = np.full((40, 40), 500, np.uint16)
    counts[:8, :8] = 900
    black = np.zeros(4, np.float32)
    assert full_level(900.0, 64, counts.size, 1000.0) == 900.0
    _, full, clipped = _cells(counts, BAYER, b"RGBG", black, 1000.0, 20, 8)
    np.testing.assert_allclose(clipped, [64 / 1600] * 3)
    assert full[:4, :4].all()
    assert full.sum() == 3 * 16
    # A few bright pixels are no pile.
    counts[:] = 500
    counts[:2, :2] = 900
    assert not _cells(counts, BAYER, b"RGBG", black, 1000.0, 20, 8)[1].any()


def test_a_developed_photograph_is_not_said_to_be_free_of_clipped_pixels(tmp_path: Path) -> None:
    path = write_exr(tmp_path / "white.exr", np.ones((12, 16, 3), np.float32))
    _, facts = large(path, 8)
    assert facts.clipped is None
    text = " ".join(look_values(facts)["sentences"])
    assert "Whether pixels are clipped is not known" in text
    assert "Nothing is clipped" not in text
