"""What the networks see: maps as channels in -1..1, and back.

Albedo and textures are encoded as sRGB (so that a step looks the same in dark and light skin),
specular albedo linearly over 0..0.1, normals as they are.

Instance norm takes a patch's mean away in the first layer, so the tone of the skin would reach the
output only through its contrast with eyes and hair, which takes long to learn. With a `relative`
tone, colours are relative to the mean colour of the whole lit texture: the tone goes around the
network, and what it learns is how shading relates to albedo. For the same reason normals are then
in the frame of the shape's own. The published encoding is absolute.

Skin is nearly of one tone: a flat albedo is some 3 % wrong, so in a few hundred steps losses teach
nothing of brows, lips and moles, and a network without a way around its bottleneck does not show
them. With a reference of `detail`, albedo is relative to the texture's local contrast too: a
constant output is then the texture with its slow light taken out, and what is learned are the edges
of shadows, the highlights and the tones of regions.
"""

from __future__ import annotations

import dataclasses
from typing import Literal

import torch
import torch.nn.functional as functional
from torch import Tensor

from learning.render.shading import SkinMaps, unit
from learning.render.subsurface import blur

SpecularFrame = Literal["tangent", "head"]
OWN_INPUTS = 6
"""Input channels of the patch itself; those of the whole texture follow."""
OWN_CHANNELS = 10
"""Channels of the patch's own maps; those of the whole albedo follow."""
SPECULAR_MOST = 0.1
"""Specular albedo that is encoded as 1; skin has about 0.03."""
TEXTURE_HEADROOM = 4.0
"""Brightest lit texel that is distinguished, in units of the texture's colour."""
ALBEDO_HEADROOM = 10.0
"""Brightest albedo that is distinguished, in the same units: the white of an eye in dim light."""
DETAIL_FLOOR = 0.02
"""Added to sRGB-encoded colours before their ratio is taken, so that black has no contrast."""
DARK = 0.1
"""sRGB-encoded colour below which a texel's contrast fades; a 60th of the texture's mean."""
SMOOTH_MM = 5.0
"""Standard deviation, on the face, of the blur that takes folds and wrinkles out of the shape."""
DETAIL_MOST = 2.0
"""Largest contrast, and the inverse of the smallest, that goes around the network."""


def srgb_from_linear(rgb: Tensor, most: float = 1.0) -> Tensor:
    """The curve of sRGB for values of any shape, clipped to 0..`most` [IEC61966]."""
    x = rgb.clamp(0.0, most)
    return torch.where(
        x <= 0.0031308, 12.92 * x, 1.055 * x.clamp_min(0.0031308) ** (1 / 2.4) - 0.055
    )


def linear_from_srgb(image: Tensor) -> Tensor:
    """The inverse of `srgb_from_linear` for values of any shape and of at least 0."""
    return torch.where(
        image <= 0.04045, image / 12.92, ((image.clamp_min(0.04045) + 0.055) / 1.055) ** 2.4
    )


@dataclasses.dataclass(frozen=True)
class Reference:
    """What colours and normals are relative to.

    Attributes:
        texture: (B, 3, 1, 1) linear colour that is encoded as white in the input.
        albedo: (B, 3, 1, 1) the same in the output.
        normal: (B, 3, h, w) unit vectors that are +z for the output's diffuse normals.
        specular_normal: the same for its specular normals.
        detail: (B, 3, h, w) that sRGB-encoded albedo (0..1) is divided by; None for nothing.
    """

    texture: Tensor
    albedo: Tensor
    normal: Tensor
    specular_normal: Tensor
    detail: Tensor | None = None


def absolute_reference(shape_normal: Tensor, specular_frame: SpecularFrame) -> Reference:
    """White is white and +z is the head's, of specular normals in tangent space the shape's normal.

    Args:
        shape_normal: (B, 3, h, w) of the patch; zero where no surface is.
        specular_frame: as published, specular normals are in tangent space and diffuse ones in
            the head's axes [Lattas2020].
    """
    ones = shape_normal.new_ones(len(shape_normal), 3, 1, 1)
    ahead = torch.zeros_like(shape_normal)
    ahead[:, 2] = 1
    return Reference(ones, ones, ahead, shape_normal if specular_frame == "tangent" else ahead)


