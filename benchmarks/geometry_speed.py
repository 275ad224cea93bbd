"""How long reconstruction takes, error beside time: rows, patches, sweeps, views, threads.

`python -m benchmarks.geometry_speed --person lps --curves rows,views`; without --curves all. Each
row is the whole stage but for the check of poses: reading, matching, consistency, fusion. Wall time
holds for an idle machine; processor time is printed beside it.
"""

from __future__ import annotations

import argparse
import dataclasses
import resource
import time
from typing import Any

import numba

from benchmarks.geometry_case import Case
from benchmarks.geometry_people import PEOPLE
from benchmarks.geometry_scores import score
from benchmarks.record import record
from processing.reconstruction.config import ReconstructConfig
from processing.reconstruction.stereo import match_views
from processing.reconstruction.two_passes import reconstruct_in_two_rounds

CONFIG = ReconstructConfig()
TWO_PAIRS = ("full", "x+", "x-", "y+", "y-")


@dataclasses.dataclass(frozen=True)
class Setting:
    """One row: what is changed, how many views, which photographs, how many threads."""

    name: str
    change: dict[str, Any] = dataclasses.field(default_factory=dict)
    views: int = 9
    patterns: tuple[str, ...] | None = None
    threads: int = 2


CURVES: dict[str, list[Setting]] = {
    "rows": [Setting(f"at most {rows} rows", {"finest_rows": rows}) for rows in (400, 800, 1600)],
    "patch": [
        Setting(f"patches of {2 * radius + 1} x {2 * radius + 1}", {"patch_radius_px": radius})
        for radius in (1, 2, 3, 4)
    ],
    "finest patch": [
        Setting(
            f"{2 * radius + 1} x {2 * radius + 1} at the finest level",
            {"finest_patch_radius_px": radius},
        )
        for radius in (1, 2, 3)
    ],
    "sweeps": [
        Setting(f"sweeps {sweeps}", {"iterations": sweeps})
        for sweeps in ((1, 1, 1), (3, 2, 1), (4, 3, 2))
    ],
    "sources": [
        Setting(f"each matched with {count}", {"source_views": count}) for count in (2, 3, 4, 6)
    ],
    "views": [Setting(f"{count} views", views=count) for count in (3, 5, 7, 9)],
    "photographs": [
        Setting("full alone", patterns=("full",)),
        Setting("full, x and y", patterns=TWO_PAIRS),
        Setting("all seven"),
    ],
    "looks": [
        Setting("one look", {"look_again": False}),
        Setting("two looks"),
    ],
    "relief": [
        Setting(f"relief below {mm:g} mm from normals", {"relief_mm": mm}) for mm in (0, 1, 3, 6)
    ],
    "threads": [Setting(f"{count} threads", threads=count) for count in (1, 2)],
}
NEAREST = (0, 1, 2, 5, 6, 7, 8, 3, 4)
"""Cameras from the front outward."""


def measure(case: Case, setting: Setting) -> tuple[object, ...]:
    """Time and error of one setting."""
    config = dataclasses.replace(CONFIG, **setting.change)
    threads = min(setting.threads, numba.config.NUMBA_NUM_THREADS)
    before = numba.get_num_threads()
    try:
        numba.set_num_threads(threads)
        wall, used = time.perf_counter(), time.process_time()
        views, lights = case.views(config, setting.patterns)
        views = [views[k] for k in sorted(NEAREST[: setting.views])]
        depths = match_views(views, config)
        matched = time.process_time() - used
        mesh = case.mesh_placed(reconstruct_in_two_rounds(views, depths, config, lights)[2])
        wall, used = time.perf_counter() - wall, time.process_time() - used
    finally:
        numba.set_num_threads(before)
    found = score(mesh, case.skin)
    return (
        setting.name,
        f"{depths[0].pictures.shape[2]} x {depths[0].pictures.shape[1]}",
        f"{wall:.1f}",
        f"{matched:.1f}",
        f"{used:.1f}",
        f"{found.to_truth[0]:.3f} / {found.to_truth[1]:.2f}",
        f"{found.to_mesh[0]:.3f} / {found.to_mesh[1]:.2f}",
        f"{100 * found.within:.1f}",
        f"{found.normals_deg[0]:.2f}",
    )


def main() -> None:
    """Measure what is named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--person", default="lps", choices=[known.name for known in PEOPLE])
    parser.add_argument("--curves", default=",".join(CURVES))
    parser.add_argument("--rows", type=int, help="Match at most so many rows in all curves.")
    chosen = parser.parse_args()
    case = Case(chosen.person)
    small = dataclasses.replace(CONFIG, finest_rows=150, iterations=(1,))
    # Compiled before the clock starts.
    views, lights = case.views(small)
    reconstruct_in_two_rounds(views, match_views(views, small), small, lights)
    for curve in chosen.curves.split(","):
        settings = CURVES[curve]
        if chosen.rows is not None:
            settings = [
                dataclasses.replace(each, change={"finest_rows": chosen.rows, **each.change})
                for each in settings
            ]
        rows = [measure(case, setting) for setting in settings]
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        camera = case.session.rig.cameras[0]
        record(
            f"Geometry: {curve}",
            (
                "setting",
                "matched at",
                "wall, s",
                "matching, processor s",
                "all, processor s",
                "mesh to truth: median / p95, mm",
                "true skin to mesh: median / p95, mm",
                "skin within .5 mm, %",
                "normals, mean deg",
            ),
            rows,
            f"{chosen.person}, photographs of {camera.width_px} x {camera.height_px}, direct "
            f"light; at most {peak:.1f} GiB so far.",
        )


if __name__ == "__main__":
    main()
