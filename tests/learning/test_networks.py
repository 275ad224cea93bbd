from __future__ import annotations

import pytest
import torch
from torch import nn

from learning.networks.discriminator import (
    DiscriminatorConfig,
    Discriminators,
    feature_loss,
    verdict_loss,
)
from learning.networks.generator import Generator, GeneratorConfig, initialise

SMALL = GeneratorConfig(width=8, downsamplings=2, global_blocks=1, local_blocks=1)


@pytest.mark.parametrize(("enhancer", "expected"), [(False, 182_493_453), (True, 182_745_741)])
def test_full_size_generator_has_the_published_parameters(enhancer: bool, expected: int) -> None:
    with torch.device("meta"):
        generator = Generator(GeneratorConfig(enhancer=enhancer))
    assert sum(p.numel() for p in generator.parameters()) == expected


@pytest.mark.parametrize("enhancer", [False, True])
def test_generator_keeps_the_size_and_stays_in_range(enhancer: bool) -> None:
    torch.manual_seed(0)
    config = GeneratorConfig(8, 2, 1, 1, enhancer)
    found = Generator(config)(torch.randn(2, 9, 24, 40))
    assert found.shape == (2, 13, 24, 40)
    assert float(found.detach().abs().max()) <= 1
    assert config.multiple_px == (8 if enhancer else 4)


def test_no_norm_has_weights_and_padding_reflects() -> None:
    modules = list(Generator(SMALL).modules())
    norms = [m for m in modules if isinstance(m, nn.InstanceNorm2d)]
    assert norms
    assert not any(list(m.parameters()) for m in norms)
    assert sum(isinstance(m, nn.ReflectionPad2d) for m in modules) == 3 + 2 * 2


def test_initial_weights_are_gaussian_of_a_fiftieth() -> None:
    torch.manual_seed(0)
    generator = Generator(SMALL)
    initialise(generator)
    weights = torch.cat([p.flatten() for n, p in generator.named_parameters() if "weight" in n])
    assert float(weights.detach().std()) == pytest.approx(0.02, rel=0.05)
    assert float(weights.detach().mean()) == pytest.approx(0, abs=1e-3)
    assert not any(p.any() for n, p in generator.named_parameters() if "bias" in n)


def test_each_discriminator_sees_half_the_size_of_the_one_before() -> None:
    found = Discriminators(22, DiscriminatorConfig(width=4))(torch.randn(1, 22, 64, 64))
    assert [tuple(f[-1].shape) for f in found] == [(1, 1, 11, 11), (1, 1, 7, 7), (1, 1, 5, 5)]
    assert [len(f) for f in found] == [5, 5, 5]
    with torch.device("meta"):
        full = Discriminators(22, DiscriminatorConfig())
    assert sum(p.numel() for p in full.parameters()) == 3 * 2_784_193


def test_verdicts_are_squared_distances_summed_over_scales() -> None:
    verdicts = [[torch.full((1, 1, 2, 2), 0.5)], [torch.full((1, 1, 3, 3), 1.0)]]
    assert float(verdict_loss(verdicts, True)) == pytest.approx(0.25)
    assert float(verdict_loss(verdicts, False)) == pytest.approx(1.25)


def test_feature_matching_is_zero_on_equal_features_and_ignores_the_verdict() -> None:
    def features(value: float, verdict: float) -> list[list[torch.Tensor]]:
        scale = [torch.full((1, 2, 3, 3), float(value))] * 4 + [
            torch.full((1, 1, 3, 3), float(verdict))
        ]
        return [scale, scale, scale]

    assert float(feature_loss(features(1, 0), features(1, 9))) == 0
    # |difference| 2 in each of four stages of weight 1, mean over scales.
    assert float(feature_loss(features(1, 0), features(3, 0))) == pytest.approx(8)
