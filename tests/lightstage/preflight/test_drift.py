"""What may change between two looks at a camera."""

import dataclasses

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.cameras.camera import VERIFIABLE, Summary
from lightstage.preflight import drift
from lightstage.preflight.drift import BY_THEMSELVES, FIXED
from lightstage.preflight.privacy import FIELDS

BEFORE = Summary(
    "600", "D750", "1.0", "M", "100", "1/60", "f/8", "Daylight", "RAW", "MF", 80.0, 10**9, 0.0,
    "", "", "", "off",
)  # fmt: skip


def changed(**fields):
    return drift(BEFORE, dataclasses.replace(BEFORE, **fields), "cam3")


def test_every_field_is_watched_or_known_to_change():
    assert sorted((*FIXED, *BY_THEMSELVES, *FIELDS)) == sorted(VERIFIABLE)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("serial", "601"),
        ("model", "D850"),
        ("firmware", "1.1"),
        ("mode", "A"),
        ("iso", "400"),
        ("shutter", "1/50"),
        ("aperture", "f/9"),
        ("white_balance", "Auto"),
        ("image_format", "RAW+JPEG"),
        ("focus", "AF-S"),
    ],
)
def test_a_setting_that_changed_blocks(name, value):
    (finding,) = changed(**{name: value})
    assert (finding.severity, finding.code, finding.camera) == ("refuse", "drift", "cam3")
    assert name in finding.where
    assert value == finding.found
    assert getattr(BEFORE, name) in finding.expected


def test_battery_card_and_clock_change_by_themselves():
    assert changed(battery_percent=3.0, card_free_bytes=5, clock_offset_s=99.0) == []


def test_another_spelling_is_no_drift():
    assert changed(mode="Manual", shutter="0.0167", aperture="8.0", image_format="NEF (Raw)") == []


def test_a_setting_that_is_no_longer_told_blocks():
    (finding,) = changed(iso=None)
    assert (finding.severity, finding.found) == ("refuse", "that it no longer reports")


def test_a_setting_that_is_told_only_now_is_noted():
    before = dataclasses.replace(BEFORE, iso=None)
    assert [f.severity for f in drift(before, BEFORE)] == ["note"]


@pytest.mark.parametrize("name", FIELDS)
def test_a_name_or_place_that_appears_blocks_and_is_not_repeated(name):
    (finding,) = changed(**{name: "Ann Person"})
    assert finding.severity == "refuse"
    assert "Person" not in str(finding)


texts = st.none() | st.text(max_size=12)
summaries = st.builds(Summary, *(texts for _ in range(10)), st.none() | st.floats())


@given(summaries)
def test_nothing_drifts_from_itself(summary):
    assert drift(summary, summary) == []
