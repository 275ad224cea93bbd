"""Our own template: how much its UV stretches skin, and how many identity modes people need.

The layout is compared with the vertex grid spread evenly over the tile, as it was before. The
modes are the exact principal components of the simulator's fields; beside them stand those learned
from drawn people. Both are projected onto the heads of other people, whose lids and eyes move as no
mode does.
"""

from __future__ import annotations

import dataclasses
import time

import numpy as np

from benchmarks.record import record
from processing.template.uv_faults import stretch_of
from sim.head.fields import identity_fields
from sim.head.mesh import grid_places, neutral_mesh, regions
from sim.head.modes import IDENTITY_MODES
from sim.head.parametric import random_head
from sim.head.unwrap import make_layout

LEARNED_FROM = 1000
HELD_OUT = 200
MODES = (0, 1, 2, 5, 10, 20, 30)
SEED = 11


def main() -> None:
    begun = time.perf_counter()
    make_layout()
    seconds = time.perf_counter() - begun
    record(
        "Template: stretch of our UV",
        ["layout", "part", "angles, deg: median / 95 %", "areas, times: 95 %", "texel mm"],
        stretches(),
        f"Of 6144 rows. The layout was made in {seconds:.1f} s. Angles and areas as `template "
        "check` has them: the largest change of an angle of a triangle, and the factor by which "
        "texels per mm2 differ from the part's median.",
    )
    record(
        "Template: identity modes",
        ["modes", "exact mm: mean / 95 %", f"learned from {LEARNED_FROM} people mm", "ratio"],
        held_out_errors(),
        f"{HELD_OUT} people drawn apart; distance of the face's vertices from the nearest head of "
        f"so many modes by least squares over them. The template has {IDENTITY_MODES}.",
    )


def stretches() -> list[list[str]]:
    """Rows by layout and part of the head."""
    mesh = neutral_mesh()
    even = dataclasses.replace(mesh, uvs=grid_places())
    body = []
    for name, laid_out in (("ours", mesh), ("the grid, evenly", even)):
        stretch = stretch_of(laid_out, 6144)
        for part in ("skin", "lips", "ears", "hair"):
            chosen = np.asarray(np.isin(mesh.triangles(), regions()[part]).all(axis=1))
            median, most = stretch.of(chosen, 0.5), stretch.of(chosen, 0.95)
            body.append(
                [name, part, f"{median[0]:.0f} / {most[0]:.0f}", f"{most[1]:.1f}", f"{most[2]:.3f}"]
            )
    return body


def held_out_errors() -> list[list[str]]:
    """Rows by number of modes."""
    mesh = neutral_mesh()
    face = np.setdiff1d(regions()["skin"], np.flatnonzero(mesh.vertices[:, 1] < -118))
    rng = np.random.default_rng(SEED)
    heads = np.stack(
        [
            random_head(rng).vertices[face].ravel() - mesh.vertices[face].ravel()
            for _ in range(LEARNED_FROM + HELD_OUT)
        ]
    )
    people, others = heads[:LEARNED_FROM], heads[LEARNED_FROM:]
    _, fields = identity_fields()
    exact = fields[:, face].reshape(len(fields), -1)
    _, vectors = np.linalg.eigh(exact @ exact.T)
    bases = (
        vectors[:, ::-1].T @ exact,
        np.linalg.svd(people - people.mean(axis=0), full_matrices=False)[2],
    )
    means = (np.zeros(heads.shape[1]), people.mean(axis=0))
    body = []
    for count in MODES:
        errors = []
        for basis, mean in zip(bases, means, strict=True):
            chosen = basis[:count]
            beside = (others - mean).T
            if count:
                beside = beside - chosen.T @ np.linalg.lstsq(chosen.T, beside, rcond=None)[0]
            away = np.linalg.norm(beside.T.reshape(HELD_OUT, -1, 3), axis=2)
            errors.append((float(away.mean()), float(np.quantile(away, 0.95))))
        (mean_mm, most_mm), (learned_mm, _) = errors
        body.append(
            [
                str(count),
                f"{mean_mm:.2f} / {most_mm:.2f}",
                f"{learned_mm:.2f}",
                f"{mean_mm / learned_mm:.2f}",
            ]
        )
    return body


if __name__ == "__main__":
    main()
