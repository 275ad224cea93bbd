"""pix2pixHD's coarse-to-fine generator: a global network and a local enhancer around it.

Wang et al. 2018 [Wang2018], with AvatarMe++'s 9 input and 13 output channels [Lattas2021].
"""

from __future__ import annotations

import dataclasses

import torch.nn.functional as functional
from torch import Tensor, nn

IN_CHANNELS = 9
"""Texture 3, shape normals 3, whole texture shrunk to the patch 3."""
OUT_CHANNELS = 13
"""Diffuse albedo 3, specular albedo 1, diffuse normal 3, specular normal 3, whole albedo 3."""


@dataclasses.dataclass(frozen=True)
class GeneratorConfig:
    """Size of the generator; the defaults are the published one.

    Attributes:
        width: channels of the global network's first layer (the enhancer has half of it).
        downsamplings: of the global network.
        global_blocks: residual blocks of the global network.
        local_blocks: residual blocks of the enhancer.
        enhancer: False for the global network alone.
    """

    width: int = 64
    downsamplings: int = 4
    global_blocks: int = 9
    local_blocks: int = 3
    enhancer: bool = True

    @property
    def multiple_px(self) -> int:
        """Heights and widths must be multiples of this."""
        return 2 ** (self.downsamplings + int(self.enhancer))


class ResidualBlock(nn.Module):
    """x + conv(relu(conv(x))), each with reflection padding and instance norm."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.body = nn.Sequential(
            nn.ReflectionPad2d(1),
            *_normed(nn.Conv2d(channels, channels, 3)),
            nn.ReflectionPad2d(1),
            nn.Conv2d(channels, channels, 3),
            nn.InstanceNorm2d(channels),
        )

    def forward(self, features: Tensor) -> Tensor:
        """(B, c, h, w) to the same."""
        return features + self.body(features)


class Generator(nn.Module):
    """9 channels, or others, to 13, or others, in -1..1."""

    def __init__(
        self,
        config: GeneratorConfig,
        in_channels: int = IN_CHANNELS,
        out_channels: int = OUT_CHANNELS,
    ) -> None:
        """Torch's own random weights; see `initialise`."""
        super().__init__()
        self.config = config
        self.in_channels, self.out_channels = in_channels, out_channels
        self.coarse = _global_features(config, in_channels)
        if config.enhancer:
            half = config.width // 2
            self.fine_down = nn.Sequential(
                nn.ReflectionPad2d(3),
                *_normed(nn.Conv2d(in_channels, half, 7)),
                *_normed(nn.Conv2d(half, config.width, 3, stride=2, padding=1)),
            )
            self.fine_up = nn.Sequential(
                *(ResidualBlock(config.width) for _ in range(config.local_blocks)),
                *_normed(_upsampling(config.width, half)),
            )
        last = config.width // 2 if config.enhancer else config.width
        self.head = nn.Sequential(
            nn.ReflectionPad2d(3), nn.Conv2d(last, out_channels, 7), nn.Tanh()
        )

    def forward(self, inputs: Tensor) -> Tensor:
        """(B, in, h, w) in about -1..1, h and w multiples of `multiple_px`, to (B, out, h, w)."""
        if not self.config.enhancer:
            return self.head(self.coarse(inputs))
        shrunk = functional.avg_pool2d(inputs, 3, stride=2, padding=1, count_include_pad=False)
        return self.head(self.fine_up(self.fine_down(inputs) + self.coarse(shrunk)))


def _global_features(config: GeneratorConfig, in_channels: int) -> nn.Sequential:
    width = config.width
    layers: list[nn.Module] = [nn.ReflectionPad2d(3), *_normed(nn.Conv2d(in_channels, width, 7))]
    for _ in range(config.downsamplings):
        layers += _normed(nn.Conv2d(width, 2 * width, 3, stride=2, padding=1))
        width *= 2
    layers += [ResidualBlock(width) for _ in range(config.global_blocks)]
    for _ in range(config.downsamplings):
        layers += _normed(_upsampling(width, width // 2))
        width //= 2
    return nn.Sequential(*layers)


def _upsampling(channels: int, out: int) -> nn.ConvTranspose2d:
    return nn.ConvTranspose2d(channels, out, 3, stride=2, padding=1, output_padding=1)


def _normed(convolution: nn.Conv2d | nn.ConvTranspose2d) -> list[nn.Module]:
    return [convolution, nn.InstanceNorm2d(convolution.out_channels), nn.ReLU()]


def initialise(network: nn.Module) -> None:
    """N(0, 0.02) weights and zero biases, as pix2pixHD; uses torch's random state."""
    for module in network.modules():
        if isinstance(module, (nn.Conv2d, nn.ConvTranspose2d)):
            nn.init.normal_(module.weight, 0.0, 0.02)
            if module.bias is not None:
                nn.init.zeros_(module.bias)
