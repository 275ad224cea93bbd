"""What is computed on a CUDA GPU is what a processor computes. Without one these tests skip."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from learning.devices import CPU, choose_device, memory_of, moved
from learning.errors import DeviceMemoryError
from learning.render.shading import Mode, ShadeOptions, shade
from learning.train import train
from learning.whole.infer import infer_whole_face
from lightstage.formats.mesh import Mesh
from processing.dataset import open_store
from tests.learning.scenes import random_lights, random_skin
from tests.learning.test_processes import ALL
from tests.learning.test_whole_face import PLAIN, faces_of

CUDA = torch.device("cuda:0")
pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA GPU is there")


@pytest.mark.parametrize("mode", ["paper", "physical", "ggx", "dielectric"])
def test_a_gpu_shades_as_the_processor_does(mode: Mode) -> None:
    skin, lights = random_skin(np.random.default_rng(0)), random_lights(np.random.default_rng(1))
    for sigma in (0.0, 1.5):
        options = ShadeOptions(mode, subsurface_mm=sigma)
        expected = shade(skin, lights, options)
        found = shade(moved(skin, CUDA), moved(lights, CUDA), options)
        assert found.device == CUDA
        assert torch.allclose(found.cpu(), expected, rtol=2e-3, atol=2e-4)


def test_faces_are_lit_on_a_gpu_as_on_the_processor(store_path: Path) -> None:
    one, other = faces_of(store_path, PLAIN), faces_of(store_path, PLAIN, lit_on=CUDA)
    expected = one.draw(4, np.random.default_rng(5))
    found = other.draw(4, np.random.default_rng(5))
    for field in dataclasses.fields(expected):
        there, here = getattr(found, field.name), getattr(expected, field.name)
        assert there.device == CUDA
        assert torch.allclose(there.cpu(), here, rtol=2e-3, atol=1e-3), field.name


@pytest.mark.parametrize("family", ALL)
def test_each_family_trains_on_a_gpu_as_on_the_processor(
    family: str, store_path: Path, tmp_path: Path
) -> None:
    config, load = ALL[family]
    config = dataclasses.replace(config, precision="float32", compile="off", log_steps=1)
    store, lines = open_store(store_path), {}
    for name, device in (("processor", CPU), ("gpu", CUDA)):
        out = tmp_path / name
        train(store, out, config, device=device)
        lines[name] = json.loads((out / "metrics.jsonl").read_text().splitlines()[0])
        assert all(bool(value.isfinite().all()) for value in load(out)[0].state_dict().values())
    for name, value in lines["processor"].items():
        if isinstance(value, float) and "second" not in name:
            assert lines["gpu"][name] == pytest.approx(value, rel=0.02, abs=1e-3), name


def test_a_training_in_bfloat16_and_compiled_stays_near_one_in_float32(
    store_path: Path, tmp_path: Path
) -> None:
    config, _ = ALL["faces"]
    store, last = open_store(store_path), {}
    for precision, compiled in (("float32", "off"), ("bf16", "on")):
        chosen = dataclasses.replace(
            config, steps=30, precision=precision, compile=compiled, log_steps=1
        )
        out = tmp_path / precision
        train(store, out, chosen, device=CUDA)
        lines = [json.loads(line) for line in (out / "metrics.jsonl").read_text().splitlines()]
        last[precision] = np.mean([line["diffuse"] for line in lines[-11:-1]])
    assert last["bf16"] == pytest.approx(last["float32"], rel=0.15)


def test_a_run_begun_on_a_gpu_goes_on_on_the_processor(store_path: Path, tmp_path: Path) -> None:
    config, _ = ALL["faces"]
    config = dataclasses.replace(config, compile="off", seconds=1.0)
    store = open_store(store_path)
    first = train(store, tmp_path, config, device=CUDA)
    longer = dataclasses.replace(config, seconds=2.0)
    assert train(store, tmp_path, longer, resume=True).steps > first.steps > 0


def test_a_texture_gives_the_same_maps_on_a_gpu(
    store_path: Path, tmp_path: Path, ball_mesh: Mesh
) -> None:
    config, load = ALL["faces"]
    train(open_store(store_path), tmp_path, config)
    texture = np.random.default_rng(1).uniform(0.1, 0.5, (96, 64, 3)).astype(np.float32)
    network = load(tmp_path)[0].eval()
    here, there = (
        infer_whole_face(network, texture, ball_mesh, device=device).maps for device in (CPU, CUDA)
    )
    for name, expected in here.items():
        assert np.allclose(there[name], expected, atol=5e-3), name


def test_a_full_gpu_is_one_message(tmp_path: Path) -> None:
    with pytest.raises(DeviceMemoryError, match="memory of cuda:0"), memory_of(CUDA, tmp_path, "x"):
        torch.empty(1 << 44, device=CUDA)


def test_float32_keeps_its_bits_on_a_gpu() -> None:
    rng = np.random.default_rng(0)
    weights = torch.from_numpy(rng.normal(size=(64, 64, 3, 3)).astype(np.float32))
    image = torch.from_numpy(rng.normal(size=(1, 64, 32, 32)).astype(np.float32))
    expected = torch.nn.functional.conv2d(image.double(), weights.double())
    there = choose_device("cuda")
    found = torch.nn.functional.conv2d(image.to(there), weights.to(there)).cpu()
    assert float((found - expected).abs().max() / expected.abs().max()) < 1e-5
