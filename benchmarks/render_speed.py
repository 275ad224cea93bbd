"""The renderer's run time and error beside plain, compiled and published twins.

`--compiled` adds the plain twin through torch.compile (a minute of compiling), `--large` the
6144 x 4096 texture. Times are processor milliseconds of all threads, over two: what two cores take
when nothing else runs; so a busy machine does not change the ratios.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import resource
import time
from collections.abc import Callable

import torch
from torch import Tensor

from benchmarks.record import record
from benchmarks.render_twins import authors, dense_blur, plain, separable_blur
from learning.render.environments import Environment
from learning.render.shading import ShadeOptions, SkinMaps, shade, unit
from learning.render.tiles import shade_in_bands

SIZE, LIGHTS, REPEATS, CORES = 512, 12, 5, 2
TEXEL_MM = 1.4 / 21
"""The published texture's, whose kernel of 1.4 mm is 21 texels."""
LEAVES = ("diffuse_albedo", "specular_albedo", "diffuse_normal", "specular_normal")
MATTE = ShadeOptions(subsurface_mm=0)
LARGE = (6144, 4096)


def random_skin(generator: torch.Generator, rows: int = SIZE, columns: int = SIZE) -> SkinMaps:
    """A bumpy ball's front with random maps: normals as on a face, every texel another one."""

    def maps(channels: int, low: float, high: float) -> Tensor:
        return low + (high - low) * torch.rand(1, channels, rows, columns, generator=generator)

    v, u = torch.meshgrid(
        torch.linspace(1, -1, rows), torch.linspace(-1, 1, columns), indexing="ij"
    )
    ball = unit(torch.stack([1.2 * u, 1.2 * v, 1.5 - u * u - v * v])[None])
    return SkinMaps(
        maps(3, 0.1, 0.8),
        maps(1, 0.01, 0.05),
        unit(ball + 0.1 * maps(3, -1, 1)),
        unit(ball + 0.2 * maps(3, -1, 1)),
        maps(1, 8, 64),
        maps(1, 0, 1),
        90 * ball,
        torch.ones(1, 1, rows, columns),
        TEXEL_MM,
        torch.ones(1, 1, rows, columns),
    )


def lights_around(count: int = LIGHTS) -> Environment:
    """Lights in front and beside, 1.25 m away, all above some texel's horizon."""
    generator = torch.Generator().manual_seed(5)
    direction = torch.randn(1, count, 3, generator=generator)
    direction[..., 2] = direction[..., 2].abs()
    return Environment(
        1250 * unit(direction.mT).mT,
        torch.rand(1, count, 3, generator=generator) / count,
        torch.full((1, 3), 0.1),
        torch.zeros(1, count, dtype=torch.bool),
        torch.tensor([[0.0, 0.0, 1100.0]]),
    )


def best_ms(function: Callable[[], object], repeats: int = REPEATS) -> float:
    """Processor milliseconds over the cores, the best of some runs after one."""
    function()
    times = []
    for _ in range(repeats):
        began = time.process_time()
        function()
        times.append(time.process_time() - began)
    return 1e3 * min(times) / CORES


def with_gradients(render: Callable[[SkinMaps], Tensor], skin: SkinMaps) -> list[Tensor]:
    """Gradients of the picture's sum for albedos and normals."""
    leaves = [getattr(skin, name).detach().requires_grad_() for name in LEAVES]
    picture = render(dataclasses.replace(skin, **dict(zip(LEAVES, leaves, strict=True))))
    return list(torch.autograd.grad(picture.sum(), leaves))


def worst(found: list[Tensor], expected: list[Tensor]) -> float:
    """Largest difference over the largest value."""
    pairs = zip(found, expected, strict=True)
    return max(float((a - b).abs().max() / b.abs().max()) for a, b in pairs)


def rows_of(
    what: str, ours: float, twins: list[tuple[str, float]], error: float
) -> list[list[str]]:
    return [
        [what, f"{ours:.1f}", name, f"{other:.1f}", f"{other / ours:.1f}", f"{error:.1e}"]
        for name, other in twins
    ]


