"""`occlusion --network`: what it trains, what it scores, and what it refuses."""

from __future__ import annotations

import itertools
import json
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from learning.occlusion_run import (
    SCORED,
    load_occlusion_network,
    read_head,
)
from learning.render.occlusion_model import load_occlusion
from learning.render.occlusion_score import unseen_lights
from lightstage.formats.environment import LightSet, write_lights
from lightstage.formats.mesh import read_mesh, write_obj
from lightstage.formats.processed import ProcessedFolder
from tests.learning.export.called import printed, refusal
from tests.learning.test_occlusion_network import saved
from tests.learning.test_render_commands import rig_file


def test_the_command_trains_beside_the_table_and_render_shades_with_the_network(
    people: list[ProcessedFolder], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "quick.toml").write_text("steps = 2\njoint_steps = 2\nregressed = 8\nbatch = 2\n")
    words = ["occlusion", "--directions", 64, "--out", tmp_path / "t.npz", "--json"]
    # A ball casts no shadow on itself; with a waist it does.
    person = ProcessedFolder(shutil.copytree(people[0].root, tmp_path / "person"))
    ball = read_mesh(person.registered_mesh)
    size = 1 - 0.7 * np.exp(-((ball.vertices[:, 1:2] / 30) ** 2))
    write_obj(ball.with_vertices(ball.vertices * size), person.registered_mesh)
    words += ["--head", person.registered_mesh, "--config", tmp_path / "quick.toml"]
    clock = itertools.count(100.0, 0.5)
    fake = SimpleNamespace(process_time=lambda: next(clock))
    monkeypatch.setattr("learning.render.occlusion_score.time", fake)
    monkeypatch.setattr("learning.occlusion_run.SCORED_SETS", 50)
    facts = json.loads(printed(*words, "--network", tmp_path / "own").splitlines()[-1])
    network, _ = load_occlusion_network(tmp_path / "own")
    sizes, rng = network.config, np.random.default_rng([0, SCORED])
    mesh = read_head(person.registered_mesh).mesh
    unseen = unseen_lights([mesh], sizes.rows, sizes.lights, 50, rng)
    table = unseen.by_table(load_occlusion(tmp_path / "t.npz"))
    pictures = {"table": table, "network": unseen.by_network(network), "no_shadows": 0 * table + 1}
    for name, seen in pictures.items():
        error = seen[:, unseen.covered] - unseen.truth[0]
        assert facts[f"score_{name}"] == pytest.approx(np.abs(error).mean(), rel=1e-4)
        root = np.sqrt(np.square(error).mean())
        assert facts[f"score_{name}_rms"] == pytest.approx(root, rel=1e-4)
    # Half a second for 50 sets.
    assert {facts[f"score_{name}_ms"] for name in ("rays", "table", "network")} == {10.0}
    assert facts["score_table"] < 0.8 * facts["score_no_shadows"]
    assert f"table {facts['score_table']:.4f}" in facts["said"]
    assert f"network {facts['score_network']:.4f}" in facts["said"]
    assert f"{facts['score_fitted']:.4f} before its joint steps" in facts["said"]
    about = json.loads((tmp_path / "own" / "checkpoint.json").read_text())
    assert about["metrics"]["network"] == facts["score_network"]
    assert about["step"] == 4

    lights = LightSet("k", np.array([[0.0, 300, 900], [500, 0, 700]]), np.ones((2, 3)), np.zeros(3))
    environment = write_lights(lights, tmp_path / "e.json")
    base = ["render", "--environment", environment, "--rig", rig_file(tmp_path)]
    base += ["--shadows", f"network:{tmp_path / 'own'}", "--out", tmp_path / "p.png"]
    printed(*base, "--maps", person.root / "atlas")
    (tmp_path / "p.png").unlink()
    assert "found 1 other head" in refusal(*base, "--maps", people[1].root / "atlas")
    assert not (tmp_path / "p.png").exists()
    base[base.index("--shadows") + 1] = "network:"
    assert "expected baked, table, none, table:FILE, network:FILE" in refusal(
        *base, "--maps", person.root / "atlas"
    )


@pytest.mark.parametrize(
    ("config", "words", "message"),
    [
        (
            "",
            ("--network", "NETWORK", "--rows", "100"),
            "occlusion.rows: found 100, expected a mul",
        ),
        ("", (), "--config: found"),
        (
            "[occlusion]\nrows = 96",
            ("--network", "NETWORK"),
            "occlusion.rows: found 96, expected n",
        ),
        ("[occlusion]\nlights = 0", ("--network", "NETWORK"), "occlusion.lights: found 0"),
        ("stepz = 3", ("--network", "NETWORK"), "stepz: found an unknown key"),
        ("", ("--network", "NETWORK", "--template", "T", "--head", "H"), "--head: found both"),
    ],
)
def test_a_network_that_cannot_be_trained_is_refused_before_any_work(
    config: str, words: tuple[str, ...], message: str, tmp_path: Path
) -> None:
    (tmp_path / "c.toml").write_text(config)
    named = [word.replace("NETWORK", str(tmp_path / "n")) for word in words]
    base = ["occlusion", "--out", tmp_path / "t.npz", "--config", tmp_path / "c.toml"]
    assert message in refusal(*base, *named)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["c.toml"]


def test_a_folder_with_something_else_in_it_is_kept(
    people: list[ProcessedFolder], tmp_path: Path
) -> None:
    taken = saved(tmp_path / "taken", read_mesh(people[0].registered_mesh))
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "a.txt").write_text("a")
    for folder, found in ((taken, "a run that is there already"), (tmp_path / "notes", "a.txt")):
        before = {p.name: p.read_bytes() for p in folder.iterdir()}
        words = ["occlusion", "--out", tmp_path / "t.npz", "--network", folder]
        assert f"found {found}" in refusal(*words)
        assert {p.name: p.read_bytes() for p in folder.iterdir()} == before
