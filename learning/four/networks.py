"""The four generators, and reading them from a checkpoint."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor, nn

from learning.checkpoint import Checkpoint, fill, of_family, trained_tensors
from learning.data import Batch
from learning.devices import device_of
from learning.encoding import Reflectance
from learning.four.channels import PARTS, one_after_the_other, seen_of
from learning.four.config import FourTrainConfig
from learning.limits import require_within
from learning.networks.generator import Generator, GeneratorConfig
from lightstage.formats.config import make_config


class FourNetworks(nn.ModuleDict):
    """A generator for each of `PARTS`, by its name."""

    def said(self, batch: Batch) -> Reflectance:
        """What they find on patches, each given what those before it found."""
        return one_after_the_other(self.say, seen_of(batch))

    def say(self, part: str, inputs: Tensor) -> Tensor:
        """One part's output, where its input is; the networks may be on another device."""
        found: Tensor = self.generator(part)(inputs.to(device_of(self)))
        return found.to(inputs.device)

    def generator(self, part: str) -> Generator:
        """That of a part."""
        found = self[part]
        assert isinstance(found, Generator)
        return found


def fresh_networks(config: GeneratorConfig) -> FourNetworks:
    """Generators with torch's own random weights."""
    return FourNetworks(
        {
            part: Generator(config, inputs, channels.stop - channels.start)
            for part, (inputs, channels) in PARTS.items()
        }
    )


def load_four_networks(path: Path) -> tuple[FourNetworks, Checkpoint]:
    """The networks of a checkpoint, ready to infer with; otherwise as `load_generator`."""
    checkpoint, where = of_family(path, FourTrainConfig.family)
    config = make_config(GeneratorConfig, checkpoint.config.get("generator", {}), where)
    require_within(config, where, "generator")
    with torch.device("meta"):
        networks = fresh_networks(config)
    networks.to_empty(device="cpu")
    fill(networks, trained_tensors(checkpoint, "generators"), where)
    return networks.eval(), checkpoint
