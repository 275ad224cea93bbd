"""The moving average of weights: what it is, that it is kept, scored and inferred with."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from learning.average import follow, moving_average
from learning.checkpoint import (
    load_generator,
    load_super_resolution,
    load_tensors,
    load_whole_face,
    read_checkpoint,
)
from learning.four.networks import load_four_networks
from learning.train import train
from processing.dataset import open_store
from tests.learning.test_four import TINY as FOUR
from tests.learning.test_training import TINY as PATCHES
from tests.learning.test_upscale import TINY as UPSCALE
from tests.learning.test_whole_face import TINY as FACES
from tests.learning.test_whole_face import stopping_after

SHORT_FACES = dataclasses.replace(
    FACES,
    faces=dataclasses.replace(FACES.faces, shadow_sets=1),
    steps=5,
    detail_pairs=1,
    score_lights=1,
    ema=0.9,
)
SHORT_PATCHES = dataclasses.replace(PATCHES, score_patches=1, ema=0.9)
SHORT_UPSCALE = dataclasses.replace(
    UPSCALE,
    pictures=dataclasses.replace(UPSCALE.pictures, count=2, shadow_sets=1),
    steps=5,
    ema=0.9,
)
SHORT_FOUR = dataclasses.replace(FOUR, score_patches=1, batch=4, ema=0.9)
ALL: dict[str, tuple[Any, Any, str]] = {
    "faces": (SHORT_FACES, load_whole_face, "network"),
    "patches": (SHORT_PATCHES, load_generator, "generator"),
    "super-resolution": (SHORT_UPSCALE, load_super_resolution, "network"),
    "four": (SHORT_FOUR, load_four_networks, "generators"),
}


@pytest.mark.parametrize("decay", [0.0, 0.5, 0.999])
def test_an_average_is_that_of_a_plain_twin(decay: float) -> None:
    rng = np.random.default_rng(0)
    network = torch.nn.BatchNorm2d(3).double()
    average = moving_average(network)
    expected = np.ones(3)
    for number in range(30):
        values = rng.normal(size=3)
        with torch.no_grad():
            network.weight.copy_(torch.from_numpy(values))
            network.running_mean.fill_(number)  # type: ignore[union-attr]
        follow(average, network, decay, number)
        kept = min(decay, (1 + number) / (10 + number))
        expected = kept * expected + (1 - kept) * values
    np.testing.assert_allclose(average.weight.numpy(), expected, rtol=1e-12)
    assert torch.equal(average.running_mean, torch.full((3,), 29.0).double())  # type: ignore[arg-type]
    assert not average.weight.requires_grad
    assert network.weight.requires_grad


@pytest.mark.parametrize("family", ALL)
def test_a_resumed_training_has_the_same_bits_its_average_too(
    family: str, store_path: Path, tmp_path: Path
) -> None:
    """Of super-resolution, each step has a learning rate of its own."""
    config, load, role = ALL[family]
    store = open_store(store_path)
    straight = train(store, tmp_path / "a", config)
    with pytest.raises(KeyboardInterrupt):
        train(store, tmp_path / "b", config, progress=stopping_after(2))
    assert read_checkpoint(tmp_path / "b").step == 2
    assert train(store, tmp_path / "b", config, resume=True).score == straight.score
    first, second = (read_checkpoint(tmp_path / name) for name in "ab")
    assert first.files == second.files
    assert set(first.files) == {role, "average", "training"}
    raw, averaged = (load_tensors(first, name) for name in (role, "average"))
    found = load(tmp_path / "a")[0].state_dict()
    apart = 0.0
    for name, values in found.items():
        assert torch.equal(values, averaged[name])
        apart = max(apart, float((values - raw[name]).abs().max()))
    assert apart > 0
    # What is no weight is the same in both.
    for name in ("mean_log_albedo", "detail_shares", "mean_srgb"):
        if name in raw:
            assert torch.equal(raw[name], averaged[name])
