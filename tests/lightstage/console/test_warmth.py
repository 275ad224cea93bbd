"""How warm lights are by a journal: the capture's own sums, whatever stands in the lines."""

from __future__ import annotations

import datetime
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.console.warmth import Warmth

BEGIN = datetime.datetime(2031, 5, 6, 10, tzinfo=datetime.UTC)
SAFETY = {"max_heat": 0.5, "max_light_on_s": 100.0, "heat_time_constant_s": 60.0}


def at(seconds: float) -> datetime.datetime:
    return BEGIN + datetime.timedelta(seconds=seconds)


def line(seconds: float, event: str, **fields: object) -> dict[str, object]:
    return {"event": event, "time_utc": at(seconds).isoformat(), **fields}


def test_lights_warm_while_they_are_lit_and_cool_in_the_dark() -> None:
    warmth = Warmth()
    warmth.receive(line(0, "begin", config={"safety": SAFETY}), False)
    assert warmth.budget(at(1)) is None
    warmth.receive(line(5, "lit", levels=[1.0, 0.25, 0.0]), True)
    warmth.receive(line(10, "trigger"), True)
    warmth.receive(line(35, "asked"), False)
    lit = 1 - math.exp(-30 / 60)
    spent = warmth.budget(at(35))
    assert spent is not None
    assert spent.heat == pytest.approx(lit)
    assert (spent.max_heat, spent.on_s, spent.max_on_s) == (0.5, pytest.approx(30.0), 100.0)
    assert not spent.near
    cooler = warmth.budget(at(95))
    assert cooler is not None
    assert cooler.heat == pytest.approx(lit * math.exp(-60 / 60))
    assert cooler.on_s == pytest.approx(30.0)


def test_a_limit_that_is_near_is_reported_and_another_capture_begins_cold() -> None:
    warmth = Warmth()
    warmth.receive(line(0, "begin", config={"safety": SAFETY}), False)
    warmth.receive(line(0, "lit", levels=[1.0]), True)
    near = warmth.budget(at(32))
    assert near is not None
    assert near.near
    warmth.receive(line(40, "resume"), False)
    assert warmth.budget(at(41)) is None


VALUES = st.one_of(
    st.none(), st.booleans(), st.floats(), st.integers(), st.text(max_size=3),
    st.lists(st.one_of(st.floats(), st.integers(-2, 2), st.text(max_size=1)), max_size=4),
)  # fmt: skip


@given(
    st.lists(
        st.tuples(
            st.sampled_from(["begin", "resume", "lit", "asked", "x"]),
            st.sampled_from([at(n).isoformat() for n in range(-3, 9)] + ["", "never"]),
            VALUES,
            st.one_of(VALUES, st.dictionaries(st.sampled_from(["safety"]), VALUES)),
            st.booleans(),
        ),
        max_size=12,
    )
)
def test_whatever_a_journal_holds_the_figures_are_finite_or_none(lines) -> None:
    warmth = Warmth()
    for event, when, levels, config, lit in lines:
        values = {"event": event, "time_utc": when, "levels": levels, "config": config}
        warmth.receive(values, lit)
        spent = warmth.budget(at(10))
        assert spent is None or (np.isfinite(spent[:4]).all() and 0 <= spent.heat <= 1)
