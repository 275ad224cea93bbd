"""A whole session of 24 megapixel views, RAW to atlas: seconds, memory and error of each stage.

python -m benchmarks.session_large [--views 9] [--until atlas] [--rows 6144] [--keep OUT]

The scanned head, rendered at 1.5 megapixels, is enlarged four times a side and photographed by the
simulator's sensor: mosaic and noise are those of 24 megapixels, the finest relief is not. Run it
alone on the machine.
"""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.atlas_session import psnr, true_values
from benchmarks.geometry_people import person, session
from benchmarks.geometry_scores import score, true_skin
from benchmarks.record import record
from benchmarks.reflectance_24mp import photograph_large
from benchmarks.reflectance_people import folder
from lightstage.commands import progress_bar
from lightstage.formats.files import atomic_folder
from lightstage.formats.landmarks import read_points_px, write_points_px
from lightstage.formats.mesh import read_ply
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import load_session
from lightstage.formats.template import default_template_path
from lightstage.rig import Rig, default_rig
from processing.pipeline import STAGES, run
from processing.pipeline_config import read_config
from sim.session import truth_path

WHO = "lps"
TIMES = 4
"""Pixels of a large view a side for each of the rendered one's."""
CHECKED_TEXELS = 500_000
NAMES = {9: "nine", 3: "three"}


def large_views(count: int) -> Path:
    """The folder of a session of the default rig's first cameras, made where it is missing."""
    root = folder() / f"24mp-{NAMES[count]}-{WHO}"
    if not root.is_dir():
        small = load_session(session(person(WHO)))
        cameras = [camera.id for camera in default_rig().cameras[:count]]
        with atomic_folder(root, "session") as beside:
            photograph_large(small, cameras, beside / "session")
            points = read_points_px(small.root / "landmarks.json")
            large = {camera: TIMES * points[camera] for camera in cameras if camera in points}
            write_points_px(large, beside / "session" / "landmarks.json")
    return root / "session"


def albedo_psnr(out: ProcessedFolder, truth: ProcessedFolder) -> float:
    """PSNR in dB of the diffuse albedo at some texels that two or more views see."""
    twice = (out.read_atlas("coverage") >= 2) & (out.read_atlas("filled") == 0)
    chosen = np.flatnonzero(twice.ravel())
    chosen = np.random.default_rng(0).choice(chosen, min(CHECKED_TEXELS, len(chosen)), False)
    places = out.read_atlas("position").reshape(-1, 3)[chosen].astype(float)
    found = out.read_atlas("diffuse_albedo").reshape(-1, 3)[chosen]
    return psnr(found - true_values(truth, places))


def mesh_error(out: Path, truth: ProcessedFolder, rig: Rig) -> str:
    """The base mesh against what of the true head a rig's cameras see, both ways."""
    found = score(read_ply(out / "base_mesh.ply"), true_skin(truth, rig))
    away, back = ("{:.3f} / {:.2f}".format(*two) for two in (found.to_truth, found.to_mesh))
    return (
        f"mesh to truth {away} mm, true skin to mesh {back}; within .5 mm "
        f"{100 * found.within:.1f} % of skin, {100 * found.within_two:.1f} % of what two see"
    )


def main() -> None:
    """Run the stages, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--views", type=int, default=9, choices=NAMES, help="3: a frontal triple")
    parser.add_argument(
        "--until", default=STAGES[-1], choices=STAGES[STAGES.index("reconstruct") :]
    )
    parser.add_argument("--rows", type=int, default=6144)
    parser.add_argument("--keep", type=Path, help="folder for the outputs")
    parser.add_argument("--make", action="store_true", help="make the session alone")
    arguments = parser.parse_args()
    photographs = large_views(arguments.views)
    if arguments.make:
        return
    truth = ProcessedFolder(truth_path(session(person(WHO))))
    whole = load_session(session(person(WHO))).rig
    rig = dataclasses.replace(whole, cameras=whole.cameras[: arguments.views])
    stages = STAGES[: STAGES.index(arguments.until) + 1]
    with tempfile.TemporaryDirectory() as passing:
        out = arguments.keep or Path(passing) / "out"
        wall, cpu = time.perf_counter(), time.process_time()
        config = read_config(None, arguments.rows)
        template = default_template_path()
        report = run(photographs, out, template, config, until=arguments.until, bar=progress_bar)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        facts = report["stages"]
        error = {"reconstruct": mesh_error(out, truth, rig)}
        if "register" in stages:
            away = facts["register"]["template_to_scan_median_mm"]
            error["register"] = f"template to scan {away:.3f} mm"
        if "atlas" in stages:
            error["atlas"] = f"diffuse albedo {albedo_psnr(ProcessedFolder(out), truth):.1f} dB"
    rows = [
        [
            stage,
            f"{facts[stage]['seconds']:.0f}",
            f"{facts[stage]['peak_rss_mb'] / 1024:.2f}",
            error.get(stage, ""),
        ]
        for stage in stages
    ]
    peak = max(facts[stage]["peak_rss_mb"] for stage in stages) / 1024
    rows.append(["all, photographs verified", f"{wall:.0f} ({cpu:.0f} cpu)", f"{peak:.2f}", ""])
    record(
        f"A session of {NAMES[arguments.views]} views of 24 megapixels, RAW to {arguments.until}",
        ["stage", "wall s", "peak GiB", "error"],
        rows,
        f"The scanned head (Lee Perry-Smith, CC BY 3.0) in {NAMES[arguments.views]} views of 1.5 "
        f"megapixels enlarged {TIMES} times a side, photographed with mosaic and noise at full "
        f"size; true cameras; an atlas is of {arguments.rows} rows.",
    )


if __name__ == "__main__":
    main()
