"""One network and its optimiser, one step at a time."""

from __future__ import annotations

import abc
from pathlib import Path
from typing import Any, Generic, TypeVar

import torch
from torch import Tensor, nn

from learning.average import follow, moving_average
from learning.checkpoint import AVERAGE, adam_tensors, fill, fill_adam
from learning.devices import CPU
from learning.forward import Forward
from learning.processes import ALONE, Processes
from learning.training import BatchT, ConfigT, Trainer

NetworkT = TypeVar("NetworkT", bound=nn.Module)


class NetworkTrainer(Trainer[ConfigT, BatchT], Generic[ConfigT, BatchT, NetworkT]):
    """A family of one network that learns from losses of its own answers alone."""

    def __init__(
        self, config: ConfigT, device: torch.device = CPU, processes: Processes = ALONE
    ) -> None:
        """Random weights of the configuration's seed, on a device."""
        super().__init__(config, device, processes)
        # Drawn on the processor, so that every device begins with the same weights. With channels
        # last a step on whole faces takes 87 ms of one core instead of 105, one of super-resolution
        # a fifth less; the generator of patches gains nothing, its discriminators a quarter.
        self.network = self.fresh().to(device)
        self.network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.average = moving_average(self.network) if config.ema else None
        self.forward: Forward[Any] = Forward(self.network, device, config)
        self._adam = self.optimiser()

    @abc.abstractmethod
    def fresh(self) -> NetworkT:
        """A network of the configured size, with random weights."""

    def optimiser(self) -> torch.optim.Adam:
        """Of the network's weights."""
        return torch.optim.Adam(self.network.parameters(), self.config.learning_rate)

    @abc.abstractmethod
    def rate(self, done: float, number: int) -> float:
        """The learning rate of step `number`, with the share `done` (0..1) past."""

    @abc.abstractmethod
    def losses(self, batch: BatchT) -> dict[str, Tensor]:
        """By name, not weighted; means over this process's share count as much as they should."""

    def weights(self) -> dict[str, float]:
        """Of the losses that count more or less than 1."""
        return {}

    def set_rate(self, done: float, number: int) -> float:
        """See `Trainer`."""
        rate = self.rate(done, number)
        for group in self._adam.param_groups:
            group["lr"] = rate
        return rate

    def step(self, batch: BatchT, number: int = 0) -> dict[str, float]:
        """See `Trainer`."""
        losses, weights = self.losses(batch), self.weights()
        total = torch.stack([weights.get(name, 1.0) * v for name, v in losses.items()]).sum()
        self._adam.zero_grad(set_to_none=True)
        total.backward()
        self.processes.average_gradients(self.network.parameters())
        self._adam.step()
        if self.average is not None:
            follow(self.average, self.network, self.config.ema, number)
        return {name: float(value.detach()) for name, value in losses.items()}

    @property
    def trained(self) -> NetworkT:
        """The network to score and to infer with: the average where there is one."""
        return (self.network if self.average is None else self.average).eval()

    def networks(self) -> tuple[nn.Module, ...]:
        """See `Trainer`."""
        return (self.network,)

    def tensors(self) -> dict[str, dict[str, Tensor]]:
        """See `Trainer`."""
        state = {
            "network": dict(self.network.state_dict()),
            "training": adam_tensors(self._adam, "adam"),
        }
        if self.average is not None:
            state[AVERAGE] = dict(self.average.state_dict())
        return state

    def begin_with(self, weights: dict[str, Tensor], where: Path) -> None:
        """See `Trainer`."""
        fill(self.network, weights, where)
        if self.average is not None:
            fill(self.average, weights, where)

    def take_over(self, saved: dict[str, dict[str, Tensor]], where: Path) -> None:
        """See `Trainer`."""
        fill(self.network, saved["network"], where)
        if self.average is not None:
            fill(self.average, saved[AVERAGE], where)
        fill_adam(self._adam, saved["training"], "adam")
