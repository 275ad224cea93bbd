"""What each skip of the reflectance path saves, and whether the result is the same.

Run `python -m benchmarks.reflectance_skips`: one view of 24 megapixels, seven DNGs. Seconds are
processor seconds.
"""

from __future__ import annotations

import dataclasses
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar
from unittest import mock

import numpy as np

from benchmarks.record import record
from benchmarks.reflectance_24mp import CAMERA, WHO, large_session
from benchmarks.reflectance_people import person, session
from lightstage.formats.mesh import read_ply
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import load_session
from processing.decode.config import DecodeConfig
from processing.decode.stage import decode
from processing.frames.read import Frames, read_foreground, read_frames
from processing.lighting.lights import pattern_lights
from processing.refinement.config import RefineConfig
from processing.refinement.every_pixel import solve_view
from processing.refinement.gloss_search import find_gloss
from processing.refinement.scene import prepare_scene, read_view
from processing.separation import colour
from processing.separation.config import SeparateConfig
from processing.separation.view import separate_view
from processing.view_maps import PixelMaps

R = TypeVar("R")
ROUNDS = 2


def timed(call: Callable[[], R]) -> tuple[R, float]:
    """Result and the least processor seconds of two calls, after one that fills caches."""
    call()
    seconds = []
    for _ in range(ROUNDS):
        start = time.process_time()
        found = call()
        seconds.append(time.process_time() - start)
    return found, min(seconds)


def timed_in_turn(first: Callable[[], R], second: Callable[[], R]) -> list[tuple[R, float]]:
    """As `timed`, of two calls whose rounds alternate, so that both meet the same memory."""
    results = [first(), second()]
    seconds = [np.inf, np.inf]
    for _ in range(ROUNDS):
        for index, call in enumerate((first, second)):
            start = time.process_time()
            results[index] = call()
            seconds[index] = min(seconds[index], time.process_time() - start)
    return list(zip(results, seconds, strict=True))


def decode_rows(root: Path, folder: Path) -> list[list[str]]:
    """The window of the face, and photographs that did not change."""
    opened = load_session(root)
    out = folder / "skips"

    def fresh(config: DecodeConfig) -> Frames:
        shutil.rmtree(out, ignore_errors=True)
        decode(opened, out, config)
        return read_frames(out, CAMERA)

    whole, whole_s = timed(lambda: fresh(DecodeConfig(crop=False)))
    full = np.asarray(whole.half[0]).astype(np.float32) * whole.scale
    window, window_s = timed(lambda: fresh(DecodeConfig()))
    inside = np.asarray(window.half[0]).astype(np.float32) * window.scale
    away = float(np.abs(full[window.window.slices] - inside).max())
    kept, kept_s = timed(lambda: (decode(opened, out, DecodeConfig()), read_frames(out, CAMERA))[1])
    again = np.asarray(kept.half[0]).astype(np.float32) * kept.scale
    return [
        row("pixels outside the face's window (decode)", whole_s, window_s, away, "reading"),
        row(
            "photographs unchanged since the last run (decode)",
            window_s,
            kept_s,
            float(np.abs(again - inside).max()),
            "reading",
        ),
    ]


def coarse_rows(root: Path, out: Path) -> list[list[str]]:
    """Pixels outside the mask, and solves that change nothing more."""
    opened = load_session(root)
    frames, mask = read_frames(out, CAMERA), read_foreground(out, CAMERA)
    lights = pattern_lights(opened, frames.patterns)
    camera = opened.rig.camera(CAMERA)

    def maps(where: np.ndarray, config: SeparateConfig) -> PixelMaps:
        return separate_view("colour", frames, where, camera, lights, config)

    usual, usual_s = timed(lambda: maps(mask, SeparateConfig()))
    whole = frames.window.placed(np.ones(frames.window.shape, bool), frames.shape)
    full, full_s = timed(lambda: maps(whole, SeparateConfig()))
    inside = mask[whole]
    normals = full.diffuse_normal[inside]
    long = dataclasses.replace(SeparateConfig(), iterations=12)
    settled, colour.SETTLED = colour.SETTLED, 1e-12
    most, most_s = timed(lambda: maps(mask, dataclasses.replace(long, tile_mm=0.0)))
    colour.SETTLED = settled
    by_pixel, by_pixel_s = timed(
        lambda: maps(mask, dataclasses.replace(SeparateConfig(), tile_mm=0))
    )
    return [
        row(
            "lobe, confidence and lights above the horizon found anew for each pixel of a tile of "
            "8 x 8 (coarse)",
            by_pixel_s,
            usual_s,
            median_away(by_pixel.diffuse_normal, usual.diffuse_normal),
            "normal, median",
        ),
        row(
            "pixels outside the face (coarse)",
            full_s,
            usual_s,
            median_away(normals, usual.diffuse_normal),
            "normal, median",
        ),
        row(
            "solves of a normal after one that moved it by less than .002 (coarse, by pixel)",
            most_s,
            by_pixel_s,
            median_away(most.diffuse_normal, by_pixel.diffuse_normal),
            "normal, median",
        ),
    ]


