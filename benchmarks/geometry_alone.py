"""Skin that one camera alone confirms: three frontal views with and without carrying on.

`python -m benchmarks.geometry_alone --person lps --light frontal-direct` matches once, looks again
and meshes with each setting, and writes RESULTS.md.
"""

from __future__ import annotations

import argparse
import dataclasses
import time

from benchmarks.geometry_case import Case
from benchmarks.geometry_people import PEOPLE
from benchmarks.geometry_scores import score
from benchmarks.record import record
from processing.reconstruction.config import ReconstructConfig
from processing.reconstruction.fusion import alone_share
from processing.reconstruction.stereo import match_views
from processing.reconstruction.two_passes import reconstruct_in_two_rounds

CONFIG = ReconstructConfig()
SETTINGS = {
    "points that two views agree on alone, cut 2 mm from them": dataclasses.replace(
        CONFIG, carry_mm=0.0, trim_mm=2.0
    ),
    "the same, cut 1 mm from them": dataclasses.replace(CONFIG, carry_mm=0.0),
    "carried on (defaults)": CONFIG,
}


def main() -> None:
    """Measure and record."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--person", choices=[known.name for known in PEOPLE], default="lps")
    parser.add_argument("--light", default="frontal-direct")
    chosen = parser.parse_args()
    case = Case(chosen.person, chosen.light)
    views, lights = case.views(CONFIG)
    found = match_views(views, CONFIG)
    rows = []
    for name, config in SETTINGS.items():
        start = time.process_time()
        _, points, mesh, _ = reconstruct_in_two_rounds(views, found, config, lights)
        seconds = time.process_time() - start
        got = score(case.mesh_placed(mesh), case.skin)
        rows.append(
            (
                name,
                f"{got.to_truth[0]:.4f} / {got.to_truth[1]:.3f}",
                f"{got.to_mesh[0]:.4f} / {got.to_mesh[1]:.3f}",
                f"{got.capped_mm:.3f}",
                f"{100 * got.within:.1f} ({100 * got.within_two:.1f})",
                f"{100 * alone_share(mesh, points):.1f}",
                f"{seconds:.1f}",
            )
        )
        print(*rows[-1], flush=True)
    record(
        f"Geometry: skin that one camera alone confirms, {chosen.person}, {chosen.light}",
        (
            "surface",
            "mesh to truth, mm: median / p95",
            "true skin to mesh, mm",
            "the same, 1 mm at most: mean",
            "skin within .5 mm, % (seen by two)",
            "of the mesh on one view's word, %",
            "processor s after matching",
        ),
        rows,
        f"{len(views)} views of {views[0].mask.shape[1]} x {views[0].mask.shape[0]}.",
    )


if __name__ == "__main__":
    main()
