"""The sums over lights in torch's own operations: on any device, compiled or not, for any lobe.

Dot products with a light at P are (n . P - n . p) / |P - p|: matrix products of (L, 3) with (3, n),
so that no (L, 3, n) tensor is ever held.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable

import torch
from torch import Tensor

from learning.render.dielectric import (
    let_through,
    mean_through,
    mirror_lobe,
    mirrored,
    roughness_of,
)
from learning.render.environments import Environment
from learning.render.texel_blocks import NARROWEST, NEAREST_MM, SHORTEST


@dataclasses.dataclass(frozen=True)
class TexelFields:
    """What the sums read of n texels: (B, c, n) each.

    Attributes:
        position_mm: 3 channels.
        diffuse_normal: 3, of any length.
        specular_normal: 3.
        shininess: 1.
        occlusion: 1, of the ambient light.
        visibility: one channel a light, or None.
    """

    position_mm: Tensor
    diffuse_normal: Tensor
    specular_normal: Tensor
    shininess: Tensor
    occlusion: Tensor
    visibility: Tensor | None


def unit(vectors: Tensor, floor: float = SHORTEST) -> Tensor:
    """Vectors along dimension 1 at length 1; those shorter than `floor` fade to zero.

    The gradient is finite everywhere, at zero too.

    Args:
        vectors: (B, 3, ..).
        floor: length below which they fade.

    Returns:
        (B, 3, ..).
    """
    square = (vectors * vectors).sum(dim=1, keepdim=True)
    return vectors * square.clamp_min(floor * floor).rsqrt()


def sums(texels: TexelFields, environment: Environment, mode: str) -> tuple[Tensor, Tensor, Tensor]:
    """Irradiance, lobe and rim: (B, 3, n) each.

    The skin shows albedo * irradiance + specular albedo * lobe + rim; the rim, Fresnel's rise
    toward grazing light, is 0 except in mode `ggx`.
    """
    paper = mode == "paper"
    position, shininess = texels.position_mm, texels.shininess
    distant = environment.distant[:, :, None]
    near = (~distant).to(position)
    light = environment.position_mm  # (B, L, 3)
    length = light.square().sum(dim=-1, keepdim=True).clamp_min(1e-30).rsqrt()
    light = torch.where(distant, light * length, light)
    colour = environment.rgb.mT  # (B, 3, L)
    ambient = environment.ambient_rgb[:, :, None]
    view = unit(environment.camera_mm[:, :, None] - position)
    normal = unit(texels.specular_normal)

    def toward_light(direction: Tensor) -> Tensor:
        """(B, L, n) direction . (P - p), of a distant light direction . P."""
        return light @ direction - near * _dot(direction, position)

    square = (light * light).sum(dim=-1, keepdim=True)
    distance2 = square - near * (2 * (light @ position) - _dot(position, position))
    least = near * (NEAREST_MM**2 - 1e-12) + 1e-12
    inverse = torch.maximum(distance2, least).rsqrt()
    diffuse = diffuse_cosine = toward_light(unit(texels.diffuse_normal)) * inverse
    incidence = toward_light(normal) * inverse
    toward_view = _dot(normal, view)
    view_light = toward_light(view) * inverse
    half_length = (2 + 2 * view_light).clamp_min(NARROWEST).rsqrt()
    half = ((incidence + toward_view) * half_length).clamp(0.0, 1.0)
    reach = square * inverse * inverse
    seen = texels.visibility
    if not paper:
        diffuse = diffuse.clamp_min(0) * reach
        incidence = incidence.clamp_min(0)
    rim = None
    if mode == "dielectric":
        through = mirrored(roughness_of(shininess))
        leaving = let_through(through, _dot(unit(texels.diffuse_normal), view))
        diffuse = diffuse * let_through(through, diffuse_cosine) * leaving / mean_through(through)
        view_half = ((1 + view_light) * half_length).clamp(0.0, 1.0)
        specular = mirror_lobe(half, incidence, toward_view, view_half, shininess) * reach
    elif mode == "ggx":
        facets = ggx(half, incidence, toward_view.clamp_min(0), shininess) * reach
        beside = (1 - (1 + view_light) * half_length).clamp_min(0) ** 5
        specular, rim = facets * (1 - beside), facets * beside
    else:
        # As x^s at 0 has an infinite slope for s < 1, what is darker than any lobe is not raised.
        specular = torch.where(half > 0, half.clamp_min(1e-30) ** shininess, 0.0)
        specular = specular if paper else specular * incidence * reach
    if seen is not None:
        diffuse, specular = diffuse * seen, specular * seen
        rim = rim if rim is None else rim * seen
    irradiance, lobe = colour @ diffuse, colour @ specular
    nothing = torch.zeros_like(lobe)
    if paper:
        return irradiance, lobe, nothing
    irradiance = irradiance + ambient * texels.occlusion
    if mode == "dielectric":
        return irradiance, lobe, nothing
    if rim is not None:
        return irradiance, lobe, colour @ rim
    return irradiance, lobe * lobe_norm(shininess), nothing


def lobe_norm(exponent: Tensor) -> Tensor:
    """What makes the lobe (n . h)^s reflect all light that comes along the normal.

    pi times Giesen's factor, (s + 2) (s + 4) / (8 (2^(-s/2) + s)) [Giesen2009].
    """
    return (exponent + 2) * (exponent + 4) / (8 * (torch.exp2(-0.5 * exponent) + exponent))


def ggx(half: Tensor, incidence: Tensor, toward_view: Tensor, exponent: Tensor) -> Tensor:
    """Pi D G / (4 n.v) of GGX facets with Smith's shadowing of both directions [Walter2007].

    The roughness is the exponent's: alpha^2 = 2 / (s + 2). On the scale where a white diffuser
    shows n . l; finite at grazing angles.

    Args:
        half: (B, L, n) of L lights at n texels: n . h, 0..1.
        incidence: (B, L, n): n . l, clamped at 0.
        toward_view: (B, 1, n): n . v, clamped at 0.
        exponent: (B, 1, n): s.

    Returns:
        (B, L, n).
    """
    squared = 2 / (exponent + 2)
    spread = half.square() * (squared - 1) + 1
    density = squared / spread.square()

    def lengthened(cosine: Tensor) -> Tensor:
        return cosine + (squared + (1 - squared) * cosine.square()).sqrt()

    facets = density * incidence / (lengthened(incidence) * lengthened(toward_view))
    return torch.where((half > 0) & (incidence > 0) & (toward_view > 0), facets, 0.0)


@functools.cache
def compiled() -> Callable[..., tuple[Tensor, Tensor, Tensor]]:
    """`sums` through torch.compile; the first call of a shape takes seconds to minutes."""
    return torch.compile(_sums_of_tensors)


def _sums_of_tensors(
    fields: tuple[Tensor, Tensor, Tensor, Tensor, Tensor],
    visibility: Tensor | None,
    lights: tuple[Tensor, Tensor, Tensor, Tensor, Tensor],
    mode: str,
) -> tuple[Tensor, Tensor, Tensor]:
    return sums(TexelFields(*fields, visibility), Environment(*lights), mode)


def compiled_sums(
    texels: TexelFields, environment: Environment, mode: str
) -> tuple[Tensor, Tensor, Tensor]:
    """As `sums`, one compiled pass."""
    fields = (
        texels.position_mm,
        texels.diffuse_normal,
        texels.specular_normal,
        texels.shininess,
        texels.occlusion,
    )
    lights = (
        environment.position_mm,
        environment.rgb,
        environment.ambient_rgb,
        environment.distant,
        environment.camera_mm,
    )
    return compiled()(fields, texels.visibility, lights, mode)


def _dot(a: Tensor, b: Tensor) -> Tensor:
    return (a * b).sum(dim=1, keepdim=True)
