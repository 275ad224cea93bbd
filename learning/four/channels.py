"""Inputs and outputs of each of the four networks, as channels in -1..1 [Lattas2020]."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import torch
from torch import Tensor

from learning.data import Batch
from learning.encoding import (
    OWN_CHANNELS,
    Reference,
    Reflectance,
    decode_maps,
    encode_colour,
    turn,
)
from lightstage.formats.srgb import LUMINANCE

DIFFUSE_ALBEDO, SPECULAR_ALBEDO = "diffuse_albedo", "specular_albedo"
DIFFUSE_NORMAL, SPECULAR_NORMAL = "diffuse_normal", "specular_normal"
PARTS: dict[str, tuple[int, slice]] = {
    DIFFUSE_ALBEDO: (4, slice(0, 3)),
    SPECULAR_ALBEDO: (3, slice(3, 4)),
    DIFFUSE_NORMAL: (4, slice(4, 7)),
    SPECULAR_NORMAL: (4, slice(7, 10)),
}
"""Input channels of each network, and its output among a patch's ten channels; each may take what
those before it found."""
DEPTH_MM = 150.0
"""Depth, encoded as 1: from the head's middle toward the front; a head has up to about 130."""
LUMA = tuple(LUMINANCE.tolist())
"""Shares of encoded red, green and blue in a grey picture: the luminance's of linear ones."""


@dataclasses.dataclass(frozen=True)
class Seen:
    """What is known of a patch, or of a whole texture, before any network has spoken.

    Attributes:
        texture: (B, 3, h, w) linear, light baked in; 0 where no surface is.
        covered: (B, 1, h, w), 1 where a surface is.
        position_mm: (B, 3, h, w) in the head frame.
        shape_normal: (B, 3, h, w) unit, in the head frame; 0 where no surface is.
        smooth_normal: the same of the shape without its folds.
        reference: of the encoding.
    """

    texture: Tensor
    covered: Tensor
    position_mm: Tensor
    shape_normal: Tensor
    smooth_normal: Tensor
    reference: Reference

    def input_of(self, part: str, albedo: Tensor | None) -> Tensor:
        """What a network sees.

        Texture and depth; the diffuse albedo; its grey and the shape's normals, in the head's axes
        or, of specular normals, in tangent space. That is here the frame of the shape without its
        folds, in which the shape's own normals show them.

        Args:
            part: of `PARTS`.
            albedo: (B, 3, h, w) linear; needed by all but the first network.
        """
        if part == DIFFUSE_ALBEDO:
            encoded = encode_colour(self.texture, self.reference.texture)
            depth = (self.position_mm[:, 2:] / DEPTH_MM).clamp(-1, 1) * self.covered
            return torch.cat([encoded, depth], dim=1)
        assert albedo is not None
        encoded = encode_colour(albedo * self.covered, self.reference.albedo)
        if part == SPECULAR_ALBEDO:
            return encoded
        grey = (encoded * encoded.new_tensor(LUMA).view(1, 3, 1, 1)).sum(dim=1, keepdim=True)
        normal = self.shape_normal
        if part == SPECULAR_NORMAL:
            normal = turn(normal, self.smooth_normal, back=True)
        return torch.cat([grey, normal], dim=1)


def seen_of(batch: Batch) -> Seen:
    """What is known of a batch of patches."""
    # The published input holds normals as they are.
    shape = batch.inputs[:, 3:6]
    given = (batch.texture, batch.covered, batch.skin.position_mm, shape, batch.smooth_normal)
    return Seen(*given, batch.reference)


def pairs(batch: Batch) -> dict[str, Batch]:
    """The batch as each network is trained on it: with the true albedo where it sees one."""
    seen = seen_of(batch)
    return {
        part: dataclasses.replace(
            batch,
            inputs=seen.input_of(part, batch.skin.diffuse_albedo),
            target=batch.target[:, channels],
            covered_channels=batch.covered_channels[:, channels],
        )
        for part, (_, channels) in PARTS.items()
    }


def infer_in_sequence(run_part: Callable[[str, Tensor], Tensor], seen: Seen) -> Reflectance:
    """Output of the four networks; each gets the results of those before it.

    Args:
        run_part: of a part's name and its (B, C, h, w) input, its (B, c, h, w) output.
        seen: the texture.
    """
    channels = seen.texture.new_zeros(len(seen.texture), OWN_CHANNELS, *seen.texture.shape[2:])
    albedo = None
    for part, (_, own) in PARTS.items():
        channels[:, own] = run_part(part, seen.input_of(part, albedo))
        if part == DIFFUSE_ALBEDO:
            albedo = decode_maps(channels, seen.reference).diffuse_albedo
    return decode_maps(channels, seen.reference)
