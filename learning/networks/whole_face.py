"""A U-Net over a whole face at low resolution: a person's tone, and what is light and what is skin.

What decides an inferred albedo is the person's tone, which no patch shows: it follows from the
whole face, its shading and its colour. So this network sees all of it at once, in 96 x 64 texels.
Its output is the difference of the albedo's logarithm from the mean person's, place by place and by
one colour for all of the face; that of an untrained one is the mean person.
"""

from __future__ import annotations

import dataclasses

import torch
import torch.nn.functional as functional
from torch import Tensor, nn

IN_CHANNELS = 10
"""Log colour 3, normals 3, position 3, photographed or not 1."""
SIDEWAYS = (3, 6)
"""Channels of the input that change their sign in a mirror: x of normals and of positions."""
SAID_CHANNELS = 4
"""Change of log diffuse albedo 3, of log specular albedo 1."""
BANDS = 4
"""Bands of a texture's detail, of each of which a share is added (see learning.whole.detail)."""
DARKEST = 1e-3
"""Linear value below which a colour's logarithm is cut off."""
POSITION_MM = 100.0
"""Unit of positions, so that they are about as large as normals are."""
UNSURE = 0.3
"""Share of people's variance that a network leaves open, until its errors were measured."""
RIDGE = 0.01
"""Weight of people's prior, where a texel has 1."""
DEVIATION = (0.003, 0.5)
"""Bounds of the expected error, sRGB-encoded."""


@dataclasses.dataclass(frozen=True)
class WholeFaceConfig:
    """Size of the network.

    Attributes:
        rows: of the texture that it sees.
        columns: the same.
        width: channels at full size; each of the halvings doubles them.
        halvings: of the size.
        modes: principal directions in which people's albedo differs, kept beside the weights.
        heads: of attention, by which the face's tone is read from places such as the eyes; with 0
            it is read from the mean over all places alone.
    """

    rows: int = 96
    columns: int = 64
    width: int = 16
    halvings: int = 3
    modes: int = 12
    heads: int = 0


@dataclasses.dataclass(frozen=True)
class KnownPeople:
    """What the people trained on have in common.

    Attributes:
        log_albedo: (1, 3, rows, columns), mean of the diffuse albedo's natural logarithm.
        log_specular: (1, 1, rows, columns), the same of the specular albedo.
        position_mm: (1, 3, rows, columns), mean.
        modes: (modes, 3, rows, columns), principal components of the diffuse albedo's logarithm,
            orthonormal; zero beyond those that so few people have.
        deviations: (modes,), of the people along them.
    """

    log_albedo: Tensor
    log_specular: Tensor
    position_mm: Tensor
    modes: Tensor
    deviations: Tensor


@dataclasses.dataclass(frozen=True)
class WholeFace:
    """The network's answer for a face.

    Attributes:
        diffuse_albedo: (B, 3, rows, columns) linear.
        specular_albedo: (B, 1, rows, columns).
        deviation: (B, 1, rows, columns), the error to expect of the sRGB-encoded diffuse albedo.
    """

    diffuse_albedo: Tensor
    specular_albedo: Tensor
    deviation: Tensor


class Attention(nn.Module):
    """What a face shows at places that matter: means of the features, each with its own weights.

    The places of a texture are the same for all faces, so that a head learns where to look, and
    from the features whether there is something to see. A mean over the whole face would hold the
    eyes, which distinguish light from skin, at a hundredth.
    """

    def __init__(self, channels: int, places: int, heads: int) -> None:
        """For features of so many channels at so many places; `heads` means are taken."""
        super().__init__()
        self.here = nn.Parameter(torch.zeros(heads, places))
        self.seen = nn.Conv2d(channels, heads, 1)

    def forward(self, features: Tensor) -> Tensor:
        """(B, channels, rows, columns) to (B, channels * heads)."""
        weights = (self.seen(features).flatten(2) + self.here).softmax(dim=2)
        return torch.einsum("bhn,bcn->bhc", weights, features.flatten(2)).flatten(1)


