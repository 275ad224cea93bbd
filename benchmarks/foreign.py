"""Maps of people whose light and skin share no formula with `processing`.

The simulator gives faces, cameras and lamps; what skin does with light is Mitsuba's, and what
else a stage has that `processing` was not written for is a line of `benchmarks.foreign_cases`.
Maps are made with our own mesh and with the person's true one; clothes, hair and glasses are in
the scene as far as `reconstruct` finds them. Sessions, and rows of the table, are kept in a folder,
so that the table can be made in pieces: it has all rows of one size of picture that `processing`
as it is now made. After a change of `sim` the folder has to be removed.

``python -m benchmarks.foreign``; ``--cases burley,oily --rows 300`` to try; ``--unseen`` takes
the scenes that were not looked at while working.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.foreign_cases import CASES
from benchmarks.foreign_hair import between_hairs
from benchmarks.foreign_session import LIT_CAMERAS, SKIN, session_of
from benchmarks.record import record
from benchmarks.reflectance_case import facets_of
from benchmarks.reflectance_clothes import errors
from benchmarks.reflectance_people import folder
from benchmarks.reflectance_relight import Relighter, relit
from benchmarks.reflectance_scores import read_maps, true_view
from lightstage.formats.files import write_json
from lightstage.formats.mesh import read_ply
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import load_session
from lightstage.formats.template import default_template_path
from processing.pipeline import run
from processing.pipeline_config import PipelineConfig
from processing.records import code_version
from sim.session import truth_path

ROWS = 300
MESHES = ("own", "true")
HEADER = (
    "scene", "person", "mesh", "diffuse normals: all / above the chin, deg",
    "the same without skin between hairs, deg", "albedo RMSE / after one factor",
    "specular over 2 mm, share of a constant's error", "specular normals, deg",
    "confidence above .5, %", "new lights, dB", "seconds", "peak MiB",
)  # fmt: skip
SCORES = (
    "all", "above", "all_clear", "above_clear", "albedo", "albedo_after_gain", "specular",
    "specular_normal", "sure", "new_db",
)  # fmt: skip
TARGETS = {
    ("light", "own"): "1.20 / 0.90", ("dark", "own"): "1.80 / 1.40",
    ("light", "true"): "0.75", ("dark", "true"): "1.20",
}  # fmt: skip
OTHER_TARGETS = {
    "light": (".0120", ".60", "2.50", "92", "33"),
    "dark": (".0090", ".70", "3.00", "88", "33"),
}


def main() -> None:
    """Make the scenes, their maps, and the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=ROWS, help=f"of a picture [{ROWS}]")
    parser.add_argument("--cases", default="", help="names of scenes; all of the half where absent")
    parser.add_argument("--meshes", default=",".join(MESHES), help="own,true")
    parser.add_argument("--unseen", action="store_true", help="scenes not looked at while working")
    parser.add_argument("--keep", type=Path, default=folder() / "foreign", help="folder")
    parser.add_argument("--no-record", action="store_true", help="print rows alone")
    arguments = parser.parse_args()
    half = [name for name, case in CASES.items() if case.seen != arguments.unseen]
    for name in arguments.cases.split(",") if arguments.cases else half:
        for mesh in arguments.meshes.split(","):
            path = row_path(arguments.keep, arguments.rows, name, mesh)
            if not path.is_file():
                write_json(path, measured(name, arguments.rows, mesh, arguments.keep))
            print(*cells(name, mesh, json.loads(path.read_text())), sep=" | ", flush=True)
    if not arguments.no_record:
        record(
            "Reflectance: foreign scenes, "
            + ("not looked at" if arguments.unseen else "looked at"),
            HEADER,
            table(half, arguments.keep, arguments.rows),
            f"Nine views of {arguments.rows} rows, skin seen under 70 degrees; new lights in three "
            "views. Seconds and memory of all stages until `refine`, on a busy machine; with the "
            "true mesh decode and coarse maps are those of the row above.",
        )


