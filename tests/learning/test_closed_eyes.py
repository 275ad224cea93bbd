"""Eyes that show no whites are found in light of any colour, and open ones are left."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from learning.checkpoint import load_whole_face, shipped_weights
from learning.whole.closed_eyes import LEAST_CONTRAST, closed_eyes

SKIN, WHITE = (0.5, 0.3, 0.2), (0.6, 0.55, 0.5)
SIZE = 96, 64


def eyes() -> np.ndarray:
    """(h, w) bool, two whites of 6 x 3 texels."""
    found = np.zeros(SIZE, bool)
    found[38:41, 20:26] = found[38:41, 38:44] = True
    return found


def skin(whites: tuple[float, ...]) -> np.ndarray:
    """(h, w, 3) a face of one colour, and another one where eyes are."""
    return np.where(eyes()[..., None], whites, SKIN)


HIDDEN = 2 * (6 + 5 * 10 + 6)
"""Texels of both eyes, rounded: a disc of two texels around each white."""
ANY = st.one_of(st.floats(-1e6, 1e6), st.sampled_from([np.nan, np.inf, -np.inf, 0.0]))
EVERYWHERE = np.ones(SIZE, bool)
MEAN = np.log(skin(WHITE))


@pytest.mark.parametrize("light", [(1.0, 1.0, 1.0), (1e-2, 1e-3, 1e-4), (1e2, 1e5, 1e6)])
def test_lids_are_hidden_and_whites_are_not_in_light_of_any_colour(
    light: tuple[float, ...],
) -> None:
    shadow = np.linspace(0.2, 1, SIZE[1])[None, :, None]
    lids, open_eyes = (skin(colour) * light * shadow for colour in (SKIN, WHITE))
    hidden = closed_eyes(lids, EVERYWHERE, MEAN, EVERYWHERE)
    assert hidden[eyes()].all()
    assert hidden.sum() == HIDDEN
    assert not closed_eyes(open_eyes, EVERYWHERE, MEAN, EVERYWHERE).any()


def test_the_contrast_decides_at_its_bound() -> None:
    # Red and blue change by opposite halves, in natural logarithms.
    for contrast, closed in ((0.95 * LEAST_CONTRAST, True), (1.05 * LEAST_CONTRAST, False)):
        half = np.exp(0.5 * contrast)
        texture = skin((SKIN[0] / half, SKIN[1], SKIN[2] * half))
        assert closed_eyes(texture, EVERYWHERE, MEAN, EVERYWHERE).any() == closed


def test_eyes_that_are_not_photographed_and_people_without_whites_are_left() -> None:
    lids = skin(SKIN)
    nothing = ~EVERYWHERE
    assert not closed_eyes(lids, nothing, MEAN, EVERYWHERE).any()
    assert not closed_eyes(lids, EVERYWHERE, MEAN, nothing).any()
    assert not closed_eyes(lids, ~eyes(), MEAN, EVERYWHERE).any()
    assert not closed_eyes(lids, EVERYWHERE, np.log(lids), EVERYWHERE).any()


@settings(max_examples=30, deadline=None)
@given(arrays(np.float64, (*SIZE, 3), elements=ANY))
def test_any_texture_hides_both_eyes_or_none(texture: np.ndarray) -> None:
    hidden = closed_eyes(texture, EVERYWHERE, MEAN, EVERYWHERE)
    assert hidden.sum() in (0, HIDDEN)


def test_the_shipped_weights_know_where_eyes_are() -> None:
    network = load_whole_face(shipped_weights())[0]
    mean = network.mean_log_albedo[0].permute(1, 2, 0).numpy()
    position_mm = network.mean_position_mm[0].permute(1, 2, 0).numpy()
    _, height, depth = np.moveaxis(position_mm, 2, 0)
    face = (depth > 40) & (height > -110) & (height < 40)
    one_colour = np.full(mean.shape, 0.4)
    hidden = closed_eyes(one_colour, np.ones(mean.shape[:2], bool), mean, face)
    assert 60 < hidden.sum() < 240
    # Both eyes, and nothing but eyes.
    across = position_mm[hidden][:, 0]
    assert (across > 0).mean() == pytest.approx(0.5, abs=0.1)
    assert ((np.abs(across) > 8) & (np.abs(across) < 60)).all()
    assert np.ptp(position_mm[hidden][:, 1]) < 35
    assert not closed_eyes(np.exp(mean), np.ones(mean.shape[:2], bool), mean, face).any()
