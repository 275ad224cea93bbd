"""Registration: run time against error, over the schedule and the template's resolution."""

from __future__ import annotations

import dataclasses
import os
import time

import numpy as np

from benchmarks.record import record
from benchmarks.registration_case import Case, make_case, model
from lightstage.formats.mesh import Mesh
from processing.registration.config import NonrigidConfig, RegisterConfig
from processing.registration.stage import register_mesh
from processing.registration.target import Target

SEED = 1
USUAL = NonrigidConfig()
SCHEDULES = {
    "usual": USUAL,
    "three rounds a stiffness": dataclasses.replace(USUAL, iterations=3),
    "one round a stiffness": dataclasses.replace(USUAL, iterations=1),
    "every second stiffness": dataclasses.replace(USUAL, stiffness_mm=USUAL.stiffness_mm[::2]),
    "down to 2.5 mm": dataclasses.replace(USUAL, stiffness_mm=USUAL.stiffness_mm[:-2]),
    "from 40 mm": dataclasses.replace(USUAL, stiffness_mm=USUAL.stiffness_mm[2:]),
    "the whole template at coarse stiffnesses too": dataclasses.replace(USUAL, coarse_cell_mm=0.0),
    "a template in cells of 10 mm at coarse stiffnesses": dataclasses.replace(
        USUAL, coarse_cell_mm=10.0
    ),
    "closest points of what has not moved asked anew": dataclasses.replace(
        USUAL, gate=dataclasses.replace(USUAL.gate, unmoved_mm=-1.0)
    ),
}
CELLS_MM = (5.0, 8.0)


def clustered(case: Case, cell_mm: float) -> Case:
    """The same case with a template of fewer vertices: one for each cell of a grid."""
    mesh = case.template.mesh
    cell = np.floor(mesh.vertices / cell_mm).astype(np.int64)
    _, cluster = np.unique(cell, axis=0, return_inverse=True)
    cluster = cluster.ravel()
    # One vertex represents its cell, so that truth is known; landmarks stay.
    count = int(cluster.max()) + 1
    chosen = np.full(count, -1)
    chosen[cluster[::-1]] = np.arange(len(cluster))[::-1]
    chosen[cluster[case.template.landmarks]] = case.template.landmarks
    triangles = cluster[mesh.triangles()]
    distinct = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    _, first = np.unique(np.sort(triangles[distinct], axis=1), axis=0, return_index=True)
    faces = triangles[distinct][np.sort(first)].astype(np.int32)
    places = chosen[cluster[case.template.landmarks]]
    template = dataclasses.replace(
        case.template,
        mesh=Mesh(mesh.vertices[chosen], faces),
        landmarks=cluster[case.template.landmarks],
        regions={"skin": np.arange(count)},
    )
    marks = case.truth[places]
    return dataclasses.replace(
        case, template=template, truth=case.truth[chosen], landmarks_mm=marks
    )


def run(case: Case, config: NonrigidConfig) -> list[str]:
    begin, wall = time.process_time(), time.perf_counter()
    settings = RegisterConfig(nonrigid=config)
    found, facts = register_mesh(case.scan, case.landmarks_mm, case.template, settings)
    seconds, wall = time.process_time() - begin, time.perf_counter() - wall
    surface = Target(case.clean).closest(found).distance_mm
    error = np.linalg.norm(found - case.truth, axis=1)
    return [
        str(len(found)),
        str(facts["rounds"]),
        f"{100 * facts['matches_kept_share']:.0f}",
        f"{surface.mean():.3f}",
        f"{error.mean():.2f}",
        f"{seconds:.1f}",
        f"{wall:.1f}",
    ]


def main() -> None:
    case = make_case(model(), SEED)
    run(case, SCHEDULES["one round a stiffness"])  # compiles what is not compiled yet
    rows = []
    for name, config in SCHEDULES.items():
        rows.append([name, *run(case, config)])
        print(rows[-1], flush=True)
    for cell in CELLS_MM:
        rows.append([f"template in cells of {cell:g} mm", *run(clustered(case, cell), USUAL)])
        print(rows[-1], flush=True)
    record(
        "Registration: run time against error",
        [
            "schedule",
            "vertices",
            "rounds",
            "closest points kept %",
            "surface mm mean",
            "correspondence mm mean",
            "processor s",
            "wall s",
        ],
        rows,
        f"Person {SEED} of `registration_accuracy`, first case; {len(case.scan.faces)} faces; "
        f"everything from the scan's arrays to the registered mesh. Load average "
        f"{os.getloadavg()[2]:.1f} with other programs on the same cores: processor seconds count, "
        f"wall ones are too long by about that over the cores. Usual: {USUAL}.",
    )


if __name__ == "__main__":
    main()
