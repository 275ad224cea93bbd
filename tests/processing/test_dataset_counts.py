"""A release counts, and shows means of, only the people whose patches it holds."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from lightstage.formats.processed import ProcessedFolder
from processing.dataset import build_store
from tests.processing.releases import SEED, SMALL, Make, open_in_memory, publish, read


def test_statistics_need_enough_people(tmp_path: Path, make_processed: Make) -> None:
    roots = [make_processed(tmp_path / str(i), 192, 128, subject=f"p{i}", seed=i) for i in range(3)]

    def statistics(count: int) -> dict:
        store = open_in_memory(build_store(roots[:count], tmp_path / "store"))
        out = publish(store, tmp_path / "out", SEED, SMALL)
        return json.loads((out / "dataset.json").read_text())["statistics"]

    assert statistics(2) == {}
    shown = statistics(3)
    albedo = read(tmp_path / "out", "diffuse_albedo").astype(float)
    seen = read(tmp_path / "out", "diffuse_normal").any(axis=3)
    np.testing.assert_allclose(shown["diffuse_albedo_mean"], albedo[seen].mean(axis=0), rtol=1e-6)
    np.testing.assert_allclose(shown["shape_mean"], 0, atol=1e-4)


def test_people_of_whom_no_patch_is_shown_do_not_count(
    tmp_path: Path, make_processed: Make
) -> None:
    roots = [make_processed(tmp_path / str(i), 192, 128, subject=f"p{i}", seed=i) for i in range(3)]
    for root in roots[1:]:
        ProcessedFolder(root).write_atlas("skin", np.zeros((192, 128)))
    again = make_processed(tmp_path / "smile", 192, 128, subject="p0", seed=0, expression="smile")
    store = open_in_memory(build_store([*roots, again], tmp_path / "store"))
    facts = json.loads((publish(store, tmp_path / "out", SEED, SMALL) / "dataset.json").read_text())
    assert facts["counts"]["subjects"] == 1
    assert sum(facts["consent"][name] for name in ("subjects_on_record", "subjects_simulated")) == 1
    # One person's own means would be published.
    assert facts["statistics"] == {}
