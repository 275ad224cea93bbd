"""A small convolutional network that parts a texture's detail into skin and tilts of its surface.

Its layers look ever wider and narrower again, without a pooling, so that any tile of a texture,
with `reach_px` texels around it, has the same answer as the whole.
"""

from __future__ import annotations

import dataclasses

import torch
from torch import Tensor, nn

from learning.mesostructure.evidence import CHANNELS

SAID_CHANNELS = 7
"""Tilt of the diffuse normal 2, of the specular normal 2, shading in the detail's logarithm 3."""
DILATIONS = (1, 2, 4, 8, 4, 2, 1)


@dataclasses.dataclass(frozen=True)
class MesostructureConfig:
    """Size of the network.

    Attributes:
        width: channels between its layers.
    """

    width: int = 32


class Mesostructure(nn.Module):
    """Evidence (see `learning.mesostructure.evidence`) to tilts and shading.

    By an untrained network all detail is skin: no tilt, no shading.
    """

    def __init__(self, config: MesostructureConfig) -> None:
        """Weights from torch's random state."""
        super().__init__()
        self.config = config
        self.first = nn.Conv2d(CHANNELS, config.width, 3, padding=1)
        self.inner = nn.ModuleList(
            nn.Conv2d(config.width, config.width, 3, padding=d, dilation=d) for d in DILATIONS
        )
        self.last = nn.Conv2d(config.width, SAID_CHANNELS, 1)
        nn.init.zeros_(self.last.weight)
        assert self.last.bias is not None
        nn.init.zeros_(self.last.bias)

    @property
    def reach_px(self) -> int:
        """Texels beyond its own that an answer depends on."""
        return 1 + sum(DILATIONS)

    def forward(self, given: Tensor) -> Tensor:
        """(B, `CHANNELS`, h, w) to (B, `SAID_CHANNELS`, h, w); 0 where nothing is known."""
        features = torch.relu(self.first(given))
        for layer in self.inner:
            features = features + torch.relu(layer(features))
        output: Tensor = self.last(features) * given[:, -1:]
        return output
