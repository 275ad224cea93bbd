"""Our own template in the topology with closed loops (see `sim.head.loops`)."""

from __future__ import annotations

import dataclasses

import numpy as np

from lightstage.formats.mesh import Mesh
from lightstage.formats.population import Population
from lightstage.formats.surface_points import SurfacePoints
from lightstage.formats.template import Modes, Template, default_template_path, load_template
from sim.errors import SimError
from sim.head.grid import ROW_LID_LOW, ROW_LID_UP, ROW_LIP_LOW, ROW_LIP_UP, ROW_MOUTH
from sim.head.layout import layout
from sim.head.loops import Loops, loops
from sim.head.mesh import HALF, grid_vertices, landmarks, neutral_mesh, regions
from sim.head.template import build_template

CURVES = (
    ROW_LID_UP, (ROW_LID_UP + ROW_LID_LOW) // 2, ROW_LID_LOW,
    ROW_LIP_UP, ROW_MOUTH - 1, ROW_MOUTH, ROW_MOUTH + 1, ROW_LIP_LOW,
)  # fmt: skip
"""Rows of the grid along which landmarks of eyes and mouth stay."""
FIRST_OF_EYES = 36
"""In iBUG's order; the mouth's follow."""
LEAST_WEIGHT = -1e-9
"""What rounding may leave of a weight that is zero."""


def build_loops_template() -> Template:
    """The template with the people and the detector's points of the one that is kept as data."""
    made, own = loops(), build_template()
    kept = load_template(default_template_path())
    if not np.array_equal(kept.mesh.faces, own.mesh.faces):
        raise SimError(
            default_template_path(),
            found=f"{len(kept.mesh.vertices)} vertices of another topology",
            expected="the template of `lightstage-sim template`, whose people are carried",
        )
    assert own.modes is not None  # the simulator's template has modes
    modes = own.modes
    return dataclasses.replace(
        own,
        name=f"{own.name}, loops",
        mesh=loops_mesh(),
        landmarks=loops_landmarks(),
        regions=loops_regions(),
        source=f"{own.source} --loops",
        modes=Modes(
            np.stack([made.carried(mode) for mode in modes.identity]),
            np.stack([made.carried(mode) for mode in modes.expression]),
            modes.expression_names,
        ),
        face_points=None if kept.face_points is None else carried_points(kept.face_points),
        population=None if kept.population is None else _carried_people(kept.population),
    )


def loops_mesh() -> Mesh:
    """The average head: quads, one UV tile, head frame, mm."""
    made = loops()
    uv = np.asarray(made.carry_points @ layout().reshape(-1, 2))
    return Mesh(made.carried(neutral_mesh().vertices), made.faces(), uv, made.quads)


def loops_landmarks() -> np.ndarray:
    """(68,) vertex indices in iBUG's order: the nearest vertices on the same curves."""
    made = loops()
    before, after = neutral_mesh().vertices, made.carried(neutral_mesh().vertices)
    of_grid = _places_of_grid()
    places = _places_of_vertices(made)
    found = []
    for number, vertex in enumerate(landmarks()):
        row, column = of_grid[vertex]
        possible = np.ones(len(after), bool)
        if number >= FIRST_OF_EYES and row in CURVES:
            possible &= np.abs(places[:, 0] - row) < 1e-6
        if column == HALF:
            possible &= np.abs(places[:, 1] - HALF) < 1e-6
        away = np.linalg.norm(after - before[vertex], axis=1)
        found.append(int(np.where(possible, away, np.inf).argmin()))
    return np.array(found, np.int64)


def loops_regions() -> dict[str, np.ndarray]:
    """Vertex indices of each region: each vertex has that of which it has most."""
    made, names = loops(), list(regions())
    shares = np.zeros((len(neutral_mesh().vertices), len(names)))
    for number, name in enumerate(names):
        shares[regions()[name], number] = 1.0
    most = made.carried(shares).argmax(axis=1)
    return {name: np.flatnonzero(most == number) for number, name in enumerate(names)}


def carried_points(points: SurfacePoints) -> SurfacePoints:
    """Points on the grid's mesh, at the same places of the surface.

    Raises:
        SimError: a point on three vertices that are no triangle of the grid's mesh.
    """
    made, grid = loops(), neutral_mesh()
    known = {
        tuple(sorted(vertices)): dict(zip(vertices, at, strict=True))
        for vertices, at in zip(
            grid.triangles().tolist(), grid.triangle_uvs().tolist(), strict=True
        )
    }
    triangles = loops_mesh().triangle_uvs()
    corners = made.places[triangles]
    columns = grid_vertices().shape[1]
    out_triangles = np.full(points.triangles.shape, -1, np.int64)
    out_weights = np.full(points.weights.shape, np.nan)
    for number in np.flatnonzero(points.triangles[:, 0] >= 0):
        vertices = points.triangles[number].tolist()
        at = known.get(tuple(sorted(vertices)))
        if at is None:
            raise SimError(
                default_template_path(),
                field=f"triangles[{number}]",
                found=str(vertices),
                expected="a triangle of its mesh",
            )
        here = np.array([divmod(at[vertex], columns) for vertex in vertices], float)
        triangle, weights = _found_in(corners, points.weights[number] @ here)
        out_triangles[number] = made.vertices[triangles[triangle]]
        out_weights[number] = weights
    return SurfacePoints(points.scheme, out_triangles, out_weights, points.spread_mm)


def _found_in(corners: np.ndarray, place: np.ndarray) -> tuple[int, np.ndarray]:
    """The triangle of (t, 3, 2) that a place is in, and its three weights there."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]

    def area(p: np.ndarray, q: np.ndarray, r: np.ndarray) -> np.ndarray:
        one, two = q - p, r - p
        return np.asarray(one[..., 0] * two[..., 1] - one[..., 1] * two[..., 0])

    whole = area(a, b, c)
    weights = np.stack([area(place, b, c), area(a, place, c), area(a, b, place)], axis=1)
    weights = weights / whole[:, None]
    best = int(weights.min(axis=1).argmax())
    assert weights[best].min() > LEAST_WEIGHT  # the triangles cover the grid
    inside = np.maximum(weights[best], 0)
    return best, inside / inside.sum()


def _carried_people(people: Population) -> Population:
    made = loops()
    return dataclasses.replace(
        people,
        mean_mm=made.carried(people.mean_mm),
        identity_mm=np.stack([made.carried(mode) for mode in people.identity_mm]),
        face_points=None if people.face_points is None else carried_points(people.face_points),
    )


def _places_of_grid() -> np.ndarray:
    """(n, 2) row and column of the grid's vertices, of those on the seam their first."""
    index = grid_vertices()
    places = np.empty((int(index.max()) + 1, 2))
    places[index.ravel()[::-1]] = np.argwhere(index >= 0)[::-1]
    return places


def _places_of_vertices(made: Loops) -> np.ndarray:
    """(n, 2) row and column of the topology's vertices, of those on the seam their first."""
    places = np.empty((len(made.carry.indptr) - 1, 2))
    places[made.vertices[::-1]] = made.places[::-1]
    return places
