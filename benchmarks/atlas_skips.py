"""What skips of the atlas save, and that they change nothing.

python -m benchmarks.atlas_skips [--scale .36] [--rows 3072] [--keep DIR]

Each runs with the skip as the stage has it, and without, in turn. Apart: the largest change of any
map's value.
"""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from unittest import mock

import numpy as np

from benchmarks.atlas_case import AtlasCase, case_at, make_case, skin
from benchmarks.atlas_speed import NOISE
from benchmarks.record import record
from processing.atlas.blend import BlendConfig
from processing.atlas.stage import BLENDED, AtlasConfig, atlas
from processing.atlas.tiles import TileBounds

ROUNDS = 2

Around = Callable[[], AbstractContextManager[None]]
Maps = dict[str, np.ndarray]


@contextmanager
def every_tile() -> Iterator[None]:
    """Each view looks at each tile."""

    def all_of_them(self: TileBounds, place_mm: np.ndarray, least_cos: float) -> np.ndarray:
        del place_mm, least_cos
        return np.arange(len(self.trusted))

    with mock.patch.object(TileBounds, "seen_from", all_of_them):
        yield


@contextmanager
def whole_pictures() -> Iterator[None]:
    """Of each view the whole picture is kept."""

    def all_of_it(usable: np.ndarray) -> tuple[slice, slice]:
        return slice(0, usable.shape[0]), slice(0, usable.shape[1])

    with mock.patch("processing.atlas.weights.window_of", all_of_it):
        yield


def least(case: AtlasCase, config: AtlasConfig, around: Around) -> tuple[float, Maps]:
    """Processor seconds of the stage, the least of some rounds; and its maps."""
    seconds = []
    for _ in range(ROUNDS):
        begin = time.process_time()
        with around():
            facts = atlas(case.session, case.out.root, case.template, config)
        seconds.append(time.process_time() - begin)
    return min(seconds), {name: case.out.read_atlas(name) for name in (*facts["maps"], "view")}


def main() -> None:
    """Measure, and write the table."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--scale", type=float, default=0.36, help="of cameras of 24 megapixels")
    asked.add_argument("--rows", type=int, default=3072)
    asked.add_argument("--keep", type=Path, help="folder of the case, made where it is not there")
    given = asked.parse_args()
    usual = AtlasConfig(rows=given.rows, maps=BLENDED)
    alone = dataclasses.replace(usual, maps=BLENDED[:1])
    thorough = dataclasses.replace(usual, blend=BlendConfig(detail_least=0.0))
    with tempfile.TemporaryDirectory() as passing:
        folder = given.keep or Path(passing) / "case"
        if not (folder / "views").is_dir():
            make_case(folder, given.scale, skin, gain_sigma=0.0, noise=NOISE)
        case = case_at(folder, given.scale)
        atlas(case.session, folder, case.template, dataclasses.replace(usual, rows=48))
        with_s, ours = least(case, usual, nullcontext)
        rows = []
        for name, config, around in (
            ("tiles that look away from a view", usual, every_tile),
            ("pixels around what may be read", usual, whole_pictures),
            ("detail of views below a tenth of the best's weight", thorough, nullcontext),
        ):
            seconds, maps = least(case, config, around)
            rows.append(line(name, seconds, with_s, maps, ours))
        seconds, maps = least(case, alone, nullcontext)
        rows.append(line(f"all maps but one of {len(BLENDED)}", with_s, seconds, ours, maps))
    record(
        "Atlas: what each skip saves",
        ["skipped", "processor s without", "processor s with", "saved", "largest change of a map"],
        rows,
        f"{given.rows} rows from nine views of {given.scale:g} of 24 megapixels a side, "
        f"{len(BLENDED)} maps, least of {ROUNDS} rounds. A half float's step is .0005 below 1. "
        "Texels and tiles without face are in no list; that unchanged inputs are not worked on "
        "again is the pipeline's doing.",
    )


def line(name: str, without_s: float, with_s: float, one: Maps, other: Maps) -> list[str]:
    """A row of the table."""
    change = max(float(np.abs(one[key] - other[key]).max()) for key in one.keys() & other.keys())
    saved = f"{1 - with_s / without_s:.0%}"
    print(name, without_s, with_s, change, flush=True)
    return [name, f"{without_s:.1f}", f"{with_s:.1f}", saved, f"{change:.2g}"]


if __name__ == "__main__":
    main()
