"""Tiles hold every covered texel once, and what is skipped changes nothing."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.atlas.tiles import tiled
from tests.processing.atlas_samples import blended, samples_of


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    rows=st.integers(1, 40),
    columns=st.integers(1, 40),
    side=st.integers(1, 50),
    share=st.sampled_from([0.0, 0.02, 0.5, 1.0]),
)
def test_tiles_hold_every_covered_texel_once(seed, rows, columns, side, share):
    covered = np.random.default_rng(seed).uniform(size=(rows, columns)) < share
    face = np.where(covered, 3, -1).astype(np.int32)
    found = tiled(face, side)
    assert np.array_equal(np.sort(found.flat), np.flatnonzero(covered))
    assert (np.diff(found.start) > 0).all()
    for first, last in zip(found.start[:-1], found.start[1:], strict=True):
        row, column = np.divmod(found.flat[first:last], columns)
        assert len(np.unique(row // side)) == len(np.unique(column // side)) == 1


def test_detail_of_views_that_hardly_count_is_skipped_below_what_half_floats_tell():
    rng = np.random.default_rng(1)
    weights = rng.uniform(0.001, 1, size=(4, 300)).astype(np.float32)
    pictures = (0.4 + 0.1 * rng.normal(size=(4, 40, 40, 3))).astype(np.float16)
    pixel = rng.uniform(4, 36, size=(300, 2)).astype(np.float32)
    views = [
        (samples_of(pixel, weight, (40, 40)), picture)
        for weight, picture in zip(weights, pictures, strict=True)
    ]
    found = [blended(300, views, best) for best in (None, weights.max(axis=0))]
    assert (weights < 0.1 * weights.max(axis=0)).mean() > 0.05
    assert np.abs(found[0] - found[1]).max() < 2**-12  # half of a half float's step near .4
