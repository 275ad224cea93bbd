"""Shading in texture space: Lambert, Blinn-Phong and subsurface scattering [Lattas2021].

Four modes. `dielectric` is skin under a rough dielectric surface: facets with exact Fresnel, and
only what they do not mirror reaches the diffuse layer (see `dielectric`). `physical` is on the
scale of light: diffuse light is clamped at the horizon, ambient light is added, the specular lobe
carries the cosine of incidence and Giesen's normalisation, so that specular albedo is a reflectance
and no skin sends back more than arrives. `paper` is AvatarMe++ as printed: no clamp on the diffuse
dot product, the ambient intensity multiplies the sum (so 0 is black), no fall-off, no
normalisation. `ggx` has facets with Fresnel's rise at grazing angles by Schlick.
"""

from __future__ import annotations

import torch
from torch import Tensor

from learning.render.eager import TexelFields, compiled_sums, sums, unit
from learning.render.environments import Environment
from learning.render.fused import FusedLight, Inputs, can_fuse, fused_facets, wants_gradient
from learning.render.skin import (
    Mode,
    ShadeOptions,
    SkinMaps,
    finite_without_surface,
    wide_enough,
)
from learning.render.subsurface import scatter, scatter_paper

__all__ = ["Mode", "ShadeOptions", "SkinMaps", "direct", "shade", "unit"]

PAIRS_AT_ONCE = 1 << 19
"""Pairs of a light and a texel that torch's operations hold in memory together."""


def shade(
    maps: SkinMaps,
    environment: Environment,
    options: ShadeOptions | None = None,
    visibility: Tensor | None = None,
) -> Tensor:
    """Render skin in texture space.

    Values are taken as they are: a NaN or infinity reaches its own texel, and with scattering all
    skin around it, but changes nothing in a texel without surface; a negative albedo gives negative
    light; positions in metres put all lights a thousand times too far away. `maps.load_head`
    refuses all three. Normals count by their direction and fade below a length of 1e-6 (below 1
    with `fade_normals`); a light within 1 mm of a texel is as bright as at 1 mm; without lights the
    ambient light remains (nothing in mode `paper`, which multiplies).

    Args:
        maps: the skin, batch B or 1; it is never changed.
        environment: lights and camera, batch B or 1. Textures x light sets: a batch of one skin
            under B light sets, B skins under one, or B pairs.
        options: of the shading.
        visibility: (B, L, H, W), the share of each light that a texel sees; all where None. One
            channel holds for every light.

    Returns:
        (B, 3, H, W) linear rgb, 1 = a white diffuser in light of 1; 0 where no surface is.
    """
    chosen = options or ShadeOptions()
    maps = finite_without_surface(maps)
    irradiance, lobe, rim = direct(maps, environment, chosen, visibility)
    diffuse = maps.diffuse_albedo * irradiance
    if chosen.subsurface_mm > 0:
        diffuse = _scattered(maps, diffuse, irradiance, chosen)
    picture = diffuse + maps.specular_albedo * lobe
    if rim is None:
        return picture
    # Below 2 % no dielectric mirrors: there the map means that nothing shines, at any angle.
    return picture + rim * (50 * maps.specular_albedo).clamp(0, 1)


def _scattered(
    maps: SkinMaps, diffuse: Tensor, irradiance: Tensor, options: ShadeOptions
) -> Tensor:
    """Diffuse light after it has spread inside the skin."""
    kind, sigma = wide_enough(diffuse), options.subsurface_mm / maps.texel_mm
    translucency, area = maps.translucency.to(kind), maps.area.to(kind)
    edges = None if maps.edges is None else maps.edges.to(kind)
    if options.mode == "paper":
        return scatter_paper(diffuse, irradiance, translucency, area, sigma)
    if not translucency.requires_grad and not bool((translucency > 0).any()):
        return diffuse
    fused = options.engine == "auto"
    return scatter(diffuse, irradiance, translucency, area, sigma, edges, fused)


