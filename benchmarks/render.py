"""The renderer against plain twins: shading 512 x 512 under 12 lights, subsurface scattering."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable

import numpy as np
import torch
import torch.nn.functional as functional
from torch import Tensor

from benchmarks.record import record
from learning.render.environments import Environment
from learning.render.shading import ShadeOptions, SkinMaps, shade, unit
from learning.render.subsurface import blur

SIZE, LIGHTS, REPEATS = 512, 12, 5


def random_skin(generator: torch.Generator) -> SkinMaps:
    def maps(channels: int, low: float, high: float) -> Tensor:
        values = torch.rand(1, channels, SIZE, SIZE, generator=generator)
        return low + (high - low) * values

    return SkinMaps(
        maps(3, 0.1, 0.8),
        maps(1, 0.01, 0.05),
        maps(3, -1, 1),
        maps(3, -1, 1),
        maps(1, 8, 64),
        maps(1, 0, 1),
        maps(3, -90, 90),
        torch.ones(1, 1, SIZE, SIZE),
        0.1,
        torch.ones(1, 1, SIZE, SIZE),
    )


def random_lights(generator: torch.Generator) -> Environment:
    direction = torch.randn(1, LIGHTS, 3, generator=generator)
    return Environment(
        1250 * unit(direction.mT).mT,
        torch.rand(1, LIGHTS, 3, generator=generator) / LIGHTS,
        torch.full((1, 3), 0.1),
        torch.zeros(1, LIGHTS, dtype=torch.bool),
        torch.tensor([[0.0, 0.0, 1100.0]]),
    )


def plain(skin: SkinMaps, lights: Environment) -> Tensor:
    """One light at a time, vectors of three as they are written in the formulas."""
    view = unit(lights.camera_mm[:, :, None, None] - skin.position_mm)
    diffuse_normal, specular_normal = unit(skin.diffuse_normal), unit(skin.specular_normal)
    picture = skin.diffuse_albedo * lights.ambient_rgb[:, :, None, None]
    for index in range(lights.rgb.shape[1]):
        position = lights.position_mm[:, index, :, None, None]
        rgb = lights.rgb[:, index, :, None, None]
        toward = position - skin.position_mm
        distance = toward.norm(dim=1, keepdim=True)
        light = toward / distance
        reach = (position.norm(dim=1, keepdim=True) / distance) ** 2
        diffuse = (diffuse_normal * light).sum(dim=1, keepdim=True).clamp_min(0)
        half = unit(light + view)
        lobe = (specular_normal * half).sum(dim=1, keepdim=True).clamp_min(0) ** skin.shininess
        cosine = (specular_normal * light).sum(dim=1, keepdim=True).clamp_min(0)
        strength = (skin.shininess + 8) / 8 * lobe * cosine
        picture = picture + rgb * reach * (
            skin.diffuse_albedo * diffuse + skin.specular_albedo * strength
        )
    return picture


def dense_blur(image: Tensor, sigma_px: float) -> Tensor:
    radius = int(np.ceil(3.5 * sigma_px))
    taps = torch.exp(-0.5 * (torch.arange(-radius, radius + 1) / sigma_px) ** 2)
    kernel = torch.outer(taps, taps) / taps.sum() ** 2
    # Planes as a batch: torch's grouped convolution of this size is a hundred times slower.
    return functional.conv2d(image.transpose(0, 1), kernel[None, None], padding=radius).transpose(
        0, 1
    )


def best_ms(function: Callable[[], object]) -> float:
    times = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        function()
        times.append(time.perf_counter() - began)
    return 1e3 * min(times)


def with_gradients(render: Callable[[SkinMaps], Tensor], skin: SkinMaps) -> list[Tensor]:
    leaves = [skin.diffuse_albedo, skin.specular_albedo, skin.diffuse_normal, skin.specular_normal]
    for leaf in leaves:
        leaf.grad = None
        leaf.requires_grad_()
    render(skin).sum().backward()
    return [leaf.grad for leaf in leaves if leaf.grad is not None]


def main() -> None:
    generator = torch.Generator().manual_seed(0)
    skin, lights = random_skin(generator), random_lights(generator)
    options = ShadeOptions(subsurface_mm=0)

    def fast(maps: SkinMaps) -> Tensor:
        return shade(maps, lights, options)

    def slow(maps: SkinMaps) -> Tensor:
        return plain(maps, lights)

    with torch.no_grad():
        difference = float((fast(skin) - slow(skin)).abs().max())
        forward = [best_ms(functools.partial(r, skin)) for r in (fast, slow)]
    pairs = zip(with_gradients(fast, skin), with_gradients(slow, skin), strict=True)
    worst = max(float((a - b).abs().max() / b.abs().max()) for a, b in pairs)
    both = [best_ms(functools.partial(with_gradients, r, skin)) for r in (fast, slow)]

    image = torch.rand(1, 3, SIZE, SIZE, generator=generator)
    sigma_px = 21.0 / 3.5  # the reach of the paper's 21 px
    blur_difference = float((blur(image, sigma_px) - dense_blur(image, sigma_px)).abs().max())
    blurs = [best_ms(functools.partial(b, image, sigma_px)) for b in (blur, dense_blur)]
    measured = [
        ("shade, forward", forward, difference),
        ("shade, forward and backward", both, worst),
        ("subsurface kernel of 43 px, 3 channels", blurs, blur_difference),
    ]
    record(
        "Renderer",
        ["what", "ms", "plain twin ms", "ratio", "largest difference"],
        [[w, f"{a:.1f}", f"{b:.1f}", f"{b / a:.1f}", f"{d:.1e}"] for w, (a, b), d in measured],
        f"{SIZE} x {SIZE} texels, {LIGHTS} lights, float32; best of {REPEATS}. The twin takes one "
        "light at a time in eager torch, the kernel's a dense convolution; backward differences "
        "relative to the largest gradient.",
    )


if __name__ == "__main__":
    main()
