"""The four generators, and reading them from a checkpoint."""

from __future__ import annotations

from pathlib import Path

from torch import Tensor, nn

from learning.checkpoint import Checkpoint, load_network, unfilled
from learning.data import Batch
from learning.devices import device_of
from learning.encoding import Reflectance
from learning.four.channels import PARTS, infer_in_sequence, seen_of
from learning.four.config import FourTrainConfig
from learning.networks.generator import Generator, GeneratorConfig


class FourNetworks(nn.ModuleDict):
    """A generator for each of `PARTS`, by its name."""

    def answers(self, batch: Batch) -> Reflectance:
        """The networks' output on patches; each gets the results of those before it."""
        return infer_in_sequence(self.run_part, seen_of(batch))

    def run_part(self, part: str, inputs: Tensor) -> Tensor:
        """One part's output, on its input's device; the networks may be on another device."""
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
    """The networks of a checkpoint; otherwise as `load_network`."""

    def make(size: GeneratorConfig) -> FourNetworks:
        return unfilled(lambda: fresh_networks(size))

    family = FourTrainConfig.family
    return load_network(path, family, "generator", GeneratorConfig, make, "generators")
