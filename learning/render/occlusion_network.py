"""The published way to shadows: pictures of occlusion decoded from a linear code of the lights.

A decoder turns 64 latent features into the occlusion under a whole light set; a linear regressor
gives the features from the lights' directions and strengths [Lattas2021]. What is published is
5 blocks of two convolutions with ELU and batch norm and one resampling, 64 features, a fully
connected layer of 256; the channels are ours. From a direction's coordinates a linear regressor
finds little of what changes fast with it, so that a network may be given the direction's harmonics
instead. A network of one light gives each light of a set a picture of its own, whatever their
number; one of more lights gives a set of as many one picture.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import torch
from torch import Tensor, nn

from learning.render.light_dome import harmonics

CHANNELS = (8, 16, 32, 64, 128)
"""Channels of the 5 blocks, from the picture inward."""
ROWS_MULTIPLE = 96
"""Five blocks halve rows and columns, which are two thirds as many."""
AT_ONCE = 64
"""Pictures decoded together: the last blocks of as many take 130 MB at 96 x 64 texels."""
LEAST_ALIKE = 0.98
"""Share of texels that show the same triangle in one UV, at least; rounding moves some edges."""


@dataclasses.dataclass(frozen=True)
class OcclusionNetworkConfig:
    """Sizes.

    Attributes:
        rows: of the pictures, a multiple of 96; two thirds as many columns.
        lights: in a set.
        order: of the spherical harmonics that encode a direction for the regressor; 1 for its
            coordinates, as published.
        features: latent.
        connected: width of the fully connected layer.
    """

    rows: int = 96
    lights: int = 1
    order: int = 10
    features: int = 64
    connected: int = 256

    @property
    def columns(self) -> int:
        """Of the pictures."""
        return self.rows * 2 // 3

    @property
    def light_features(self) -> int:
        """Length of L: of each light its direction and its share."""
        return self.lights * (self.order + 1) ** 2


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
    """Encoder, decoder and the lights' regressor; and which UV the pictures are in."""

    face: Tensor
    """(rows, columns) int32, the triangle that each texel shows; -1 where no surface is."""

    def __init__(self, config: OcclusionNetworkConfig) -> None:
        """Fresh weights, of no UV yet."""
        super().__init__()
        self.config = config
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
        self.small = (CHANNELS[-1], config.rows // 32, config.columns // 32)
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
        self.regressor = nn.Linear(config.light_features, config.features)
        empty = torch.full((config.rows, config.columns), -1, dtype=torch.int32)
        self.register_buffer("face", empty)

    def logits(self, features: Tensor) -> Tensor:
        """(B, 64) to (B, rows, columns), before they are brought to 0..1."""
        return self.decoder(self.widen(features).unflatten(1, self.small))[:, 0]

    def decode(self, features: Tensor) -> Tensor:
        """(B, 64) to (B, rows, columns) in 0..1; 1 where no surface is."""
        return torch.where(self.face >= 0, torch.sigmoid(self.logits(features)), 1.0)

    def forward(self, pictures: Tensor) -> Tensor:
        """Pictures through the code and back, (B, rows, columns)."""
        return self.decode(self.encoder(pictures[:, None]))

    def occlusion(self, directions: Tensor, share: Tensor) -> Tensor:
        """Occlusion of light sets: (B, n, 3) unit directions, (B, n) shares; differentiable."""
        return self.decode(self.regressor(described(directions, share, self.config.order)))

    def for_lights(self, position_mm: Tensor, rgb: Tensor, size: tuple[int, int]) -> Tensor:
        """Visibility of lights for maps of a size.

        A lamp nearby counts as far away in its direction from the origin of the head's frame.

        Args:
            position_mm: (L, 3) lights around the head's origin; differentiable. One at the origin,
                or not finite, has no direction: its pictures are NaN.
            rgb: (L, 3) what a white diffuser in the middle that faces each would read.
            size: (rows, columns) of the maps.

        Returns:
            (L, rows, columns), 0..1. With a network of several lights, which L must be as many as,
            all have the set's picture.
        """
        count, own = len(position_mm), self.config.lights
        sets = (count, 1) if own == 1 else (1, own)
        toward = unit_directions(position_mm).unflatten(0, sets)
        share = shares(rgb.mean(dim=1).unflatten(0, sets))
        parts = zip(toward.split(AT_ONCE), share.split(AT_ONCE), strict=True)
        pictures = torch.cat([self.occlusion(*part) for part in parts])
        large = nn.functional.interpolate(
            pictures[None], size=size, mode="bilinear", align_corners=False
        )[0]
        return large.expand(count, -1, -1)


def likeness(face: np.ndarray, other: np.ndarray) -> float:
    """Share, 0..1, of texels with surface that show the same in two rasters.

    Args:
        face: (rows, columns) triangles, `UvRaster.face`.
        other: (rows, columns) of the other raster.
    """
    covered = (face >= 0) | (other >= 0)
    return float((face == other)[covered].mean()) if covered.any() else 0.0


def unit_directions(position_mm: Tensor) -> Tensor:
    """(..., 3) unit vectors of (..., 3) places of any finite length; NaN of a place at the origin.

    Places are brought to a largest coordinate of 1 first, so that no square is infinite or 0.
    """
    near = position_mm / position_mm.detach().abs().amax(dim=-1, keepdim=True)
    return near / near.square().sum(dim=-1, keepdim=True).sqrt()


def shares(strength: Tensor) -> Tensor:
    """(B, n) shares that sum to 1 of (B, n) strengths of 0 or more; even ones where all are 0."""
    largest = strength.detach().amax(dim=-1, keepdim=True)
    # NaN is not 0, and stays.
    black = largest == 0
    scaled = torch.where(black, 1.0, strength) / torch.where(black, 1.0, largest)
    return scaled / scaled.sum(dim=-1, keepdim=True)


def described(directions: Tensor, share: Tensor, order: int) -> Tensor:
    """L = [l_1 .. l_n, c_1 .. c_n], (B, n (order + 1)^2) of (B, n, 3) and (B, n) [Lattas2021].

    l_j is the direction, with an order above 1 its harmonics of band 1 on, of mean square 1.
    """
    coordinates = directions
    if order > 1:
        coordinates = math.sqrt(4 * math.pi) * harmonics(directions, order)[..., 1:]
    return torch.cat([coordinates.flatten(1), share], dim=1)
