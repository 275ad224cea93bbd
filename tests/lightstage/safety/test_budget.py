"""Flashes and warmth, against cases made by hand and brute force."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.safety.budget import (
    FlashCounter,
    Spent,
    heat_after,
    seconds_until,
    worst_heat,
)


def worst(states, times):
    counter = FlashCounter(len(states[0]))
    for time_s, levels in zip(times, states, strict=True):
        counter.add(time_s, np.array(levels, float))
    return counter.worst_per_s


def every(step, count):
    return [step * i for i in range(count)]


@pytest.mark.parametrize(
    ("states", "step_s", "flashes"),
    [
        # One lamp on and off three times in a second: three flashes, the most that is allowed.
        ([[1], [0]] * 3, 0.18, 3.0),
        # A fourth begins within that second.
        ([[1], [0]] * 4, 0.14, 4.0),
        # On for good: half a flash, for the darkness that may follow.
        ([[1]] * 9, 0.1, 0.5),
        # Two lamps in turn: neither the sum nor any one lamp tells more than this.
        ([[1, 0], [0, 1], [1, 0], [0, 1]], 0.2, 2.0),
        # A tenth of the highest level, up and down, is a flash.
        ([[1.0], [0.9], [1.0], [0.9]], 0.2, 2.0),
        # Less than half a tenth is none, however often.
        ([[1.0], [0.96], [1.0], [0.96], [1.0], [0.96]], 0.1, 0.5),
        # Slow enough: one change in any second.
        ([[1], [0]] * 4, 1.01, 0.5),
        # Both ends of a second belong to it.
        ([[1], [0]] * 4, 0.5, 1.5),
        # Dim lights flash too, when the sequence knows no brighter ones.
        ([[0.02], [0.0]] * 3, 0.1, 3.0),
    ],
)
def test_flashes_of_hand_made_sequences(states, step_s, flashes):
    assert worst(states, every(step_s, len(states))) == flashes


def test_a_ramp_in_small_steps_counts_by_what_it_falls():
    down = [[level] for level in np.linspace(1, 0, 201)]
    # On, then a twentieth at a time.
    assert 9 <= worst(down, every(0.001, 201)) <= 10.5


def true_flashes(series, times, highest):
    """Most pairs of opposing swings of at least a tenth of the highest level within a second.

    By trying every choice of turning points in every window.
    """
    best = 0
    for first in range(len(series)):
        inside = [i for i in range(first, len(series)) if times[i] - times[first] <= 1.0]
        for size in range(len(inside), 2, -1):
            for turns in itertools.combinations(inside, size):
                swings = np.diff([series[i] for i in turns])
                opposed = (swings[1:] * swings[:-1] < 0).all()
                if opposed and (np.abs(swings) >= 0.1 * highest - 1e-12).all():
                    best = max(best, (size - 1) // 2)
                    break
    return best


level = st.sampled_from([0.0, 0.02, 0.05, 0.08, 0.1, 0.13, 0.5, 0.9, 1.0])


@given(
    st.lists(st.tuples(level, level, level), min_size=1, max_size=6),
    st.lists(st.floats(0.05, 0.6), min_size=7, max_size=7),
)
def test_no_group_of_lights_ever_flashes_more_often_than_counted(states, pauses):
    states = np.array([(0.0, 0.0, 0.0), *states])
    times = np.cumsum([0.0, *pauses])[: len(states)]
    counted = worst(states[1:], times[1:])
    for members in itertools.chain.from_iterable(
        itertools.combinations(range(3), size) for size in (1, 2, 3)
    ):
        series = states[:, members].mean(axis=1)
        assert true_flashes(series, times, states.max()) <= counted


@given(st.lists(st.tuples(level, level), min_size=1, max_size=30), st.floats(0.5, 8.0))
def test_light_that_waits_as_told_never_flashes_more_often_than_allowed(states, max_per_s):
    counter, now_s = FlashCounter(2), 0.0
    for state in states:
        levels = np.array(state)
        now_s += counter.wait_s(now_s, levels, max_per_s)
        assert counter.wait_s(now_s, levels, max_per_s) <= 1e-9
        counter.add(now_s, levels)
    assert counter.worst_per_s <= max_per_s


def test_warmth_follows_its_time_constant():
    cold, full = np.zeros(2), np.array([1.0, 0.5])
    assert heat_after(cold, full, 60.0, 60.0) == pytest.approx((1 - np.exp(-1)) * full)
    assert heat_after(full, cold, 60.0, 60.0) == pytest.approx(np.exp(-1) * full)
    assert heat_after(cold, full, 1e6, 60.0) == pytest.approx(full)


shares = st.floats(0.0, 1.0)


@given(shares, shares, shares, st.floats(1e-6, 1e6))
def test_seconds_until_a_limit_are_those_after_which_it_is_reached(heat, levels, limit, constant_s):
    now, power = np.array([heat]), np.array([levels])
    left = seconds_until(now, power, limit, constant_s)
    if levels <= limit:
        assert left == np.inf
    elif heat >= limit:
        assert left == 0
    else:
        assert heat_after(now, power, left[0], constant_s) == pytest.approx(limit, abs=1e-9)


@given(
    st.lists(st.tuples(shares, shares), min_size=1, max_size=6),
    st.lists(shares, min_size=6, max_size=6),
    st.floats(0.1, 1000.0),
)
def test_no_course_of_a_sequence_gets_warmer_than_its_worst(states, lasts, constant_s):
    longest_s = 30.0
    bound = worst_heat(np.array(states), longest_s, constant_s)
    heat = np.zeros(2)
    for levels, share in zip(states, lasts, strict=False):
        heat = heat_after(heat, np.array(levels), share * longest_s, constant_s)
        assert (heat <= bound + 1e-12).all()


def test_what_is_spent_adds_up_over_states():
    spent = Spent(2, 60.0)
    spent.light(10.0, np.array([1.0, 0.5]))
    spent.light(14.0, np.array([0.0, 0.5]))
    spent.advance(20.0)
    assert spent.on_s.tolist() == [4.0, 5.0]
    warm = 1 - np.exp(-4 / 60)
    assert spent.heat == pytest.approx([warm * np.exp(-6 / 60), 0.5 * (1 - np.exp(-10 / 60))])
    left = spent.allowed_s(np.array([1.0, 0.5]), max_on_s=6.0, max_heat=1.0)
    assert left.tolist() == [2.0, 2.0]
    assert spent.allowed_s(np.zeros(2), 0.0, 0.0).tolist() == [np.inf, np.inf]


def test_a_clock_that_goes_backward_spends_nothing_twice():
    spent = Spent(1, 60.0)
    spent.light(10.0, np.ones(1))
    spent.advance(20.0)
    spent.advance(15.0)
    spent.advance(20.0)
    assert spent.on_s == 10.0
