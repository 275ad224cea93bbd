"""Meshes against truth: people of plain and freckled skin, ICT's, the scanned head; both ways.

`python -m benchmarks.geometry_accuracy --people plain,lps --parts ours,peer`, results gathering in
one file (--keep), so that a person and a part fit into four minutes; a run without --people and
--parts does all and writes RESULTS.md. Parts: `ours`, `peer` (OpenCV SGBM, the same fusion),
`normals` (positions and normals together: off, on, and with normals tipped by 3 degrees),
`patterns` (which photographs the matcher saw). --told writes the tables of what is kept.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.geometry_case import Case, Depths, timed_match
from benchmarks.geometry_peer import Sgbm, peer_depths
from benchmarks.geometry_people import PEOPLE
from benchmarks.geometry_pictures import write_pictures
from benchmarks.geometry_scores import Scores, score
from benchmarks.record import record
from benchmarks.reflectance_people import folder
from lightstage.formats.files import read_json, write_json
from lightstage.formats.mesh import Mesh
from processing.reconstruction.config import ReconstructConfig
from processing.reconstruction.views import Level

SETS = {
    "all seven": None,
    "full alone": ("full",),
    "the six without full": ("x+", "x-", "y+", "y-", "z+", "z-"),
    "full, x+, x-": ("full", "x+", "x-"),
    "full, y+, y-": ("full", "y+", "y-"),
    "full, z+, z-": ("full", "z+", "z-"),
}
LIGHTS = ("direct", "reference", "frontal-direct", "frontal-reference")
TIPPED_DEG = 3.0
COARSE_ROWS = 400
"""Of the comparison of photographs, which matches often."""
CONFIG = ReconstructConfig()

Row = dict[str, Any]
Cells = tuple[object, ...]
Meshes = Iterator[tuple[str, Mesh, float]]
"""What it is, the mesh, processor seconds."""


@functools.lru_cache(maxsize=1)
def _matched(case: Case) -> tuple[Depths, float]:
    """Our depths of a person, which several parts take, and processor seconds."""
    return timed_match(case.views(CONFIG), CONFIG)


def ours(case: Case) -> Meshes:
    """The stage as it is."""
    depths, matched_s = _matched(case)
    yield "ours", *_meshed(case, depths, CONFIG, matched_s)


def peer(case: Case) -> Meshes:
    """OpenCV's matcher, our consistency and fusion, its points as they are."""
    plain = dataclasses.replace(CONFIG, relief_mm=0.0)
    views = case.views(plain)
    start = time.process_time()
    depths = peer_depths(case.session, case.out, views, plain, Sgbm())
    yield "OpenCV SGBM", *_meshed(case, depths, plain, time.process_time() - start)


def normals(case: Case) -> Meshes:
    """What positions and normals together are worth: off, on, and with tipped normals.

    First a mesh of points alone, normals by planes through neighbouring points: a surface that no
    photometric normal has touched after matching.
    """
    (level, inverse, costs), _ = _matched(case)
    tipped = dataclasses.replace(level, normals=_tipped(level, TIPPED_DEG))
    cases: list[tuple[str, Level, float]] = [
        ("points alone, their planes' normals", _toward_cameras(level), 0.0),
        ("points alone, normals of both", level, 0.0),
        ("with normals", level, CONFIG.relief_mm),
        ("with normals tipped", tipped, CONFIG.relief_mm),
    ]
    for name, seen, relief_mm in cases:
        config = dataclasses.replace(CONFIG, relief_mm=relief_mm)
        yield name, *_meshed(case, (seen, inverse, costs), config, 0.0)


def _toward_cameras(level: Level) -> Level:
    """A level whose normals tell nothing: all face their camera."""
    normals = np.empty_like(level.normals)
    height, width = normals.shape[1:3]
    for index, ((fx, fy, cx, cy), pose) in enumerate(zip(level.lenses, level.poses, strict=True)):
        x, y = (np.arange(width) + 0.5 - cx) / fx, (np.arange(height) + 0.5 - cy) / fy
        sight = np.stack(np.broadcast_arrays(x[None], y[:, None], 1.0), axis=-1)
        sight /= np.linalg.norm(sight, axis=-1, keepdims=True)
        normals[index] = -sight @ pose[:, :3]
    return dataclasses.replace(level, normals=normals)


def patterns(case: Case) -> Meshes:
    """Points alone, of matching with some of the photographs, coarser than by default."""
    config = dataclasses.replace(CONFIG, relief_mm=0.0, finest_rows=COARSE_ROWS)
    for name, chosen in SETS.items():
        depths, matched_s = timed_match(case.views(config, chosen), config)
        yield name, *_meshed(case, depths, config, matched_s)


PARTS: dict[str, Callable[[Case], Meshes]] = {
    "ours": ours,
    "peer": peer,
    "normals": normals,
    "patterns": patterns,
}


