"""The chart's reflectances, colour differences, and fits of a camera's colours to its patches."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from lightstage.errors import FormatError
from processing.calibration.colour.chart_reference import (
    D50_WHITE,
    D65_FROM_D50,
    RGB_FROM_XYZ,
    chart_reflectance,
)
from processing.calibration.colour.config import ColourFitConfig
from processing.calibration.colour.fit import ChartSample, fit_colour
from processing.colour import root_terms
from processing.colour_difference import colour_science, delta_e_2000, lab_from_linear
from processing.errors import ProcessingError

KNOWN = chart_reflectance("classic")
CONFIG = ColourFitConfig()
RAW_FROM_LINEAR = np.diag([0.5, 1.0, 0.7]) @ [
    [0.88, 0.10, 0.02],
    [0.06, 0.87, 0.07],
    [0.01, 0.13, 0.86],
]


def sample(raw, white=1.0, clipped=None):
    cut = np.zeros(24) if clipped is None else clipped
    return ChartSample(raw, np.broadcast_to(white, (24, 3)).astype(float), cut)


PUBLISHED_LAB_2014 = {
    0: (37.54, 14.37, 14.92), 5: (70.48, -32.26, -0.37), 17: (49.57, -29.71, -28.32),
    18: (95.19, -1.03, 2.93), 23: (20.64, 0.07, -0.46),
}  # fmt: skip
"""The maker's, D50, of dark skin, bluish green, cyan, white and black."""
SHARMA = np.array(
    [
        [50, 2.6772, -79.7751, 50, 0, -82.7485, 2.0425],
        [50, 3.1571, -77.2803, 50, 0, -82.7485, 2.8615],
        [50, 2.8361, -74.02, 50, 0, -82.7485, 3.4412],
        [50, -1.3802, -84.2814, 50, 0, -82.7485, 1.0],
        [50, 2.5, 0, 50, 0, -2.5, 4.3065],
        [50, 2.5, 0, 73, 25, -18, 27.1492],
        [50, 2.5, 0, 61, -5, 29, 22.8977],
        [50, 2.5, 0, 56, -27, -3, 31.9030],
        [60.2574, -34.0099, 36.2677, 60.4626, -34.1751, 39.4387, 1.2644],
        [22.7233, 20.0904, -46.6940, 23.0331, 14.9730, -42.5619, 2.0373],
        [90.8027, -2.0831, 1.4410, 91.1528, -1.6435, 0.0447, 1.4441],
        [2.0776, 0.0795, -1.1350, 0.9033, -0.0636, -0.5514, 0.9082],
    ]
)
"""Two colours in CIELAB and their difference, as [Sharma2005] prints them."""


@pytest.fixture(scope="module")
def science():
    return colour_science()


def test_the_chart_of_2014_has_the_maker_s_lab_values():
    """Cyan has a red below 0 in sRGB, and is kept."""
    rgb = chart_reflectance("2014")
    xyz = np.linalg.solve(RGB_FROM_XYZ @ D65_FROM_D50, rgb.T).T / D50_WHITE
    f = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz / (3 * (6 / 29) ** 2) + 4 / 29)
    lab = np.stack(
        [116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], axis=1
    )
    for patch, expected in PUBLISHED_LAB_2014.items():
        np.testing.assert_allclose(lab[patch], expected, atol=1e-9)
    assert rgb[17, 0] < 0


def test_the_two_charts_differ_by_what_makers_and_prints_differ(science):
    apart = delta_e_2000(lab_from_linear(KNOWN), lab_from_linear(chart_reflectance("2014")))
    assert 0.5 < apart.mean() < 2.5
    assert apart.max() < 4