def relative_reference(whole_texture: Tensor, covered: Tensor, shape_normal: Tensor) -> Reference:
    """White is a multiple of the lit texture's colour; +z is the shape's normal.

    The colour is the root of the mean square, in which the lit parts count more than the shadows:
    how much of a face is in shadow does not depend on its skin.

    Args:
        whole_texture: (B, 3, h, w) linear, of the whole face.
        covered: (B, 1, h, w), 1 where a surface is that the texture shows.
        shape_normal: (B, 3, h, w) of the patch.
    """
    total = (whole_texture.square() * covered).sum(dim=(2, 3), keepdim=True)
    mean = (total / covered.sum(dim=(2, 3), keepdim=True).clamp_min(1.0)).sqrt()
    mean = mean.clamp_min(1e-4)
    white = (TEXTURE_HEADROOM * mean, ALBEDO_HEADROOM * mean)
    return Reference(*white, shape_normal, shape_normal)


def local_contrast(texture: Tensor, covered: Tensor, white: Tensor, sigma_px: float) -> Tensor:
    """The sRGB-encoded texture over its own blurred self; 1 where it is black or not there.

    sRGB is nearly a power, so light that is even over the blur's width falls out of the ratio.

    Args:
        texture: (B, 3, h, w) linear.
        covered: (B, 1, h, w), 1 where a surface is.
        white: (B, 3, 1, 1) linear colour that is encoded as 1.
        sigma_px: the blur's standard deviation; nothing comes in over borders.

    Returns:
        (B, 3, h, w) in 1 / DETAIL_MOST..DETAIL_MOST.
    """
    encoded = srgb_from_linear(texture / white)
    # Black texels were never lit or never photographed: they do not show the skin.
    known = covered * (encoded.amax(dim=1, keepdim=True) / DARK).clamp_max(1.0)
    spread = blur(torch.cat([encoded * known, known], dim=1), sigma_px)
    mean = spread[:, :3] / spread[:, 3:].clamp_min(1e-4)
    contrast = (encoded + DETAIL_FLOOR) / (mean + DETAIL_FLOOR)
    return contrast.clamp(1 / DETAIL_MOST, DETAIL_MOST) ** known


def smoothed_normal(shape_normal: Tensor, area: Tensor, texel_mm: float) -> Tensor:
    """Normals of the shape without its folds: in this frame the shape's own normals show them.

    Args:
        shape_normal: (1, 3, h, w) of a whole face; zero where no surface is.
        area: (1, 1, h, w) of texels, 0 where no surface is; the unit does not matter.
        texel_mm: edge of a typical texel.
    """
    return unit(blur(shape_normal * area, SMOOTH_MM / texel_mm))


def turn(vectors: Tensor, normal: Tensor, back: bool = False) -> Tensor:
    """Turn (B, 3, h, w) vectors by the smallest rotation that takes +z to a unit normal.

    Args:
        vectors: (B, 3, h, w), to be turned.
        normal: (B, 3, h, w), unit.
        back: the inverse, from the normal's frame to the head's axes being the forward one.
    """
    x, y, z = normal.unbind(dim=1)
    # Straight backward (-z) every turn is as small as any; the scalp's edge alone is there.
    a = 1 / (1 + z).clamp_min(1e-3)
    first = torch.stack([1 - x * x * a, -x * y * a, -x], dim=1)
    second = torch.stack([-x * y * a, 1 - y * y * a, -y], dim=1)
    if back:
        return torch.stack([(axis * vectors).sum(dim=1) for axis in (first, second, normal)], dim=1)
    return vectors[:, :1] * first + vectors[:, 1:2] * second + vectors[:, 2:] * normal


def encode_colour(rgb_linear: Tensor, white: Tensor | float = 1.0) -> Tensor:
    """(B, 3, h, w) linear 0..white (clipped) to sRGB in -1..1; white is 1 or (B, 3, 1, 1)."""
    return 2 * srgb_from_linear(rgb_linear / white) - 1


def decode_colour(channels: Tensor, white: Tensor | float = 1.0) -> Tensor:
    """(B, 3, h, w) in -1..1 to linear 0..white; white is 1 or (B, 3, 1, 1)."""
    return linear_from_srgb((channels + 1) / 2) * white


