"""What the renderer's shortcuts cost in error and save in time: lights, steps, resolution."""

from __future__ import annotations

import argparse
import functools
import math

import numpy as np
import torch

from benchmarks.record import record
from benchmarks.render_speed import MATTE, best_ms, random_skin
from learning.render import diffusion
from learning.render.diffusion import Diffusion
from learning.render.environments import Environment
from learning.render.light_dome import even_directions
from learning.render.occlusion_model import OcclusionConfig, bake_dome, bake_table
from learning.render.panorama import (
    Panorama,
    directions,
    importance,
    irradiance,
    median_cut,
    project,
    solid_angles,
)
from learning.render.shading import shade
from lightstage.formats.template import default_template_path, load_template

CAMERA = np.array([0.0, 0.0, 1100.0])
RUNS = 12


def room(rows: int = 64) -> Panorama:
    """Walls, a window and a small lamp."""
    radiance = np.random.default_rng(0).uniform(0.05, 0.15, (rows, 2 * rows, 3))
    radiance[rows // 4 : rows // 2, rows // 2 : rows * 3 // 4] += [3, 4, 5]
    radiance[rows // 3 : rows // 3 + 2, rows + 20 : rows + 22] += [400, 250, 120]
    return Panorama(radiance)


def lights_table() -> list[list[str]]:
    panorama, normals = room(), even_directions(2000)
    rows = len(panorama.radiance)
    power = (panorama.radiance * solid_angles(rows)[..., None] / np.pi).reshape(-1, 3)
    exact = np.maximum(normals @ directions(rows).reshape(-1, 3).T, 0) @ power
    skin = random_skin(torch.Generator().manual_seed(0), 256, 256)
    rng = np.random.default_rng(1)

    def error(found: np.ndarray) -> str:
        return f"{100 * np.abs(found - exact).mean() / exact.mean():.2f}"

    def received(lights: Environment) -> np.ndarray:
        cosine = np.maximum(normals @ lights.position_mm[0].double().numpy().T, 0)
        return cosine @ lights.rgb[0].double().numpy()

    table = []
    for count in (4, 16, 64, 256):
        cut = median_cut(panorama, count, CAMERA)
        drawn = importance(panorama, count, CAMERA, rng)
        ms = best_ms(functools.partial(shade, skin, cut, MATTE), RUNS)
        table.append([f"{count} lights", error(received(cut)), error(received(drawn)), f"{ms:.1f}"])
    grid = torch.from_numpy(normals.T[None, :, :, None])
    for order in (1, 2, 4):
        light = project(panorama, order)
        found = irradiance(light, grid)[0, :, :, 0].numpy().T
        normal = skin.diffuse_normal
        ms = best_ms(functools.partial(irradiance, light, normal), RUNS)
        table.append([f"harmonics of order {order}, no gloss", error(found), "-", f"{ms:.1f}"])
    return table


def steps_table() -> list[list[str]]:
    count, sigma = 512, 21.0
    ones, table = torch.ones(1, 1, count, count), []
    planes = torch.rand(1, 6, count, count)
    lit = (torch.arange(count) >= count // 2).float().expand_as(ones)
    at = torch.arange(count).double() + 0.5 - count / 2

    def error(spread: Diffusion, sigma: float) -> str:
        """Largest, at the edge of a shadow, in percent of the step."""
        exact = 0.5 * (1 + torch.erf(at / sigma / math.sqrt(2)))
        found = spread.spread(lit)[0, 0, count // 2].double()
        return f"{100 * float((found - exact)[count // 4 : -count // 4].abs().max()):.2f}"

    usual = diffusion.STEPS
    for steps in (1, 2, 4, 8, 16):
        diffusion.STEPS = steps
        spread = Diffusion(ones, None, sigma)
        ms = best_ms(functools.partial(spread.spread, planes), RUNS)
        mark = " (default)" if steps == usual else ""
        table.append([f"{steps} steps{mark}", error(spread, sigma), f"{ms:.1f}"])
    diffusion.STEPS = usual
    for wide in (2.0, 5.0, 60.0):
        spread = Diffusion(ones, None, wide)
        ms = best_ms(functools.partial(spread.spread, planes), RUNS)
        row = [f"{usual} steps, sigma {wide:g} texels", error(spread, wide), f"{ms:.1f}"]
        table.append(row)
    return table


def resolution_table() -> list[list[str]]:
    mesh, toward = load_template(default_template_path()).mesh, even_directions(37)
    truth, covered = bake_dome(mesh, 144, toward)
    table = []
    for rows, count in ((24, 512), (48, 512), (96, 512), (96, 128), (96, 2048)):
        baked = bake_table(mesh, OcclusionConfig(rows, count))
        light = torch.from_numpy(toward).float()
        size = (covered.shape[0], covered.shape[1])
        found = baked.for_lights(light, size).numpy()[:, covered]
        ms = best_ms(functools.partial(baked.for_lights, light, size), RUNS) / len(toward)
        error = float(np.abs(found - truth).mean())
        table.append([f"{rows} rows, {count} directions", f"{error:.4f}", f"{ms:.2f}"])
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=("lights", "steps", "resolution"))
    only = parser.parse_args().only
    if only in (None, "lights"):
        record(
            "Renderer: lights that stand for a picture",
            ["lights", "median cut, %", "importance, %", "ms"],
            lights_table(),
            "Mean error of what diffusers of 2000 directions receive of a room with a window and a "
            "lamp; shading of 256 x 256 texels, processor ms over 2 cores.",
        )
    if only in (None, "steps"):
        record(
            "Renderer: steps of diffusion",
            ["steps", "largest error at a shadow's edge, %", "ms"],
            steps_table(),
            "Against an exact Gaussian of 21 texels; 512 x 512, 6 planes, processor ms over 2 "
            "cores.",
        )
    if only in (None, "resolution"):
        record(
            "Renderer: resolution of the shadows' table",
            ["table", "mean error", "ms a light"],
            resolution_table(),
            "Template, 37 directions between the baked ones, against rays at 144 x 96 texels.",
        )


if __name__ == "__main__":
    main()
