"""Gloss pooled on the mesh: what pixels agree on is found, what they do not say is not made up."""

from __future__ import annotations

import functools
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from lightstage.formats.mesh import Mesh
from processing.lighting.lights import no_shadows
from processing.lighting.lobe import SKIN_F0
from processing.refinement.every_pixel import enlarged
from processing.refinement.gloss import (
    LONGEST_STEP,
    ROUGHNESS_RANGE,
    SPECULAR_RANGE,
    Gloss,
    better_gloss,
    local_specular,
    skin_gloss,
    smooth,
    sum_at_vertices,
)
from processing.surface import LitSurface, Sight, lit_surface
from tests.processing import lit_ball

LIGHTS = lit_ball.lights_of_rig(lit_ball.small_rig())
SEEDS = st.integers(0, 2**31)


def make_mesh() -> Mesh:
    import trimesh

    shape = trimesh.creation.icosphere(2, 20.0)
    return Mesh(np.asarray(shape.vertices), np.asarray(shape.faces, np.int32))


MESH = make_mesh()
COUNT = len(MESH.vertices)


@functools.cache
def surface() -> LitSurface:
    """The mesh under the lamps."""
    return lit_surface(
        MESH, LIGHTS, offset_mm=0.1, smoothing_mm=0, directions=8, most_faces=10**6, finest_mm=50
    )


def perturbed_sums(offsets_s: np.ndarray, offsets_m: np.ndarray, seed: int = 0) -> np.ndarray:
    """(V, 5) evidence whose best answer at each vertex is these offsets."""
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(COUNT, 9, 2)) * [30.0, 5.0]
    information = np.einsum("vri,vrj->vij", rows, rows)
    pulls = np.einsum("vij,vj->vi", information, np.stack([offsets_s, offsets_m], axis=1))
    return np.column_stack([information[:, [0, 0, 1], [0, 1, 1]], pulls])


def better(gloss: Gloss, sums: np.ndarray, pool_mm: float = 6.0, prior: float = 0.02) -> Gloss:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return better_gloss(
            gloss,
            sums,
            surface(),
            roughness_pool_mm=pool_mm,
            specular_pool_mm=pool_mm,
            prior=prior,
            spread=1e12,
        )


def test_sums_at_vertices_are_those_of_a_plain_loop() -> None:
    rng = np.random.default_rng(0)
    corners = rng.integers(0, 9, (50, 3)).astype(np.int32)
    weights = rng.dirichlet([1] * 3, 50).astype(np.float32)
    evidence = rng.normal(size=(50, 5))
    known = np.zeros((10, 5))
    for i in range(50):
        for k in range(3):
            known[corners[i, k]] += weights[i, k] * evidence[i]
    np.testing.assert_allclose(sum_at_vertices(evidence, corners, weights, 10), known, rtol=1e-6)