def compare(compiled: bool) -> list[list[str]]:
    generator = torch.Generator().manual_seed(0)
    skin, lights = random_skin(generator), lights_around()
    seen = torch.rand(1, LIGHTS, SIZE, SIZE, generator=generator)
    slow = functools.partial(plain, lights=lights)

    def fast(maps: SkinMaps) -> Tensor:
        return shade(maps, lights, MATTE)

    twins: list[tuple[str, Callable[[SkinMaps], Tensor]]] = [("plain eager", slow)]
    if compiled:
        twins.append(("plain, torch.compile", torch.compile(slow)))
    table = []
    with torch.no_grad():
        error = worst([fast(skin)], [slow(skin)])
        times = [(name, best_ms(functools.partial(f, skin))) for name, f in twins]
        table += rows_of("shading, forward", best_ms(lambda: fast(skin)), times, error)
    error = worst(with_gradients(fast, skin), with_gradients(slow, skin))
    times = [(n, best_ms(functools.partial(with_gradients, f, skin), 3)) for n, f in twins]
    ours = best_ms(lambda: with_gradients(fast, skin))
    table += rows_of("shading, forward and backward", ours, times, error)

    def whole(maps: SkinMaps) -> Tensor:
        return shade(maps, lights, None, seen)

    published: list[tuple[str, Callable[[SkinMaps], Tensor]]] = [
        (f"published formula, {name}", functools.partial(authors, lights=lights, blur=blur))
        for name, blur in (("dense 43 x 43", dense_blur), ("separable", separable_blur))
    ]
    ours = best_ms(lambda: with_gradients(whole, skin))
    times = [(n, best_ms(functools.partial(with_gradients, f, skin), 1)) for n, f in published]
    with torch.no_grad():
        literal = ShadeOptions(mode="paper", subsurface_mm=0)
        error = worst([shade(skin, lights, literal)], [authors(skin, lights, None)])
    table += rows_of("shading, scattering, occlusion, forward and backward", ours, times, error)
    return table


def curves() -> list[list[str]]:
    """Linear in lights and texels."""
    table = []

    def case(skin: SkinMaps, lights: Environment) -> list[str]:
        size, count = skin.area.shape[-1], lights.rgb.shape[1]
        render = functools.partial(shade, environment=lights, options=MATTE)
        ms = best_ms(functools.partial(with_gradients, render, skin), 4 * REPEATS)
        pairs = size * size * count
        return [f"{count} lights, {size} x {size}", f"{ms:.1f}", f"{1e6 * ms / pairs:.1f}"]

    for count in (1, 3, 12, 48):
        skin, lights = random_skin(torch.Generator().manual_seed(1)), lights_around(count)
        table.append(case(skin, lights))
    for size in (128, 256, 1024):
        skin = random_skin(torch.Generator().manual_seed(1), size, size)
        table.append(case(skin, lights_around()))
    return table