def network_input(
    texture: Tensor, shape_normal: Tensor, whole_texture: Tensor, reference: Reference
) -> Tensor:
    """The nine input channels.

    Args:
        texture: (B, 3, h, w) linear, light baked in.
        shape_normal: (B, 3, h, w) unit, head frame; zero where no surface is.
        whole_texture: (B, 3, h, w) linear, the whole texture shrunk to the patch's size.
        reference: of the encoding.
    """
    colours = [encode_colour(image, reference.texture) for image in (texture, whole_texture)]
    return torch.cat([colours[0], shape_normal, colours[1]], dim=1)


def encode_maps(
    skin: SkinMaps, whole_albedo: Tensor, covered: Tensor, reference: Reference
) -> Tensor:
    """The thirteen channels the generator should give for a skin.

    Args:
        skin: of the patch.
        whole_albedo: (B, 3, h, w) of the whole texture, shrunk to the patch's size.
        covered: (B, 13, h, w) of `covered_channels`; where it is 0 the encoding is 0.
        reference: of the encoding.
    """
    channels = torch.cat(
        [
            _without(encode_colour(skin.diffuse_albedo, reference.albedo), reference.detail),
            (2 / SPECULAR_MOST) * skin.specular_albedo.clamp(0, SPECULAR_MOST) - 1,
            turn(unit(skin.diffuse_normal), reference.normal, back=True),
            turn(unit(skin.specular_normal), reference.specular_normal, back=True),
            encode_colour(whole_albedo, reference.albedo),
        ],
        dim=1,
    )
    return channels * covered


def covered_channels(patch: Tensor, whole: Tensor) -> Tensor:
    """(B, 13, h, w), 1 where a surface is that a channel shows.

    Args:
        patch: (B, 1, h, w) of the patch's own maps.
        whole: (B, 1, h, w) of the whole albedo, which has the outline of the whole texture.
    """
    return torch.cat([patch.expand(-1, OWN_CHANNELS, -1, -1), whole.expand(-1, 3, -1, -1)], dim=1)


def _without(channels: Tensor, detail: Tensor | None) -> Tensor:
    """Colour channels over the detail; values beyond the network's range are cut off."""
    return channels if detail is None else ((channels + 1) / detail - 1).clamp_max(1.0)


def _with(channels: Tensor, detail: Tensor | None) -> Tensor:
    return channels if detail is None else ((channels + 1) * detail - 1).clamp_max(1.0)


@dataclasses.dataclass(frozen=True)
class Reflectance:
    """The generator's output, in physical units.

    Attributes:
        diffuse_albedo: (B, 3, h, w).
        specular_albedo: (B, 1, h, w).
        diffuse_normal: (B, 3, h, w), unit, or shorter where the network is unsure.
        specular_normal: (B, 3, h, w).
    """

    diffuse_albedo: Tensor
    specular_albedo: Tensor
    diffuse_normal: Tensor
    specular_normal: Tensor

    def on(self, skin: SkinMaps) -> SkinMaps:
        """This reflectance on the surface of `skin`."""
        return dataclasses.replace(
            skin,
            diffuse_albedo=self.diffuse_albedo,
            specular_albedo=self.specular_albedo,
            diffuse_normal=self.diffuse_normal,
            specular_normal=self.specular_normal,
        )


def decode_maps(channels: Tensor, reference: Reference) -> Reflectance:
    """Reflectance of a patch's own maps.

    Args:
        channels: (B, 10 or more, h, w); those after the first ten are dropped.
        reference: of the encoding.

    Normals shorter than 1 keep their length: to make them unit would multiply their gradient by
    its inverse, without bound in an untrained network, whose outputs are near zero. Shade them with
    `ShadeOptions.fade_normals`.
    """
    return Reflectance(
        decode_colour(_with(channels[:, :3], reference.detail), reference.albedo),
        (channels[:, 3:4] + 1) * (SPECULAR_MOST / 2),
        unit(turn(channels[:, 4:7], reference.normal), floor=1.0),
        unit(turn(channels[:, 7:10], reference.specular_normal), floor=1.0),
    )


def shrink(image: Tensor, size: tuple[int, int]) -> Tensor:
    """Resize a (B, c, H, W) image to (B, c, h, w) by averaging over areas."""
    return functional.interpolate(
        image, size=size, mode="bilinear", align_corners=False, antialias=True
    )
