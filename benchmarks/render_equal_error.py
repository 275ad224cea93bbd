"""Seconds at equal error: a scanned head in light from everywhere, by lights and by paths.

Ours cuts the light into more and more lights; Mitsuba follows more and more paths. Both are held
against many paths. `--texels` is the texture's side, `--reference` paths of the truth.
"""

from __future__ import annotations

import argparse
import functools
import time
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from benchmarks.record import record
from benchmarks.render_pictures import SCALE
from benchmarks.render_scene import (
    NAMES,
    MatteScene,
    head_of,
    lights_of,
    matte,
    panorama_of,
    scanned_head,
)
from learning.relight import render_head, shadows_of
from learning.render.skin import ShadeOptions
from lightstage.rig import default_rig

LIGHTS, PATHS, BARE = (4, 16, 64, 256), (1, 4, 16, 64, 256), ShadeOptions(subsurface_mm=0)
T = TypeVar("T")


def timed(function: Callable[[], T]) -> tuple[float, T]:
    """Processor seconds, and what came of it."""
    began = time.process_time()
    found = function()
    return time.process_time() - began, found


def seconds_at(error: float, tried: list[tuple[float, float]]) -> float:
    """What Mitsuba takes for an error: between (seconds, error) tried, or by its noise's law."""
    costs, errors = (np.array(values) for values in zip(*tried, strict=True))
    if error < errors[-1]:
        return float(costs[-1] * (errors[-1] / error) ** 2)
    return float(np.exp(np.interp(-np.log(error), -np.log(errors), np.log(costs))))


def compare(name: str, texels: int, reference: int) -> list[list[str]]:
    person, camera = scanned_head(texels), default_rig().scaled(SCALE).camera("cam0")
    head, panorama = matte(head_of(person, False)), panorama_of(name)
    scene = MatteScene(person, panorama, camera)
    truth = scene.picture(reference, seed=1000)
    # Once for nothing: what is compiled is read from disk. The head's outline is left out.
    alpha = render_head(head, lights_of(panorama, 1), camera, 0.0, options=BARE)[1]
    inside = alpha > 0.999

    def error(picture: np.ndarray) -> float:
        return 100 * float(np.abs(picture - truth)[inside].mean() / truth[inside].mean())

    tried = []
    for count in PATHS:
        cost, picture = timed(functools.partial(scene.picture, count))
        tried.append((cost, error(picture)))
    rows = []
    for count in LIGHTS:
        cutting, lights = timed(functools.partial(lights_of, panorama, count))
        rays, seen = timed(functools.partial(shadows_of, head, lights))
        draw = functools.partial(render_head, head, lights, camera, 0.0, options=BARE, seen=seen)
        drawing, (picture, _) = timed(draw)
        theirs = seconds_at(error(picture), tried)
        first = cutting + rays + drawing
        cells = (error(picture), first, drawing, theirs)
        ratios = (theirs / first, theirs / drawing)
        rows.append(
            [f"{name}, {count} lights"]
            + [f"{value:.2f}" for value in cells]
            + [f"{value:.1f}" for value in ratios]
        )
    for count, (cost, off) in zip(PATHS, tried, strict=True):
        rows.append([f"{name}, Mitsuba, {count} paths", f"{off:.2f}", f"{cost:.2f}", *"----"])
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--texels", type=int, default=480)
    parser.add_argument("--reference", type=int, default=1024)
    parser.add_argument("--only", choices=NAMES)
    chosen = parser.parse_args()
    names = NAMES if chosen.only is None else (chosen.only,)
    record(
        "Renderer: seconds at equal error beside Mitsuba",
        [
            "way",
            "mean error, %",
            "s, all",
            "s, next picture",
            "Mitsuba s at that error",
            "ratio",
            "ratio, next picture",
        ],
        [row for name in names for row in compare(name, chosen.texels, chosen.reference)],
        f"Matte scanned head in direct light, 200 x 300 px, {chosen.texels} texels a side, against "
        f"{chosen.reference} paths a pixel. All: cutting the light, shadow rays, shading, drawing; "
        "the next picture of the same head and light needs the last two. Processor seconds.",
    )


if __name__ == "__main__":
    main()
