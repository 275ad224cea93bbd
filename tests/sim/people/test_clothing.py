"""Clothes are outside of the body that wears them."""

from __future__ import annotations

import dataclasses

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from sim.people.clothing import AROUND, _outside, collar
from tests.sim.conftest import one_person


def test_a_collar_is_as_it_was_where_no_body_reaches_it() -> None:
    reach = np.full((5, AROUND), 60.0)
    heights = np.linspace(0, -40, 5)
    body = np.array([[50.0, -20, 0], [0, -10, 50], [90, 30, 0], [90, -60, 0]])
    np.testing.assert_array_equal(_outside(reach, heights, body), reach)


@given(st.integers(0, 2**32 - 1))
def test_rings_of_cloth_are_outside_of_any_body(seed: int) -> None:
    rng = np.random.default_rng(seed)
    heights = np.linspace(0, -40, 9)
    reach = np.full((9, AROUND), 60.0)
    turn, far = rng.uniform(0, 2 * np.pi, 30), rng.uniform(20, 110, 30)
    body = np.stack([far * np.cos(turn), rng.uniform(-40, 0, 30), far * np.sin(turn)], axis=1)
    found = _outside(reach, heights, body)
    assert (found >= reach).all()
    at = np.arange(AROUND)
    for x, y, z in body:
        place = np.arctan2(z, x) / (2 * np.pi) % 1 * AROUND - 0.5
        around = [np.interp(place, at, ring, period=AROUND) for ring in found]
        assert np.interp(-y, -heights, around) > np.hypot(x, z)


def test_shoulders_do_not_poke_through_a_collar_and_the_chest_does_not_show_below_it() -> None:
    person = one_person()
    to_head = person.head_from_world
    head = person.mesh.vertices @ to_head[:, :3].T + to_head[:, 3]
    low = np.clip((head[:, 1].min() + 25 - head[:, 1]) / 25, 0, 1)
    wide = head * np.column_stack([1 + 0.8 * low, np.ones(len(low)), np.ones(len(low))])
    wide[:, 1] -= 60 * low
    shoulders = (wide - to_head[:, 3]) @ to_head[:, :3]
    mesh = dataclasses.replace(person.mesh, vertices=shoulders)
    cloth = collar(dataclasses.replace(person, mesh=mesh))
    rings = (cloth.vertices @ to_head[:, :3].T + to_head[:, 3]).reshape(-1, AROUND, 3)
    assert rings[-1, :, 1].max() < wide[:, 1].min()
    middle = rings[0].mean(axis=0)
    widest = np.linalg.norm((rings - middle)[..., [0, 2]], axis=2).max(axis=0)
    body = wide[low > 0] - middle
    place = (np.arctan2(body[:, 2], body[:, 0]) / (2 * np.pi) % 1 * AROUND).astype(int) % AROUND
    assert (np.hypot(body[:, 0], body[:, 2]) < widest[place]).all()
