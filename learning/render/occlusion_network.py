"""The published way to shadows: an autoencoder of occlusion pictures, and lights to its code.

A decoder turns 64 latent features into the occlusion under a whole light set; a linear regressor
gives the features from the lights' directions and strengths [Lattas2021]. What is published is
5 blocks of two convolutions with ELU and batch norm and one resampling, 64 features, a fully
connected layer of 256; the channels are ours.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits

CHANNELS = (8, 16, 32, 32, 64)
"""Of the 5 blocks, from the picture inward."""


@dataclasses.dataclass(frozen=True)
class NetworkConfig:
    """How the network is trained.

    Attributes:
        lights: in a set.
        features: latent.
        connected: width of the fully connected layer.
        steps: of Adam.
        batch: sets a step.
        rate: learning rate, falling to 0.
        regressed: sets that the linear regressor is fitted on.
    """

    lights: int = 3
    features: int = 64
    connected: int = 256
    steps: int = 600
    batch: int = 16
    rate: float = 2e-3
    regressed: int = 4000


def _block(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, padding=1),
        nn.BatchNorm2d(outputs),
        nn.ELU(),
        nn.Conv2d(outputs, outputs, 3, padding=1),
        nn.BatchNorm2d(outputs),
        nn.ELU(),
    )


class OcclusionNetwork(nn.Module):
    """Encoder, decoder and the lights' regressor, for pictures whose sides 32 divides."""

    def __init__(self, rows: int, columns: int, config: NetworkConfig) -> None:
        """Fresh weights.

        Args:
            rows: of the pictures, a multiple of 32.
            columns: the same.
            config: sizes.
        """
        super().__init__()
        inward: list[nn.Module] = []
        outward: list[nn.Module] = []
        before = 1
        for channels in CHANNELS:
            inward += [_block(before, channels), nn.AvgPool2d(2)]
            before = channels
        after = [*reversed(CHANNELS[:-1]), CHANNELS[0]]
        for channels in after:
            outward += [nn.Upsample(scale_factor=2, mode="bilinear"), _block(before, channels)]
            before = channels
        self.small = (CHANNELS[-1], rows // 32, columns // 32)
        size = int(np.prod(self.small))
        self.encoder = nn.Sequential(
            *inward,
            nn.Flatten(),
            nn.Linear(size, config.connected),
            nn.ELU(),
            nn.Linear(config.connected, config.features),
        )
        self.widen = nn.Sequential(
            nn.Linear(config.features, config.connected),
            nn.ELU(),
            nn.Linear(config.connected, size),
            nn.ELU(),
        )
        self.decoder = nn.Sequential(*outward, nn.Conv2d(before, 1, 3, padding=1))
        self.regressor = nn.Linear(light_features(config.lights), config.features)

    def logits(self, features: Tensor) -> Tensor:
        """(B, 64) to (B, rows, columns), before they are brought to 0..1."""
        return self.decoder(self.widen(features).unflatten(1, self.small))[:, 0]

    def decode(self, features: Tensor) -> Tensor:
        """(B, 64) to (B, rows, columns) in 0..1."""
        return torch.sigmoid(self.logits(features))

    def forward(self, pictures: Tensor) -> Tensor:
        """Pictures through the code and back, (B, rows, columns)."""
        return self.decode(self.encoder(pictures[:, None]))

    def occlusion(self, directions: Tensor, strength: Tensor) -> Tensor:
        """Occlusion of light sets: (B, n, 3) unit directions, (B, n) shares; differentiable."""
        return self.decode(self.regressor(described(directions, strength)))


def light_features(lights: int) -> int:
    """Count of features of a set: three of direction and one of strength a light."""
    return 4 * lights


def described(directions: Tensor, strength: Tensor) -> Tensor:
    """L = [l_1 .. l_n, c_1 .. c_n], (B, 4 n)."""
    return torch.cat([directions.flatten(1), strength], dim=1)


def random_sets(
    rng: np.random.Generator, pool: int, count: int, lights: int
) -> tuple[np.ndarray, np.ndarray]:
    """(count, lights) indices into a pool of directions, and shares that sum to 1."""
    index = rng.integers(0, pool, (count, lights))
    share = rng.uniform(0.2, 1.0, (count, lights))
    return index, share / share.sum(axis=1, keepdims=True)


def train_network(
    visibility: np.ndarray,
    directions: np.ndarray,
    covered: np.ndarray,
    config: NetworkConfig,
    seed: int = 0,
) -> OcclusionNetwork:
    """Train on light sets drawn from baked directions.

    Half of the steps by cross entropy, then by the mean absolute error that counts: most texels of
    most sets see all lights, and under that error alone training stays at a white picture (after
    2000 steps 6 % better than white).

    Args:
        visibility: (d, t) of the covered texels.
        directions: (d, 3) unit.
        covered: (rows, columns) bool.
        config: how.
        seed: of weights and sets.
    """
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    mask = torch.from_numpy(covered)
    seen, toward = torch.from_numpy(visibility), torch.from_numpy(directions).float()
    network = OcclusionNetwork(covered.shape[0], covered.shape[1], config)

    def draw(count: int) -> tuple[Tensor, Tensor, Tensor]:
        index, share = random_sets(rng, len(visibility), count, config.lights)
        weight = torch.from_numpy(share).float()
        flat = torch.einsum("bl,blt->bt", weight, seen[torch.from_numpy(index)])
        pictures = flat.new_ones((count, *covered.shape))
        pictures[:, mask] = flat
        return pictures, toward[torch.from_numpy(index)], weight

    optimiser = torch.optim.Adam(network.parameters(), lr=config.rate)
    falling = torch.optim.lr_scheduler.LinearLR(optimiser, 1.0, 0.01, config.steps)
    for step in range(config.steps):
        pictures, _, _ = draw(config.batch)
        found = network.logits(network.encoder(pictures[:, None]))[:, mask]
        expected = pictures[:, mask]
        if step < config.steps // 2:
            loss = binary_cross_entropy_with_logits(found, expected)
        else:
            loss = (torch.sigmoid(found) - expected).abs().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        falling.step()
    network.eval()
    with torch.no_grad():
        codes, lights = [], []
        for _ in range(-(-config.regressed // 64)):
            pictures, way, weight = draw(64)
            codes.append(network.encoder(pictures[:, None]))
            lights.append(described(way, weight))
        inputs = torch.cat(lights)
        inputs = torch.cat([inputs, torch.ones(len(inputs), 1)], dim=1)
        solution = torch.linalg.lstsq(inputs, torch.cat(codes), driver="gelsd").solution
        network.regressor.weight.copy_(solution[:-1].T)
        network.regressor.bias.copy_(solution[-1])
    return network
