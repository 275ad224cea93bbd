"""Several processes that train one network, as torchrun starts them: each has a share of the batch.

Gradients are averaged over the processes before every step of an optimiser, so that all have the
same weights. The first process decides when a training ends, and alone writes and prints.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
from collections.abc import Iterable, Iterator

import torch
import torch.distributed as together
from torch import Tensor

from learning.devices import CPU
from learning.errors import TrainingError
from lightstage.errors import ConfigError
from lightstage.interrupts import interrupted

AT_ONCE = 1 << 24
"""Numbers that are averaged by one message, about: the largest copy of gradients that is held."""
VARIABLES = ("RANK", "WORLD_SIZE", "LOCAL_RANK", "MASTER_ADDR", "MASTER_PORT")
"""Variables of the environment in which torchrun gives a process its number [TorchElastic2021]."""


@dataclasses.dataclass(frozen=True)
class Processes:
    """The processes of a training; one alone as it is made here.

    Attributes:
        rank: number of this one.
        count: how many there are.
        local_rank: number of this one on its machine.
    """

    rank: int = 0
    count: int = 1
    local_rank: int = 0

    @property
    def first(self) -> bool:
        """Whether this process writes files and prints."""
        return self.rank == 0

    def share(self, batch: int) -> slice:
        """Which examples of a batch are this process's.

        Raises:
            ConfigError: a batch that is not the same number for each.
        """
        if batch % self.count:
            raise ConfigError(
                "training",
                field="batch",
                found=f"{batch}, for {self.count} processes",
                expected=f"a multiple of {self.count}",
                hint="The batch is that of all processes; each takes an equal share of it.",
            )
        own = batch // self.count
        return slice(self.rank * own, (self.rank + 1) * own)

    def mean(self, values: list[float]) -> list[float]:
        """Mean of each number over the processes, the same on all of them."""
        if self.count == 1:
            return values
        numbers = torch.tensor(values, dtype=torch.float64)
        with _reported_once():
            together.all_reduce(numbers)
        found: list[float] = (numbers / self.count).tolist()
        return found

    def weight(self, own: Tensor) -> float:
        """What a mean over this process's texels is multiplied by, so that the processes' mean is
        the mean over all texels.

        Args:
            own: sum of this process's texels, or of their weights.
        """
        if self.count == 1:
            return 1.0
        (mean,) = self.mean([float(own)])
        return float(own) / mean if mean > 0 else 1.0

    def of_first(self, value: float) -> float:
        """The first process's value."""
        if self.count == 1:
            return value
        number = torch.tensor(value, dtype=torch.float64)
        with _reported_once():
            together.broadcast(number, 0)
        return float(number)

    def average_gradients(self, weights: Iterable[Tensor]) -> None:
        """Make each gradient the mean of all processes' own."""
        if self.count == 1:
            return
        gradients = [weight.grad for weight in weights if weight.grad is not None]
        for part in _parts(gradients):
            # NCCL takes a GPU's tensors, Gloo the processor's.
            flat = torch.cat([gradient.flatten() for gradient in part])
            flat = flat if flat.is_cuda else flat.to(CPU)
            with _reported_once():
                together.all_reduce(flat)
            means = (flat / self.count).split([gradient.numel() for gradient in part])
            for gradient, mean in zip(part, means, strict=True):
                gradient.copy_(mean.view_as(gradient))

    def same_tensors(self, tensors: Iterable[Tensor]) -> None:
        """Give all processes the first one's values."""
        if self.count == 1:
            return
        for tensor in tensors:
            values = tensor.detach()
            sent = (values if values.is_cuda else values.to(CPU)).contiguous()
            with _reported_once():
                together.broadcast(sent, 0)
            values.copy_(sent)


ALONE = Processes()


def started_by_torchrun() -> Processes:
    """Which process this is, by the environment; one alone where torchrun did not start it.

    Raises:
        ConfigError: only some of the variables that torchrun sets, or others than numbers.
    """
    environment = {name: os.environ[name] for name in VARIABLES if name in os.environ}
    if "RANK" not in environment and "WORLD_SIZE" not in environment:
        return ALONE
    numbers = [environment.get(name, "nothing") for name in VARIABLES[:3]]
    if len(environment) < len(VARIABLES) or not all(text.isdecimal() for text in numbers):
        raise ConfigError(
            "environment",
            field=", ".join(VARIABLES),
            found=", ".join(environment.get(name, "nothing") for name in VARIABLES),
            expected="all of them, as torchrun sets them, or none",
            hint="Start with `torchrun --nproc-per-node N -m learning train ..`, or unset them.",
        )
    return Processes(*map(int, numbers))


@contextlib.contextmanager
def joined(processes: Processes, device: torch.device) -> Iterator[None]:
    """Join the others within the block.

    Raises:
        TrainingError: they do not come, or go before the end.
    """
    if processes.count == 1:
        yield
        return
    with _reported_once():
        # Numbers that steer the training are the processor's, whatever the network runs on.
        backend = "cpu:gloo,cuda:nccl" if device.type == "cuda" else "gloo"
        if device.type == "cuda":
            torch.cuda.set_device(device)
        together.init_process_group(backend, rank=processes.rank, world_size=processes.count)
    try:
        yield
    finally:
        together.destroy_process_group()


@contextlib.contextmanager
def _reported_once() -> Iterator[None]:
    """Report that another process is gone as one error; where a signal ended it, as that signal."""
    try:
        yield
    except (RuntimeError, ValueError) as error:
        if isinstance(error, torch.OutOfMemoryError):
            raise
        if interrupted():
            raise KeyboardInterrupt from None
        message = " ".join(str(error).split("\n")[0].split())[:200]
        raise TrainingError(
            "processes",
            found=f"another process that does not answer ({message})",
            expected="all processes of the training, to its end",
            hint="The first one that ended reports why. --resume continues the training.",
        ) from None


def _parts(tensors: list[Tensor]) -> Iterator[list[Tensor]]:
    """Lists of tensors of about `AT_ONCE` numbers together."""
    part: list[Tensor] = []
    for tensor in tensors:
        part.append(tensor)
        if sum(one.numel() for one in part) >= AT_ONCE:
            yield part
            part = []
    if part:
        yield part