def _meshed(
    case: Case, depths: Depths, config: ReconstructConfig, before_s: float
) -> tuple[Mesh, float]:
    start = time.process_time()
    mesh = case.meshed(depths, config)
    return mesh, before_s + time.process_time() - start


def _tipped(level: Level, degrees: float) -> np.ndarray:
    """All normals tipped by a slowly changing angle, `degrees` at most, the same in all views."""
    out = level.normals.copy()
    rows, columns = np.indices(out.shape[1:3]) / (out.shape[1] / 4.0)
    tip = np.radians(degrees) * np.stack(
        [np.cos(columns + rows), np.sin(columns - rows), np.zeros_like(rows)], axis=-1
    )
    known = np.linalg.norm(out, axis=-1, keepdims=True) > 0.5
    out = np.where(known, out + tip.astype(np.float32), 0)
    length = np.linalg.norm(out, axis=-1, keepdims=True)
    return np.asarray(np.divide(out, length, out=np.zeros_like(out), where=length > 0))


def _row(found: Scores, seconds: float) -> Row:
    return {**dataclasses.asdict(found), "seconds": round(seconds, 1)}


def tables(results: dict[str, dict[str, Row]]) -> None:
    """Write what is there into RESULTS.md; keys are `light person part`."""
    rows: list[Cells] = []
    regions: list[Cells] = []
    turned: list[Cells] = []
    sets: list[Cells] = []
    for key, found in sorted(results.items()):
        light, name, part = key.split(" ")
        for method, row in found.items():
            who = f"{name}, {light}"
            mm = [f"{row[k][0]:.3f} / {row[k][1]:.2f}" for k in ("to_truth", "to_mesh")]
            share = f"{100 * row['within']:.1f} ({100 * row['within_two']:.1f})"
            deg = f"{row['normals_deg'][0]:.2f} / {row['normals_deg'][1]:.2f}"
            if part in ("ours", "peer"):
                rows.append((who, method, *mm, share, deg, row["seconds"]))
                cells = [
                    f"{row['regions'][r][0]:.3f} / {row['regions'][r][1]:.2f} / "
                    f"{100 * row['regions'][r][2]:.0f}"
                    if r in row["regions"]
                    else "-"
                    for r in ("nose", "cheek", "lids", "lips", "ear", "chin")
                ]
                regions.append((who, method, *cells))
            else:
                (turned if part == "normals" else sets).append((who, method, *mm, share, deg))
    note = (
        "Nine views of 1004 x 1504, pixel noise .001, cameras measured from boards. `direct` "
        "light has cast shadows, `reference` bounces and scattering as well; `frontal`: 3 views."
    )
    both = ("mesh to truth: median / p95, mm", "true skin to mesh: median / p95, mm")
    share, deg = "skin within .5 mm, % (seen by two)", "normals: mean / median, deg"
    if rows:
        record(
            "Geometry: meshes of known people",
            ("person", "method", *both, share, deg, "processor, s"),
            rows,
            note,
        )
        record(
            "Geometry: by region",
            ("person", "method", "nose", "cheek", "lids", "lips", "ear", "chin"),
            regions,
            "True skin to mesh: median / p95 in mm / % within .5 mm.",
        )
    if turned:
        record(
            "Geometry: positions and normals together",
            ("person", "points", *both, share, deg),
            turned,
            f"`tipped`: normals off by up to {TIPPED_DEG:g} degrees more, slowly changing.",
        )
    if sets:
        record(
            "Geometry: which photographs help",
            ("person", "photographs", *both, share, deg),
            sets,
            f"Matched at up to {COARSE_ROWS} rows, points alone.",
        )


def main() -> None:
    """Measure what is named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--people", default=",".join(known.name for known in PEOPLE))
    parser.add_argument("--parts", default=",".join(PARTS))
    parser.add_argument("--light", choices=LIGHTS, default="direct")
    parser.add_argument("--keep", type=Path, default=folder() / "geometry-accuracy.json")
    parser.add_argument("--told", action="store_true", help="Measure nothing: tell what is kept.")
    parser.add_argument("--pictures", type=Path, help="Folder for pictures of the meshes.")
    chosen = parser.parse_args()
    results: dict[str, dict[str, Row]] = read_json(chosen.keep) if chosen.keep.is_file() else {}
    for name in () if chosen.told else chosen.people.split(","):
        case = Case(name, chosen.light)
        for part in chosen.parts.split(","):
            found = results[f"{chosen.light} {name} {part}"] = {}
            for method, mesh, spent in PARTS[part](case):
                found[method] = _row(score(mesh, case.skin), spent)
                print(name, method, found[method], flush=True)
                if chosen.pictures is not None:
                    label = f"{name}-{method}".replace(" ", "-")
                    write_pictures(mesh, case.skin.mesh, chosen.pictures / label)
            write_json(chosen.keep, results)
    tables(results)


if __name__ == "__main__":
    main()
