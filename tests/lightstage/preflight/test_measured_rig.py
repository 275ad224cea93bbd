"""What a capture says of a rig whose cameras were measured in part."""

from __future__ import annotations

import dataclasses

import pytest

from lightstage.preflight import measured_rig_findings
from lightstage.preflight.values import exposure_s
from lightstage.rig import UNCHECKED, UNMEASURED, default_rig

RIG = default_rig()


def test_cameras_that_were_not_measured_or_not_checked_are_warned_of_by_name() -> None:
    assert measured_rig_findings(RIG) == []
    values = {UNMEASURED: ["cam3", "cam5"], UNCHECKED: ["cam4"]}
    first, second = measured_rig_findings(dataclasses.replace(RIG, more=values))
    assert (first.severity, second.severity) == ("warn", "warn")
    assert "older lens and pose of cam3, cam5" in first.found
    assert "too few boards to be checked: cam4" in second.found
    assert measured_rig_findings(dataclasses.replace(RIG, more={k: [] for k in values})) == []


@pytest.mark.parametrize("given", [None, "cam3", 7, [[]], ["cam77"], {"cam3": 1}])
def test_a_list_of_cameras_that_is_none_states_nothing(given: object) -> None:
    assert measured_rig_findings(dataclasses.replace(RIG, more={UNMEASURED: given})) == []


@pytest.mark.parametrize("text", ["0.0000909048", "0.000000123456789"])
def test_a_shutter_time_of_many_places_is_a_time(text: str) -> None:
    found = exposure_s(text)
    assert found is not None
    assert found[0] == pytest.approx(float(text))
