"""Skin's colour against other people's numbers: Prahl's, the chart's, colour-science's."""

from __future__ import annotations

import math

import colour
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from sim.camera.chart import CHART_SRGB
from sim.people.person import person_skin
from sim.people.traits import Traits
from sim.skin.complexion import random_complexion
from sim.skin.pigments import (
    BLOOD_RANGE,
    MELANIN_RANGE,
    WAVELENGTHS_NM,
    PigmentConfig,
    haemoglobin,
    lab,
    matching_functions,
    paint_pigments,
    reflectance,
    rgb_weights,
    skin_rgb,
    tone_angle_deg,
)

CHART_DISTANCE = 1.5
"""CIE 1976 colour difference within which both skin patches are reached."""


def chart_rgb(patch: int) -> np.ndarray:
    return ((CHART_SRGB[patch] / 255 + 0.055) / 1.055) ** 2.4


def closest(target: np.ndarray, config: PigmentConfig | None = None) -> tuple[np.ndarray, float]:
    """(C_m, C_h, B_m) within plausible ranges whose colour is nearest, and its distance."""

    def off(p: np.ndarray) -> np.ndarray:
        rgb = skin_rgb(math.exp(p[0]), math.exp(p[1]), p[2], config)
        return lab(rgb) - lab(target)

    low, high = [math.log(0.005), math.log(0.003), 0.05], [math.log(0.4), math.log(0.1), 0.95]
    starts = ([-4, -4, 0.5], [-2, -3, 0.6], [-3, -4.5, 0.3])
    best = min((least_squares(off, s, bounds=(low, high)) for s in starts), key=lambda r: r.cost)
    return np.array([*np.exp(best.x[:2]), best.x[2]]), float(np.linalg.norm(best.fun))


def plain_reflectance(nm: float, cm: float, ch: float, bm: float, hb: float) -> float:
    """The two layers again, scalar by scalar."""
    eu, ph = 6.6e10 * nm**-3.33, 2.9e14 * nm**-4.75
    base = 0.0244 + 8.53 * math.exp(-(nm - 154) / 66.2)
    scatter = 14.74 * nm**-0.22 + 2.2e11 * nm**-4
    upper = cm * (bm * eu + (1 - bm) * ph) + (1 - cm) * base
    lower = ch * hb + (1 - ch) * base * 0.2
    a = 0.5 * scatter / (0.5 * scatter + lower)
    q = math.sqrt(3 * (1 - a))
    dermis = a / 2 * (1 + math.exp(-4 / 3 * (1.53 / 0.47) * q)) * math.exp(-q)
    s, k = 0.5 * scatter, 2 * upper
    r = (s + k) / s
    b = math.sqrt(r * r - 1)
    x = min(b * s * 0.06, 300)
    reflected = math.sinh(x) / (r * math.sinh(x) + b * math.cosh(x))
    through = b / (r * math.sinh(x) + b * math.cosh(x))
    return reflected + through**2 * dermis / (1 - reflected * dermis)


def test_reflectance_agrees_with_its_plain_twin():
    hb = haemoglobin(0.75)
    for cm, ch, bm in ((0.002, 0.003, 0.7), (0.0135, 0.02, 0.7), (0.185, 0.05, 0.1), (0.5, 0.3, 1)):
        twin = [
            plain_reflectance(nm, cm, ch, bm, h) for nm, h in zip(WAVELENGTHS_NM, hb, strict=True)
        ]
        assert np.allclose(reflectance(cm, ch, bm), twin, rtol=1e-9)


