"""Speed of reflectance at 24 megapixels: one view from RAW to all maps, and nine views.

Run `python -m benchmarks.reflectance_speed`; the data is made where it is missing. With `coarse` it
measures the first rows alone, with `refine` that stage and its parts. Every row runs in a process
of its own, once to compile and once or more to be measured (rows of many seconds only once,
compiled code loaded), files being in the system's cache.
Processor seconds stand beside wall seconds: on a machine that does other work besides they are the
ones to compare.
"""

from __future__ import annotations

import dataclasses
import os
import resource
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import TypeVar

import numpy as np
from numba import njit, prange

from benchmarks.record import record
from benchmarks.reflectance_24mp import CAMERA, WHO, large_session
from benchmarks.reflectance_naive import all_developed, printed_formula
from benchmarks.reflectance_people import person, session
from benchmarks.reflectance_refine_parts import refine_parts
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import Session, load_session
from processing.coarse_maps import write_as_view, write_coarse
from processing.decode.config import DecodeConfig
from processing.decode.stage import decode
from processing.frames.read import read_foreground, read_frames, write_foreground
from processing.lighting.lights import pattern_lights
from processing.parallel import over_views, workers
from processing.refinement.config import RefineConfig
from processing.refinement.stage import refine
from processing.separation.config import SeparateConfig
from processing.separation.view import separate_view
from processing.view_maps import PixelMaps

R = TypeVar("R")
VIEWS = 9


@dataclasses.dataclass(frozen=True)
class Cost:
    """Seconds of one call, wall and processor, and its process's peak in GiB."""

    wall_s: float
    own_s: float
    peak_gib: float

    def plus(self, other: Cost) -> Cost:
        """One after the other."""
        peak = max(self.peak_gib, other.peak_gib)
        return Cost(self.wall_s + other.wall_s, self.own_s + other.own_s, peak)


def timed(
    call: Callable[[], object],
    times: int = 3,
    *,
    warm: bool = True,
    before: Callable[[], object] = lambda: None,
) -> Cost:
    """Least of some calls, after one that compiles unless compiled code is loaded anyway.

    `before` runs ahead of each call and is not counted.
    """
    walls, owns = [], []
    for _ in range(times + warm):
        before()
        wall, own = time.perf_counter(), time.process_time()
        call()
        walls.append(time.perf_counter() - wall)
        owns.append(time.process_time() - own)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    return Cost(min(walls[warm:]), min(owns[warm:]), peak)


def naive(root: Path, out: Path, threads: int) -> Cost:
    """LibRaw's linear demosaic of all seven, then the printed formula where the face is."""
    opened = load_session(root)
    patterns = opened.file.sequence
    paths = [opened.frame_path(opened.frame(name, CAMERA)) for name in patterns]
    mask = read_foreground(out, CAMERA)
    return timed(lambda: printed_formula(all_developed(paths, threads), patterns, mask), 1)


def formula(root: Path, out: Path) -> Cost:
    """The printed formula alone, pictures at hand."""
    opened = load_session(root)
    patterns = opened.file.sequence
    paths = [opened.frame_path(opened.frame(name, CAMERA)) for name in patterns]
    pictures, mask = all_developed(paths, 2), read_foreground(out, CAMERA)
    return timed(lambda: printed_formula(pictures, patterns, mask))


def decoded(root: Path, out: Path) -> Cost:
    """The stage `decode`, nothing kept from the last run."""
    del out
    opened = load_session(root)
    with tempfile.TemporaryDirectory() as name:
        target = Path(name) / "out"
        # Removing what the last call left is no part of the stage.
        return timed(
            lambda: decode(opened, target, DecodeConfig()),
            before=lambda: shutil.rmtree(target, ignore_errors=True),
        )


def maps_of(opened: Session, out: Path, method: str) -> PixelMaps:
    """One view's maps by a method, its frames mapped from the disk."""
    frames, mask = read_frames(out, CAMERA), read_foreground(out, CAMERA)
    lights = pattern_lights(opened, frames.patterns)
    config = SeparateConfig()
    return separate_view(method, frames, mask, opened.rig.camera(CAMERA), lights, config)


def coarse(root: Path, out: Path, method: str) -> Cost:
    """One view's maps from mapped half floats."""
    opened = load_session(root)
    quick = method == "colour"
    return timed(lambda: maps_of(opened, out, method), 3 if quick else 1, warm=quick)