def direct(
    maps: SkinMaps,
    environment: Environment,
    options: ShadeOptions,
    visibility: Tensor | None = None,
) -> tuple[Tensor, Tensor, Tensor | None]:
    """What arrives: the diffuse irradiance and the specular lobe's sum over lights.

    Returns:
        (B, 3, H, W) irradiance with ambient light; (B, 3, H, W) to multiply by the specular
        albedo, 0 where that is 0 and has no gradient; (B, 3, H, W) to add, or None.
    """
    height, width = maps.position_mm.shape[-2:]
    kind = wide_enough(maps.position_mm)
    skins, sets = maps.position_mm.shape[0], environment.rgb.shape[0]
    batch = max(skins, sets)

    def flat(field: Tensor) -> Tensor:
        return field.flatten(2).to(kind).expand(batch, -1, -1)

    def for_each(values: Tensor) -> Tensor:
        values = values if values.dtype == torch.bool else values.to(kind)
        return values.expand(batch, *values.shape[1:])

    lights = Environment(
        for_each(environment.position_mm),
        for_each(environment.rgb),
        for_each(environment.ambient_rgb),
        for_each(environment.distant),
        for_each(environment.camera_mm),
    )
    count = lights.rgb.shape[1]
    texels = TexelFields(
        flat(maps.position_mm),
        flat(maps.diffuse_normal),
        flat(maps.specular_normal),
        flat(maps.shininess),
        flat(maps.ambient_occlusion),
        None if visibility is None else flat(visibility).expand(-1, count, -1),
    )
    valid = (maps.area > 0).flatten(1).expand(batch, -1)
    paper = options.mode == "paper"
    rim = None
    facets = options.mode == "dielectric"
    given = None
    if options.engine == "auto" and options.mode != "ggx" and can_fuse(texels.position_mm):
        glossy = valid
        if not maps.specular_albedo.requires_grad:
            glossy = valid & (maps.specular_albedo != 0).flatten(1)
        given = Inputs(
            texels.position_mm,
            texels.diffuse_normal,
            texels.specular_normal,
            texels.shininess,
            texels.occlusion,
            texels.visibility,
            lights.position_mm,
            lights.rgb,
            lights.ambient_rgb,
            lights.camera_mm,
            lights.distant,
            glossy,
            valid,
            paper,
        )
    if given is not None and facets and not wants_gradient(given):
        irradiance, lobe = fused_facets(given)
    elif given is not None and not facets:
        irradiance, lobe = FusedLight.apply(*given)
    else:
        irradiance, lobe, high = _in_torch(texels, lights, options)
        some = valid[:, None]
        irradiance, lobe = (torch.where(some, x, 0.0) for x in (irradiance, lobe))
        if options.mode == "ggx":
            rim = torch.where(some, high, 0.0).unflatten(2, (height, width))
    if options.fade_normals:
        irradiance = irradiance * _fading(texels.diffuse_normal)
        shine = _fading(texels.specular_normal)
        lobe = lobe * shine
        rim = None if rim is None else rim * shine.unflatten(2, (height, width))
    if paper:
        irradiance = irradiance * lights.ambient_rgb[:, :, None]
    return irradiance.unflatten(2, (height, width)), lobe.unflatten(2, (height, width)), rim


def _fading(normals: Tensor) -> Tensor:
    """(B, 1, n) share of the light that (B, 3, n) normals get: 0 at length 0, 1 from 1 on.

    It rises as r (2 - r): the slope of a direction, which grows as 1 / r, is at most doubled by it,
    and at length 1 it has no slope and no kink.
    """
    length = normals.norm(dim=1, keepdim=True).clamp_max(1.0)
    return length * (2 - length)


def _in_torch(
    texels: TexelFields, lights: Environment, options: ShadeOptions
) -> tuple[Tensor, Tensor, Tensor]:
    """The sums by torch's operations; in chunks, so that (lights, texels) stays in the cache."""
    if options.engine == "compiled":
        return compiled_sums(texels, lights, options.mode)
    step = max(1, PAIRS_AT_ONCE // max(1, lights.rgb.shape[1]))

    def part(first: int) -> TexelFields:
        here = slice(first, first + step)
        seen = texels.visibility
        return TexelFields(
            texels.position_mm[:, :, here],
            texels.diffuse_normal[:, :, here],
            texels.specular_normal[:, :, here],
            texels.shininess[:, :, here],
            texels.occlusion[:, :, here],
            None if seen is None else seen[:, :, here],
        )

    count = texels.position_mm.shape[2]
    chunks = [sums(part(first), lights, options.mode) for first in range(0, count, step)]
    irradiance, lobe, rim = (torch.cat(values, dim=2) for values in zip(*chunks, strict=True))
    return irradiance, lobe, rim
