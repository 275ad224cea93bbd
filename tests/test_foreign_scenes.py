"""The scenes of `benchmarks.foreign`: their lines say what exists, and no person sits twice."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.foreign import MESHES, OTHER_TARGETS, SCORES, TARGETS, row_path, table
from benchmarks.foreign_cases import ALPHAS, CAMERAS, CASES, RIGS, WORN
from benchmarks.foreign_hair import narrow_gaps_filled
from sim.foreign.materials import MATERIALS


def test_each_line_names_what_exists_and_no_person_sits_in_two() -> None:
    for case in CASES.values():
        assert case.who in ("parametric", "ict")
        assert 1 <= case.tone <= 6
        assert case.material in MATERIALS
        assert set(case.wears) <= set(WORN)
        assert case.gloss in ALPHAS
        assert case.rig in RIGS
        assert case.camera in CAMERAS
        assert case.stretch == 1 or case.material == "lambert-ggx"
    seeds = [case.seed for case in CASES.values()]
    assert len(set(seeds)) == len(seeds)


def test_both_halves_have_each_material_both_skins_and_both_kinds_of_people() -> None:
    for seen in (True, False):
        half = [case for case in CASES.values() if case.seen == seen]
        assert {case.material for case in half} == set(MATERIALS)
        assert {case.skin for case in half} == {"light", "dark"}
        assert {case.who for case in half} == {"parametric", "ict"}
        assert {case.camera for case in half} == set(CAMERAS)
        assert {case.gloss for case in half} == set(ALPHAS)
        assert {case.rig for case in half} == set(RIGS)
        assert any(case.lamps for case in half)
        assert any(case.wears for case in half)


def test_a_table_has_the_rows_that_are_kept_and_means_beside_their_targets(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("benchmarks.foreign.code_version", lambda: "0123456789abcdef")
    row = dict.fromkeys(SCORES, 1.0) | {"seconds": 10.0, "mib": 100.0}
    for name, value in (("lambert-ggx", 1.0), ("burley", 3.0), ("principled", 5.0)):
        path = row_path(tmp_path, 300, name, "own")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(row | {"all": value}))
    names = ["lambert-ggx", "principled", "burley", "oily"]
    rows = table(names, tmp_path, 300)
    assert [line[0] for line in rows[:3]] == ["lambert-ggx", "principled", "burley"]
    assert len(rows) == 3 + 4
    assert rows[3][:4] == ("**mean of 2**", "light", "own", "2.00 / 1.00")
    assert rows[4][:4] == ("*target*", "light", "own", "1.20 / 0.90")
    assert rows[5][:4] == ("**mean of 1**", "dark", "own", "5.00 / 1.00")
    assert table(names, tmp_path, 360) == []
    assert set(TARGETS) == {(skin, mesh) for skin in OTHER_TARGETS for mesh in MESHES}


def test_a_scene_is_one_line() -> None:
    first = next(iter(CASES.values()))
    assert dataclasses.replace(first, seed=900).seen is False


def test_gaps_between_hairs_are_filled_and_the_edge_of_a_collar_is_none() -> None:
    hairs = np.zeros((60, 60), bool)
    hairs[10:30, 10:40:3] = True
    collar = np.zeros((60, 60), bool)
    collar[45:] = True
    filled = narrow_gaps_filled(hairs | collar, 4.0)
    assert filled[12:28, 12:38].all()
    assert not filled[40:44].any()
    assert not filled[:5].any()
    assert not filled[:, 50:][:40].any()
    assert not narrow_gaps_filled(np.zeros((9, 9), bool), 4.0).any()