def skips() -> list[list[str]]:
    """What is left out, what it saves, and that it changes nothing."""
    least = functools.partial(best_ms, repeats=4 * REPEATS)
    generator = torch.Generator().manual_seed(2)
    skin, lights = random_skin(generator), lights_around()
    whole_ms = least(lambda: shade(skin, lights, MATTE))
    whole = shade(skin, lights, MATTE)
    rows = []

    def add(what: str, ms: float, full: float, change: float) -> None:
        rows.append([what, f"{ms:.1f}", f"{full:.1f}", f"{change:.1e}"])

    behind = dataclasses.replace(lights, position_mm=lights.position_mm * torch.tensor([1, 1, -1]))
    dark = float((shade(skin, behind, MATTE) - plain(skin, behind)).abs().max())
    add("all lights behind the head", least(lambda: shade(skin, behind, MATTE)), whole_ms, dark)
    every_other = torch.arange(LIGHTS)[:, None] % 2 * torch.ones(3)
    some = dataclasses.replace(lights, rgb=lights.rgb * every_other)
    change = float((shade(skin, some, MATTE) - plain(skin, some)).abs().max())
    add("half the lights black", least(lambda: shade(skin, some, MATTE)), whole_ms, change)
    half = skin.area.clone()
    half[..., : SIZE // 2, :] = 0
    holed = dataclasses.replace(skin, area=half)
    change = float((shade(holed, lights, MATTE) - whole * (half > 0)).abs().max())
    add(
        "half the texture without face",
        least(lambda: shade(holed, lights, MATTE)),
        whole_ms,
        change,
    )
    matte = dataclasses.replace(skin, specular_albedo=0 * skin.specular_albedo)
    change = float((shade(matte, lights, MATTE) - plain(matte, lights)).abs().max())
    add("specular albedo 0", least(lambda: shade(matte, lights, MATTE)), whole_ms, change)
    full_ms = least(lambda: shade(skin, lights))
    opaque = dataclasses.replace(skin, translucency=0 * skin.translucency)
    change = float((shade(opaque, lights) - whole).abs().max())
    add("translucency 0", least(lambda: shade(opaque, lights)), full_ms, change)
    seen = torch.ones(1, LIGHTS, SIZE, SIZE)
    change = float((shade(skin, lights, MATTE, seen) - whole).abs().max())
    add("occlusion off", whole_ms, least(lambda: shade(skin, lights, MATTE, seen)), change)

    def gradient(names: tuple[str, ...]) -> list[Tensor]:
        leaves = [getattr(skin, n).detach().requires_grad_() for n in names]
        maps = dataclasses.replace(skin, **dict(zip(names, leaves, strict=True)))
        return list(torch.autograd.grad(shade(maps, lights, MATTE).sum(), leaves))

    every = (*LEAVES, "shininess", "position_mm", "ambient_occlusion")
    full_ms = least(lambda: gradient(every))
    for names in (("diffuse_albedo", "specular_albedo"), LEAVES):
        expected = [g for n, g in zip(every, gradient(every), strict=True) if n in names]
        change = worst(gradient(names), expected)
        add(
            f"gradients of {len(names)} maps, not {len(every)}",
            least(functools.partial(gradient, names)),
            full_ms,
            change,
        )
    return rows


def large() -> list[list[str]]:
    """One 6144 x 4096 picture under 3 lights, in bands."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    skin = random_skin(torch.Generator().manual_seed(3), *LARGE)
    seen = torch.rand(1, 3, *LARGE, generator=torch.Generator().manual_seed(4))
    lights, maps = lights_around(3), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    began = time.process_time()
    picture = shade_in_bands(skin, lights, None, seen)
    seconds = (time.process_time() - began) / CORES
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    size = picture.numel() * 4 / 2**30
    name = f"{LARGE[0]} x {LARGE[1]}, 3 lights, scattering, occlusion"
    return [[name, *(f"{value:.2f}" for value in (seconds, before, maps, peak, size))]]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--compiled", action="store_true")
    parser.add_argument("--large", action="store_true")
    parser.add_argument("--only", choices=("twins", "curves", "skips", "large"))
    chosen = parser.parse_args()
    about = f"{SIZE} x {SIZE} texels, {LIGHTS} lights, float32; processor ms over {CORES} cores."
    if chosen.only in (None, "twins"):
        record(
            "Renderer: speed",
            ["what", "ms", "beside", "ms", "ratio", "largest difference"],
            compare(chosen.compiled),
            f"{about} Differences over the largest value: of the picture, of the gradients; in the "
            "last rows of the published formula without its blur. Gradients of albedos and "
            "normals.",
        )
    if chosen.only in (None, "curves"):
        record(
            "Renderer: lights and texels",
            ["case", "ms", "ns a light and texel"],
            curves(),
            "Shading, forward and backward; processor ms over 2 cores.",
        )
    if chosen.only in (None, "skips"):
        record(
            "Renderer: what is left out",
            ["what", "ms", "ms with it", "largest change"],
            skips(),
            about,
        )
    if chosen.large or chosen.only == "large":
        record(
            "Renderer: a large texture",
            ["case", "s", "GiB before", "GiB with maps", "GiB at most", "GiB of picture"],
            large(),
            "In bands of rows, processor seconds over 2 cores; resident memory of the process.",
        )


if __name__ == "__main__":
    main()
