"""Skin and light solved together: against a plain twin, known answers, and extremes."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from learning.whole.light import DARK
from learning.whole.together import (
    GLOSS,
    STRENGTH,
    TINT,
    TOGETHER,
    Explained,
    KnownSkin,
    _Problem,
    explain,
)

TEXELS, FEW = 15_000, 1500
DOUBT = 0.3


@dataclasses.dataclass(frozen=True)
class Case:
    """A face under two lamps and light from everywhere, and a network that said it too dark."""

    texture: np.ndarray
    irradiance: np.ndarray
    lobe: np.ndarray
    skin: KnownSkin
    along: np.ndarray
    rgb: np.ndarray
    begin: Explained


def case(seed: int = 0, dark: float = 1.5, texels: int = TEXELS) -> Case:
    """Normals all over a ball, two directions in which people differ: their tone and a pattern."""
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=(texels, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    lamps = np.array([[0.6, 0.3, 0.7], [-0.8, 0.1, 0.5]])
    lamps /= np.linalg.norm(lamps, axis=1, keepdims=True)
    irradiance = np.column_stack([np.clip(normal @ lamps.T, 0, None), np.ones(texels)])
    half = lamps + np.array([0.0, 0.0, 1.0])
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    lobe = irradiance * np.column_stack(
        [5 * np.clip(normal @ half.T, 0, None) ** 32, np.zeros(texels)]
    )
    pattern = rng.normal(size=(texels, 3))
    tone = np.tile([0.5, 0.8, 1.0], (texels, 1))
    modes = np.stack([0.4 * tone, 0.1 * pattern], axis=2)
    along, rgb = np.array([0.8, 0.6]), np.array([[0.6, 0.5, 0.5], [0.2, 0.3, 0.4], [0.1, 0.1, 0.1]])
    skin = KnownSkin(
        np.log(np.tile([0.4, 0.25, 0.18], (texels, 1))),
        modes,
        along - dark * np.array([0.8, 0.0]),
        DOUBT * np.eye(2),
        np.full(texels, 0.028),
    )
    texture = skin.albedo(along) * (irradiance @ rgb) + 0.028 * (lobe @ rgb)
    begin = Explained(skin.answer, 1.3 * rgb, 1.0)
    return Case(texture, irradiance, lobe, skin, along, rgb, begin)


def found(
    c: Case, weight: np.ndarray | None = None, texture: np.ndarray | None = None
) -> Explained:
    return explain(
        c.texture if texture is None else texture,
        np.ones(TEXELS) if weight is None else weight,
        c.irradiance,
        c.lobe,
        c.skin,
        c.begin,
    )


def test_highlights_correct_a_tone_that_the_network_found_too_dark() -> None:
    c = case()
    answer = found(c)
    off = np.abs(np.log(c.skin.albedo(answer.along) / c.skin.albedo(c.along)))
    before = np.abs(np.log(c.skin.albedo(c.skin.answer) / c.skin.albedo(c.along)))
    assert off.mean() < 0.4 * before.mean()
    assert np.abs(np.log(answer.rgb / c.rgb)).mean() < 0.5 * np.log(1.3)
    assert answer.gloss == pytest.approx(1.0, abs=GLOSS)


def test_without_highlights_more_of_the_networks_tone_stays() -> None:
    c = case()
    dull = dataclasses.replace(c, lobe=np.zeros_like(c.lobe))
    texture = c.skin.albedo(c.along) * (c.irradiance @ c.rgb)
    with_highlights, without = (
        abs(answer.along[0] - c.skin.answer[0])
        for answer in (found(c), found(dull, texture=texture))
    )
    assert without < 0.5 * with_highlights


def test_the_normal_equations_hold_the_slope_of_the_cost() -> None:
    c = case(3)
    problem = _Problem(c.texture, np.ones(TEXELS), c.irradiance, c.lobe, c.skin, c.begin)
    values = problem.start() + np.random.default_rng(1).normal(0, 0.1, 12)
    _, _, half = problem.equations(values)
    for index in range(len(values)):
        step = 1e-5 * np.eye(len(values))[index]
        slope = (problem.equations(values + step)[0] - problem.equations(values - step)[0]) / 2e-5
        assert slope == pytest.approx(2 * half[index], rel=1e-4, abs=1e-4)


def test_a_plain_solver_of_the_same_cost_finds_the_same_answer() -> None:
    c = case(5, texels=FEW)
    problem = _Problem(c.texture, np.ones(FEW), c.irradiance, c.lobe, c.skin, c.begin)
    problem.set_outlier_scale(problem.start() - 0.1)
    far = problem._far
    values, cost, _ = problem.descended(problem.start())
    answer = problem.answer(values, cost)
    trust = (c.texture / (c.texture + DARK)) ** 2
    logs = np.log(1.3 * c.rgb).mean(axis=1, keepdims=True)

    def residuals(values: np.ndarray) -> np.ndarray:
        along, strength, gloss = values[:2], values[2:11].reshape(3, 3), values[11]
        rgb = np.exp(strength)
        albedo = np.exp(c.skin.mean + c.skin.modes @ along)
        made = albedo * (c.irradiance @ rgb)
        made += np.exp(gloss) * c.skin.specular[:, None] * (c.lobe @ rgb)
        off = np.log(c.texture) - np.log(made)
        ratio = (trust * off**2).sum(axis=1) / trust.sum(axis=1) / far**2
        each = 2.0 * np.sqrt(trust.sum(axis=1) * np.log1p(ratio) / TOGETHER)
        grey = strength.mean(axis=1, keepdims=True)
        known = [
            (along - c.skin.answer) / np.sqrt(DOUBT),
            ((strength - grey) / TINT).ravel(),
            ((grey - logs) * np.sqrt(3) / STRENGTH).ravel(),
            [gloss / GLOSS],
        ]
        return np.concatenate([each, *known])

    plain = least_squares(residuals, problem.start(), method="trf", xtol=1e-12, ftol=1e-12)
    np.testing.assert_allclose(answer.along, plain.x[:2], atol=0.02)
    np.testing.assert_allclose(answer.rgb, np.exp(plain.x[2:11].reshape(3, 3)), rtol=5e-3)
    assert answer.cost == pytest.approx(2 * plain.cost, rel=1e-3, abs=1e-3)


def test_a_tenth_of_texels_that_are_hair_changes_the_tone_little() -> None:
    c = case(2)
    texture = c.texture.copy()
    texture[::10] *= 0.2
    skins = [c.skin.albedo(found(c, texture=t).along) for t in (texture, c.texture)]
    assert np.abs(np.log(skins[0] / skins[1])).mean() < 0.03


def test_a_lamp_that_is_off_stays_off_and_texels_that_do_not_count_change_nothing() -> None:
    c = case()
    begin = dataclasses.replace(c.begin, rgb=c.begin.rgb * [[1], [0], [1]])
    assert (
        explain(c.texture, np.ones(TEXELS), c.irradiance, c.lobe, c.skin, begin).rgb[1] == 0
    ).all()
    weight = np.ones(TEXELS)
    weight[:50] = 0
    other = c.texture.copy()
    other[:50] = 7.0
    np.testing.assert_array_equal(found(c, weight).along, found(c, weight, other).along)
    assert found(c, np.zeros(TEXELS)) is c.begin


@settings(max_examples=30, deadline=None)
@given(
    scale=st.floats(1e-6, 1e6),
    black=st.integers(0, FEW),
    dark=st.floats(-3, 3),
    seed=st.integers(0, 5),
)
def test_any_brightness_and_any_black_texels_give_a_finite_answer(
    scale: float, black: int, dark: float, seed: int
) -> None:
    c = case(seed, dark, FEW)
    texture = c.texture * scale
    texture[:black] = 0.0
    begin = dataclasses.replace(c.begin, rgb=c.begin.rgb * scale)
    answer = explain(texture, np.ones(FEW), c.irradiance, c.lobe, c.skin, begin)
    for values in (answer.along, answer.rgb, np.array(answer.gloss)):
        assert np.isfinite(values).all()
    assert (answer.rgb >= 0).all()