def written(root: Path, out: Path) -> Cost:
    """Writing the six maps for the next stages, and bringing them to the disk."""
    maps = maps_of(load_session(root), out, "colour")
    with tempfile.TemporaryDirectory() as name:
        return timed(lambda: write_coarse(Path(name), CAMERA, maps), 1, warm=False)


def written_to_views(root: Path, out: Path) -> Cost:
    """Writing the six maps and the mask as they last where a run ends with `separate`."""
    maps = maps_of(load_session(root), out, "colour")
    with tempfile.TemporaryDirectory() as name:
        target = Path(name)
        write_foreground(target, CAMERA, read_foreground(out, CAMERA))
        write_coarse(target, CAMERA, maps)
        return timed(lambda: write_as_view(ProcessedFolder(target), CAMERA), 1, warm=False)


def refined(root: Path, out: Path, config: RefineConfig) -> Cost:
    """The stage `refine` on the one view with the true mesh, what it writes included.

    It is long enough to be measured at once; compiled code comes from numba's cache.
    """
    opened = load_session(root)
    truth = ProcessedFolder(session(person(WHO)).with_name("session.truth"))
    with tempfile.TemporaryDirectory() as name:
        target = Path(name) / "out"
        shutil.copytree(out, target)
        shutil.copy(truth.base_mesh, ProcessedFolder(target).base_mesh)
        return timed(lambda: refine(opened, target, config), 1, warm=False)


def parts(root: Path, out: Path) -> dict[str, Cost]:
    """What each part of `refine` takes, with the true mesh."""
    opened = load_session(root)
    truth = ProcessedFolder(session(person(WHO)).with_name("session.truth"))
    with tempfile.TemporaryDirectory() as name:
        target = Path(name) / "out"
        shutil.copytree(out, target)
        shutil.copy(truth.base_mesh, ProcessedFolder(target).base_mesh)
        seconds = refine_parts(opened, target, RefineConfig())
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    return {part: Cost(*both, peak) for part, both in seconds.items()}


def nine(root: Path, out: Path) -> Cost:
    """Nine views to maps on the disk, as many at once as fit: each reads one camera's frames."""
    opened = load_session(root)
    mask = read_foreground(out, CAMERA)
    with tempfile.TemporaryDirectory() as name:

        def one(view: str) -> int:
            maps = maps_of(opened, out, "colour")
            write_coarse(Path(name), view, maps)
            return len(maps.confidence)

        views = [f"view{k}" for k in range(VIEWS)]
        at_once = workers(bytes_of_view(mask))
        return timed(lambda: list(over_views(one, views, at_once)), 1, warm=False)


def bytes_of_view(mask: np.ndarray) -> int:
    """What a view's maps take at most, in float32 and in half floats."""
    return int(mask.sum()) * 12 * (4 + 2)


def moved_bytes(out: Path) -> int:
    """Bytes that the coarse pass must read and write once: readings, masks, maps, maps again."""
    frames, mask = read_frames(out, CAMERA), read_foreground(out, CAMERA)
    pixels = int(mask.sum())
    readings = pixels * len(frames.patterns) * 3 * 2
    maps = pixels * 4 * (3 + 3 + 1 + 1 + 1)
    again = pixels * 4 * 2 * (3 + 1 + 1)
    return readings + maps + again + 3 * frames.window.height * frames.window.width


