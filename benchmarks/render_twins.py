"""Straightforward renderers: a light at a time, as formulas are written, and the published ones."""

from __future__ import annotations

from collections.abc import Callable

import torch
import torch.nn.functional as functional
from torch import Tensor

from learning.render.environments import Environment
from learning.render.skin import SkinMaps

RADIUS_PX = 21
"""Of the published kernel, 43 x 43."""


def unit(vectors: Tensor) -> Tensor:
    return vectors / vectors.norm(dim=1, keepdim=True).clamp_min(1e-6)


def plain(skin: SkinMaps, lights: Environment) -> Tensor:
    """One light at a time, vectors of three as they are written in the formulas."""
    view = unit(lights.camera_mm[:, :, None, None] - skin.position_mm)
    diffuse_normal, specular_normal = unit(skin.diffuse_normal), unit(skin.specular_normal)
    picture = skin.diffuse_albedo * lights.ambient_rgb[:, :, None, None]
    s = skin.shininess
    norm = (s + 2) * (s + 4) / (8 * (torch.exp2(-s / 2) + s))
    for index in range(lights.rgb.shape[1]):
        position = lights.position_mm[:, index, :, None, None]
        rgb = lights.rgb[:, index, :, None, None]
        toward = position - skin.position_mm
        distance = toward.norm(dim=1, keepdim=True)
        light = toward / distance
        reach = (position.norm(dim=1, keepdim=True) / distance) ** 2
        diffuse = (diffuse_normal * light).sum(dim=1, keepdim=True).clamp_min(0)
        half = unit(light + view)
        lobe = (specular_normal * half).sum(dim=1, keepdim=True).clamp_min(0) ** s
        cosine = (specular_normal * light).sum(dim=1, keepdim=True).clamp_min(0)
        shine = skin.specular_albedo * norm * lobe * cosine
        picture = picture + rgb * reach * (skin.diffuse_albedo * diffuse + shine)
    return picture


def _taps() -> Tensor:
    taps = torch.exp(-0.5 * (torch.arange(-RADIUS_PX, RADIUS_PX + 1) / (RADIUS_PX / 3)) ** 2)
    return taps / taps.sum()


def dense_blur(image: Tensor) -> Tensor:
    """43 x 43 at once. Planes as a batch: grouped, torch's is a hundred times slower."""
    kernel = torch.outer(_taps(), _taps())
    planes = image.transpose(0, 1)
    return functional.conv2d(planes, kernel[None, None], padding=RADIUS_PX).transpose(0, 1)


def separable_blur(image: Tensor) -> Tensor:
    """43 along each axis."""
    taps, planes = _taps(), image.transpose(0, 1)
    planes = functional.conv2d(planes, taps[None, None, :, None], padding=(RADIUS_PX, 0))
    planes = functional.conv2d(planes, taps[None, None, None], padding=(0, RADIUS_PX))
    return planes.transpose(0, 1)


def authors(skin: SkinMaps, lights: Environment, blur: Callable[[Tensor], Tensor] | None) -> Tensor:
    """AvatarMe++'s formulas as printed, one light at a time; no scattering without a blur."""
    view = unit(lights.camera_mm[:, :, None, None] - skin.position_mm)
    diffuse_normal, specular_normal = unit(skin.diffuse_normal), unit(skin.specular_normal)
    irradiance = torch.zeros_like(skin.diffuse_albedo)
    lobes = torch.zeros_like(skin.diffuse_albedo)
    for index in range(lights.rgb.shape[1]):
        rgb = lights.rgb[:, index, :, None, None]
        light = unit(lights.position_mm[:, index, :, None, None] - skin.position_mm)
        irradiance = irradiance + rgb * (diffuse_normal * light).sum(dim=1, keepdim=True)
        half = unit(light + view)
        lobe = (specular_normal * half).sum(dim=1, keepdim=True).clamp_min(0) ** skin.shininess
        lobes = lobes + rgb * lobe
    irradiance = irradiance * lights.ambient_rgb[:, :, None, None]
    diffuse = skin.diffuse_albedo * irradiance
    if blur is not None:
        kept = diffuse.new_tensor([0.5, 0.85, 0.95]).view(1, 3, 1, 1)
        share = skin.translucency * (1 - irradiance)
        diffuse = (1 - share) * kept * diffuse + share * (1 - kept) * blur(diffuse)
    return diffuse + skin.specular_albedo * lobes
