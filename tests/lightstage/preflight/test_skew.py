"""Time between the cameras' triggers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.preflight import SkewReport, skew_findings
from lightstage.preflight.skew import shot_skew_s


def test_each_camera_is_counted_from_the_first_of_its_shot():
    report = SkewReport()
    report.add({"cam0": 10.0, "cam1": 10.002, "cam2": 10.001})
    report.add({"cam0": 20.004, "cam1": 20.0})
    report.add({"cam1": 30.0, "cam0": 30.0, "cam2": 30.005})
    assert report.facts() == {
        "cam0": {"shots": 3, "median_s": 0.0, "p95_s": 0.0036, "max_s": 0.004},
        "cam1": {"shots": 3, "median_s": 0.0, "p95_s": 0.0018, "max_s": 0.002},
        "cam2": {"shots": 2, "median_s": 0.003, "p95_s": 0.0048, "max_s": 0.005},
    }


def test_no_shots_have_no_figures():
    assert SkewReport().facts() == {}
    assert shot_skew_s({}) == 0.0


def test_a_warning_comes_over_the_limit_only():
    shot = {"cam0": 5.0, "cam1": 5.03}
    assert skew_findings("x+", shot, 0.03001) == []
    (finding,) = skew_findings("x+", shot, 0.02)
    assert (finding.severity, finding.pattern) == ("warn", "x+")
    assert "30.0 ms" in finding.found
    assert "cam1" in finding.found


times = st.one_of(st.floats(-1e6, 1e6), st.sampled_from([np.nan, np.inf, -np.inf]))
shots = st.lists(st.dictionaries(st.sampled_from(["a", "b", "c"]), times), max_size=8)


@given(shots)
def test_figures_are_in_order_and_never_negative(shots):
    report = SkewReport()
    for shot in shots:
        report.add(shot)
        assert shot_skew_s(shot) >= 0
        assert len(skew_findings("x", shot, 0.0)) <= 1
    for figures in report.facts().values():
        assert 0 <= figures["median_s"] <= figures["p95_s"] <= figures["max_s"]


def test_the_largest_skew_is_the_largest_offset():
    rng = np.random.default_rng(3)
    report = SkewReport()
    spans = []
    for _ in range(20):
        shot = {f"cam{i}": float(t) for i, t in enumerate(rng.random(9))}
        report.add(shot)
        spans.append(shot_skew_s(shot))
    largest = max(f["max_s"] for f in report.facts().values())
    assert largest == pytest.approx(max(spans), abs=1e-6)
