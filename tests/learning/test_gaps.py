"""Gaps of an unlit texture are filled by neighbours and by the face's other side."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from learning.whole.gaps import ALIKE, continued, likeness, without_gaps

SIZE = (48, 32)
EVERYWHERE = np.ones(SIZE, bool)


def marks(seed: int) -> np.ndarray:
    """(rows, columns, 3) alike on both sides."""
    half = np.random.default_rng(seed).normal(0, 0.1, (SIZE[0], SIZE[1] // 2, 1))
    return np.repeat(np.concatenate([half, half[:, ::-1]], axis=1), 3, axis=2)


def continued_plainly(total: np.ndarray, share: np.ndarray) -> np.ndarray:
    """The plain twin, in float64, for sides that are equal powers of two.

    Args:
        total: (n, n, c), 0 where it is not known.
        share: (n, n) of each texel that is known.
    """
    side = len(share)
    if side == 1:
        return total / np.maximum(share, 1e-9)[..., None]
    each = (side // 2, 2, side // 2, 2)
    larger = total.reshape(*each, -1).mean(axis=(1, 3)), share.reshape(each).mean(axis=(1, 3))
    return total + (1 - share)[..., None] * _doubled(continued_plainly(*larger))


def _doubled(image: np.ndarray) -> np.ndarray:
    """Linear between texels' centres, the outermost beyond them."""
    for axis in (0, 1):
        side = image.shape[axis]
        place = np.clip((np.arange(2 * side) - 0.5) / 2, 0, side - 1)
        below = np.floor(place).astype(int)
        above = np.minimum(below + 1, side - 1)
        part = (place - below).reshape([-1 if a == axis else 1 for a in range(3)])
        image = np.take(image, below, axis) * (1 - part) + np.take(image, above, axis) * part
    return image


def test_a_gap_is_continued_as_by_the_plain_twin() -> None:
    rng = np.random.default_rng(0)
    known = rng.random((32, 32)) > 0.6
    known[8:20, 5:25] = False
    image = rng.normal(size=(32, 32, 3)) * known[..., None]
    found = continued(image.astype(np.float32), known)
    np.testing.assert_allclose(found, continued_plainly(image, known), atol=1e-5)


def test_an_even_skin_is_even_in_its_gaps() -> None:
    known = np.random.default_rng(1).random(SIZE) > 0.7
    known[10:30] = False
    found = without_gaps(np.full((*SIZE, 3), 0.2), known, EVERYWHERE, sides=False)
    np.testing.assert_allclose(found, 0.2, atol=1e-5)


@pytest.mark.parametrize("rows", [(0, 14), (30, 48)])
def test_skin_known_at_one_end_alone_continues_to_the_other(rows: tuple[int, int]) -> None:
    known = np.zeros(SIZE, bool)
    known[slice(*rows)] = True
    found = without_gaps(np.full((*SIZE, 3), 0.2), known, EVERYWHERE, sides=False)
    np.testing.assert_allclose(found, 0.2, atol=1e-5)


def test_what_is_known_stays_and_what_has_no_surface_is_zero() -> None:
    beside, known, covered = marks(2), EVERYWHERE.copy(), EVERYWHERE.copy()
    known[5:20, 3:9], covered[40:] = False, False
    found = without_gaps(beside, known, covered, sides=True)
    seen = known & covered
    np.testing.assert_array_equal(found[seen], beside[seen].astype(np.float32))
    assert not found[40:].any()


def test_a_mark_in_a_gap_is_found_on_the_other_side() -> None:
    beside, known = marks(3), EVERYWHERE.copy()
    known[8:24, 4:12] = False
    gap = ~known
    errors = [
        np.sqrt(np.square(without_gaps(beside, known, EVERYWHERE, sides) - beside)[gap].mean())
        for sides in (False, True)
    ]
    assert errors[1] < 0.35 * errors[0]


def test_sides_that_are_not_alike_show_nothing_of_each_other() -> None:
    beside = np.random.default_rng(4).normal(0, 0.1, (*SIZE, 3)).astype(np.float32)
    assert likeness(beside, beside[:, ::-1], EVERYWHERE) < 0.25
    alike = marks(4).astype(np.float32)
    assert likeness(alike, alike[:, ::-1], EVERYWHERE) == pytest.approx(1.0)
    assert likeness(alike, alike[:, ::-1], EVERYWHERE & False) == ALIKE


@settings(max_examples=40, deadline=None)
@given(
    hnp.arrays(np.float64, (13, 7, 3), elements=st.floats(-1e6, 1e6) | st.just(np.nan)),
    hnp.arrays(bool, (13, 7)),
    hnp.arrays(bool, (13, 7)),
    st.booleans(),
)
def test_whatever_is_not_known_the_answer_is_finite_and_within_what_is_known(
    beside: np.ndarray, known: np.ndarray, covered: np.ndarray, sides: bool
) -> None:
    known &= np.isfinite(beside).all(axis=2)
    found = without_gaps(beside, known, covered, sides)
    assert np.isfinite(found).all()
    seen = np.abs(beside[known & covered])
    # Twice: the other side's, and the step to it.
    assert np.abs(found).max(initial=0) <= 3.01 * seen.max(initial=0)
