"""What skips of the atlas save, and by how much they change its maps.

python -m benchmarks.atlas_skips [--scale .25] [--rows 2048] [--keep DIR]

Looking (which texels a view shows), reading (a view's pictures side by side) and adding (both
bands) are timed apart, files unpacked before: beside the stage's threads that read and write, no
skip's own seconds could be measured. With a skip and without it run in turn. Apart: the largest
change of any map's value.
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
from lightstage.formats.mesh import read_obj
from lightstage.formats.processed import MAPS
from processing.atlas.blend import Blender
from processing.atlas.config import BLENDED, OPTIONAL, BlendConfig
from processing.atlas.geometry import Geometry
from processing.atlas.sampling import room, side_by_side
from processing.atlas.seen import Seen
from processing.atlas.weights import Sampler, Texels

ROUNDS = 3
EVERY = (*BLENDED, *OPTIONAL)
NORMAL = "diffuse_normal"
LOOKING, READING, ADDING = PARTS = ("looking", "reading", "adding")

Around = Callable[[], AbstractContextManager[None]]


@dataclasses.dataclass(frozen=True)
class Bench:
    """An atlas's texels, and its views' files unpacked.

    Attributes:
        case: cameras.
        shape: the mesh's texels.
        texels: the same under the views.
        pictures: of each camera, its maps.
    """

    case: AtlasCase
    shape: Geometry
    texels: Texels
    pictures: dict[str, dict[str, np.ndarray]]


@contextmanager
def whole_pictures() -> Iterator[None]:
    """Of each view the whole picture is kept."""

    def all_of_it(usable: np.ndarray) -> tuple[slice, slice]:
        return slice(0, usable.shape[0]), slice(0, usable.shape[1])

    with mock.patch("processing.atlas.weights.window_of", all_of_it):
        yield


def prepared(case: AtlasCase, rows: int) -> Bench:
    """Texels and pictures of a case."""
    shape = Geometry.of(read_obj(case.out.registered_mesh), rows)
    places = shape.at(shape.vertices)
    trust = np.ones(len(places), np.float32)
    texels = Texels(places, shape.normals(), trust, shape.tiles.start)
    pictures = {}
    for camera in case.session.rig.cameras:
        pictures[camera.id] = {
            name: case.out.read_half_view(camera.id, name) for name in (*EVERY, "confidence")
        }
        pictures[camera.id]["mask"] = case.out.read_mask(camera.id)
    return Bench(case, shape, texels, pictures)


@dataclasses.dataclass(frozen=True)
class Merged:
    """Some maps of an atlas, before anything is guessed.

    Attributes:
        values: (k, d).
        seconds: processor's, of each part.
        shares: of pixels kept, and of samples that give detail.
    """

    values: np.ndarray
    seconds: dict[str, float]
    shares: tuple[float, float]


def merged(bench: Bench, names: tuple[str, ...], config: BlendConfig) -> Merged:
    """All views' share of some maps."""
    cameras, shape = bench.case.session.rig.cameras, bench.shape
    seconds = dict.fromkeys(PARTS, 0.0)

    @contextmanager
    def timed(part: str) -> Iterator[None]:
        begin = time.process_time()
        yield
        seconds[part] += time.process_time() - begin

    middle = shape.vertices.mean(axis=0)
    finest = min(np.linalg.norm(c.centre_mm - middle) / c.fx_px for c in cameras)
    sampler = Sampler(shape.vertices, shape.triangles, bench.texels, float(finest), config.weights)
    seen, views = Seen.none(len(shape.tiles.flat)), []
    for index, camera in enumerate(cameras):
        maps = bench.pictures[camera.id]
        confidence = maps["confidence"].astype(np.float32)
        with timed(LOOKING):
            views.append(sampler.look(camera, confidence, maps["mask"], maps[NORMAL]))
            seen.add(views[-1].reading, index)
    channels = sum(MAPS[name].channels for name in names)
    values = np.zeros((len(seen.best), room(channels)), np.float32)
    with timed(ADDING):
        blender = Blender(seen.best, views, config)
    for index, camera in enumerate(cameras):
        with timed(READING):
            maps = bench.pictures[camera.id]
            image = side_by_side((maps[name][views[index].window] for name in names), channels)
        with timed(ADDING):
            blender.add(index, image, values)
    samples = [view.reading for view in views]
    detailed = sum(
        np.count_nonzero(one.weight >= config.detail_least * seen.best[one.slot]) for one in samples
    )
    shares = (
        sum(one.usable.size for one in samples) / sum(c.width_px * c.height_px for c in cameras),
        detailed / sum(len(one.slot) for one in samples),
    )
    return Merged(values[:, :channels], seconds, shares)


