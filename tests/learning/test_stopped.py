"""A training that is interrupted says which step is kept, where, and the command that goes on."""

from __future__ import annotations

import json
import os
import re
import shlex
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from learning import run as runs
from learning.checkpoint import read_checkpoint
from learning.presets import FAMILIES
from learning.processes import ALONE, Processes
from learning.stopped import stopped_training

PATCHES = """
batch = 2
seconds = 60
score_patches = 1
[generator]
width = 4
downsamplings = 1
global_blocks = 1
local_blocks = 1
[discriminator]
width = 4
scales = 1
[data]
patch_px = 32
stride_px = 32
shadow_rows = 16
shadow_sets = 1
patches_in_memory = 4
"""
TINY = {
    "patches": PATCHES,
    "four_networks": PATCHES,
    "whole_face": """
seconds = 60
batch = 2
detail_pairs = 1
doubt_faces = 2
score_lights = 1
[network]
rows = 24
columns = 16
width = 4
halvings = 1
[faces]
shadow_sets = 1
""",
    "super_resolution": """
steps = 40
batch = 2
score_lights = 1
[network]
groups = 1
blocks = 1
width = 8
reduction = 2
tail_width = 4
times = 2
[pictures]
patch_px = 8
count = 2
shadow_sets = 1
""",
    "mesostructure": """
seconds = 60
batch = 2
score_lights = 1
[network]
width = 2
[patches]
patch_px = 16
textures = 2
of_each = 2
shadow_sets = 1
""",
}


@pytest.fixture
def train(run_command: Callable[..., Any]) -> Callable[..., tuple[int, str, str]]:
    """Runs `train`: exit code, stdout, stderr."""

    def run(*words: str) -> tuple[int, str, str]:
        ended = run_command("learning", "train", *words)
        return ended.code, ended.out, ended.err

    return run


def interrupt_at(monkeypatch: pytest.MonkeyPatch, name: str, call: int) -> None:
    """Ctrl-C as a method of `Run` is called for the so many-th time."""
    real, calls = getattr(runs.Run, name), []

    def interrupted(self: runs.Run, *rest: object) -> object:
        calls.append(name)
        if len(calls) == call:
            os.kill(os.getpid(), signal.SIGINT)
        return real(self, *rest)

    monkeypatch.setattr(runs.Run, name, interrupted)


def asked(store: Path, out: Path, config: str) -> tuple[Path, list[str]]:
    """A run's folder, and the options of a training with such a configuration."""
    path = out.parent / "tiny.toml"
    path.write_text(config)
    return out, ["--data", str(store), "--out", str(out), "--config", str(path)]


def stop(*_: object) -> None:
    raise KeyboardInterrupt


@pytest.mark.parametrize("preset", FAMILIES)
def test_every_preset_reports_what_is_kept_and_a_line_that_resumes_it(
    preset: str,
    store_path: Path,
    tmp_path: Path,
    train: Callable[..., tuple[int, str, str]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    out, words = asked(store_path, tmp_path / "my run", TINY[FAMILIES[preset].family])
    words = [*words[:4], "--preset", preset, *words[4:], "--seed", "3"]
    with monkeypatch.context() as patch:
        interrupt_at(patch, "_mean", 2)
        code, text, errors = train(*words, "--json")
    assert code == 130
    assert read_checkpoint(out).step == 2
    found = re.fullmatch(r"Interrupted: step 2 is kept in (.*)\. To resume: (.*)", last(errors))
    assert found is not None, errors
    assert found[1] == str(out)
    assert json.loads(text)["error"]["message"] == last(errors)
    line = shlex.split(found[2])
    assert line[:2] == ["lightstage-learning", "train"]
    assert line[2:] == [*words, "--device", "auto", "--resume"]
    with monkeypatch.context() as patch:
        interrupt_at(patch, "_mean", 1)
        code, _, errors = train(*line[2:])
    assert (code, read_checkpoint(out).step) == (130, 3)
    assert "step 3 is kept" in last(errors)


def last(told: str) -> str:
    return told.splitlines()[-1]


def test_an_interrupt_before_the_first_step_reports_that_nothing_is_kept(
    store_path: Path,
    tmp_path: Path,
    train: Callable[..., tuple[int, str, str]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    out, words = asked(store_path, tmp_path / "run", TINY["whole_face"])
    monkeypatch.setattr("learning.train.weights_of", stop)
    code, _, errors = train(*words, "--begin-with", "shipped")
    assert code == 130
    assert f"no step is kept in {out}. Begin again with: lightstage-learning train" in last(errors)
    assert "--begin-with shipped" in last(errors)
    assert "--resume" not in errors


def test_an_interrupt_while_people_are_scored_keeps_all_steps(
    store_path: Path,
    tmp_path: Path,
    train: Callable[..., tuple[int, str, str]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    out, words = asked(
        store_path, tmp_path / "run", TINY["whole_face"].replace("seconds = 60", "steps = 3")
    )
    monkeypatch.setattr("learning.whole.train.score_faces", stop)
    code, _, errors = train(*words)
    assert (code, read_checkpoint(out).step) == (130, 3)
    assert "step 3 is kept" in last(errors)


def test_several_processes_are_resumed_as_several(tmp_path: Path) -> None:
    options = {"--data": tmp_path / "S", "--out": tmp_path / "R", "--seconds": None}
    message = str(stopped_training(tmp_path / "R", options, Processes(0, 4, 0)))
    line = f"torchrun --nproc-per-node 4 -m learning train --data {tmp_path}/S --out {tmp_path}/R"
    assert message.endswith(line)
    assert "torchrun" not in str(stopped_training(tmp_path / "R", options, ALONE))
