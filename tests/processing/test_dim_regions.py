"""Dark things beside a bright one that are foreground, and dark things that are not."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from processing.dim_regions import background, dim_regions
from processing.masks import foreground

SHAPE = (120, 100)
HEAD, CLOTH = np.s_[10:80, 30:70], np.s_[78:120, 5:95]
BLACK = 0.015
"""Half of the threshold, which is .03 of the face."""


def photograph(cloth: float = BLACK, noise: float = 0.0, seed: int = 0) -> np.ndarray:
    """A head of brightness 1 above cloth that reaches the picture's border."""
    image = np.zeros(SHAPE, np.float32)
    image[CLOTH] = cloth
    image[HEAD] = 1.0
    rng = np.random.default_rng(seed)
    return (image + noise * rng.standard_normal(SHAPE)).astype(np.float32)


@pytest.mark.parametrize("noise", [0.0, 0.0005])
def test_black_cloth_below_a_face_is_foreground(noise: float) -> None:
    mask = foreground(photograph(noise=noise), 0.03)
    expected = photograph() > 0
    assert (mask != expected).mean() < 0.002


def test_bright_skin_that_only_cloth_joins_to_the_face_is_foreground() -> None:
    image = photograph()
    image[100:115, 6:14] = 0.6
    assert foreground(image, 0.03)[100:115, 6:14].all()


def test_cloth_that_the_border_and_the_face_enclose_is_foreground() -> None:
    image = photograph(cloth=0.5)
    image[95:110, 5:40] = BLACK
    image[95:110, :5] = 0.5
    assert foreground(image, 0.03)[95:110, 5:40].all()


@pytest.mark.parametrize(
    ("case", "image"),
    [
        ("no cloth", photograph(cloth=0.0)),
        ("noise", photograph(cloth=0.0, noise=0.004)),
        ("cloth as dark as the noise", photograph(cloth=0.004, noise=0.004)),
        ("scattered light", photograph(0.0) + cv2.GaussianBlur(photograph(0.0), (0, 0), 8) * 0.03),
        ("a lit room", photograph(cloth=0.0) + np.float32(0.02)),
    ],
)
def test_what_is_no_dark_thing_changes_no_mask(case: str, image: np.ndarray) -> None:
    smooth = cv2.medianBlur(image.astype(np.float32), 5)
    level = float(np.percentile(image, 99))
    assert not dim_regions(smooth, smooth > 0.03 * level, 0.03 * level).any(), case


def test_a_dark_thing_apart_from_the_face_and_a_small_one_are_no_foreground() -> None:
    image = photograph(cloth=0.0)
    image[30:60, 2:20] = BLACK
    image[80:85, 40:50] = BLACK
    mask = foreground(image, 0.03)
    assert not mask[30:60, 2:20].any()
    assert mask.sum() <= (image > 0.5).sum() + 20


def test_a_background_is_found_where_cloth_is_most_of_what_is_dark() -> None:
    rng = np.random.default_rng(1)
    room = 0.003 + 0.0005 * rng.standard_normal(3000)
    cloth = 0.02 + 0.001 * rng.standard_normal(2000)
    mean, sigma = background(room)
    assert mean == pytest.approx(0.003, abs=1e-4)
    assert sigma == pytest.approx(0.0005, rel=0.2)
    mean, sigma = background(np.concatenate([room, cloth]))
    assert mean + 6 * sigma < 0.01


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, np.nan, np.inf, -np.inf, -1.0]))
def test_pixels_that_are_no_numbers_are_never_foreground(seed: int, odd: float) -> None:
    rng = np.random.default_rng(seed)
    image = photograph(noise=0.0003, seed=seed)
    where = rng.random(SHAPE) < rng.uniform(0, 0.5)
    bright = image > 0.5
    image[where] = odd
    found = dim_regions(image, bright, 0.03)
    assert found.dtype == bool
    assert not (found & bright).any()
    assert np.isfinite(image[cv2.erode(found.astype(np.uint8), np.ones((3, 3))) > 0]).all() or (
        odd == np.inf
    )
    assert not dim_regions(np.full(SHAPE, odd, np.float32), bright, 0.03).any()