def one_by_one(bench: Bench, names: tuple[str, ...], config: BlendConfig) -> Merged:
    """The same, each map for itself."""
    found = [merged(bench, (name,), config) for name in names]
    seconds = {part: sum(each.seconds[part] for each in found) for part in PARTS}
    values = np.concatenate([each.values for each in found], axis=1)
    return Merged(values, seconds, found[0].shares)


Way = Callable[[Bench, tuple[str, ...], BlendConfig], Merged]


def without(
    name: str,
    parts: tuple[str, ...],
    bench: Bench,
    around: Around = nullcontext,
    config: BlendConfig | None = None,
    way: Way = merged,
) -> list[str]:
    """A row of the table: the parts' seconds without a skip and with it, the least of each."""
    usual = BlendConfig()
    least: list[list[float]] = [[], []]
    change = 0.0
    for _ in range(ROUNDS):
        with around():
            plain = way(bench, EVERY, config or usual)
        ours = merged(bench, EVERY, usual)
        for seconds, one in zip(least, (plain, ours), strict=True):
            seconds.append(sum(one.seconds[part] for part in parts))
        change = max(change, float(np.abs(plain.values - ours.values).max()))
    slow, fast = min(least[0]), min(least[1])
    left = [1 - b / a for a, b in zip(plain.shares, ours.shares, strict=True)]
    share = f"{max(left):.0%}" if way is merged else f"{len(EVERY) - 1} of {len(EVERY)}"
    row = [name, share, ", ".join(parts), f"{slow:.2f}", f"{fast:.2f}", f"{1 - fast / slow:.0%}"]
    print(*row, change, flush=True)
    return [*row, f"{change:.2g}"]


def main() -> None:
    """Measure, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scale", type=float, default=0.25, help="of cameras of 24 megapixels")
    parser.add_argument("--rows", type=int, default=2048)
    parser.add_argument("--keep", type=Path, help="folder of the case, made where it is not there")
    arguments = parser.parse_args()
    every = (LOOKING, READING, ADDING)
    with tempfile.TemporaryDirectory() as passing:
        folder = arguments.keep or Path(passing) / "case"
        if not (folder / "views").is_dir():
            make_case(folder, arguments.scale, skin, gain_sigma=0.0, noise=NOISE)
        bench = prepared(case_at(folder, arguments.scale), arguments.rows)
        merged(bench, EVERY, BlendConfig())  # compiled code is loaded before the clock starts
        rows = [
            without("pixels around what may be read", every, bench, whole_pictures),
            without(
                "detail of views below a tenth of the best's weight",
                (ADDING,),
                bench,
                config=BlendConfig(detail_least=0.0),
            ),
            without("what all maps share, for each map", every, bench, way=one_by_one),
        ]
    record(
        "Atlas: what each skip saves",
        [
            "skipped",
            "share",
            "of the time of",
            "processor s without",
            "with",
            "saved",
            "largest change",
        ],
        rows,
        f"{arguments.rows} rows from nine views of {arguments.scale:g} of 24 megapixels a side, "
        f"{len(EVERY)} maps, least of {ROUNDS} rounds in turn; files unpacked before. A half "
        "float's step is .0005 below 1. Texels and tiles without face are in no list; that "
        "unchanged inputs are not worked on again is the pipeline's doing.",
    )


if __name__ == "__main__":
    main()