@njit(parallel=True)
def _triad(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> None:
    for i in prange(len(a)):
        a[i] = b[i] + np.float32(1.5) * c[i]


def bandwidth(root: Path, out: Path) -> float:
    """GB/s that a = b + 1.5 c moves on all cores, arrays far larger than any cache."""
    del root, out
    a, b, c = (np.ones(50_000_000, np.float32) for _ in range(3))
    return 3 * a.nbytes / timed(lambda: _triad(a, b, c), 5).wall_s / 1e9


def apart(call: Callable[..., R], *args: object) -> R:
    """A call in a process of its own, so that its peak of memory is its own."""
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        return pool.submit(call, *args).result()


def only_refine() -> None:
    """Measure `refine` and its parts alone, compiled code loaded by a run before."""
    root = large_session()
    with tempfile.TemporaryDirectory() as name:
        out = Path(name) / "out"
        decode(load_session(root), out, DecodeConfig())
        pixels = int(np.count_nonzero(read_foreground(out, CAMERA)))
        apart(parts, root, out)
        costs = {"refine, true mesh, maps written": apart(refined, root, out, RefineConfig())}
        costs.update(apart(parts, root, out))
    record(
        "Reflectance: refine at 24 megapixels",
        ["what", "s", "processor s", "peak GiB"],
        [
            [what, f"{cost.wall_s:.2f}", f"{cost.own_s:.2f}", f"{cost.peak_gib:.2f}"]
            for what, cost in costs.items()
        ],
        f"One view of 4016 x 6016, {pixels / 1e6:.1f} megapixels of it face, seven patterns. Other "
        f"programs ran beside: {os.getloadavg()[0]:.0f} wanted a core, so that processor seconds "
        "are the ones to compare; on two cores the stage takes at least half of them.",
    )


def main() -> None:
    """Measure all rows, or those that are named."""
    if sys.argv[1:] == ["refine"]:
        only_refine()
        return
    short = sys.argv[1:] == ["coarse"]
    root = large_session()
    with tempfile.TemporaryDirectory() as name:
        out = Path(name) / "out"
        decode(load_session(root), out, DecodeConfig())
        mask = read_foreground(out, CAMERA)
        window = read_frames(out, CAMERA).window
        costs: dict[str, Cost] = {}
        plain = apart(naive, root, out, 1)
        costs["naive: rawpy linear, one after the other, + printed formula"] = plain
        costs["naive, its files in two threads"] = two = apart(naive, root, out, 2)
        costs["the printed formula alone, pictures at hand"] = apart(formula, root, out)
        ours_raw = apart(decoded, root, out)
        ours_maps = apart(coarse, root, out, "colour")
        costs["decode: RAW to half floats of the window, mask, checks"] = ours_raw
        costs["coarse: half floats to all maps"] = ours_maps
        costs["RAW to all coarse maps"] = ours_raw.plus(ours_maps)
        if not short:
            for method in ("kampouris", "ratios"):
                costs[f"plain arrays: method {method}"] = apart(coarse, root, out, method)
            costs["writing the coarse maps (half floats in work/)"] = apart(written, root, out)
            costs["the same as EXR in views/, where a run ends there"] = apart(
                written_to_views, root, out
            )
            costs["refine, true mesh, maps written"] = apart(refined, root, out, RefineConfig())
            costs.update(apart(parts, root, out))
            alone = RefineConfig(light_step_mm=0.0)
            costs["its plain twin: light gathered for every pixel"] = apart(
                refined, root, out, alone
            )
            costs["nine views, coarse, maps written"] = apart(nine, root, out)
        memory = apart(bandwidth, root, out)
        moved = moved_bytes(out)
        decoded_bytes = 7 * window.height * window.width * (2 + 6)
    rows = [
        [
            name,
            f"{cost.wall_s:.2f}",
            f"{cost.own_s:.2f}",
            f"{plain.wall_s / cost.wall_s:.2f}",
            f"{two.wall_s / cost.wall_s:.2f}",
            f"{plain.own_s / cost.own_s:.2f}",
            f"{cost.peak_gib:.2f}",
        ]
        for name, cost in costs.items()
    ]
    rate = moved / ours_maps.wall_s / 1e9
    record(
        "Reflectance: RAW to coarse maps" if short else "Reflectance: speed at 24 megapixels",
        [
            "what",
            "s",
            "processor s",
            "times faster than the first",
            "than the second",
            "by processor s",
            "peak GiB",
        ],
        rows,
        f"One view of 4016 x 6016, seven DNG files, {mask.mean():.0%} of it face (window "
        f"{window.width} x {window.height}). The coarse pass moves {moved / 1e9:.2f} GB at "
        f"{rate:.2f} GB/s, {rate / memory:.0%} of the {memory:.1f} GB/s of a plain triad; decode "
        f"reads and writes {decoded_bytes / 1e9:.2f} GB at "
        f"{decoded_bytes / ours_raw.wall_s / 1e9:.2f} GB/s: what bounds them is not memory. "
        f"Other programs ran beside: {os.getloadavg()[0]:.0f} wanted a core. Peaks hold mapped "
        "files and the compiler.",
    )


if __name__ == "__main__":
    main()
