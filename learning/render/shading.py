"""Shading in texture space: Lambert, Blinn-Phong and subsurface scattering [Lattas2021].

Two modes. `default` is on the scale of physical light: diffuse light is clamped at the horizon,
ambient light is added, the specular lobe carries the cosine of incidence and (s + 8) / 8, so that
specular albedo is a reflectance. `paper` is AvatarMe++ as printed: no clamp on the diffuse dot
product, the ambient intensity multiplies the sum (so 0 is black), no fall-off, no normalisation.
"""

from __future__ import annotations

import dataclasses
from typing import Literal

import torch
from torch import Tensor

from learning.errors import MapsError
from learning.render.environments import Environment
from learning.render.subsurface import scatter, scatter_paper

PAIRS_AT_ONCE = 1 << 19
"""Pairs of a light and a texel that are held in memory together."""


@dataclasses.dataclass(frozen=True)
class SkinMaps:
    """A batch of skin textures: all that the renderer needs of a surface.

    Attributes:
        diffuse_albedo: (B, 3, H, W), 1 = perfect white, without occlusion.
        specular_albedo: (B, 1, H, W), reflectance at normal incidence.
        diffuse_normal: (B, 3, H, W), any length; zero where no surface is.
        specular_normal: (B, 3, H, W).
        shininess: (B, 1, H, W), Blinn-Phong's exponent.
        translucency: (B, 1, H, W), 0..1.
        position_mm: (B, 3, H, W).
        area: (B, 1, H, W), a texel's surface relative to `texel_mm` squared; 0 where no surface is.
        texel_mm: edge of a texel of area 1, for the subsurface kernel.
        ambient_occlusion: (B, 1, H, W), 1 = open; what is left of the ambient light.
    """

    diffuse_albedo: Tensor
    specular_albedo: Tensor
    diffuse_normal: Tensor
    specular_normal: Tensor
    shininess: Tensor
    translucency: Tensor
    position_mm: Tensor
    area: Tensor
    texel_mm: float
    ambient_occlusion: Tensor

    def __post_init__(self) -> None:
        size = self.diffuse_albedo.shape[-2:]
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if isinstance(value, Tensor) and value.shape[-2:] != size:
                raise MapsError(
                    "maps",
                    field=field.name,
                    found=f"{value.shape[-2]} x {value.shape[-1]} texels",
                    expected=f"{size[0]} x {size[1]}, as diffuse_albedo",
                )


@dataclasses.dataclass(frozen=True)
class ShadeOptions:
    """How to shade.

    Attributes:
        mode: `default`, or `paper` for the formulas as printed.
        subsurface_mm: the diffusion kernel's standard deviation on the skin; 0 for none. The
            paper's 1.4 mm, 21 px of its 6144 x 4096 texture, is read as a standard deviation.
    """

    mode: Literal["default", "paper"] = "default"
    subsurface_mm: float = 1.4


def unit(vectors: Tensor, floor: float = 1e-6) -> Tensor:
    """Vectors along dimension 1 at length 1; those shorter than `floor` fade to zero.

    The gradient is finite everywhere, at zero too.
    """
    square = (vectors * vectors).sum(dim=1, keepdim=True)
    return vectors * square.clamp_min(floor * floor).rsqrt()


def shade(
    maps: SkinMaps,
    environment: Environment,
    options: ShadeOptions | None = None,
    visibility: Tensor | None = None,
) -> Tensor:
    """Render skin in texture space.

    Args:
        maps: the skin, batch B.
        environment: lights and camera, batch B or 1.
        options: how.
        visibility: (B, L, H, W), the share of each light that a texel sees; all where None.

    Returns:
        (B, 3, H, W) linear rgb, 1 = a white diffuser in light of 1.
    """
    chosen = options or ShadeOptions()
    irradiance, lobe = direct(maps, environment, chosen, visibility)
    diffuse = maps.diffuse_albedo * irradiance
    if chosen.subsurface_mm > 0:
        sigma_px = chosen.subsurface_mm / maps.texel_mm
        spread = scatter_paper if chosen.mode == "paper" else scatter
        diffuse = spread(diffuse, irradiance, maps.translucency, maps.area, sigma_px)
    return diffuse + maps.specular_albedo * lobe


