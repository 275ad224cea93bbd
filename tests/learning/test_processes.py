"""Several processes that train one network: as one process with the batch of all of them."""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import socket
import subprocess
import sys
import time
import typing
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
import torch

from learning.checkpoint import (
    INDEX,
    load_generator,
    load_super_resolution,
    load_tensors,
    load_whole_face,
    read_checkpoint,
)
from learning.errors import TrainingError
from learning.four.networks import load_four_networks
from learning.losses import RenderNorm, rendering_loss
from learning.patch_light import Scene
from learning.patch_train import PatchTrainer
from learning.processes import ALONE, Processes, started_by_torchrun
from learning.train import train
from lightstage import interrupts
from lightstage.errors import ConfigError
from processing.dataset import open_store
from tests.learning.test_four import TINY as FOUR
from tests.learning.test_training import TINY as PATCHES
from tests.learning.test_training import patches
from tests.learning.test_upscale import TINY as UPSCALE
from tests.learning.test_whole_face import TINY as FACES
from tests.learning.test_whole_face import faces_of

ONE_OF_TWO = """
import os
import sys
from pathlib import Path
import torch
from learning.__main__ import main
from learning.processes import joined, started_by_torchrun
from learning.train import train
from processing.dataset import open_store
from tests.learning.test_processes import ALL

torch.set_num_threads(1)
store, out = map(Path, sys.argv[1:3])
processes = started_by_torchrun()
with joined(processes, torch.device("cpu")):
    for family, (config, _) in ALL.items():
        train(open_store(store), out / family, config, processes=processes)
print("trained", flush=True)
os.environ["MASTER_PORT"] = sys.argv[3]
sys.argv[1:] = sys.argv[4:]
main()
"""
"""Trains each of `ALL`, then runs a command: to start a process takes as long as all of these."""
ALL: dict[str, tuple[Any, Any]] = {
    "faces": (
        dataclasses.replace(FACES, batch=4, steps=3, detail_pairs=1, score_lights=1),
        load_whole_face,
    ),
    "patches": (dataclasses.replace(PATCHES, batch=4, epochs=1, score_patches=1), load_generator),
    "super-resolution": (dataclasses.replace(UPSCALE, steps=3), load_super_resolution),
    "four": (dataclasses.replace(FOUR, batch=4, epochs=1, score_patches=1), load_four_networks),
}
"""Of each family: a short configuration, and what reads its weights."""


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def started(rank: int, port: int, *words: object) -> subprocess.Popen[str]:
    """One of two processes, as torchrun would start it."""
    values = {"RANK": rank, "LOCAL_RANK": rank, "WORLD_SIZE": 2, "MASTER_PORT": port}
    return subprocess.Popen(
        [sys.executable, *map(str, words)],
        env={**os.environ, "MASTER_ADDR": "127.0.0.1", **{k: str(v) for k, v in values.items()}},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@dataclasses.dataclass(frozen=True)
class Pair:
    """What two processes left, the second of which got a signal in the midst of a long training."""

    trained: Path
    stopped: Path
    codes: list[int]
    printed: list[tuple[str, str]]


@pytest.fixture(scope="module")
def pair(store_path: Path, tmp_path_factory: pytest.TempPathFactory) -> Pair:
    """Two processes that train each of `ALL`, and then one network for long."""
    folder = tmp_path_factory.mktemp("two")
    config, run = folder / "long.toml", folder / "run"
    config.write_text(
        "steps = 100000\nbatch = 2\nlog_steps = 1\n[faces]\nshadow_sets = 2\n"
        "[network]\nrows = 48\ncolumns = 32\nwidth = 4\n"
    )
    port, other = free_port(), free_port()
    words = ["-c", ONE_OF_TWO, store_path, folder / "two", other, "train", "--data", store_path]
    words += ["--out", run, "--config", config, "--device", "cpu"]
    both = [started(rank, port, *words) for rank in (0, 1)]
    metrics = run / "metrics.jsonl"
    while both[0].poll() is None and not (metrics.exists() and metrics.stat().st_size > 600):
        time.sleep(0.05)
    both[1].send_signal(signal.SIGTERM)
    printed = [process.communicate(timeout=300) for process in both]
    return Pair(folder / "two", run, [process.returncode for process in both], printed)


def test_two_processes_train_as_one_with_the_batch_of_both(
    pair: Pair, store_path: Path, tmp_path: Path
) -> None:
    for out, _ in pair.printed:
        assert out.startswith("trained\n"), pair.printed
    for family, (config, load) in ALL.items():
        train(open_store(store_path), tmp_path / family, config)
        runs = [tmp_path / family, pair.trained / family]
        lines = [
            [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
            for run in runs
        ]
        assert [line["step"] for line in lines[1]] == [0, 1, 2, 3]
        for alone, both in zip(*lines, strict=True):
            for name in {n for n in alone if n != "seconds" and not n.startswith("share_")}:
                # A correlation lies between -1 and 1: of a hardly trained network it is almost 0.
                least = 2e-3 if name.startswith("detail") else 1e-5
                assert both[name] == pytest.approx(alone[name], rel=2e-3, abs=least), name
        first, second = (load(run)[0].state_dict() for run in runs)
        for name, values in first.items():
            # What instance norm takes away, a bias, has a gradient of rounding alone, which Adam
            # makes as large as any other; and rounding turns the sign of a texel's absolute
            # difference, after which single weights differ. A step moves weights by 2e-3.
            if values.ndim > 1 or family == "faces":
                apart = (second[name] - values).double().square().mean().sqrt()
                assert float(apart) < 1e-4, name


@pytest.mark.parametrize("target", ["one", "each"])
def test_a_share_of_a_batch_is_what_the_whole_batch_has_there(
    target: Literal["one", "each"], store_path: Path
) -> None:
    """Examples, and the scenes of the rendering loss, are those of one process."""
    faces = faces_of(store_path, FACES.faces, FACES.augment)
    places = patches(store_path, dataclasses.replace(PATCHES.data, target=target), draws=2)
    for draw in (faces.draw, places.draw):
        whole = draw(4, np.random.default_rng(7))
        shares = [draw(4, np.random.default_rng(7), Processes(rank, 2).share(4)) for rank in (0, 1)]
        for name in ("inputs", "texture"):
            both = torch.cat([getattr(share, name) for share in shares])
            torch.testing.assert_close(both, getattr(whole, name), rtol=1e-5, atol=1e-6)
    batch = places.draw(4, np.random.default_rng(7))
    own = [Processes(rank, 2).share(4) for rank in (0, 1)]
    parts = [places.draw(4, np.random.default_rng(7), share) for share in own]
    for share, part in zip(own, parts, strict=True):
        assert len(part.draws) == len(batch.draws) == 2
        scenes = [(Scene(b.environment, b.visibility), *b.draws) for b in (batch, part)]
        for whole_scene, scene in zip(*scenes, strict=True):
            # Lights that fill up a set where another example has more are black.
            lights = scene.environment.rgb.shape[1]
            expected = whole_scene.environment.position_mm[share, :lights]
            assert torch.equal(scene.environment.position_mm, expected)
            assert torch.equal(scene.visibility, whole_scene.visibility[share, :lights])
            assert not whole_scene.environment.rgb[share, lights:].any()
    found = 0.3 * batch.target
    for norm in typing.get_args(RenderNorm):
        total = torch.zeros(())
        for share, part in zip(own, parts, strict=True):
            skin = dataclasses.replace(part.skin, texel_mm=batch.skin.texel_mm)
            value = rendering_loss(found[share], dataclasses.replace(part, skin=skin), norm)
            texels = part.covered.sum() / batch.covered.sum()
            total = total + value * (texels if norm == "texel" else 0.5)
        torch.testing.assert_close(total, rendering_loss(found, batch, norm), rtol=1e-5, atol=1e-7)


class Heavy(Processes):
    """A process alone, as if it had twice the texels of the mean process."""

    def weight(self, own: torch.Tensor) -> float:
        assert float(own) > 0
        return 2.0


@pytest.mark.parametrize(("norm", "times"), [("texel", 2.0), ("patch", 1.0)])
def test_a_mean_over_texels_counts_by_the_processs_texels_and_one_over_patches_does_not(
    norm: RenderNorm, times: float, store_path: Path
) -> None:
    batch = patches(store_path, draws=1).draw(2, np.random.default_rng(7))
    config = dataclasses.replace(PATCHES, render_norm=norm)
    one, heavy = (PatchTrainer(config, processes=p).step(batch) for p in (ALONE, Heavy()))
    for name, expected in {"rendering": times, "maps": 2.0, "error": 2.0, "features": 1.0}.items():
        assert heavy[name] == pytest.approx(expected * one[name], rel=1e-5), name


def test_a_batch_that_the_processes_cannot_share_is_refused() -> None:
    assert ALONE.share(3) == slice(0, 3)
    assert Processes(2, 3).share(6) == slice(4, 6)
    with pytest.raises(ConfigError, match="batch: found 4, for 3 processes, expected a multiple"):
        Processes(0, 3).share(4)


def test_what_torchrun_sets_is_read_and_half_of_it_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ("RANK", "WORLD_SIZE", "LOCAL_RANK", "MASTER_ADDR", "MASTER_PORT"):
        monkeypatch.delenv(name, raising=False)
    assert started_by_torchrun() == ALONE
    monkeypatch.setenv("RANK", "3")
    with pytest.raises(ConfigError, match=r"WORLD_SIZE.*as torchrun sets them"):
        started_by_torchrun()
    for name, value in (("WORLD_SIZE", "8"), ("LOCAL_RANK", "1"), ("MASTER_ADDR", "a"),
                        ("MASTER_PORT", "1")):  # fmt: skip
        monkeypatch.setenv(name, value)
    assert started_by_torchrun() == Processes(3, 8, 1)
    monkeypatch.setenv("LOCAL_RANK", "x")
    with pytest.raises(ConfigError, match="as torchrun sets them"):
        started_by_torchrun()


def test_a_process_whose_other_one_is_gone_reports_it(tmp_path: Path) -> None:
    alone = Processes(0, 2)
    # No group was joined, which torch tells by another error of the same class.
    with pytest.raises((TrainingError, ValueError), match="process"):
        alone.mean([1.0])


def test_a_signal_waits_for_the_end_of_what_is_held_and_an_impatient_one_does_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    handlers = {s: signal.getsignal(s) for s in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        interrupts.raise_on_signals()
        with interrupts.first_signal_noted() as signals:
            assert not signals.came
            os.kill(os.getpid(), signal.SIGTERM)
            os.kill(os.getpid(), signal.SIGTERM)
            assert signals.came
            monkeypatch.setattr(interrupts, "AGAIN_S", 0.0)
            with pytest.raises(KeyboardInterrupt):
                os.kill(os.getpid(), signal.SIGTERM)
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGTERM)
    finally:
        interrupts.raise_on_signals()
        for number, handler in handlers.items():
            signal.signal(number, handler)


def test_the_first_process_alone_writes_and_all_stop_after_the_same_step(pair: Pair) -> None:
    """One of two gets a signal in the midst: both end by it, and the checkpoint is whole."""
    assert pair.codes == [130, 130], pair.printed
    metrics = (pair.stopped / "metrics.jsonl").read_text()
    steps = [json.loads(line)["step"] for line in metrics.splitlines()]
    checkpoint = read_checkpoint(pair.stopped)
    assert steps == list(range(checkpoint.step))
    assert load_tensors(checkpoint, "training")["adam.0.step"] == checkpoint.step
    assert not list(pair.stopped.parent.glob(f"**/{INDEX}.*"))
