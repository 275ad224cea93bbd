"""Checkpoints: whole however a save ends, and refused where they are not what was saved."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

import learning.checkpoint
from learning.checkpoint import (
    INDEX,
    load_generator,
    load_tensors,
    read_checkpoint,
    save_checkpoint,
)
from learning.errors import CheckpointError
from learning.networks.generator import Generator, GeneratorConfig
from lightstage.errors import ConfigError
from lightstage.formats.files import sha256_file

ROLES = ("generator", "training")
ABOUT = {
    "config": {},
    "data_fingerprint": "none",
    "held_out": [],
    "texture_rows": 96,
    "metrics": {},
}
KILLED_AT_EVERY_CHANGE = """
import json, os, shutil, signal, sys
from pathlib import Path
import torch
from learning.checkpoint import save_checkpoint

folder, roles, about = Path(sys.argv[1]), json.loads(sys.argv[2]), json.loads(sys.argv[3])

def save(step):
    tensors = {role: {"w": torch.full((8, 8), float(step))} for role in roles}
    save_checkpoint(folder, step, tensors, about)

def dies_before(left):
    # Whatever changes a name or is to reach the disk: the process is killed before the nth.
    def counted(real):
        def call(*args, **kwargs):
            left[0] -= 1
            if left[0] < 0:
                os.kill(os.getpid(), signal.SIGKILL)
            return real(*args, **kwargs)
        return call
    for name in ("replace", "fsync", "unlink"):
        setattr(os, name, counted(getattr(os, name)))

save(1)
for changes in range(1000):
    child = os.fork()
    if not child:
        dies_before([changes])
        save(changes + 2)
        os._exit(0)
    _, status = os.waitpid(child, 0)
    shutil.copytree(folder, folder.parent / f"kept-{changes:04d}")
    if status == 0:
        break
    assert os.WIFSIGNALED(status)
"""


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run folder with the weights of a network that was not trained."""
    config = GeneratorConfig(width=8, downsamplings=2, global_blocks=1, local_blocks=1)
    weights = {"generator": Generator(config).state_dict()}
    about = {**ABOUT, "config": {"generator": dataclasses.asdict(config)}}
    return save_checkpoint(tmp_path / "run", 1, weights, about).parent


def test_a_save_that_is_killed_anywhere_leaves_one_whole_checkpoint(tmp_path: Path) -> None:
    run = tmp_path / "run"
    run.mkdir()
    message = [str(run), json.dumps(ROLES), json.dumps(ABOUT)]
    subprocess.run([sys.executable, "-c", KILLED_AT_EVERY_CHANGE, *message], check=True)
    after = sorted(tmp_path.glob("kept-*"))
    assert len(after) > 8  # three files, each written, renamed and made to reach the disk
    before = 1
    for killed, folder in enumerate(after):
        checkpoint = read_checkpoint(folder)
        assert checkpoint.step in (before, killed + 2)
        before = checkpoint.step
        for role in ROLES:
            weights = load_tensors(checkpoint, role)["w"]
            assert torch.equal(weights, torch.full((8, 8), float(checkpoint.step)))
    assert before == len(after) + 1
    # What the killed saves left is removed by the next that comes to its end.
    left = {path.name for path in after[-1].iterdir()}
    files = read_checkpoint(after[-1]).files.values()
    assert left == {"checkpoint.json", *(entry["name"] for entry in files)}


def test_a_step_that_is_saved_again_and_killed_leaves_the_first_of_both(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The last step is saved among the steps, and again with its score and other weights."""

    def save(value: float) -> None:
        tensors = {role: {"w": torch.full((8, 8), value)} for role in ROLES}
        save_checkpoint(tmp_path / "run", 7, tensors, ABOUT)

    def held() -> set[float]:
        found = read_checkpoint(tmp_path / "run")
        return {float(load_tensors(found, role)["w"].mean()) for role in ROLES}

    def killed(*_: object) -> None:
        raise KeyboardInterrupt

    save(1.0)
    with monkeypatch.context() as patch:
        patch.setattr(learning.checkpoint, "write_json", killed)
        with pytest.raises(KeyboardInterrupt):
            save(2.0)
    assert held() == {1.0}
    for value in (3.0, 4.0):
        save(value)
        assert held() == {value}
        assert len(list((tmp_path / "run").glob("*.safetensors"))) == len(ROLES)


def test_a_run_whose_name_has_a_full_stop_is_read_and_a_file_of_weights_is_not(run: Path) -> None:
    named = run.rename(run.with_name("run.v2"))
    assert read_checkpoint(named).step == read_checkpoint(named / INDEX).step == 1
    weights = next(named.glob("generator-*.safetensors"))
    with pytest.raises(CheckpointError, match=r"a file with the suffix '.safetensors'"):
        read_checkpoint(weights)


def test_damaged_checkpoints_are_refused(run: Path) -> None:
    weights = next(run.glob("generator-*.safetensors"))
    data = weights.read_bytes()
    weights.write_bytes(data[:-4])
    with pytest.raises(CheckpointError, match="other bytes than were saved"):
        load_generator(run)
    weights.unlink()
    with pytest.raises(CheckpointError, match="no such file"):
        load_generator(run)
    weights.write_bytes(data)
    value = json.loads((run / INDEX).read_text())
    value["config"]["generator"]["width"] = 16
    (run / INDEX).write_text(json.dumps(value))
    with pytest.raises(CheckpointError, match="those of the configured network"):
        load_generator(run)
    del value["step"]
    (run / INDEX).write_text(json.dumps(value))
    with pytest.raises(CheckpointError, match="step"):
        load_generator(run)


def test_weights_that_are_not_finite_are_refused(run: Path) -> None:
    weights = next(run.glob("generator-*.safetensors"))
    tensors = load_file(weights)
    name = sorted(tensors)[3]
    tensors[name].view(-1)[:2] = torch.nan
    save_file(tensors, weights)
    value = json.loads((run / INDEX).read_text())
    value["files"]["generator"]["sha256"] = sha256_file(weights)
    (run / INDEX).write_text(json.dumps(value))
    with pytest.raises(CheckpointError, match=f"{name}: found 2 NaN or infinite values"):
        load_generator(run)


def test_a_checkpoint_of_an_impossible_network_is_refused(run: Path) -> None:
    for width in (-8, 0, 10**9):
        value = json.loads((run / INDEX).read_text())
        value["config"]["generator"]["width"] = width
        (run / INDEX).write_text(json.dumps(value))
        with pytest.raises(ConfigError, match=f"generator.width: found {width}, expected 2 or"):
            load_generator(run)
