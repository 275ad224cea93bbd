"""Where networks run: the device asked for, what is said where it is missing or full."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from learning.checkpoint import save_tensors
from learning.commands import train_command
from learning.devices import choose_device, memory_of, moved
from learning.errors import DeviceMemoryError
from learning.render.environments import Environment
from learning.render.fused import FusedLight
from learning.render.shading import ShadeOptions, shade
from lightstage.commands import quiet
from lightstage.errors import ConfigError
from tests.learning.scenes import random_lights, random_skin


def two_gpus(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda index: f"GPU {index}")


def without_gpus(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(torch.backends.mps, "is_available", lambda: False)


def test_auto_takes_a_gpu_where_there_is_one_and_each_process_its_own(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    without_gpus(monkeypatch)
    assert choose_device() == torch.device("cpu")
    monkeypatch.setattr(torch.backends.mps, "is_available", lambda: True)
    assert choose_device() == torch.device("mps")
    two_gpus(monkeypatch)
    assert choose_device() == torch.device("cuda:0")
    assert choose_device("cuda", local_rank=1) == torch.device("cuda:1")
    assert choose_device("cuda:0", local_rank=1) == torch.device("cuda:0")
    assert choose_device("cpu") == torch.device("cpu")
    with pytest.raises(ConfigError, match=r"--device: found cuda:2, .*at most one process"):
        choose_device("auto", local_rank=2)


def test_a_device_that_is_not_there_is_named_with_those_that_are(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    without_gpus(monkeypatch)
    for asked, named in (("cuda", "cuda:0"), ("cuda:3", "cuda:3"), ("mps", "mps")):
        with pytest.raises(ConfigError, match=f"found {named}, which is not there.* is: cpu"):
            choose_device(asked)
    two_gpus(monkeypatch)
    with pytest.raises(ConfigError, match=r"is: cpu, cuda:0 \(GPU 0\), cuda:1 \(GPU 1\)"):
        choose_device("cuda:2")
    for asked in ("gpu", "", "cuda:", "cuda:-1", "cuda:1x", "CPU", "cuda:99999"):
        with pytest.raises(ConfigError, match="expected auto, cpu, cuda, cuda:N or mps"):
            choose_device(asked)


def test_a_device_is_checked_before_the_data_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    without_gpus(monkeypatch)
    with pytest.raises(ConfigError, match="--device"):
        train_command(
            tmp_path / "none", tmp_path / "out", "modern", None, 1.0, 0, False, quiet, "cuda"
        )


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (
            torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 GiB. GPU 0 has a"),
            "CUDA out of memory. Tried to allocate 2.00 GiB",
        ),
        (RuntimeError("MPS backend out of memory (MPS allocated: 9 GB)"), "MPS backend out of"),
    ],
)
def test_a_full_gpu_is_one_message_with_a_smaller_batch(
    error: RuntimeError,
    message: str,
    store_path: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def full(*_: object) -> None:
        raise error

    monkeypatch.setattr("learning.whole.train.face_losses", full)
    (tmp_path / "six.toml").write_text("batch = 6\nsteps = 3\n[faces]\nshadow_sets = 1\n")
    with pytest.raises(
        DeviceMemoryError, match=f"memory of cpu: found {message}.*batch = 3 "
    ) as caught:
        train_command(
            store_path, tmp_path / "out", "modern", tmp_path / "six.toml", None, 0, False, quiet,
            "cpu",
        )  # fmt: skip
    assert str(tmp_path / "out") in str(caught.value)
    assert not (tmp_path / "out" / "checkpoint.json").exists()


def test_other_errors_are_not_taken_for_a_full_gpu(tmp_path: Path) -> None:
    with (
        pytest.raises(RuntimeError, match="size of tensor"),
        memory_of(torch.device("cpu"), tmp_path, ""),
    ):
        raise RuntimeError("The size of tensor a must match")


@dataclasses.dataclass(frozen=True)
class Pair:
    one: torch.Tensor
    rest: list[torch.Tensor | None]
    named: dict[str, torch.Tensor]
    few: tuple[torch.Tensor, ...]
    count: int


def test_all_tensors_of_a_batch_are_moved_and_nothing_else_changes() -> None:
    there = torch.device("meta")
    pair = Pair(torch.ones(2), [torch.ones(3), None], {"a": torch.ones(4)}, (torch.ones(1),), 5)
    found = moved(pair, there)
    assert [found.one.device, found.rest[0].device, found.named["a"].device] == [there] * 3  # type: ignore[union-attr]
    assert [one.device for one in found.few] == [there]
    assert (found.rest[1], found.count) == (None, 5)
    assert moved(pair, torch.device("cpu")).one is pair.one


def test_the_compiled_shading_is_never_given_another_devices_tensors(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    skin, lights = random_skin(np.random.default_rng(0)), random_lights(np.random.default_rng(1))
    options = ShadeOptions(subsurface_mm=0)
    expected = shade(skin, lights, options).shape

    def called(*_: object) -> None:
        raise AssertionError("compiled code was called")

    monkeypatch.setattr(FusedLight, "apply", called)
    with pytest.raises(AssertionError, match="compiled code"):
        shade(skin, lights, options)
    there = torch.device("meta")
    found = shade(moved(skin, there), moved(lights, there), options)
    assert isinstance(moved(lights, there), Environment)
    assert found.device == there
    assert found.shape == expected


def test_checkpoints_hold_the_processors_tensors(tmp_path: Path) -> None:
    wide = torch.arange(24.0).reshape(2, 3, 2, 2).to(memory_format=torch.channels_last)
    weights = torch.nn.Parameter(wide)
    path = save_tensors(tmp_path / "w.safetensors", {"w": weights})
    assert torch.equal(load_file(path)["w"], wide)
    header = path.read_bytes()
    assert json.loads(header[8 : 8 + int.from_bytes(header[:8], "little")])["w"]["dtype"] == "F32"
