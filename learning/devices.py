"""Where networks run: a processor, a CUDA GPU or Apple's, and the error where one is missing."""

from __future__ import annotations

import contextlib
import dataclasses
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeVar

import torch
from torch import Tensor

from learning.errors import DeviceMemoryError
from lightstage.errors import ConfigError

CPU = torch.device("cpu")
KNOWN = "auto, cpu, cuda, cuda:N or mps"
T = TypeVar("T")


def choose_device(asked: str = "auto", local_rank: int = 0) -> torch.device:
    """The device of an option `--device`.

    Args:
        asked: `auto` (CUDA, then MPS, then the processor), `cpu`, `cuda`, `cuda:N` or `mps`.
        local_rank: number of this process on its machine; `auto` and `cuda` give each its own GPU.

    Raises:
        ConfigError: another word, or a device that is not there.
    """
    wanted = re.fullmatch(r"auto|cpu|mps|cuda(?::(\d{1,4}))?", asked)
    if wanted is None:
        raise ConfigError("--device", found=repr(asked), expected=KNOWN)
    if asked == "auto":
        # With fewer GPUs than processes this is an error, rather than a slow training.
        asked = "cuda" if torch.cuda.is_available() else "mps" if _has_mps() else "cpu"
    if asked == "cuda":
        asked = f"cuda:{local_rank}"
    there = devices_here()
    if asked not in there:
        hint = ""
        if asked.startswith("cuda") and local_rank:
            hint = "Start at most one process for each GPU."
        elif asked.startswith("cuda") and not torch.backends.cuda.is_built():
            hint = "This torch is built without CUDA: install a build with it, or leave --device."
        raise ConfigError(
            "--device",
            found=f"{asked}, which is not there",
            expected=f"one of what is: {', '.join(there.values())}",
            hint=hint,
        )
    # float32 is computed as float32: by default cuDNN keeps 10 bits of 23.
    torch.backends.cudnn.allow_tf32 = False
    return torch.device(asked)


def devices_here() -> dict[str, str]:
    """What this machine has, by the word for `--device`, with its name."""
    found = {"cpu": "cpu"}
    if torch.cuda.is_available():
        for index in range(torch.cuda.device_count()):
            found[f"cuda:{index}"] = f"cuda:{index} ({torch.cuda.get_device_name(index)})"
    if _has_mps():
        found["mps"] = "mps"
    return found


def device_name(device: torch.device) -> str:
    """A device by its maker's name, where it has one."""
    return torch.cuda.get_device_name(device) if device.type == "cuda" else str(device)


def device_of(network: torch.nn.Module) -> torch.device:
    """Where a network's weights are."""
    return next(network.parameters()).device


def moved(value: T, device: torch.device) -> T:
    """A tensor, or a dataclass, list, tuple or dictionary with tensors in it, on a device.

    Whatever else is in it stays as it is; what is there already is not copied.
    """
    found: Any = value
    if isinstance(value, Tensor):
        found = value.to(device)
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        names = [field.name for field in dataclasses.fields(value)]
        found = dataclasses.replace(value, **{n: moved(getattr(value, n), device) for n in names})
    elif isinstance(value, list):
        found = [moved(one, device) for one in value]
    elif isinstance(value, tuple):
        found = tuple(moved(one, device) for one in value)
    elif isinstance(value, dict):
        found = {name: moved(one, device) for name, one in value.items()}
    return found


@contextlib.contextmanager
def memory_of(device: torch.device, where: str | Path, hint: str) -> Iterator[None]:
    """Report that a GPU's memory is full as one error.

    Args:
        device: what is worked on.
        where: what to name.
        hint: what would fit.

    Raises:
        DeviceMemoryError: torch found too little memory within the block.
    """
    try:
        yield
    except RuntimeError as error:
        # For Apple's GPUs torch has no class of this error.
        message = " ".join(str(error).split())
        if not isinstance(error, torch.OutOfMemoryError) and "MPS backend out of" not in message:
            raise
        raise DeviceMemoryError(
            where,
            field=f"memory of {device}",
            found=". ".join(message.split(". ")[:3]).rstrip("."),
            expected="work that fits",
            hint=hint,
        ) from None


def _has_mps() -> bool:
    return torch.backends.mps.is_available()