def test_colour_differences_are_the_published_ones():
    found = delta_e_2000(SHARMA[:, :3], SHARMA[:, 3:6])
    np.testing.assert_allclose(found, SHARMA[:, 6], atol=5.1e-5)
    np.testing.assert_allclose(delta_e_2000(SHARMA[:, 3:6], SHARMA[:, :3]), found, atol=1e-12)
    assert delta_e_2000(SHARMA[:, :3], SHARMA[:, :3]).max() == 0
    assert np.isnan(delta_e_2000([np.nan, 0, 0], [50.0, 0, 0]))


def test_colour_science_is_imported_without_a_word_and_numbers_are_printed_as_before():
    code = """
import numpy as np
from processing.colour_difference import colour_science, delta_e_2000
before = repr(np.float64(0.5))
delta_e_2000([50.0, 0, 0], [50.0, 1, 0])
print(before == repr(np.float64(0.5)))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("True\n", "")


def test_a_measured_chart_is_read_and_a_malformed_one_refused(tmp_path):
    path = tmp_path / "chart.json"
    path.write_text(json.dumps({"schema": "lightstage.chart/1", "reflectance": KNOWN.tolist()}))
    np.testing.assert_array_equal(chart_reflectance(str(path)), KNOWN)
    for wrong in (KNOWN[:23].tolist(), (KNOWN * 255).tolist(), "white", None):
        path.write_text(json.dumps({"schema": "lightstage.chart/1", "reflectance": wrong}))
        with pytest.raises(FormatError, match="24 times r, g, b"):
            chart_reflectance(str(path))
    with pytest.raises(FormatError, match="classic, 2014 or a JSON file"):
        chart_reflectance("clasic")


def test_a_linear_camera_s_matrix_is_recovered_under_uneven_light():
    rng = np.random.default_rng(4)
    white = rng.uniform(0.5, 2.0, (24, 1)) * [1.0, 0.97, 0.9]
    raw = (KNOWN * white) @ RAW_FROM_LINEAR.T
    fit = fit_colour([sample(raw, white)], KNOWN, CONFIG, exposure=0.02)
    np.testing.assert_allclose(fit.matrix @ RAW_FROM_LINEAR, np.eye(3), atol=1e-10)
    assert fit.facts["used"] == "matrix"
    assert fit.correction.exposure == 0.02
    assert fit.facts["delta_e"]["white_balance_alone"] > 2
    assert fit.facts["delta_e"]["largest"] == 0
    assert fit.facts["neutral_scale"] == 1


def test_a_camera_that_bends_colours_gets_the_root_polynomial():
    terms = np.concatenate([1.6 * np.linalg.inv(RAW_FROM_LINEAR), 0.25 * (1 - 2 * np.eye(3))], 1)
    raw = np.array(
        [
            least_squares(
                lambda x, c=colour: terms @ root_terms(x) - c,
                RAW_FROM_LINEAR @ colour,
                bounds=(1e-6, 10),
                xtol=1e-15,
                ftol=1e-15,
                gtol=1e-15,
            ).x
            for colour in KNOWN
        ]
    )
    fit = fit_colour([sample(raw)], KNOWN, CONFIG)
    held = fit.facts["held_out_delta_e"]
    assert fit.facts["used"] == "root_polynomial"
    assert held["root_polynomial"]["all"] < 0.1 * held["matrix"]["all"]
    np.testing.assert_allclose(fit.correction.apply(raw), KNOWN, atol=1e-3)
    alone = fit_colour([sample(raw)], KNOWN, dataclasses.replace(CONFIG, use="matrix"))
    assert alone.correction.root_polynomial is None
    assert alone.facts["delta_e"]["mean"] > 5 * fit.facts["delta_e"]["mean"]


def test_measured_cameras_under_leds_read_colours_far_better_than_by_white_balance(science):
    """Spectra of chart, LEDs and two cameras from colour-science: a camera that is not linear."""
    shape = science.SpectralShape(400, 700, 10)

    def values(spectra):
        return spectra.copy().align(shape).values

    chart = np.array([values(sd) for sd in science.SDS_COLOURCHECKERS["ISO 17321-1"].values()])
    eye = values(science.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"])
    eye = eye * values(science.SDS_ILLUMINANTS["D65"])[:, None]
    known = science.XYZ_to_RGB((chart @ eye) / eye[:, 1].sum(), "sRGB")
    for name in science.MSDS_CAMERA_SENSITIVITIES:
        for led in ("LED-B3", "LED-B5", "LED-V2"):
            light = values(science.SDS_ILLUMINANTS[led])[:, None]
            sensor = values(science.MSDS_CAMERA_SENSITIVITIES[name]) * light
            raw = chart @ sensor / sensor[:, 1].sum()
            fit = fit_colour([sample(raw)], known, CONFIG)
            before = fit.facts["delta_e"]["white_balance_alone"]
            assert before > 5
            assert fit.facts["delta_e"]["mean"] < 0.3 * before
            assert fit.facts["held_out_delta_e"]["matrix"]["all"] < 0.45 * before
            assert abs(fit.facts["neutral_scale"] - 1) < 0.015


def test_the_root_polynomial_is_used_only_where_held_out_skin_gains_as_well(science):
    rng = np.random.default_rng(8)
    raw = KNOWN @ RAW_FROM_LINEAR.T
    bent = raw.copy()
    bent[2:18] = (raw + 0.1 * (root_terms(raw)[:, 3:] - raw))[2:18]  # all patches but skin, greys
    fit = fit_colour([sample(bent + rng.normal(0, 1e-5, raw.shape))], KNOWN, CONFIG)
    held = fit.facts["held_out_delta_e"]
    assert held["root_polynomial"]["skin"] > 0.9 * held["matrix"]["skin"]
    assert fit.facts["used"] == "matrix"


def test_glare_clipping_and_what_is_no_number_are_left_out_and_reported():
    raw = KNOWN @ RAW_FROM_LINEAR.T
    raw[13] += 0.3  # glare
    raw[4] = np.nan
    cut = np.zeros(24)
    cut[18] = 0.2
    fit = fit_colour([sample(raw, clipped=cut)], KNOWN, CONFIG)
    assert fit.facts["left_out"] == {"clipped": [5, 19], "unlike_the_chart": [14]}
    np.testing.assert_allclose(fit.matrix @ RAW_FROM_LINEAR, np.eye(3), atol=1e-9)
    json.dumps(fit.facts, allow_nan=False)


def test_too_few_patches_are_an_error_that_states_how_many():
    raw = KNOWN @ RAW_FROM_LINEAR.T
    cut = np.zeros(24)
    cut[:9] = 1
    with pytest.raises(ProcessingError, match="15 of 24 usable chart patches, 6 of them neutral"):
        fit_colour([sample(raw, clipped=cut)], KNOWN, CONFIG)
    cut = np.zeros(24)
    cut[18:22] = 1
    with pytest.raises(ProcessingError, match="20 of 24 usable chart patches, 2 of them neutral"):
        fit_colour([sample(raw, clipped=cut)], KNOWN, CONFIG)


@settings(deadline=None, max_examples=25)
@given(
    st.sampled_from([1e-6, 1e-3, 1.0, 1e3, 1e6]),
    st.sampled_from([1e-6, 1.0, 1e6]),
    st.integers(0, 2**31),
)
def test_a_fit_does_not_depend_on_the_scale_of_light_or_counts(light, counts, seed):
    rng = np.random.default_rng(seed)
    raw = KNOWN @ RAW_FROM_LINEAR.T * rng.uniform(0.97, 1.03, (24, 3))
    one = fit_colour([sample(raw)], KNOWN, CONFIG)
    other = fit_colour([sample(raw * counts * light, light)], KNOWN, CONFIG)
    np.testing.assert_allclose(other.matrix * counts, one.matrix, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(other.read, one.read, atol=1e-6)
    assert other.facts["used"] == one.facts["used"]
