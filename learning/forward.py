"""A network's forward pass in training: in which precision, and compiled or not."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable
from typing import Any, Generic, Literal, Protocol, TypeVar

import torch
from torch import Tensor, nn

from learning.errors import TrainingError
from lightstage.errors import ConfigError

Precision = Literal["auto", "float32", "bf16"]
Compile = Literal["auto", "on", "off"]
OutputT = TypeVar("OutputT")


class Speed(Protocol):
    """What of a configuration decides how fast, and not what, is computed."""

    @property
    def precision(self) -> Precision:
        """`auto`: bfloat16 where the device has it."""

    @property
    def compile(self) -> Compile:
        """`auto`: through torch.compile where that pays."""


class Forward(Generic[OutputT]):
    """Calls a network; what comes out is float32, whatever it was computed in.

    Weights, the optimiser's state and the losses stay float32: bfloat16 has the exponents of
    float32, so that losses need no scale.
    """

    def __init__(self, network: nn.Module, device: torch.device, config: Speed) -> None:
        """Prepare the call of a network that is on a device.

        Raises:
            ConfigError: a precision that the device does not have.
        """
        self._network: Callable[[Tensor], Any] = network
        self._dtype = autocast_dtype(config.precision, device)
        self._device = device
        self._compiled: Callable[[Tensor], Any] | None = None
        # On processors a step of the default networks is 1 % (whole faces, beside channels last)
        # and 15 % (patches) faster compiled, and the first one takes half a minute or more.
        if config.compile == "on" or (config.compile == "auto" and device.type == "cuda"):
            self._compiled = torch.compile(network)
        self._must = config.compile == "on"

    def __call__(self, inputs: Tensor) -> OutputT:
        """The network's output.

        Raises:
            TrainingError: it was to be compiled, and cannot be.
        """
        with self._autocast():
            output = self._called(inputs)
        found: OutputT = output if self._dtype is None else _to_float32(output)
        return found

    def _called(self, inputs: Tensor) -> Any:
        if self._compiled is not None:
            # Importing the compiler takes a second of every command's start.
            from torch._dynamo.exc import TorchDynamoException

            try:
                return self._compiled(inputs)
            except TorchDynamoException as error:
                if self._must:
                    raise TrainingError(
                        "training",
                        field="compile",
                        found=f"{type(error).__name__}: {' '.join(str(error).split())[:200]}",
                        expected="a network that torch.compile takes, and a C++ compiler",
                        hint='Set compile = "off".',
                    ) from None
                self._compiled = None
        return self._network(inputs)

    def _autocast(self) -> contextlib.AbstractContextManager[Any]:
        if self._dtype is None:
            return contextlib.nullcontext()
        return torch.autocast(self._device.type, self._dtype)


def autocast_dtype(precision: Precision, device: torch.device) -> torch.dtype | None:
    """The type of half the width to compute in on a device; None for float32.

    Raises:
        ConfigError: `bf16` on a device that does not have it.
    """
    # Emulated, on GPUs of before 2020, it is slower than float32.
    has = device.type == "cuda" and torch.cuda.is_bf16_supported(including_emulation=False)
    if precision == "bf16" and not has:
        raise ConfigError(
            "training",
            field="precision",
            found=f"bf16, on {device}",
            expected="float32 or auto: this device computes no bfloat16",
        )
    return torch.bfloat16 if has and precision != "float32" else None


def _to_float32(output: Any) -> Any:
    """Tensors of half the width as float32, in dataclasses and lists too."""
    if isinstance(output, Tensor):
        return output.float() if output.is_floating_point() else output
    if isinstance(output, list):
        return [_to_float32(one) for one in output]
    fields = [field.name for field in dataclasses.fields(output)]
    return dataclasses.replace(
        output, **{name: _to_float32(getattr(output, name)) for name in fields}
    )
