"""The mesh displaced by specular normals, against a person whose relief is known to the micrometre.

Run `python -m benchmarks.geometry_detail` (people of the reflectance benchmarks; their
sessions are reconstructed and refined first). Truth: the smooth head plus the height of
its relief along its normals, texel by texel, where some camera sees skin. Position is asked in
whole, and in the fine: less its mean within 3 mm, which is what pores and wrinkles are.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.geometry_scores import Surface
from benchmarks.record import record
from benchmarks.reflectance_people import TEXTURE_ROWS, folder, person, session
from lightstage.formats.mesh import Mesh, read_ply, vertex_normals
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import load_session
from lightstage.formats.template import default_template_path
from processing import pipeline, pipeline_config
from processing.refinement.config import RefineConfig
from processing.refinement.detail import NormalView, displaced
from processing.refinement.stage import read_normals
from sim.head.maps import to_window
from sim.people.person import person_skin
from sim.people.subjects import load_subject
from sim.session import truth_path
from sim.skin.normals import bend_normals

EVERY_TEXEL = 3
SEEN_MM = 0.3
FINE_MM = 3.0
APART_MM = 0.05
Row = tuple[object, ...]


class Truth:
    """Points on a person's skin with its relief.

    Attributes:
        smooth: (n, 3) mm, without relief.
        normals: (n, 3) unit, of the smooth surface.
        bent: (n, 3) unit, with relief.
        height_mm: (n,) of the relief.
        reached: (n,) bool, what is asked for.
    """

    def __init__(self, name: str) -> None:
        """Read what was made once, or make it."""
        known = person(name)
        kept = folder() / f"detail-truth-{name}.npz"
        if not kept.is_file():
            assert known.traits is not None, "a scan's relief is not known as a height"
            head = load_subject(known.name, known.seed, None, 96, known.traits).mesh
            height = person_skin(known.seed, known.traits, TEXTURE_ROWS).height_mm("neutral")
            rows, columns = height.shape
            smooth = vertex_normals(head.vertices, head.triangles())
            place = to_window(head.vertices, rows, columns, 0, rows)
            normal = to_window(smooth, rows, columns, 0, rows)
            bent = bend_normals(place, normal, height)
            some = np.s_[::EVERY_TEXEL, ::EVERY_TEXEL]
            normal = normal[some].reshape(-1, 3)
            normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
            fields = place[some].reshape(-1, 3), normal, bent[some].reshape(-1, 3)
            seen = self._seen(session(known), fields[0])
            np.savez(kept, *(field[seen] for field in (*fields, height[some].ravel())))
        with np.load(kept) as found:
            self.smooth, self.normals, self.bent, self.height_mm = (
                found[f"arr_{k}"].astype(float) for k in range(4)
            )
        self.reached = np.ones(len(self.height_mm), bool)
        self.first: np.ndarray | None = None

    @staticmethod
    def _seen(path: Path, places: np.ndarray) -> np.ndarray:
        truth = ProcessedFolder(truth_path(path))
        seen = np.concatenate(
            [
                truth.read_view(camera, "position")[truth.read_mask(camera)][::2]
                for camera in load_session(path).camera_ids()
            ]
        )
        return np.asarray(cKDTree(seen).query(places, distance_upper_bound=SEEN_MM)[0] < SEEN_MM)

    def ask_near(self, mesh: Mesh) -> None:
        """Leave out what a mesh has not: skin more than a millimetre from it."""
        self.reached = Surface(mesh).nearest(self.smooth)[0] < 1.0

    def score(self, mesh: Mesh) -> tuple[str, ...]:
        """Position: median / 95th percentile, mm; worse and better than the first mesh asked for,
        %; in the fine, rms and median in micrometres; normals, degrees.
        """
        surface = Surface(mesh)
        places = self.smooth + self.height_mm[:, None] * self.normals
        gap, normals = surface.nearest(places)
        near = self.reached
        gap = gap[near]
        if self.first is None:
            self.first = gap
        change = gap - self.first
        off = surface.signed(places[near], self.normals[near])
        known = np.isfinite(off)
        fine = self._fine(places[near][known], off[known])
        cosine = np.einsum("nk,nk->n", normals[near], self.bent[near])
        angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
        return (
            f"{np.median(gap):.4f} / {np.percentile(gap, 95):.3f}",
            f"{100 * (change > APART_MM).mean():.1f} / {100 * (change < -APART_MM).mean():.1f}",
            f"{1e3 * np.sqrt(np.mean(fine**2)):.1f}",
            f"{1e3 * np.median(np.abs(fine)):.1f}",
            f"{angle.mean():.2f} / {np.median(angle):.2f}",
        )

    def fine_um(self) -> float:
        """Root mean square of the true relief in the fine, micrometres."""
        fine = self._fine(self.smooth, self.height_mm)
        return float(1e3 * np.sqrt(np.mean(fine**2)))

    @staticmethod
    def _fine(places: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Values less their mean within FINE_MM, beyond doubt (not more than .5 mm off it)."""
        some = np.arange(0, len(places), max(1, len(places) // 20_000))
        tree = cKDTree(places)
        near = tree.query_ball_point(places[some], FINE_MM)
        out = values[some] - np.array([values[each].mean() for each in near])
        return np.asarray(out[np.abs(out) < 0.5])


def processed(name: str) -> tuple[Mesh, list[NormalView]]:
    """A person's mesh, and the specular normals that `refine` found on it."""
    path, config = session(person(name)), pipeline_config.read_config(None)
    with tempfile.TemporaryDirectory() as place:
        out = ProcessedFolder(Path(place))
        pipeline.run(path, out.root, default_template_path(), config, until="refine")
        return read_ply(out.base_mesh), read_normals(out, load_session(path).rig, 0.0)


def rows_of(name: str, sizes: list[tuple[float, float]]) -> list[Row]:
    """The mesh as it is, and displaced."""
    mesh, views = processed(name)
    truth = Truth(name)
    truth.ask_near(mesh)
    rows: list[Row] = [(name, "as it is", len(mesh.vertices), *truth.score(mesh), "")]
    print(*rows[-1], f"true relief {truth.fine_um():.1f} um", flush=True)
    for edge_mm, below_mm in sizes:
        start = time.process_time()
        found = displaced(mesh, views, edge_mm, below_mm)
        spent = time.process_time() - start
        by = f"displaced, below {below_mm:g} mm, edges of {edge_mm:g} mm"
        rows.append((name, by, len(found.mesh.vertices), *truth.score(found.mesh), f"{spent:.0f}"))
        print(*rows[-1], flush=True)
    return [
        *rows,
        (name, "(size of the true relief)", "", "", "", f"{truth.fine_um():.1f}", "", "", ""),
    ]


def main() -> None:
    """Measure, and write the table."""
    default = RefineConfig()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--people", default="tone3-old,tone3")
    parser.add_argument("--below", default=f"{default.detail_below_mm:g}")
    parser.add_argument("--edge", type=float, default=0.3)
    chosen = parser.parse_args()
    sizes = [(chosen.edge, float(each)) for each in chosen.below.split(",")]
    rows = [row for name in chosen.people.split(",") for row in rows_of(name, sizes)]
    record(
        "Geometry: the mesh displaced by specular normals",
        (
            "person",
            "mesh",
            "vertices",
            "true skin to mesh: median / p95, mm",
            f"skin worse / better by {APART_MM:g} mm, %",
            "in the fine: rms, um",
            "median, um",
            "normals: mean / median, deg",
            "processor, s",
        ),
        rows,
        "Three frontal views of 1004 x 1504 (.25 mm a pixel), the reflectance benchmarks' people.",
    )


if __name__ == "__main__":
    main()