class WholeFaceNetwork(nn.Module):
    """10 channels of a lit face to its albedo, beside the mean person's that it keeps."""

    mean_log_albedo: Tensor
    mean_log_specular: Tensor
    mean_position_mm: Tensor
    albedo_modes: Tensor
    mode_deviations: Tensor
    mode_doubt: Tensor
    detail_shares: Tensor

    def __init__(self, config: WholeFaceConfig) -> None:
        """Weights from torch's random state; the mean person is black until it is set."""
        super().__init__()
        self.config = config
        size = (config.rows, config.columns)
        self.register_buffer("mean_log_albedo", torch.zeros(1, 3, *size))
        self.register_buffer("mean_log_specular", torch.zeros(1, 1, *size))
        self.register_buffer("mean_position_mm", torch.zeros(1, 3, *size))
        self.register_buffer("albedo_modes", torch.zeros(config.modes, 3, *size))
        self.register_buffer("mode_deviations", torch.zeros(config.modes))
        self.register_buffer("mode_doubt", UNSURE * torch.eye(config.modes))
        self.register_buffer("detail_shares", torch.zeros(BANDS))
        widths = [config.width * 2**level for level in range(config.halvings + 1)]
        self.first = _two(IN_CHANNELS, widths[0])
        self.down = nn.ModuleList(
            nn.Sequential(
                nn.Conv2d(wide, 2 * wide, 3, stride=2, padding=1),
                nn.SiLU(),
                *_convolution(2 * wide, 2 * wide),
            )
            for wide in widths[:-1]
        )
        self.up = nn.ModuleList(_two(3 * wide, wide) for wide in reversed(widths[:-1]))
        everywhere = nn.Linear(widths[-1], SAID_CHANNELS)
        self.attention: Attention | None = None
        self.back: nn.Linear | None = None
        read = widths[-1]
        if config.heads:
            places = (config.rows >> config.halvings) * (config.columns >> config.halvings)
            self.attention = Attention(widths[-1], places, config.heads)
            self.back = nn.Linear(widths[-1], widths[-1])
            read *= 1 + config.heads
        self.everywhere = nn.Sequential(nn.Linear(read, widths[-1]), nn.SiLU(), everywhere)
        self.here = nn.Conv2d(widths[0], SAID_CHANNELS, 1)
        unsure = nn.Conv2d(widths[0], 1, 1)
        self.unsure = nn.Sequential(*_convolution(widths[0] + SAID_CHANNELS, widths[0]), unsure)
        for layer in (self.here, everywhere, unsure):
            nn.init.zeros_(layer.weight)
            if layer.bias is not None:
                nn.init.zeros_(layer.bias)

    def set_people(self, people: KnownPeople) -> None:
        """Keep what the people trained on have in common."""
        self.mean_log_albedo.copy_(people.log_albedo)
        self.mean_log_specular.copy_(people.log_specular)
        self.mean_position_mm.copy_(people.position_mm)
        self.albedo_modes.copy_(people.modes)
        self.mode_deviations.copy_(people.deviations)

    def along_modes(self, beside: Tensor, weight: Tensor) -> Tensor:
        """Where albedos are along the modes, in people's standard deviations.

        Args:
            beside: (n, 3, rows, columns) natural logarithms less the mean person's, on the
                processor.
            weight: (1, rows, columns), how much a texel counts.

        Returns:
            (n, modes), by a ridge regression that hardly feels people's variance; 0 along modes
            that so few people have.
        """
        # On the processor, since not every device has doubles.
        modes = (self.albedo_modes * self.mode_deviations.view(-1, 1, 1, 1)).flatten(1)
        modes = modes.cpu().double()
        counts = weight.expand(3, -1, -1).reshape(-1).double()
        normal = (modes * counts) @ modes.T + RIDGE * torch.eye(len(modes), dtype=torch.float64)
        right = (modes * counts) @ beside.flatten(1).double().T
        return torch.linalg.solve(normal, right).T.to(beside)

    def forward(self, inputs: Tensor) -> WholeFace:
        """(B, 10, rows, columns) of `face_input` to what the face is made of."""
        features = [self.first(inputs)]
        for layer in self.down:
            features.append(layer(features[-1]))
        found = features.pop()
        read = found.mean(dim=(2, 3))
        if self.attention is not None:
            read = torch.cat([read, self.attention(found)], dim=1)
        hidden, last = self.everywhere[:-1](read), self.everywhere[-1]
        colour = last(hidden)[:, :, None, None]
        if self.back is not None:
            found = found + self.back(hidden)[:, :, None, None]
        for layer in self.up:
            beside = features.pop()
            larger = functional.interpolate(
                found, size=beside.shape[2:], mode="bilinear", align_corners=False
            )
            found = layer(torch.cat([larger, beside], dim=1))
        change = self.here(found) + colour
        # The answer is trained by the squared error alone: the expected error does not change it.
        seen = torch.cat([found, change], dim=1).detach()
        low, high = DEVIATION
        deviation = low * (high / low) ** torch.sigmoid(self.unsure(seen))
        return WholeFace(
            # Nothing reflects more than arrives, and a black skin is none.
            (self.mean_log_albedo + change[:, :3]).clamp(-7.0, 0.0).exp(),
            (self.mean_log_specular + change[:, 3:]).clamp(-7.0, 0.0).exp(),
            deviation,
        )


def face_input(texture: Tensor, normal: Tensor, position_mm: Tensor, seen: Tensor) -> Tensor:
    """The ten input channels.

    Args:
        texture: (B, 3, rows, columns) linear, light in it.
        normal: (B, 3, rows, columns) unit, head frame; zero where no surface is.
        position_mm: (B, 3, rows, columns), head frame.
        seen: (B, 1, rows, columns), 1 where the texture was photographed.
    """
    # A logarithm: light multiplies skin, so that it adds here. 0 is skin in middling light.
    colour = (texture.clamp_min(DARKEST).log() + 1.5) * seen
    return torch.cat([colour, normal, position_mm / POSITION_MM, seen], dim=1)


def _convolution(channels: int, out: int) -> list[nn.Module]:
    return [nn.Conv2d(channels, out, 3, padding=1), nn.SiLU()]


def _two(channels: int, out: int) -> nn.Sequential:
    return nn.Sequential(*_convolution(channels, out), *_convolution(out, out))