@pytest.mark.parametrize(
    ("nm", "oxy", "deoxy"), [(450, 62816, 103292), (550, 43016, 53412), (610, 1506, 9443.6)]
)
def test_haemoglobin_absorbs_as_prahl_tabulates(nm, oxy, deoxy):
    place = int((nm - 390) // 10)
    # 150 g/l of 64,500 g/mol; per cm to per mm.
    scale = math.log(10) * 150 / 64500 / 10
    assert haemoglobin(1.0)[place] == pytest.approx(oxy * scale, rel=1e-3)
    assert haemoglobin(0.0)[place] == pytest.approx(deoxy * scale, rel=1e-3)


def test_white_is_white_and_matching_functions_are_the_cies():
    assert np.allclose(rgb_weights().sum(axis=1), 1)
    cmfs = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    known = np.array([cmfs[nm] for nm in WAVELENGTHS_NM]).T
    assert np.abs(matching_functions() - known).max() < 0.05
    # A whole skin under D65 by the CIE's own tables, against the LEDs adapted to D65.
    d65 = np.array([colour.SDS_ILLUMINANTS["D65"][nm] for nm in WAVELENGTHS_NM])
    for cm, ch in ((0.02, 0.01), (0.1, 0.02), (0.3, 0.02)):
        spectrum = reflectance(cm, ch, 0.6)
        xyz = (known * d65 * spectrum).sum(axis=1) / (known * d65)[1].sum()
        daylight = lab(colour.XYZ_to_sRGB(xyz, apply_cctf_encoding=False))
        assert np.linalg.norm(daylight - lab(skin_rgb(cm, ch, 0.6))) < 3


def test_both_skin_patches_of_the_chart_are_reached_by_plausible_pigments():
    for patch, melanin in ((0, (0.08, 0.25)), (1, (0.02, 0.08))):
        found, distance = closest(chart_rgb(patch))
        assert distance < CHART_DISTANCE
        assert melanin[0] < found[0] < melanin[1]


def test_without_the_two_corrections_the_dark_patch_stays_out_of_reach():
    toy = PigmentConfig(backscatter=1e-4, dermis_base=1.0)
    assert closest(chart_rgb(0), toy)[1] > 3 * CHART_DISTANCE
    assert closest(chart_rgb(1), toy)[1] > 1.5 * CHART_DISTANCE


def test_more_melanin_is_darker_everywhere_and_more_blood_is_redder():
    melanin = np.geomspace(*MELANIN_RANGE, 40)
    assert (np.diff(reflectance(melanin, 0.01, 0.6), axis=0) < 0).all()
    rgb = skin_rgb(0.03, np.geomspace(0.003, 0.05, 30), 0.6)
    assert (np.diff(rgb[:, 0] / rgb[:, 1]) > 0).all()


def test_table_agrees_with_the_formulas():
    rng = np.random.default_rng(0)
    melanin = np.exp(rng.uniform(*np.log(MELANIN_RANGE), (64, 64))).astype(np.float32)
    blood = np.exp(rng.uniform(*np.log(BLOOD_RANGE), (64, 64))).astype(np.float32)
    ratio = paint_pigments(melanin, blood, 0.6) / skin_rgb(melanin, blood, 0.6)
    assert np.abs(ratio - 1).max() < 2e-3


@settings(max_examples=40, deadline=None)
@given(
    st.floats(allow_nan=True, allow_infinity=True, width=32),
    st.floats(allow_nan=True, allow_infinity=True, width=32),
    st.floats(0, 1),
)
def test_any_amount_of_pigment_gives_a_colour(melanin, blood, eumelanin):
    one = paint_pigments(
        np.full((2, 2), melanin, np.float32), np.full((2, 2), blood, np.float32), eumelanin
    )
    assert np.isfinite(one).all()
    assert (one > 0).all()
    assert (one < 1).all()


def test_tones_span_very_light_to_dark_in_order():
    rng = np.random.default_rng(3)
    middles, every = [], []
    for tone in (1, 2, 3, 4, 5, 6):
        who = [random_complexion(rng, Traits("female", 30.0, tone)) for _ in range(60)]
        angles = [float(tone_angle_deg(skin_rgb(c.melanin, c.blood, c.eumelanin))) for c in who]
        middles.append(np.median(angles))
        every += angles
    assert (np.diff(middles) < -5).all()
    # Very light is above 55 degrees, dark below -30 [Chardon1991].
    assert max(every) > 57
    assert min(every) < -50
    assert middles[0] > 50
    assert middles[-1] < -35


def test_a_persons_skin_has_the_tone_of_its_pigments():
    who = Traits("female", 30.0, 5)
    skin = person_skin(45, who, 96)
    painted = float(tone_angle_deg(skin.diffuse_albedo[skin.skin].mean(axis=0)))
    rng = np.random.default_rng([45, 1])
    c = random_complexion(rng, who)
    assert abs(painted - tone_angle_deg(skin_rgb(c.melanin, c.blood, c.eumelanin))) < 12
