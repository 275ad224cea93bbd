"""The tone of a photographed skin: its cues, each alone and together."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from learning.checkpoint import load_whole_face, shipped_weights
from learning.photo.tone import (
    DISPLAY_WHITE,
    GREY,
    LIGHTEST,
    NETWORK_DARKER,
    WHITE_OF_EYE,
    Cue,
    SkinColours,
    cues_of,
    find_tone,
    skin_colours,
)

BROWN = np.array([0.2, 0.11, 0.07])


@pytest.fixture(scope="module")
def people() -> SkinColours:
    return skin_colours(load_whole_face(shipped_weights())[0])


def lightness(rgb: np.ndarray) -> float:
    return float(np.log(rgb).mean())


def test_cues_that_agree_give_the_skin_and_its_typology_angle(people: SkinColours) -> None:
    whites = np.tile(DISPLAY_WHITE * WHITE_OF_EYE, (2, 1))
    network = BROWN * np.exp(-NETWORK_DARKER)
    found = find_tone(cues_of(DISPLAY_WHITE * BROWN, whites, network), people)
    np.testing.assert_allclose(found.rgb, BROWN, rtol=0.1)
    assert found.span_deg[0] < found.ita_deg < found.span_deg[1]
    assert set(found.cues) == {"exposure", "whites of the eyes", "network"}
    assert all(abs(off) < 0.1 for off in found.cues.values())


def test_whites_twice_as_bright_explain_part_of_twice_the_light(
    people: SkinColours,
) -> None:
    def found(light: float, whites: bool) -> float:
        eyes = np.tile(light * WHITE_OF_EYE, (2, 1)) if whites else None
        return lightness(find_tone(cues_of(light * BROWN, eyes, BROWN), people).rgb)

    seen, hidden = (found(1.4, w) - found(0.7, w) for w in (True, False))
    assert abs(seen) < 0.7 * hidden


def test_whites_in_shade_show_how_light_the_skin_is_at_most(people: SkinColours) -> None:
    shown = DISPLAY_WHITE * BROWN
    dark = find_tone(cues_of(shown, np.tile(0.1 * WHITE_OF_EYE, (2, 1)), BROWN), people)
    light = find_tone(cues_of(shown, np.tile(2.5 * WHITE_OF_EYE, (2, 1)), BROWN), people)
    without = lightness(find_tone(cues_of(shown, None, BROWN), people).rgb)
    # Whites that are too dark hardly count; whites that are too bright show a stronger light.
    assert lightness(dark.rgb) - without < 0.5 * (without - lightness(light.rgb)) + 0.1


def test_one_eye_that_is_seen_is_enough_and_none_is_no_cue(people: SkinColours) -> None:
    one = np.array([WHITE_OF_EYE, np.full(3, np.nan)])
    assert len(cues_of(BROWN, one, BROWN)) == 3
    assert len(cues_of(BROWN, np.full((2, 3), np.nan), BROWN)) == 2


def test_a_cue_that_is_far_off_gives_way_to_the_exposure(people: SkinColours) -> None:
    shown, far = GREY @ np.log(BROWN), GREY @ np.log(BROWN * np.exp(-6))
    exposure = Cue("exposure", shown, (0.4, 0.1, 0.1))
    wrong = Cue("network", far, (0.4, 0.1, 0.1))
    found = find_tone([exposure, wrong], people)
    assert lightness(found.rgb) == pytest.approx(shown[0], abs=0.3)


@settings(max_examples=60, deadline=None)
@given(
    scale=st.sampled_from([0.0, 1e-6, 1e-3, 1.0, 1e3, 1e6]),
    whites=st.sampled_from([None, 0.0, 1e-6, 1.0, 1e6]),
    network=st.sampled_from([1e-6, 0.2, 1.0]),
)
def test_any_exposure_gives_a_skin_that_people_have(
    people: SkinColours, scale: float, whites: float | None, network: float
) -> None:
    eyes = None if whites is None else np.full((2, 3), whites)
    found = find_tone(cues_of(scale * BROWN, eyes, np.full(3, network)), people)
    assert np.isfinite(found.rgb).all()
    assert 0 < found.rgb.mean() < 1.6 * LIGHTEST
    assert 0 <= found.deviation < 1


def test_the_answer_is_that_of_a_plain_search_over_lightness_and_tint(people: SkinColours) -> None:
    cues = [
        Cue("exposure", np.array([-1.2, 0.7, -0.5]), (0.5, 0.1, 0.2)),
        Cue("network", np.array([-1.6, 0.5, -0.3]), (0.4, 0.2, 0.1), 0.8),
    ]
    found = find_tone(cues, people)
    tint = found.rgb[0] / found.rgb[1], found.rgb[2] / found.rgb[1]
    middle = lightness(found.rgb)
    # A plain twin: the weighted mean of the tints at the lightness that was found.
    parts = [(people.at(np.array([middle]))[0], (0.10, 0.12))]
    parts += [(cue.log_skin[1:], cue.deviations[1:]) for cue in cues]
    for k in (0, 1):
        weight = [part[1][k] ** -2 for part in parts]
        mean = sum(w * part[0][k] for w, part in zip(weight, parts, strict=True)) / sum(weight)
        assert np.log(tint[k]) == pytest.approx(mean, abs=0.02)
