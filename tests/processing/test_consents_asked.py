"""Every command that uses a person's photographs asks the registry, by option or by environment."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from lightstage.rig import save_rig
from processing.dataset import build_store
from tests.processing import lit_ball
from tests.processing.lit_ball import Ball
from tests.processing.releases import ABOUT_FILE

Made = Callable[..., Any]
ABOUT = ("--about", ABOUT_FILE)


@pytest.fixture
def registry(tmp_path: Path) -> Path:
    consents = [
        {"id": "C-0001", "purposes": ["commercial"]},
        {"id": "C-0002", "purposes": ["research"], "withdrawn": "2020-01-01"},
    ]
    path = tmp_path / "consents.json"
    path.write_text(json.dumps({"schema": "lightstage.consents/1", "consent": consents}))
    return path


def refused(ended: Any, said: str) -> None:
    assert ended.code == 2, ended
    assert said in ended.err
    assert "Traceback" not in ended.err


def test_capture_asks_before_a_device_is_opened(
    registry: Path, tmp_path: Path, run_command: Made
) -> None:
    rig = save_rig(lit_ball.small_rig(1), tmp_path / "rig.json")
    words = ["capture", "--out", tmp_path / "new", "--rig", rig, "--leds", "serial:///dev/none"]
    words += ["--subject", "P1", "--consent", "C-0001", "--consents", registry]
    refused(run_command("lightstage", *words), "purpose capture: found C-0001 (P1) covers commerc")
    assert not (tmp_path / "new").exists()


def test_batch_asks_for_every_session(registry: Path, tmp_path: Path, run_command: Made) -> None:
    sessions = []
    for name, consent in (("a", "C-0001"), ("b", "C-0002"), ("c", None)):
        root = lit_ball.write_session(Ball(), lit_ball.small_rig(1, 0.015), tmp_path / name)
        file = root / "session.json"
        value = json.loads(file.read_text())
        file.write_text(json.dumps({**value, "id": name, "consent": consent}))
        sessions.append(root)
    words = ["batch", *sessions, "--out", tmp_path / "out", "--consents", registry]
    ended = run_command("processing", *words)
    refused(ended, f"purpose research: found C-0001 ({sessions[0]}) covers commercial")
    assert f"C-0002 ({sessions[1]}) was withdrawn on 2020-01-01" in ended.err
    assert f"{sessions[2]} carries no id" in ended.err
    assert not (tmp_path / "out").exists()


def test_build_asks_before_a_map_is_read_and_leaves_the_old_store(
    registry: Path, tmp_path: Path, make_processed: Made, run_command: Made
) -> None:
    people = [
        make_processed(tmp_path / name, subject=name, seed=i, consent=consent)
        for i, (name, consent) in enumerate((("p1", "C-0001"), ("p2", "C-0002"), ("p3", None)))
    ]
    store = build_store(people[:1], tmp_path / "store")
    before = (store / "dataset.json").read_bytes()
    (people[0] / "atlas" / "position.exr").write_bytes(b"")
    words = ["dataset", "build", *people, "--out", store, "--overwrite", "--consents", registry]
    ended = run_command("processing", *words)
    refused(ended, f"purpose research: found C-0001 (p1 in {people[0]}) covers commercial")
    assert f"C-0002 (p2 in {people[1]}) was withdrawn on 2020-01-01" in ended.err
    assert f"p3 in {people[2]} carries no id" in ended.err
    assert (store / "dataset.json").read_bytes() == before


def test_add_publish_and_train_ask_too(
    registry: Path,
    tmp_path: Path,
    make_processed: Made,
    run_command: Made,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    people = [make_processed(tmp_path / f"p{i}", subject=f"person-{i}", seed=i) for i in range(2)]
    store = build_store(people[:1], tmp_path / "store")
    new = tmp_path / "new"
    commands = {
        "research": ("processing", "dataset", "add", people[1], "--store", store),
        "publication": ("processing", "dataset", "publish", store, "--out", new, *ABOUT),
        "training": ("learning", "train", "--data", store, "--out", new, "--preset", "demo"),
    }
    for purpose, (program, *words) in commands.items():
        text = f"purpose {purpose}: found C-0001 (person-"
        refused(run_command(program, *words, "--consents", registry), text)
        assert not new.exists()
    monkeypatch.setenv("LIGHTSTAGE_CONSENTS", str(registry))
    program, *words = commands["publication"]
    refused(run_command(program, *words), "purpose publication")
    refused(run_command(program, *words, "--without-consent"), "registry of consents")
    value = json.loads(registry.read_text())
    value["consent"][0]["purposes"] = ["publication"]
    registry.write_text(json.dumps(value))
    ended = run_command(program, *words, "--patch", "8")
    assert ended.code == 0, ended.err