@given(seed=SEEDS, columns=st.integers(1, 5))
@settings(max_examples=20, deadline=None)
def test_means_over_a_meshs_neighbours_are_those_of_a_sparse_product(
    seed: int, columns: int
) -> None:
    values = np.random.default_rng(seed).normal(size=(COUNT, columns))
    average = surface().average
    # Vertices of an icosphere have six neighbours or five: rows of seven numbers and of six.
    assert set(np.diff(average.indptr)) == {6, 7}
    known = average @ (average @ (average @ values))
    np.testing.assert_allclose(smooth(values, average, 3), known, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("pool_mm", [0.0, 6.0])
def test_gloss_that_all_pixels_agree_on_is_found_in_one_step(pool_mm: float) -> None:
    gloss = skin_gloss(COUNT, 0.28)
    assert gloss.specular[0] == SKIN_F0
    found = better(gloss, perturbed_sums(np.full(COUNT, 0.007), np.full(COUNT, -0.03)), pool_mm)
    np.testing.assert_allclose(found.roughness, 0.25, atol=1e-9)
    np.testing.assert_allclose(found.specular, SKIN_F0 + 0.007, atol=1e-9)


def test_gloss_that_varies_over_the_face_is_followed() -> None:
    gloss = skin_gloss(COUNT, 0.28)
    side = surface().vertices[:, 0] / 20
    # Evidence of one strength, so that pooling is a mean of the offsets.
    sums = np.tile([1e4, 0.0, 1e4, 0.0, 0.0], (COUNT, 1))
    sums[:, 3] = 1e4 * 0.01 * side
    found = better(gloss, sums, pool_mm=3.0)
    assert np.corrcoef(found.specular, side)[0, 1] > 0.999
    slope = np.polyfit(0.01 * side, found.specular - SKIN_F0, 1)[0]
    assert 0.9 < slope <= 1.0


def test_places_that_say_nothing_get_the_whole_faces_answer() -> None:
    sums = perturbed_sums(np.full(COUNT, 0.01), np.full(COUNT, 0.02))
    silent = surface().vertices[:, 2] < -5
    sums[silent] = 0
    found = better(skin_gloss(COUNT, 0.28), sums, pool_mm=0.0)
    np.testing.assert_allclose(found.roughness, 0.30, atol=1e-9)
    np.testing.assert_allclose(found.specular, SKIN_F0 + 0.01, atol=1e-9)


def test_without_evidence_gloss_stays() -> None:
    gloss = skin_gloss(COUNT, 0.28)
    assert better(gloss, np.zeros((COUNT, 5))) is gloss


def test_a_step_is_short_and_ends_within_the_range_of_faces() -> None:
    found = better(
        skin_gloss(COUNT, 0.28), perturbed_sums(np.full(COUNT, 5.0), np.full(COUNT, 1.0))
    )
    np.testing.assert_allclose(found.roughness, 0.28 + LONGEST_STEP)
    np.testing.assert_allclose(found.specular, SPECULAR_RANGE[1])
    found = better(
        skin_gloss(COUNT, 0.08), perturbed_sums(np.full(COUNT, -5.0), np.full(COUNT, -1.0))
    )
    np.testing.assert_allclose(found.roughness, ROUGHNESS_RANGE[0])
    np.testing.assert_allclose(found.specular, SPECULAR_RANGE[0])


@given(seed=SEEDS, power=st.integers(-6, 6), share=st.floats(0, 1))
@settings(max_examples=30, deadline=None)
def test_gloss_is_finite_and_does_not_depend_on_the_strength_of_all_evidence(
    seed: int, power: int, share: float
) -> None:
    rng = np.random.default_rng(seed)
    sums = perturbed_sums(0.02 * rng.normal(size=COUNT), 0.05 * rng.normal(size=COUNT), seed)
    sums[rng.uniform(size=COUNT) < share] = 0
    gloss = skin_gloss(COUNT, 0.28)
    found, scaled = better(gloss, sums), better(gloss, sums * 10.0**power)
    for name in ("roughness", "specular"):
        values = getattr(found, name)
        assert np.isfinite(values).all()
        np.testing.assert_allclose(getattr(scaled, name), values, atol=1e-9)


@given(
    evidence=arrays.arrays(
        np.float64, (COUNT, 5), elements=st.floats(-1e6, 1e6, width=32), fill=st.just(0.0)
    )
)
@settings(max_examples=30, deadline=None)
def test_gloss_stays_in_range_whatever_the_sums(evidence: np.ndarray) -> None:
    evidence = evidence.copy()
    evidence[:, [0, 2]] = np.abs(evidence[:, [0, 2]])
    found = better(skin_gloss(COUNT, 0.28), evidence)
    for values, (low, high) in (
        (found.roughness, ROUGHNESS_RANGE),
        (found.specular, SPECULAR_RANGE),
    ):
        assert np.isfinite(values).all()
        assert (values >= low).all()
        assert (values <= high).all()


def test_local_specular_follows_strong_evidence_and_ignores_weak() -> None:
    mask = np.ones((40, 40), bool)
    mask[:5] = False
    count = int(mask.sum())
    specular = np.full(count, 0.03)
    for strength, known in ((1e8, 0.034), (1e-3, 0.03)):
        evidence = np.zeros((count, 5), np.float32)
        evidence[:, 0], evidence[:, 3] = strength, strength * 0.004
        found = local_specular(evidence, specular, mask, 2.0, 0.002, 8.0)
        np.testing.assert_allclose(found, known, atol=1e-5)
    np.testing.assert_array_equal(
        local_specular(np.zeros((count, 5), np.float32), specular, mask, 2.0, 0.002, 8.0), specular
    )


def test_local_specular_weighs_evidence_against_the_spread_expected() -> None:
    mask = np.ones((60, 60), bool)
    information, spread, sigma = 1e3, 0.002, 2.0
    evidence = np.zeros((3600, 5), np.float32)
    evidence[:, 0], evidence[:, 3] = information, information * 0.004
    found = local_specular(evidence, np.full(3600, 0.03), mask, sigma, spread, 8.0).reshape(60, 60)
    pooled = information * 4 * np.pi * sigma**2
    share = pooled / (pooled + 1 / spread**2)
    np.testing.assert_allclose(found[30, 30], 0.03 + 0.004 * share, rtol=1e-5)


def test_where_all_of_a_pool_may_be_mistaken_only_the_level_and_the_detail_count() -> None:
    mask = np.ones((80, 80), bool)
    across = np.arange(80) / 80
    offset = np.broadcast_to(0.004 * across, mask.shape).ravel()
    evidence = np.zeros((6400, 5), np.float32)
    evidence[:, 0], evidence[:, 3] = 1e8, 1e8 * offset
    specular = np.full(6400, 0.03)
    given = (evidence, specular, mask, 1.0, 0.002, 4.0)
    np.testing.assert_allclose(local_specular(*given, 1.0), 0.03 + offset, atol=2e-4)
    inside = np.zeros(mask.shape, bool)
    inside[20:60, 20:60] = True
    found = local_specular(*given, np.zeros(6400))[inside.ravel()]
    np.testing.assert_allclose(found, 0.03 + offset.mean(), atol=1e-4)


def test_places_that_may_be_mistaken_take_the_faces_level() -> None:
    sums = np.tile([1e8, 0.0, 1e8, 0.0, 0.0], (COUNT, 1))
    bright = surface().vertices[:, 0] > 0
    sums[bright, 3] = 1e8 * 0.02
    given = {"roughness_pool_mm": 6.0, "specular_pool_mm": 6.0, "prior": 0.0, "spread": 0.003}
    gloss = skin_gloss(COUNT, 0.28)
    sure = better_gloss(gloss, sums, surface(), **given)
    doubted = better_gloss(gloss, sums, surface(), **given, wrong=np.full(COUNT, 0.006))
    middle = sure.specular.mean()
    share = (doubted.specular - middle).std() / (sure.specular - middle).std()
    assert share == pytest.approx(1 / (1 + (0.006 / 0.003) ** 2), rel=0.02)


def sight_of(mask: np.ndarray, step: int) -> Sight:
    """A sight of which only the pixels' places are asked."""
    count = int(mask.sum())
    zeros = np.zeros((count, 3), np.float32)
    return Sight(
        mask, zeros, zeros, zeros, np.zeros(count), no_shadows(count, LIGHTS),
        np.zeros(mask.shape, np.float32), step,
    )  # fmt: skip


@given(seed=SEEDS, step=st.integers(2, 6), height=st.integers(7, 40), width=st.integers(7, 40))
@settings(max_examples=30, deadline=None)
def test_a_grids_linear_field_is_the_same_in_the_whole_view(
    seed: int, step: int, height: int, width: int
) -> None:
    rng = np.random.default_rng(seed)
    slope = rng.normal(size=(2, 3))
    whole = np.ones((height, width), bool)
    grid = sight_of(whole[::step, ::step], step)
    rows, columns = np.nonzero(grid.mask)
    values = step * np.stack([rows, columns], axis=1) @ slope
    view = sight_of(whole, 1)
    found, near = enlarged(values, np.ones(len(values), bool), grid, view)
    assert near.all()
    rows, columns = np.nonzero(whole)
    # Beyond the grid's last row and column there is nothing to go on to.
    rows = np.minimum(rows, step * (grid.mask.shape[0] - 1))
    columns = np.minimum(columns, step * (grid.mask.shape[1] - 1))
    known = np.stack([rows, columns], axis=1) @ slope
    np.testing.assert_allclose(found, known, atol=1e-4 * (1 + np.abs(known).max()))


def test_pixels_of_a_grid_without_a_value_are_left_out_and_do_not_count_as_zero() -> None:
    rng = np.random.default_rng(0)
    whole = np.ones((32, 32), bool)
    grid, view = sight_of(whole[::4, ::4], 4), sight_of(whole, 1)
    known = rng.random(64) > 0.3
    found, near = enlarged(np.where(known, 5.0, 0.0)[:, None], known, grid, view)
    assert 0.8 < near.mean() < 1
    np.testing.assert_allclose(found[near], 5.0, rtol=1e-5)
    assert not found[~near].any()


def test_where_the_grid_has_no_pixel_nearby_that_is_reported() -> None:
    mask = np.zeros((8, 8), bool)
    mask[:4] = True
    grid = sight_of(mask, 4)
    view = sight_of(np.ones((32, 32), bool), 1)
    found, near = enlarged(np.full((32, 2), 7.0), np.ones(32, bool), grid, view)
    near = near.reshape(32, 32)
    assert near[:15].all()
    assert not near[16:].any()
    np.testing.assert_allclose(found.reshape(32, 32, 2)[near], 7.0, rtol=1e-5)
    assert not found.reshape(32, 32, 2)[~near].any()