def direct(
    maps: SkinMaps,
    environment: Environment,
    options: ShadeOptions,
    visibility: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """What arrives: the diffuse irradiance and the specular lobe's sum over lights.

    Texels are taken in chunks, so that the (lights, texels) tensors stay in the cache.

    Returns:
        (B, 3, H, W) irradiance with ambient light, and (B, 3, H, W) to multiply by the specular
        albedo.
    """
    height, width = maps.position_mm.shape[-2:]
    fields = [
        field.flatten(2)
        for field in (
            maps.position_mm,
            maps.diffuse_normal,
            maps.specular_normal,
            maps.shininess,
            maps.ambient_occlusion,
        )
    ]
    if visibility is not None:
        fields.append(visibility.flatten(2))
    step = max(1, PAIRS_AT_ONCE // max(1, environment.rgb.shape[1]))
    chunks = [
        _arriving(environment, options.mode == "paper", *parts)
        for parts in zip(*(field.split(step, dim=2) for field in fields), strict=True)
    ]
    irradiance = torch.cat([chunk[0] for chunk in chunks], dim=2)
    lobe = torch.cat([chunk[1] for chunk in chunks], dim=2)
    return irradiance.unflatten(2, (height, width)), lobe.unflatten(2, (height, width))


def _arriving(
    environment: Environment,
    paper: bool,
    position: Tensor,
    diffuse_normal: Tensor,
    specular_normal: Tensor,
    shininess: Tensor,
    occlusion: Tensor,
    seen: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """`direct` for n texels, all lights at once; fields are (B, c, n).

    Dot products with a light at P are (n . P - n . p) / |P - p|: matrix products of (L, 3) with
    (3, n), so that no (L, 3, n) tensor is ever held.
    """
    light = environment.position_mm  # (B, L, 3)
    distant = environment.distant[:, :, None]
    near = (~distant).to(position)
    colour = environment.rgb.mT  # (B, 3, L)
    ambient = environment.ambient_rgb[:, :, None]
    view = unit(environment.camera_mm[:, :, None] - position)
    specular_normal = unit(specular_normal)

    def toward_light(direction: Tensor) -> Tensor:
        """(B, L, n) direction . (P - p), of a distant light direction . P."""
        return light @ direction - near * _dot(direction, position)

    square = (light * light).sum(dim=-1, keepdim=True)
    # Within 1 mm of a lamp the inverse square has no meaning for a point light.
    distance2 = square - near * (2 * (light @ position) - _dot(position, position))
    inverse = distance2.clamp_min(1.0).rsqrt()
    diffuse = toward_light(unit(diffuse_normal)) * inverse
    incidence = toward_light(specular_normal) * inverse
    # |l + v|^2 = 2 + 2 l.v; where l = -v the half vector is undefined and no lobe is seen.
    half_length = (2 + 2 * toward_light(view) * inverse).clamp_min(1e-4)
    half = (incidence + _dot(specular_normal, view)) * half_length.rsqrt()
    specular = half.clamp(0.0, 1.0) ** shininess
    if not paper:
        reach = torch.where(distant, 1.0, square * inverse * inverse)
        diffuse = diffuse.clamp_min(0) * reach
        specular = specular * incidence.clamp_min(0) * reach
    if seen is not None:
        diffuse, specular = diffuse * seen, specular * seen
    irradiance, lobe = colour @ diffuse, colour @ specular
    if paper:
        return irradiance * ambient, lobe
    return irradiance + ambient * occlusion, lobe * ((shininess + 8) / 8)


def _dot(a: Tensor, b: Tensor) -> Tensor:
    return (a * b).sum(dim=1, keepdim=True)
