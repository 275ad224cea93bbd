"""The trunk of MediaPipe's face mesh [Kartynnik2019] in torch, to be trained further."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import torch
import torch.nn.functional as functional
from torch import Tensor, nn

from lightstage.faces.weights import LANDMARKS, installed

WIDTHS = (16, 16, 32, 32, 32, 64, 64, 64, 128, 128, 128, 128, 128, 128, 128, 128)
"""Channels that each block gives."""
HALVED = (2, 5, 8, 11, 14)
"""Blocks that halve the picture's side."""
KEPT = 2
"""Blocks that stay as they are: they see edges, and training them takes half of a step."""
READ = (1, 4, 7, 10, 13)
"""Blocks after which the features are read, the largest picture first."""
READ_CHANNELS = sum(WIDTHS[i] for i in READ)


class _Block(nn.Module):
    """A residual block: a depthwise convolution, a pointwise one, PReLU."""

    across: nn.Conv2d
    along: nn.Conv2d
    bend: nn.PReLU

    def __init__(self, before: int, after: int, halved: bool) -> None:
        super().__init__()
        self._halved, self._more = halved, after - before
        self.across = nn.Conv2d(before, before, 3, 2 if halved else 1, groups=before)
        self.along = nn.Conv2d(before, after, 1)
        self.bend = nn.PReLU(after)

    def forward(self, x: Tensor) -> Tensor:
        # TensorFlow pads below and at the right alone where a side is halved.
        padded = functional.pad(x, (0, 1, 0, 1) if self._halved else (1, 1, 1, 1))
        kept = functional.max_pool2d(x, 2) if self._halved else x
        if self._more:
            kept = functional.pad(kept, (0, 0, 0, 0, 0, self._more))
        out: Tensor = self.bend(kept + self.along(self.across(padded)))
        return out


class Trunk(nn.Module):
    """Features of a picture whose side is a multiple of 64."""

    def __init__(self) -> None:
        """Random weights; `fill_from_wheel` has MediaPipe's."""
        super().__init__()
        self.first = nn.Conv2d(3, WIDTHS[0], 3, 2)
        self.bend = nn.PReLU(WIDTHS[0])
        before = (WIDTHS[0], *WIDTHS[:-1])
        self.blocks = nn.ModuleList(
            _Block(one, other, index in HALVED)
            for index, (one, other) in enumerate(zip(before, WIDTHS, strict=True))
        )

    def forward(self, picture: Tensor) -> tuple[list[Tensor], Tensor]:
        """The features after `READ`, and the last ones, (B, 128, side / 64, side / 64).

        Args:
            picture: (B, 3, side, side), 0..1.
        """
        with torch.no_grad():
            x = self.bend(self.first(functional.pad(picture, (0, 1, 0, 1))))
        read = []
        for index, block in enumerate(self.blocks):
            with torch.set_grad_enabled(torch.is_grad_enabled() and index >= KEPT):
                x = block(x)
            if index in READ:
                read.append(x)
        return read, x


def fill_from_wheel(trunk: Trunk) -> None:
    """Give a trunk the weights of the installed detector.

    Raises:
        FaceError: see `lightstage.faces.weights`.
    """
    net = cv2.dnn.readNetFromTFLite(str(installed(LANDMARKS)), engine=cv2.dnn.ENGINE_CLASSIC)

    def given(name: str) -> list[np.ndarray]:
        layer: Any = net.getLayer(name)
        return [np.asarray(blob) for blob in layer.blobs]

    def fill(module: nn.Conv2d | nn.PReLU, name: str) -> None:
        own = list(module.parameters())
        with torch.no_grad():
            for mine, theirs in zip(own, given(name), strict=True):
                mine.copy_(torch.from_numpy(theirs.copy()).reshape(mine.shape))

    fill(trunk.first, "conv2d")
    fill(trunk.bend, "p_re_lu")
    for index, block in enumerate(trunk.blocks):
        assert isinstance(block, _Block)
        number = f"_{index}" if index else ""
        fill(block.across, f"depthwise_conv2d{number}")
        fill(block.along, f"conv2d_{index + 1}")
        fill(block.bend, f"p_re_lu_{index + 1}")
