"""Training the network of occlusion: its autoencoder, the regressor, then both from the lights.

The first two are what is published [Lattas2021]. The regressor finds the autoencoder's code badly,
since the code need not be linear in the lights; so decoder and regressor are trained together at
last, from lights to pictures, which makes it so.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits

from learning.errors import TrainingError
from learning.render.occlusion_network import (
    OcclusionNetwork,
    OcclusionNetworkConfig,
    described,
)
from learning.render.uv import UvRaster
from lightstage.commands import ProgressCallback, quiet

LEAST_SHARE = 0.2
"""Strength of a set's weakest light, before all are made to sum to 1; the strongest has 1."""
AUTOENCODER, REGRESSOR, JOINT = 0, 1, 2
"""What sets are drawn for: each has random numbers of its own."""
REGRESSED_AT_ONCE = 64


@dataclasses.dataclass(frozen=True)
class OcclusionTrainConfig:
    """How a network of occlusion is trained.

    Attributes:
        occlusion: the network's sizes; `rows` as the pictures are baked.
        steps: of Adam, of the autoencoder.
        regressed: light sets that the linear regressor is fitted on.
        joint_steps: of Adam, of regressor and decoder together; 0 for what is published.
        batch: sets a step.
        learning_rate: Adam's, falling to a hundredth; from its start again in the joint steps.
        seed: of weights and sets.
    """

    family: ClassVar[str] = "occlusion"
    occlusion: OcclusionNetworkConfig = dataclasses.field(default_factory=OcclusionNetworkConfig)
    steps: int = 1000
    regressed: int = 2000
    joint_steps: int = 3000
    batch: int = 8
    learning_rate: float = 3e-3
    seed: int = 0


@dataclasses.dataclass(frozen=True)
class BakedHeads:
    """What is trained on.

    Attributes:
        raster: texels of the heads' texture.
        directions: (d, 3) unit, of distant lights.
        visibility: (heads, d, t) bool of the covered texels.
    """

    raster: UvRaster
    directions: np.ndarray
    visibility: np.ndarray


@dataclasses.dataclass(frozen=True)
class LightSets:
    """Light sets and what a head's texels see of them.

    Attributes:
        toward: (n, lights, 3) float32 unit.
        share: (n, lights) float32, summing to 1.
        pictures: (n, rows, columns) float32; 1 where no surface is.
    """

    toward: Tensor
    share: Tensor
    pictures: Tensor


def random_shares(rng: np.random.Generator, count: int, lights: int) -> np.ndarray:
    """(count, lights) that sum to 1."""
    share = rng.uniform(LEAST_SHARE, 1.0, (count, lights))
    return share / share.sum(axis=1, keepdims=True)


class OcclusionTrainer:
    """One network in training, stage after stage."""

    def __init__(
        self, baked: BakedHeads, config: OcclusionTrainConfig, progress: ProgressCallback = quiet
    ) -> None:
        """A network with fresh weights of the seed."""
        torch.manual_seed(config.seed)
        self.config, self._baked, self._progress = config, baked, progress
        self.network = OcclusionNetwork(config.occlusion)
        self.network.face.copy_(torch.from_numpy(baked.raster.face))
        self._covered = torch.from_numpy(baked.raster.covered)
        self._done = 0

    def train_autoencoder(self) -> None:
        """Pictures through the code and back."""
        network = self.network

        def logits(sets: LightSets) -> Tensor:
            return network.logits(network.encoder(sets.pictures[:, None]))

        self._train(AUTOENCODER, self.config.steps, logits)

    def fit_regressor(self) -> None:
        """The codes of random sets as a linear function of their lights, by least squares."""
        network = self.network.eval()
        rng = self._rng(REGRESSOR)
        codes, lights = [], []
        with torch.inference_mode():
            for first in range(0, self.config.regressed, REGRESSED_AT_ONCE):
                sets = self._draw(rng, min(REGRESSED_AT_ONCE, self.config.regressed - first))
                codes.append(network.encoder(sets.pictures[:, None]))
                lights.append(self._lights(sets))
        weight, bias = linear_fit(torch.cat(lights), torch.cat(codes))
        with torch.no_grad():
            network.regressor.weight.copy_(weight)
            network.regressor.bias.copy_(bias)

    def train_jointly(self) -> None:
        """Lights to pictures, by regressor and decoder."""
        network = self.network

        def logits(sets: LightSets) -> Tensor:
            return network.logits(network.regressor(self._lights(sets)))

        self._train(JOINT, self.config.joint_steps, logits)

    def _train(self, stage: int, steps: int, logits: Callable[[LightSets], Tensor]) -> None:
        """Half of the steps by cross entropy, then by the mean absolute error that counts.

        Most texels of most sets see all lights, and under that error alone training stays at a
        white picture.
        """
        network = self.network.train()
        optimiser = torch.optim.Adam(network.parameters(), lr=self.config.learning_rate)
        falling = torch.optim.lr_scheduler.LinearLR(optimiser, 1.0, 0.01, max(steps, 1))
        for step in range(steps):
            sets = self._draw(self._rng(stage, step), self.config.batch)
            found, expected = (x[:, self._covered] for x in (logits(sets), sets.pictures))
            if step < steps // 2:
                loss = binary_cross_entropy_with_logits(found, expected)
            else:
                loss = (torch.sigmoid(found) - expected).abs().mean()
            if not bool(loss.isfinite()):
                raise TrainingError(
                    "network of occlusion",
                    field=f"step {step}",
                    found=f"loss {loss.item()}",
                    expected="a finite one",
                    hint="Lower learning_rate by --config.",
                )
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            falling.step()
            self._done += 1
            self._progress(self._done, self.config.steps + self.config.joint_steps)
        network.eval()

    def _lights(self, sets: LightSets) -> Tensor:
        return described(sets.toward, sets.share, self.config.occlusion.order)

    def _rng(self, stage: int, step: int = 0) -> np.random.Generator:
        return np.random.default_rng([self.config.seed, stage, step])

    def _draw(self, rng: np.random.Generator, count: int) -> LightSets:
        """Random sets of baked lights, each on one of the heads."""
        seen, lights = self._baked.visibility, self.config.occlusion.lights
        heads = rng.integers(0, seen.shape[0], count)
        index = rng.integers(0, seen.shape[1], (count, lights))
        share = random_shares(rng, count, lights).astype(np.float32)
        flat = np.einsum("bl,blt->bt", share, seen[heads[:, None], index].astype(np.float32))
        pictures = torch.ones(count, *self._covered.shape)
        pictures[:, self._covered] = torch.from_numpy(flat)
        toward = torch.from_numpy(self._baked.directions[index]).float()
        return LightSets(toward, torch.from_numpy(share), pictures)


def linear_fit(inputs: Tensor, outputs: Tensor) -> tuple[Tensor, Tensor]:
    """Weight (m, k) and bias (m,) with the least squares of weight . inputs + bias - outputs.

    The smallest where many are equally good, as of shares, which sum to 1 with the bias's input.

    Args:
        inputs: (n, k).
        outputs: (n, m).
    """
    ones = inputs.new_ones(len(inputs), 1)
    both = torch.cat([inputs, ones], dim=1).double()
    solution = torch.linalg.lstsq(both, outputs.double(), driver="gelsd").solution
    solution = solution.to(outputs.dtype)
    return solution[:-1].T, solution[-1]
