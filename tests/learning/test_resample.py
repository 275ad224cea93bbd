"""Textures of another size than a network was trained on."""

import numpy as np
import pytest

from learning.errors import MapsError
from learning.resample import resampled_texture


def test_a_texture_of_the_right_size_is_not_touched():
    image = np.random.default_rng(0).random((12, 8, 3)).astype(np.float32)
    found, notes = resampled_texture(image, 12, "t")
    assert found is image
    assert notes == []


@pytest.mark.parametrize("rows", [6, 24, 18, 7])
def test_one_colour_stays_that_colour_up_to_its_border_and_is_reported_to_be_resampled(rows):
    image = np.zeros((12, 8, 3), np.float32)
    image[2:10, 2:6] = (0.5, 0.3, 0.2)
    found, notes = resampled_texture(image, rows, "t")
    assert found.shape == (rows, round(8 * rows / 12), 3)
    seen = found.max(axis=2) > 0
    np.testing.assert_allclose(found[seen], np.tile([[0.5, 0.3, 0.2]], (seen.sum(), 1)), rtol=1e-5)
    assert seen.mean() == pytest.approx(1 / 3, abs=0.15)
    assert notes == [f"resampled from 12 x 8 texels to the {rows} rows the network was trained on"]


def test_half_the_size_is_the_mean_of_what_was_photographed():
    rng = np.random.default_rng(0)
    image = rng.uniform(0.1, 1, (8, 6, 3)).astype(np.float32)
    image[0, 0] = 0
    found, _ = resampled_texture(image, 4, "t")
    blocks = image.astype(float).reshape(4, 2, 3, 2, 3)
    known = blocks.mean(axis=(1, 3))
    known[0, 0] *= 4 / 3
    np.testing.assert_allclose(found, known, rtol=1e-5)


def test_a_texture_with_no_width_left_is_refused():
    with pytest.raises(MapsError, match="found 1000 x 1 texels"):
        resampled_texture(np.ones((1000, 1, 3), np.float32), 8, "t")
