"""Atlas: time and memory beside error, by its size and by the number of views.

python -m benchmarks.atlas_speed [--scale .36] [--rows 768,1536,3072] [--views 3,5,9] [--keep DIR]

Every run is a process of its own, so that its peak memory is its own too.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.atlas_accuracy import by_open3d
from benchmarks.atlas_case import AtlasCase, case_at, make_case, skin
from benchmarks.record import record
from lightstage.formats.session import Session
from lightstage.rig import Rig
from processing.atlas.config import BLENDED, OPTIONAL, AtlasConfig
from processing.atlas.raster import rasterise
from processing.atlas.stage import atlas

NOISE = 0.002
PART_ROWS = 256
"""Rows scored at once."""


def fewer(case: AtlasCase, views: int) -> AtlasCase:
    """The same case with so many of its cameras, evenly chosen."""
    rig = case.session.rig
    chosen = np.linspace(0, len(rig.cameras) - 1, views).round().astype(int)
    cameras = tuple(rig.cameras[i] for i in chosen)
    session = Session(case.session.root, case.session.file, Rig(rig.lights, cameras))
    return dataclasses.replace(case, session=session)


def score(case: AtlasCase) -> float:
    """PSNR in dB of the diffuse albedo wherever a view shows it."""
    found, place = case.out.read_atlas("diffuse_albedo"), case.out.read_atlas("position")
    seen = case.out.read_atlas("coverage") > 0
    squares, count = 0.0, 0
    for top in range(0, len(found), PART_ROWS):
        part = slice(top, top + PART_ROWS)
        inside = seen[part]
        error = found[part][inside] - skin(place[part][inside].astype(float))
        squares, count = squares + float((error**2).sum()), count + error.size
    return -10 * float(np.log10(squares / count))


def one(folder: Path, scale: float, rows: int, views: int, maps: list[str]) -> dict[str, Any]:
    """One atlas in this process."""
    case = fewer(case_at(folder, scale), views)
    config = AtlasConfig(rows=rows, maps=tuple(maps))
    # Compiled code is loaded before the clock starts.
    atlas(case.session, folder, case.template, dataclasses.replace(config, rows=48))
    wall, cpu = time.perf_counter(), time.process_time()
    facts = atlas(case.session, folder, case.template, config)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    return {"wall": wall, "cpu": cpu, "peak": peak, "psnr": score(case), **facts}


def peer(folder: Path, scale: float, rows: int) -> dict[str, Any]:
    """Open3D's albedo in this process, its square of so many rows."""
    case = case_at(folder, scale)
    mesh = case.template.mesh
    assert mesh.uvs is not None
    wall, cpu = time.perf_counter(), time.process_time()
    found = by_open3d(mesh, case.session.rig.cameras, case.out, rows)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    raster = rasterise(mesh.uvs, mesh.triangle_uvs(), rows, rows)
    texels = raster.texels()
    place = raster.at(mesh.vertices, mesh.triangles(), texels)
    given = found.reshape(-1, 3)[texels]
    shown = given.sum(axis=1) > 0
    error = given[shown] - skin(place[shown].astype(float))
    return {
        "wall": wall,
        "cpu": cpu,
        "peak": peak,
        "psnr": -10 * float(np.log10(np.mean(error**2))),
        "seen_share": float(shown.mean()),
    }


def apart(*words: object) -> dict[str, Any]:
    """Run this file in another process."""
    command = [sys.executable, "-m", "benchmarks.atlas_speed", "--one", *map(str, words)]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    found: dict[str, Any] = json.loads(printed.strip().splitlines()[-1])
    return found


def line(name: str, rows: int, views: int, got: dict[str, Any]) -> list[str]:
    return [
        name,
        str(rows),
        str(views),
        f"{got['wall']:.1f}",
        f"{got['cpu']:.1f}",
        f"{got['peak']:.2f}",
        f"{got['psnr']:.1f}",
        f"{got['seen_share']:.0%}",
    ]


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--scale", type=float, default=0.36, help="of cameras of 24 megapixels")
    parser.add_argument("--rows", default="768,1536,3072")
    parser.add_argument("--views", default="3,5,9")
    parser.add_argument("--keep", type=Path, help="folder of the case, made where it is not there")
    parser.add_argument("--no-peer", action="store_true")
    parser.add_argument("--one", nargs="+", help="what a process of its own does")
    arguments = parser.parse_args()
    if arguments.one:
        folder, scale, rows, views, *maps = arguments.one
        where = Path(folder), float(scale), int(rows)
        print(json.dumps(one(*where, int(views), maps) if maps else peer(*where)))
        return
    sizes = [int(rows) for rows in arguments.rows.split(",")]
    counts = [int(views) for views in arguments.views.split(",")]
    table = []
    every = [*BLENDED, *OPTIONAL]
    with tempfile.TemporaryDirectory() as passing:
        folder = arguments.keep or Path(passing) / "case"
        if not (folder / "views").is_dir():
            make_case(folder, arguments.scale, skin, gain_sigma=0.0, noise=NOISE)
        runs = [(rows, counts[-1]) for rows in sizes]
        runs += [(sizes[-1], views) for views in counts[:-1]]
        for rows, views in runs:
            got = apart(folder, arguments.scale, rows, views, *every)
            table.append(line("all maps", rows, views, got))
            print(table[-1], flush=True)
        got = apart(folder, arguments.scale, sizes[-1], counts[-1], "diffuse_albedo")
        table.append(line("diffuse albedo alone", sizes[-1], counts[-1], got))
        print(table[-1], flush=True)
        if not arguments.no_peer:
            other = apart(folder, arguments.scale, sizes[-1], counts[-1])
            table.append(line("Open3D, albedo alone, square", sizes[-1], counts[-1], other))
            table.append(
                [
                    "ours over Open3D",
                    "",
                    "",
                    *(f"{got[key] / other[key]:.2f}" for key in ("wall", "cpu", "peak")),
                    f"{got['psnr'] - other['psnr']:+.1f}",
                    "",
                ]
            )
    camera = case_at(Path(passing), arguments.scale).session.rig.cameras[0]
    record(
        f"Atlas: time and memory beside error, views of {camera.width_px} x {camera.height_px}",
        [
            "maps",
            "rows",
            "views",
            "wall s",
            "processor s",
            "peak GiB",
            "PSNR dB, all that is seen",
            "seen",
        ],
        table,
        "All maps: six of the views' and six of the atlas's own, read and written as EXR; true "
        f"mesh, albedo with noise of {NOISE}, the other maps smooth.",
    )


if __name__ == "__main__":
    main()
