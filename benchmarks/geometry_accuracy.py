"""Meshes against truth: people of plain and freckled skin, ICT's, the scanned head; both ways.

`python -m benchmarks.geometry_accuracy --people plain,lps --parts ours,peer`, results gathering in
one file (--keep), so that a person and a part fit into four minutes; a run without --people and
--parts does all and writes RESULTS.md. Parts: `ours`, `peer` (OpenCV SGBM, the same fusion),
`normals` (positions and normals together: off, on, and with normals tipped by 3 degrees; the
person `relief` has shape and shading of one relief),
`patterns` (which photographs the matcher saw), `pictures` (no normals: pictures alone, beside the
whole session), `floor` (true cameras, no noise). --told writes the tables of what is kept.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.geometry_case import Case, timed
from benchmarks.geometry_peer import Sgbm, peer_depths
from benchmarks.geometry_people import PEOPLE
from benchmarks.geometry_pictures import write_pictures
from benchmarks.geometry_poses import true_rig
from benchmarks.geometry_scores import Scores, Skin, score, where
from benchmarks.record import record
from benchmarks.reflectance_people import folder
from lightstage.formats.files import read_json, write_json
from lightstage.formats.mesh import Mesh
from processing.reconstruction.config import ReconstructConfig
from processing.reconstruction.slants import toward_cameras
from processing.reconstruction.two_passes import Depths
from processing.reconstruction.views import Level, View, pyramid

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
COARSE_ROWS = 800
"""Of the comparison of photographs, which matches often: in pictures of half the size."""
CONFIG = ReconstructConfig()

Row = dict[str, Any]
Cells = tuple[object, ...]


class Made(NamedTuple):
    """A mesh in the truth's world.

    Attributes:
        name: how it was made.
        mesh: mm.
        seconds: processor's.
        skin: what it is scored by, where that is not all of the case's.
    """

    name: str
    mesh: Mesh
    seconds: float
    skin: Skin | None = None


Meshes = Iterator[Made]


@functools.lru_cache(maxsize=1)
def _ours(case: Case) -> tuple[list[View], Depths, Mesh, float]:
    """Views, second depths and mesh of a person, which several parts take; processor seconds."""
    views, lights = case.views(CONFIG)
    depths, mesh, seconds = timed(views, lights, CONFIG)
    return views, depths, case.mesh_placed(mesh), seconds


def ours(case: Case) -> Meshes:
    """The stage as it is."""
    yield Made("ours", *_ours(case)[2:])


def peer(case: Case) -> Meshes:
    """OpenCV's matcher, our consistency and fusion, its points as they are.

    Then ours again, of what SGBM found alone.
    """
    views, _, mesh, seconds = _ours(case)
    theirs = _sgbm(case, views)
    yield theirs
    cut, skin = where(mesh, case.skin, theirs.mesh)
    yield Made("ours, where SGBM is", cut, seconds, skin)
    yield Made("SGBM, where SGBM is", *theirs[1:3], where(mesh, case.skin, theirs.mesh)[1])


def _sgbm(case: Case, views: list[View]) -> Made:
    plain = dataclasses.replace(CONFIG, relief_mm=0.0)
    start = time.process_time()
    depths = peer_depths(case.session, case.out, views, plain, Sgbm())
    return Made("OpenCV SGBM", *_meshed(case, depths, plain, time.process_time() - start))


def floor(case: Case) -> Meshes:
    """Both with true cameras and without pixel noise: what neither can be blamed for."""
    best = Case(case.name, noise=0.0, cameras=true_rig().cameras, label="-true")
    views, _, mesh, seconds = _ours(best)
    yield Made("ours, true cameras, no noise", mesh, seconds)
    yield _sgbm(best, views)._replace(name="SGBM, true cameras, no noise")


def normals(case: Case) -> Meshes:
    """The gain by positions and normals together: off, on, and with tipped normals.

    First a mesh of points alone, normals by planes through neighbouring points: a surface that no
    photometric normal has touched after matching.
    """
    views, (level, inverse, costs), _, _ = _ours(case)
    coarse = pyramid(views, CONFIG.finest_rows, CONFIG.coarsest_rows)[-1]
    tipped = dataclasses.replace(level, normals=_tipped(level, TIPPED_DEG))
    alone = dataclasses.replace(CONFIG, relief_mm=0.0)
    cases: list[tuple[str, Level, ReconstructConfig]] = [
        ("points alone, their planes' normals, not split", toward_cameras(level), _whole(alone)),
        ("points alone, their planes' normals", toward_cameras(level), alone),
        ("points alone, normals of both", level, alone),
        ("with coarse normals", coarse, CONFIG),
        ("with mended normals, not split", level, _whole(CONFIG)),
        ("with mended normals", level, CONFIG),
        ("with mended normals tipped", tipped, CONFIG),
    ]
    for name, seen, config in cases:
        yield Made(name, *_meshed(case, (seen, inverse, costs), config, 0.0))


def _whole(config: ReconstructConfig) -> ReconstructConfig:
    """The mesh left as it is fused."""
    return dataclasses.replace(config, splits=0)


def patterns(case: Case) -> Meshes:
    """Points alone, of matching with some of the photographs, coarser than by default."""
    config = dataclasses.replace(CONFIG, relief_mm=0.0, finest_rows=COARSE_ROWS)
    for name, chosen in SETS.items():
        _, mesh, seconds = timed(*case.views(config, chosen), config)
        yield Made(name, case.mesh_placed(mesh), seconds)


def pictures(case: Case) -> Meshes:
    """The stage as it is, beside photographs that give no normals, matched as pictures alone."""
    yield Made("whole session", *_ours(case)[2:])
    for name in ("full alone", "all seven"):
        views, lights = case.views(CONFIG, SETS[name], normals=False)
        _, mesh, seconds = timed(views, lights, CONFIG)
        yield Made(f"{name}, no normals", case.mesh_placed(mesh), seconds)


PARTS: dict[str, Callable[[Case], Meshes]] = {
    "ours": ours,
    "peer": peer,
    "normals": normals,
    "patterns": patterns,
    "pictures": pictures,
    "floor": floor,
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
    alone: list[Cells] = []
    for key, found in sorted(results.items()):
        light, name, part = key.split(" ")
        for method, row in found.items():
            who = f"{name}, {light}"
            mm = [f"{row[k][0]:.3f} / {row[k][1]:.2f}" for k in ("to_truth", "to_mesh")]
            share = f"{100 * row['within']:.1f} ({100 * row['within_two']:.1f})"
            deg = f"{row['normals_deg'][0]:.2f} / {row['normals_deg'][1]:.2f}"
            if part in ("ours", "peer", "floor"):
                all_skin = f"{row['capped_mm']:.3f}"
                rows.append((who, method, *mm, all_skin, share, deg, row["seconds"]))
                if part == "floor" or "where" in method:
                    continue
                cells = [
                    f"{row['regions'][r][0]:.3f} / {row['regions'][r][1]:.2f} / "
                    f"{100 * row['regions'][r][2]:.0f}"
                    if r in row["regions"]
                    else "-"
                    for r in ("nose", "cheek", "lids", "lips", "ear", "chin")
                ]
                regions.append((who, method, *cells))
            else:
                fine = f"{row['shown_deg'][0]:.2f} / {row['shown_deg'][1]:.2f}"
                cells = [who, method, *mm, share, deg]
                if part == "pictures":
                    alone.append((*cells, row["seconds"]))
                    continue
                if part == "normals":
                    turned.append((*cells, fine))
                else:
                    sets.append(tuple(cells))
    note = (
        "Nine views of 1004 x 1504, pixel noise .001, cameras measured from boards. `direct` "
        "light has cast shadows, `reference` bounces and scattering as well; `frontal`: 3 views."
    )
    both = ("mesh to truth: median / p95, mm", "true skin to mesh: median / p95, mm")
    all_at_most = "true skin to mesh, 1 mm at most: mean"
    share, deg = "skin within .5 mm, % (seen by two)", "normals: mean / median, deg"
    if rows:
        record(
            "Geometry: meshes of known people",
            ("person", "method", *both, all_at_most, share, deg, "processor, s"),
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
        shown = "to those that light shows: mean / median, deg"
        record(
            "Geometry: positions and normals together",
            ("person", "points", *both, share, deg, shown),
            turned,
            f"`tipped`: normals off by up to {TIPPED_DEG:g} degrees more, slowly changing. Points "
            "are those of the second look. The people's finest relief is in their shading alone, "
            "not in their shape, but for `relief`, the plain person once more, displaced by it. "
            "What light shows is the mean of shading normals over half a millimetre.",
        )
    if alone:
        record(
            "Geometry: pictures alone",
            ("person", "photographs", *both, share, deg, "processor, s"),
            alone,
            "Without normals the matcher's patches follow planes through the points of the level "
            "before; nothing is carried on, and no relief comes from normals.",
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
    parser.add_argument("--told", action="store_true", help="Measure nothing: write what is kept.")
    parser.add_argument("--pictures", type=Path, help="Folder for pictures of the meshes.")
    chosen = parser.parse_args()
    results: dict[str, dict[str, Row]] = read_json(chosen.keep) if chosen.keep.is_file() else {}
    for name in () if chosen.told else chosen.people.split(","):
        case = Case(name, chosen.light)
        for part in chosen.parts.split(","):
            found = results[f"{chosen.light} {name} {part}"] = {}
            for method, mesh, spent, skin in PARTS[part](case):
                found[method] = _row(score(mesh, case.skin if skin is None else skin), spent)
                print(name, method, found[method], flush=True)
                if chosen.pictures is not None:
                    label = f"{name}-{method}".replace(" ", "-")
                    write_pictures(mesh, case.skin.mesh, chosen.pictures / label)
            write_json(chosen.keep, results)
    tables(results)


if __name__ == "__main__":
    main()
