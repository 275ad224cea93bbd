"""Light that is summed over eight lamps at a time, against the sum over one after the other."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from processing.lanes import LANES, between, load, load_bytes, numbered, store, where_above
from processing.lighting.interface import Interface
from processing.lighting.lights import PatternLights, Shadows, lights_of
from processing.lighting.lobe import transport
from processing.refinement.joint import Place, lamps_of
from processing.refinement.joint_light import Lamps, chunks_of, gather
from tests.processing.lit_ball import PATTERNS, nominal_lamps
from tests.processing.test_joint import FAMILIES, LIGHTS, RIG, SEEDS, across, unpolarised

NO_BOUNCES = np.zeros((0, len(PATTERNS), 3), np.float32)
WAYS = ("binary", "one by one", "linear", "three lamps", "beam")


def driven(way: str, rng: np.random.Generator) -> PatternLights:
    """Lamps in eight groups, driven one by one, in groups of unlike size, too few, or spots."""
    if way == "binary":
        return LIGHTS
    if way == "beam":
        return dataclasses.replace(LIGHTS, exponent=2.5)
    lamps = nominal_lamps(RIG)
    count = len(lamps.position_mm)
    levels = rng.uniform(0, 1, (len(PATTERNS), count))
    if way == "linear":
        # Some share a level and most do not, as on a sphere of rings.
        levels = levels[:, rng.integers(0, count // 2, count)]
    if way == "three lamps":
        levels[:, 3:] = 0
        levels[:, 0] = 0.5
    lights = lights_of(lamps, PATTERNS, levels)
    return dataclasses.replace(lights, exponent=2.5 if way == "three lamps" else 0.0)


@njit
def _gathered(
    points: np.ndarray, normals: np.ndarray, views: np.ndarray, roughness: np.ndarray,
    corners: np.ndarray, weights: np.ndarray, lamps: Lamps, out: np.ndarray,
) -> None:  # fmt: skip
    for i in range(len(points)):
        gather(points[i], normals[i], views[i], roughness[i], corners[i], weights[i], lamps, out[i])


def both(lights: PatternLights, seed: int, interface: Interface) -> tuple[np.ndarray, ...]:
    """Gathered E and B of some places in half shadow, and those of the plain loop over lamps."""
    rng = np.random.default_rng(seed)
    count, places = len(lights.weight), 20
    normals = across(np.tile([[0.0, 0.0, 1.0]], (places, 1)), rng, 40)
    views, points = across(normals, rng, 30), 95 * normals
    points[0] = 0
    roughness = rng.uniform(0.15, 0.4, places)
    shadows = Shadows(
        rng.integers(0, 9, (places, 3)).astype(np.int32),
        rng.dirichlet([1] * 3, places).astype(np.float32),
        (rng.uniform(size=(9, count)) < 0.6).astype(np.uint8),
    )
    known = transport(lights, points, normals, views, roughness, shadows, interface)
    place = Place(points, views, shadows, NO_BOUNCES, *unpolarised(lights))
    out = np.zeros((places, len(PATTERNS), 12), np.float32)
    single = [np.ascontiguousarray(x, np.float32) for x in (points, normals, views, roughness)]
    lamps = lamps_of(lights, place, interface)
    _gathered(*single, shadows.corners, shadows.weights, lamps, out)
    return out[:, :, 0], out[:, :, 4], *known


@pytest.mark.parametrize("way", WAYS)
@given(seed=SEEDS, interface=st.sampled_from(FAMILIES))
@settings(max_examples=8, deadline=None)
def test_eight_lamps_at_once_light_as_one_after_the_other(
    way: str, seed: int, interface: Interface
) -> None:
    lights = driven(way, np.random.default_rng(seed))
    e, b, known_e, known_b = both(lights, seed, interface)
    assert known_e.max() > 0.01
    np.testing.assert_allclose(e, known_e, rtol=2e-5, atol=2e-6)
    np.testing.assert_allclose(b, known_b, rtol=2e-4, atol=2e-5)


@given(sizes=st.lists(st.integers(1, 40), min_size=1, max_size=12))
def test_every_lamp_is_in_one_chunk_of_its_own_group_or_of_several(sizes: list[int]) -> None:
    ends = np.cumsum(sizes)
    count, group = int(ends[-1]), np.repeat(np.arange(len(sizes)), sizes)
    seen = np.zeros(count, int)
    for at, first, end, own in chunks_of(ends):
        assert 0 <= at <= max(count - LANES, 0)
        assert at <= first < end <= at + LANES
        seen[first:end] += 1
        assert own == -1 or (group[first:end] == own).all()
    assert (seen == 1).all()


@njit
def _lanes(a: np.ndarray, b: np.ndarray, whole: np.ndarray, out: np.ndarray) -> None:
    x, y = load(a, 0), load(b, 0)
    store(out, 0, where_above(x, y, x, y))
    store(out, LANES, load_bytes(whole, 3))
    store(out, 2 * LANES, numbered())


def test_lanes_choose_load_whole_numbers_and_count() -> None:
    a = np.array([1, 4, 0, -1, np.inf, np.nan, 9, 2], np.float32)
    b = np.array([2, 0, 3, -5, 2, 1, 9, np.nan], np.float32)
    whole, out = np.array([9, 9, 9, 0, 1, 2, 255, 4, 5, 6, 7, 9], np.uint8), np.zeros(3 * LANES)
    out = out.astype(np.float32)
    _lanes(a, b, whole, out)
    np.testing.assert_array_equal(
        out.reshape(3, LANES), [np.where(a > b, a, b), whole[3:11], np.arange(LANES)]
    )


@njit
def _between(table: np.ndarray, places: np.ndarray, out: np.ndarray) -> None:
    for i in range(0, len(places), LANES):
        store(out, i, between(table, load(places, i), len(table) - 1))


@pytest.mark.parametrize("steps", [1, 2, 40])
def test_lanes_are_interpolated_in_a_table_up_to_both_its_ends(steps: int) -> None:
    rng = np.random.default_rng(steps)
    table = rng.normal(size=steps + 1).astype(np.float32)
    places = np.concatenate([[0, steps, steps / 2], rng.uniform(0, steps, 61)]).astype(np.float32)
    out = np.zeros_like(places)
    _between(table, places, out)
    np.testing.assert_allclose(
        out, np.interp(places, np.arange(steps + 1), table.astype(float)), atol=1e-5
    )
