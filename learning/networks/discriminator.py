"""PatchGAN discriminators at several scales, and their losses [Wang2018]."""

from __future__ import annotations

import dataclasses

import torch
import torch.nn.functional as functional
from torch import Tensor, nn


@dataclasses.dataclass(frozen=True)
class DiscriminatorConfig:
    """Size of the discriminators; the defaults are the published ones.

    Attributes:
        width: channels of the first layer.
        layers: strided layers of each.
        scales: how many, each seeing the picture at half the size of the one before.
    """

    width: int = 64
    layers: int = 3
    scales: int = 3


class PatchDiscriminator(nn.Module):
    """Says of overlapping patches whether they are real; gives its features too."""

    def __init__(self, channels: int, config: DiscriminatorConfig) -> None:
        super().__init__()
        width = config.width
        stages = [nn.Sequential(nn.Conv2d(channels, width, 4, 2, 2), nn.LeakyReLU(0.2))]
        for index in range(1, config.layers + 1):
            wider = min(2 * width, 8 * config.width)
            stride = 2 if index < config.layers else 1
            stages.append(
                nn.Sequential(
                    nn.Conv2d(width, wider, 4, stride, 2),
                    nn.InstanceNorm2d(wider),
                    nn.LeakyReLU(0.2),
                )
            )
            width = wider
        stages.append(nn.Sequential(nn.Conv2d(width, 1, 4, 1, 2)))
        self.stages = nn.ModuleList(stages)

    def forward(self, image: Tensor) -> list[Tensor]:
        """Features of every stage; the last is the verdict.

        Args:
            image: (B, channels, h, w).

        Returns:
            Of each stage (B, its channels, its h, its w); the verdict has one channel.
        """
        features = []
        for stage in self.stages:
            image = stage(image)
            features.append(image)
        return features


class Discriminators(nn.Module):
    """One PatchDiscriminator a scale, finest first."""

    def __init__(self, channels: int, config: DiscriminatorConfig) -> None:
        super().__init__()
        self.scales = nn.ModuleList(
            PatchDiscriminator(channels, config) for _ in range(config.scales)
        )

    def forward(self, image: Tensor) -> list[list[Tensor]]:
        """Features of a (B, channels, h, w) image, by scale and stage of `PatchDiscriminator`."""
        found = []
        for scale in self.scales:
            found.append(scale(image))
            image = functional.avg_pool2d(image, 3, stride=2, padding=1, count_include_pad=False)
        return found


def verdict_loss(found: list[list[Tensor]], real: bool) -> Tensor:
    """LSGAN: mean squared distance of each scale's verdict from 1 (real) or 0, summed."""
    target = 1.0 if real else 0.0
    return torch.stack([(features[-1] - target).square().mean() for features in found]).sum()


def feature_loss(real: list[list[Tensor]], fake: list[list[Tensor]]) -> Tensor:
    """Feature matching: L1 of all features but the verdict, 4 / stages each, mean over scales."""
    total = []
    for real_features, fake_features in zip(real, fake, strict=True):
        weight = 4.0 / (len(real_features) - 1) / len(real)
        total += [
            weight * functional.l1_loss(f, r.detach())
            for r, f in zip(real_features[:-1], fake_features[:-1], strict=True)
        ]
    return torch.stack(total).sum()