def pattern_rows(root: Path, out: Path) -> list[list[str]]:
    """Photographs under single lights, which the published formula does not use."""
    opened = load_session(root)
    frames, mask = read_frames(out, CAMERA), read_foreground(out, CAMERA)
    camera, seven = opened.rig.camera(CAMERA), frames.patterns
    mask = mask & (np.arange(len(mask)) % 4 == 0)[:, None]  # arrays of fourteen patterns are large
    many = (*seven, *(f"single-{k}" for k in range(len(seven))))
    shape = (len(many), *frames.half.shape[1:])
    with tempfile.TemporaryFile() as file:
        half = np.memmap(file, np.float16, "w+", shape=shape)
        half[: len(seven)], half[len(seven) :] = frames.half, frames.half
        more = dataclasses.replace(frames, patterns=many, half=half)
        lights = pattern_lights(opened, seven)
        both = dataclasses.replace(lights.of(seven * 2), patterns=many)

        def maps() -> PixelMaps:
            return separate_view("kampouris", more, mask, camera, both, SeparateConfig())

        def of_all() -> PixelMaps:
            everything = "processing.separation.view.used_patterns"
            with mock.patch(everything, lambda _, lights: lights.patterns):
                return maps()

        # Pages of a file that was just written cost whoever touches them first.
        (some, some_s), (full, full_s) = timed_in_turn(maps, of_all)
    return [
        row(
            "seven patterns of fourteen that `kampouris` does not use (coarse, every fourth row)",
            full_s,
            some_s,
            float(np.abs(full.diffuse_normal - some.diffuse_normal).max()),
            "normal, largest",
        )
    ]


def refine_rows(root: Path, out: Path) -> list[list[str]]:
    """Light gathered at nodes instead of anew for each pixel."""
    opened, config = load_session(root), RefineConfig()
    frames, mask = read_frames(out, CAMERA), read_foreground(out, CAMERA)
    mask = mask & (np.arange(len(mask)) % 256 < 64)[:, None]  # light for each pixel takes minutes
    camera, lights = opened.rig.camera(CAMERA), pattern_lights(opened, frames.patterns)
    truth = ProcessedFolder(session(person(WHO)).with_name("session.truth"))
    scene = prepare_scene(read_ply(truth.base_mesh), lights, [(camera, mask)], config)
    grid = read_view(frames, camera, mask, scene, config, config.gloss_pixels)
    scene_found, found, _ = find_gloss(scene, [grid], config)

    def solved(config: RefineConfig) -> PixelMaps:
        return solve_view(
            scene_found, frames, camera, mask, grid, found[0], config
        ).maps.pixel_maps()

    usual, usual_s = timed(lambda: solved(config))
    own, own_s = timed(lambda: solved(dataclasses.replace(config, light_step_mm=0.0)))
    return [
        row(
            "light gathered for each pixel, not at nodes (refine, a quarter of the rows)",
            own_s,
            usual_s,
            median_away(own.specular_normal, usual.specular_normal),
            "normal, median",
        ),
    ]


def median_away(a: np.ndarray, b: np.ndarray) -> float:
    """Median over pixels of how far two maps are apart."""
    return float(np.median(np.abs(a - b).max(axis=1)))


def row(what: str, before: float, after: float, away: float, of: str) -> list[str]:
    """A row of the table."""
    return [
        what,
        f"{before:.2f}",
        f"{after:.2f}",
        f"{1 - after / before:.0%}",
        f"{away:.2g} ({of})",
    ]


def main() -> None:
    """Measure all skips."""
    root = large_session()
    with tempfile.TemporaryDirectory() as name:
        rows = decode_rows(root, Path(name))
        rows += coarse_rows(root, Path(name) / "skips")
        rows += pattern_rows(root, Path(name) / "skips")
        rows += refine_rows(root, Path(name) / "skips")
    record(
        "Reflectance: what each skip saves",
        ["skipped", "processor s without", "processor s with", "saved", "results apart"],
        rows,
        "One view of 24 megapixels, seven DNG files.",
    )


if __name__ == "__main__":
    main()
