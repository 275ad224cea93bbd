"""The moving average of a network's weights: the same network, less what its last batches did."""

from __future__ import annotations

import copy
from typing import TypeVar

import torch
from torch import Tensor, nn

NetworkT = TypeVar("NetworkT", bound=nn.Module)


def moving_average(network: NetworkT) -> NetworkT:
    """A copy of a network that is to follow it; nothing is learned by it."""
    return copy.deepcopy(network).requires_grad_(False).eval()


def follow(average: nn.Module, network: nn.Module, decay: float, number: int) -> None:
    """Move an average toward the weights of now; buffers are taken over as they are.

    In the first steps less is kept, (1 + number) / (10 + number) at most, so that the average of a
    short training does not hold the random weights that it began with [TensorFlowEMA2024].

    Args:
        average: of `moving_average`.
        network: after a step.
        decay: share of the average that is kept.
        number: of the step, from 0.
    """
    new = 1 - min(decay, (1 + number) / (10 + number))
    with torch.no_grad():
        torch._foreach_lerp_(list(average.parameters()), _values(network), new)
        for mine, its in zip(average.buffers(), network.buffers(), strict=True):
            mine.copy_(its)


def _values(network: nn.Module) -> list[Tensor]:
    return [weight.detach() for weight in network.parameters()]
