"""A step's speed: precision and compiling where the device has them, and the same numbers."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import pytest
import torch
from torch._dynamo.exc import TorchDynamoException

from learning import forward
from learning.checkpoint import save_checkpoint
from learning.errors import CheckpointError, TrainingError
from learning.forward import Forward, autocast_dtype
from learning.networks.discriminator import DiscriminatorConfig, Discriminators
from learning.networks.whole_face import WholeFace, WholeFaceConfig, WholeFaceNetwork
from learning.run import begin
from learning.whole.config import WholeTrainConfig
from lightstage.errors import ConfigError
from lightstage.formats.config import as_dict
from processing.dataset import open_store

CPU, CUDA = torch.device("cpu"), torch.device("cuda:0")
PLAIN = WholeTrainConfig(compile="off", precision="float32")


def test_half_the_width_is_for_gpus_that_have_it_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    has = {"it": True}
    monkeypatch.setattr(torch.cuda, "is_bf16_supported", lambda **_: has["it"])
    assert autocast_dtype("auto", CUDA) == autocast_dtype("bf16", CUDA) == torch.bfloat16
    assert autocast_dtype("float32", CUDA) is None
    assert (
        autocast_dtype("auto", CPU)
        is autocast_dtype("float32", CPU)
        is autocast_dtype("auto", torch.device("mps"))
    )
    for device in (CPU, torch.device("mps")):
        with pytest.raises(ConfigError, match=f"precision: found bf16, on {device}"):
            autocast_dtype("bf16", device)
    has["it"] = False
    assert autocast_dtype("auto", CUDA) is None
    with pytest.raises(ConfigError, match="computes no bfloat16"):
        autocast_dtype("bf16", CUDA)


def test_what_is_computed_in_half_the_width_comes_out_as_float32_and_near(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    torch.manual_seed(0)
    face = WholeFaceNetwork(WholeFaceConfig(rows=16, columns=16, width=4, halvings=1))
    torch.nn.init.normal_(face.here.weight, std=0.1)
    judges = Discriminators(5, DiscriminatorConfig(width=4, layers=1, scales=2))
    inputs = torch.rand(2, 10, 16, 16)
    plain: Forward[WholeFace] = Forward(face, CPU, PLAIN)
    assert torch.equal(plain(inputs).diffuse_albedo, face(inputs).diffuse_albedo)
    # A processor can do it too, only slower: the wiring is the same.
    monkeypatch.setattr(forward, "autocast_dtype", lambda *_: torch.bfloat16)
    half: Forward[WholeFace] = Forward(face, CPU, PLAIN)
    output, expected = half(inputs), face(inputs)
    for field in dataclasses.fields(output):
        value, true = getattr(output, field.name), getattr(expected, field.name)
        assert value.dtype == torch.float32
        torch.testing.assert_close(value, true, rtol=0.03, atol=0.003)
    assert not torch.equal(output.diffuse_albedo, expected.diffuse_albedo)
    judged: Forward[list[list[torch.Tensor]]] = Forward(judges, CPU, PLAIN)
    assert {f.dtype for scale in judged(inputs[:, :5]) for f in scale} == {torch.float32}
    output.diffuse_albedo.mean().backward()
    assert face.here.weight.grad is not None
    assert face.here.weight.grad.dtype == torch.float32


def test_a_network_that_cannot_be_compiled_runs_as_it_is_unless_it_must_be(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tried: list[str] = []

    def compiler(network: Any) -> Any:
        def call(_: torch.Tensor) -> None:
            tried.append("call")
            raise TorchDynamoException("no compiler")

        return call

    monkeypatch.setattr(torch, "compile", compiler)
    network, inputs = torch.nn.Conv2d(3, 1, 1), torch.rand(1, 3, 4, 4)
    for way in ("off", "auto"):
        config = dataclasses.replace(PLAIN, compile=way)  # type: ignore[arg-type]
        called: Forward[torch.Tensor] = Forward(network, CPU, config)
        assert torch.equal(called(inputs), network(inputs))
    assert not tried
    must: Forward[torch.Tensor] = Forward(network, CPU, dataclasses.replace(PLAIN, compile="on"))
    with pytest.raises(TrainingError, match=r'compile: found TorchDynamoException.*"off"'):
        must(inputs)
    # As on a GPU, where it is tried and left be.
    must._must = False
    for _ in range(2):
        assert torch.equal(must(inputs), network(inputs))
    assert tried == ["call"] * 2


def test_how_fast_to_go_on_is_free_and_what_to_learn_is_not(
    store_path: Path, tmp_path: Path
) -> None:
    store = open_store(store_path)
    about = {
        "family": "whole_face",
        "config": as_dict(PLAIN),
        "data_fingerprint": store.fingerprint,
        "held_out": [],
        "texture_rows": 96,
        "metrics": {},
    }
    save_checkpoint(tmp_path / "run", 3, {}, about)
    other = WholeTrainConfig(compile="on", precision="auto", seconds=3.0)
    taken: list[int] = []
    run = begin(tmp_path / "run", other, store, set(), True, lambda c: taken.append(c.step))
    assert (run.first, taken) == (3, [3])
    with pytest.raises(CheckpointError, match="seed: found 9 now, expected 0, as the run began"):
        begin(tmp_path / "run", dataclasses.replace(other, seed=9), store, set(), True, print)
