"""RCAN: residual groups with channel attention at low resolution, then a sub-pixel upsampling.

Where tiles can differ from the whole picture: attention pools over all that it sees, in `features`
alone. `enlarged` is convolutions that reach at most `TAIL_REACH_PX` texels of the input. So
`features` runs over the whole picture, and what follows may run in tiles.
"""

from __future__ import annotations

import dataclasses
import itertools

import torch
import torch.nn.functional as functional
from torch import Tensor, nn

TAIL_REACH_PX = 2
"""Texels of the input beyond its own that a texel of the output sees of `features`, at most: each
3 x 3 convolution reaches one texel at its resolution, 1 + 1/2 + 1/4 + 1/8 at 8 times; and bicubic
interpolation two."""


@dataclasses.dataclass(frozen=True)
class RcanConfig:
    """Size of the network; the defaults are the published ones at 8 times [Zhang2018].

    Attributes:
        groups: residual groups.
        blocks: residual channel attention blocks of each group.
        width: channels of features at the input's resolution.
        tail_width: channels of features at finer resolutions, which take most of the time. The
            published network has as many as before.
        reduction: channels over those between the two layers of the attention.
        times: the output's side over the input's; 2, 4 or 8.
        beside_bicubic: the output is a difference from bicubic interpolation, which then is the
            output of an untrained network. Not published; it makes a training of minutes converge.
    """

    groups: int = 10
    blocks: int = 20
    width: int = 64
    tail_width: int = 64
    reduction: int = 16
    times: int = 8
    beside_bicubic: bool = False


class _Attention(nn.Module):
    """Gains of channels from their means over the whole picture [Zhang2018, eq. 6 to 9]."""

    def __init__(self, width: int, reduction: int) -> None:
        super().__init__()
        self.narrow = nn.Conv2d(width, width // reduction, 1)
        self.wide = nn.Conv2d(width // reduction, width, 1)

    def forward(self, features: Tensor) -> Tensor:
        mean = features.mean(dim=(2, 3), keepdim=True)
        gain: Tensor = self.wide(self.narrow(mean).relu()).sigmoid()
        return features * gain


class _Block(nn.Module):
    """Two convolutions and the attention around an identity [Zhang2018, eq. 10 to 12]."""

    def __init__(self, config: RcanConfig) -> None:
        super().__init__()
        self.first = _same(config.width, config.width)
        self.second = _same(config.width, config.width)
        self.attention = _Attention(config.width, config.reduction)

    def forward(self, features: Tensor) -> Tensor:
        inner: Tensor = self.attention(self.second(self.first(features).relu()))
        return inner + features


class _Group(nn.Module):
    """Blocks and a convolution around an identity [Zhang2018, eq. 4 and 5]."""

    def __init__(self, config: RcanConfig) -> None:
        super().__init__()
        self.blocks = nn.Sequential(*(_Block(config) for _ in range(config.blocks)))
        self.last = _same(config.width, config.width)

    def forward(self, features: Tensor) -> Tensor:
        found: Tensor = self.last(self.blocks(features))
        return found + features


class Rcan(nn.Module):
    """The network: sRGB-encoded pictures in and out."""

    mean_srgb: Tensor

    def __init__(self, config: RcanConfig) -> None:
        """Random weights, PyTorch's own; `mean_srgb` is 0.5 until a training sets it.

        The published network takes the mean colour of its data from pictures that go in and gives
        it back to those that come out; here it is a buffer, `mean_srgb`, (3,).
        """
        super().__init__()
        self.config = config
        self.head = _same(3, config.width)
        self.groups = nn.Sequential(*(_Group(config) for _ in range(config.groups)))
        self.after = _same(config.width, config.width)
        widths = [config.width] + [config.tail_width] * (config.times.bit_length() - 1)
        self.doublings = nn.Sequential(
            *(
                nn.Sequential(_same(before, 4 * after), nn.PixelShuffle(2))
                for before, after in itertools.pairwise(widths)
            )
        )
        self.last = _same(config.tail_width, 3)
        if config.beside_bicubic:
            nn.init.zeros_(self.last.weight)
            nn.init.zeros_(self.last.bias)  # type: ignore[arg-type]
        self.register_buffer("mean_srgb", torch.full((3,), 0.5))

    def features(self, picture: Tensor) -> Tensor:
        """(B, 3, h, w) sRGB-encoded to (B, width, h, w), over the whole picture."""
        shallow = self.head(picture - self.mean_srgb.view(1, 3, 1, 1))
        deep: Tensor = self.after(self.groups(shallow))
        return deep + shallow

    def enlarged(self, features: Tensor, picture: Tensor) -> Tensor:
        """Features and the same texels of the picture to (B, 3, times h, times w), encoded."""
        found: Tensor = self.last(self.doublings(features))
        if self.config.beside_bicubic:
            return found + bicubic(picture, self.config.times)
        return found + self.mean_srgb.view(1, 3, 1, 1)

    def forward(self, picture: Tensor) -> Tensor:
        """(B, 3, h, w) to (B, 3, times h, times w), both sRGB-encoded."""
        return self.enlarged(self.features(picture), picture)


def bicubic(picture: Tensor, times: int) -> Tensor:
    """Interpolate (B, 3, h, w) by cubic convolution; a texel's centre stays where it is."""
    return functional.interpolate(
        picture, scale_factor=float(times), mode="bicubic", align_corners=False
    )


def _same(channels: int, out: int) -> nn.Conv2d:
    return nn.Conv2d(channels, out, 3, padding=1)
