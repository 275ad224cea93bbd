"""Several photographs as one texture: one light, no seam, what each shows best, any input."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from learning.photo.several import View, join

ROWS, COLUMNS = 96, 64
SIZE = (ROWS, COLUMNS)


def albedo() -> np.ndarray:
    """A skin with spots."""
    rng = np.random.default_rng(0)
    return np.clip(np.array([0.5, 0.35, 0.25]) * np.exp(0.1 * rng.normal(size=(*SIZE, 1))), 0, 1)


def light(left: float, right: float) -> np.ndarray:
    """(rows, columns, 1) from one side to the other."""
    return np.broadcast_to(np.linspace(left, right, COLUMNS)[None, :, None], (*SIZE, 1))


def view(lit: np.ndarray, columns: slice, facing: float, known: bool = True) -> View:
    """A photograph of some columns under a light; its model has the mean skin."""
    seen = np.zeros(SIZE, bool)
    seen[:, columns] = True
    texture = albedo() * lit * seen[..., None]
    model = np.array([0.5, 0.35, 0.25]) * lit if known else None
    return View(texture.astype(np.float32), seen, np.full(SIZE, facing), 1.0, model)


FIRST, OTHER = light(1.0, 0.4), light(0.3, 0.9)


def test_one_photograph_stays_as_it_is() -> None:
    alone = view(FIRST, slice(0, 40), 0.9)
    found = join([alone])
    np.testing.assert_array_equal(found.texture, alone.texture)
    np.testing.assert_array_equal(found.seen, alone.seen)
    assert set(np.unique(found.source)) == {-1, 0}


def test_the_second_photograph_comes_in_the_first_ones_light() -> None:
    found = join([view(FIRST, slice(0, 40), 0.9), view(OTHER, slice(20, 64), 0.9)])
    assert found.seen.all()
    true = albedo() * FIRST
    assert np.abs(found.texture / true - 1).max() < 0.08
    assert np.abs(found.texture / true - 1).mean() < 0.01
    assert (found.source[:, :20] == 0).all()
    assert (found.source[:, 44:] == 1).all()


def test_another_exposure_and_white_balance_are_brought_to_the_firsts() -> None:
    second = view(FIRST, slice(20, 64), 0.9, known=False)
    tinted = View(
        second.texture * np.float32([1.5, 1.0, 0.7]), second.seen, second.facing, 1.0, None
    )
    found = join([view(FIRST, slice(0, 40), 0.9, known=False), tinted])
    off = np.abs(found.texture / (albedo() * FIRST) - 1)
    assert off.mean() < 0.02
    # Across the border as between any two neighbours.
    step = np.abs(np.diff(np.log(found.texture / albedo()), axis=1)).max(axis=(0, 2))
    assert step[15:45].max() < 3 * np.median(step) + 0.02


def test_each_texel_is_that_of_the_photograph_that_faces_it() -> None:
    first, second = view(FIRST, slice(0, 64), 0.3), view(FIRST, slice(30, 64), 0.95)
    found = join([first, second])
    assert (found.source[5:-5, 40:55] == 1).all()
    assert (found.source[:, :25] == 0).all()
    np.testing.assert_allclose(found.facing[10:-10, 45:50], 0.95, atol=0.02)
    np.testing.assert_allclose(found.facing[:, :20], 0.3, atol=1e-6)


def test_a_photograph_of_fewer_pixels_gives_way() -> None:
    first, second = view(FIRST, slice(0, 64), 0.8), view(FIRST, slice(0, 64), 0.8)
    few = View(first.texture, first.seen, first.facing, 0.1, first.model)
    assert (join([few, second]).source[10:-10, 10:-10] == 1).all()


def test_a_hand_in_the_second_photograph_is_left_out_where_the_first_shows_skin() -> None:
    first, second = view(FIRST, slice(0, 40), 0.5), view(FIRST, slice(10, 64), 0.95)
    texture = second.texture.copy()
    texture[40:56, 20:30] = 0.01
    hand = View(texture, second.seen, second.facing, 1.0, second.model)
    found = join([first, hand])
    assert (found.source[44:52, 23:27] == 0).all()
    ratio = found.texture / (albedo() * FIRST)
    assert ratio[40:56, 20:30].min() > 0.5


def test_dark_and_shadow_edges_of_the_second_photograph_say_nothing() -> None:
    lit = np.array(OTHER)
    lit[:, 50:] = 0.004  # a cast shadow: its edge is never quite in place
    found = join([view(FIRST, slice(0, 40), 0.9), view(lit, slice(20, 64), 0.9)])
    assert not found.seen[:, 50:].any()
    assert found.seen[:, :48].all()


@settings(max_examples=30, deadline=None)
@given(
    st.integers(0, 2**16),
    st.integers(1, 4),
    st.sampled_from([0.0, 1e-6, 1.0, 1e6]),
    st.sampled_from(["none", "some", "all"]),
    st.booleans(),
)
def test_any_photographs_give_finite_texels_that_are_not_negative(
    seed: int, count: int, scale: float, shown: str, known: bool
) -> None:
    rng = np.random.default_rng(seed)
    views = []
    for _ in range(count):
        seen = rng.random(SIZE) < {"none": 0.0, "some": 0.5, "all": 1.0}[shown]
        texture = (scale * rng.random((*SIZE, 3))).astype(np.float32) * seen[..., None]
        model = scale * rng.random((*SIZE, 3)) if known else None
        views.append(View(texture, seen, rng.uniform(-1, 1, SIZE), rng.uniform(0, 3), model))
    found = join(views)
    assert np.isfinite(found.texture).all()
    assert (found.texture >= 0).all()
    assert not (found.seen & ~np.any([v.seen for v in views], axis=0)).any()
    assert found.seen[views[0].seen].all()
    assert ((found.source >= 0) == found.seen).all()
    assert found.source.max() < count
    assert (found.facing >= 0).all()
    assert (found.facing <= 1 + 1e-5).all()