def row_path(keep: Path, rows: int, name: str, mesh: str) -> Path:
    """Where a row is kept that `processing` as it is now makes."""
    return keep / "rows" / f"{code_version()[:12]}-{rows}-{name}-{mesh}.json"


def measured(name: str, rows: int, mesh: str, keep: Path) -> dict[str, float]:
    """Errors of one scene's maps, and what they cost."""
    session = session_of(CASES[name], name, rows, keep)
    base = PipelineConfig()
    if mesh == "true":
        how = dataclasses.replace(base.reconstruct, mesh=str(session.parent / SKIN))
        base = dataclasses.replace(base, reconstruct=how)
    out = keep / "out" / f"{name}-{rows}"
    stages = run(session, out, default_template_path(), base, until="refine")["stages"]
    found = errors(out, session)
    clear = errors(out, session, between_hairs(session))
    found |= {f"{part}_clear": clear[part] for part in ("all", "above")}
    found["new_db"] = new_lights_db(out, session, stages["refine"])
    found["seconds"] = sum(stages[stage]["seconds"] for stage in stages)
    found["mib"] = max(stages[stage]["peak_rss_mb"] for stage in stages)
    return found


def new_lights_db(out: Path, session_path: Path, refined: dict[str, Any]) -> float:
    """PSNR of pictures of the maps under lights that no pattern used."""
    made, true = ProcessedFolder(out), ProcessedFolder(truth_path(session_path))
    rig = load_session(session_path).rig
    facets = facets_of(refined)
    maps = {name: read_maps(made, name, facets) for name in LIT_CAMERAS}
    truth = {name: true_view(true, rig.camera(name)) for name in LIT_CAMERAS}
    others = read_ply(made.occluders) if made.occluders.is_file() else None
    relighter = Relighter(read_ply(made.base_mesh), rig, others)
    return relit(maps, relighter, rig, truth, session_path).psnr_db()


def cells(name: str, mesh: str, error: dict[str, float]) -> tuple[str, ...]:
    """A row of the table."""
    case = CASES[name]
    return (
        name, f"{case.who}, tone {case.tone}", mesh, *numbers(error),
        f"{error['seconds']:.0f}", f"{error['mib']:.0f}",
    )  # fmt: skip


def numbers(error: dict[str, float]) -> tuple[str, ...]:
    """The errors among a row's cells."""
    return (
        f"{error['all']:.2f} / {error['above']:.2f}",
        f"{error['all_clear']:.2f} / {error['above_clear']:.2f}",
        f"{error['albedo']:.4f} / {error['albedo_after_gain']:.4f}",
        f"{error['specular']:.2f}",
        f"{error['specular_normal']:.2f}",
        f"{100 * error['sure']:.1f}",
        f"{error['new_db']:.1f}",
    )


def table(half: Sequence[str], keep: Path, rows: int) -> list[tuple[str, ...]]:
    """All rows that are kept, then the means of light and dark people beside their targets."""
    found: list[tuple[str, ...]] = []
    means: list[tuple[str, ...]] = []
    kept = {
        (name, mesh): json.loads(path.read_text())
        for name in half
        for mesh in MESHES
        if (path := row_path(keep, rows, name, mesh)).is_file()
    }
    found = [cells(name, mesh, error) for (name, mesh), error in kept.items()]
    for skin, others in OTHER_TARGETS.items():
        for mesh in MESHES:
            some = [e for (name, m), e in kept.items() if m == mesh and CASES[name].skin == skin]
            if not some:
                continue
            mean = {score: float(np.mean([error[score] for error in some])) for score in SCORES}
            means.append((f"**mean of {len(some)}**", skin, mesh, *numbers(mean), "", ""))
            means.append(("*target*", skin, mesh, TARGETS[skin, mesh], "", *others, "", ""))
    return found + means


if __name__ == "__main__":
    main()
