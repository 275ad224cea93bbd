"""The neutral head: mesh with one UV tile, landmarks, regions."""

from __future__ import annotations

import functools

import numpy as np

from lightstage.formats.mesh import Mesh, vertex_normals
from sim.head.ears import beside_ears, ear_share
from sim.head.features import add_features
from sim.head.grid import (
    COLUMNS,
    EYE_AZIMUTH_DEG,
    EYE_HALF_DEG,
    MOUTH_HALF_DEG,
    ROW_LID_LOW,
    ROW_LID_UP,
    ROW_LIP_LOW,
    ROW_LIP_UP,
    ROW_MOUTH,
    ROWS,
    face_azimuth_deg,
    head_rays,
    smoothstep,
)
from sim.head.layout import layout
from sim.head.shape import cast

HALF = COLUMNS // 2

HAIR_MM = 3.0
"""How thick the average head's short hair is."""

# Places of landmarks that lie on no row, x >= 0: mm in the head frame.
_JAW_MM = (
    (71, -6, 8),
    (69, -24, 8),
    (66, -43, 8),
    (58, -62, 9),
    (50, -80, 14),
    (42, -96, 30),
    (29, -108, 52),
    (14, -116, 73),
    (0, -120, 83),
)
_BROW_MM = ((54, 11, 66), (46, 17, 76), (36, 19, 84), (25, 17, 90), (14, 13, 93))
_NOSE_BASE_MM = ((16, -49, 94), (8, -52, 96))
_BELOW_NOSE_MM = (0, -52.5, 97.5)


@functools.cache
def grid_vertices() -> np.ndarray:
    """(rows + 1, columns + 1) vertex of each grid point: seam and slit are welded."""
    row, column = np.meshgrid(np.arange(ROWS + 1), np.arange(COLUMNS + 1), indexing="ij")
    column = np.where(column == COLUMNS, 0, column)
    column = np.where((row == 0) & (column > HALF), COLUMNS - column, column)
    vertices = np.where(row == 0, column, HALF + 1 + (row - 1) * COLUMNS + column)
    vertices.flags.writeable = False
    return vertices


@functools.cache
def neutral_mesh() -> Mesh:
    """The average head: quads, one UV tile, head frame, mm."""
    rays = head_rays()
    points = add_features(cast(rays.origins, rays.directions))
    index = grid_vertices()
    vertices = np.zeros((int(index.max()) + 1, 3))
    vertices[index.ravel()[::-1]] = points.reshape(-1, 3)[::-1]
    vertices[index[:, HALF], 0] = 0.0
    vertices[index[:, 0], 0] = 0.0
    vertices[index[0], 0] = 0.0
    # Mirror exactly, so that the base has no side.
    mirrored = index[:, ::-1]
    other = np.empty(len(vertices), int)
    other[index.ravel()] = mirrored.ravel()
    vertices = 0.5 * (vertices + vertices[other] * (-1, 1, 1))
    quads = grid_quads(index)
    share = _hair_share(vertices[index])
    normals = vertex_normals(vertices, Mesh(vertices, quads).triangles())
    thick = np.empty(len(vertices))
    thick[index] = HAIR_MM * share
    vertices = vertices + thick[:, None] * 0.5 * (normals + normals[other] * (-1, 1, 1))
    flat = np.arange((ROWS + 1) * (COLUMNS + 1)).reshape(ROWS + 1, COLUMNS + 1)
    return Mesh(vertices, quads, layout().reshape(-1, 2), grid_quads(flat))


def grid_places() -> np.ndarray:
    """(k, 2) for each UV of `neutral_mesh` its point's column and row in the vertex grid, 0..1.

    The row counts from below, so that these are UV of a tile over which the grid is spread evenly.
    """
    u = np.arange(COLUMNS + 1) / COLUMNS
    v = 1 - np.arange(ROWS + 1) / ROWS
    return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)


def row_and_column(grid_uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Row and column of the vertex grid, float32 each, of places (..., 2) of `grid_places`."""
    row = (1 - grid_uv[..., 1]) * ROWS
    return row.astype(np.float32), (grid_uv[..., 0] * COLUMNS).astype(np.float32)


def grid_quads(index: np.ndarray) -> np.ndarray:
    """Quads whose first diagonal is mirror-symmetric and starts at the slit's ends."""
    a, b = index[:-1, :-1], index[1:, :-1]
    c, d = index[1:, 1:], index[:-1, 1:]
    right = np.stack([a, b, c, d], axis=-1)
    left = np.stack([d, a, b, c], axis=-1)
    quads = np.where((np.arange(COLUMNS) >= HALF)[None, :, None], right, left)
    quads[0, 0], quads[0, -1] = right[0, 0], left[0, -1]
    return quads.reshape(-1, 4).astype(np.int32)


@functools.cache
def landmarks() -> np.ndarray:
    """(68,) vertex indices in iBUG's order, the subject's right (x < 0) first."""
    index = grid_vertices()
    azimuth = face_azimuth_deg()
    vertices = neutral_mesh().vertices

    def near(place: tuple[float, float, float], side: int) -> int:
        wanted = np.array(place, float) * (side, 1, 1)
        return int(np.argmin(np.linalg.norm(vertices - wanted, axis=1)))

    def at(row: int, azimuth_deg: float) -> int:
        return int(index[row, np.argmin(np.abs(azimuth - azimuth_deg))])

    def eye(row: int, place: float, side: int) -> int:
        return at(row, side * (EYE_AZIMUTH_DEG + place * EYE_HALF_DEG))

    def mouth(row: int, place: float) -> int:
        return at(row, place * MOUTH_HALF_DEG)

    middle = (ROW_LID_UP + ROW_LID_LOW) // 2
    jaw = [near(p, -1) for p in _JAW_MM] + [near(p, 1) for p in _JAW_MM[-2::-1]]
    brows = [near(p, -1) for p in _BROW_MM] + [near(p, 1) for p in _BROW_MM[::-1]]
    front = vertices[index[:, HALF]]
    tip = ROW_LID_LOW + int(np.argmax(front[ROW_LID_LOW : ROW_LIP_UP - 3, 2]))
    bridge = np.linspace(np.argmin(np.abs(front[:, 1] + 1)), tip, 4).round().astype(int)
    nose = [int(index[row, HALF]) for row in bridge]
    under = [near(p, -1) for p in _NOSE_BASE_MM]
    under.append(int(index[np.argmin(np.linalg.norm(front - _BELOW_NOSE_MM, axis=1)), HALF]))
    base = under + [near(p, 1) for p in _NOSE_BASE_MM[::-1]]
    eyes = [eye(middle, 0.98, -1), eye(ROW_LID_UP, 0.36, -1), eye(ROW_LID_UP, -0.36, -1)]
    eyes += [eye(middle, -0.98, -1), eye(ROW_LID_LOW, -0.36, -1), eye(ROW_LID_LOW, 0.36, -1)]
    eyes += [eye(middle, -0.98, 1), eye(ROW_LID_UP, -0.36, 1), eye(ROW_LID_UP, 0.36, 1)]
    eyes += [eye(middle, 0.98, 1), eye(ROW_LID_LOW, 0.36, 1), eye(ROW_LID_LOW, -0.36, 1)]
    outer = [mouth(ROW_MOUTH, -1.0)] + [mouth(ROW_LIP_UP, p) for p in (-0.6, -0.22, 0, 0.22, 0.6)]
    outer += [mouth(ROW_MOUTH, 1.0)] + [mouth(ROW_LIP_LOW, p) for p in (0.6, 0.28, 0, -0.28, -0.6)]
    inner = [mouth(ROW_MOUTH, -0.86)] + [mouth(ROW_MOUTH - 1, p) for p in (-0.3, 0, 0.3)]
    inner += [mouth(ROW_MOUTH, 0.86)] + [mouth(ROW_MOUTH + 1, p) for p in (0.3, 0, -0.3)]
    found = np.array(jaw + brows + nose + base + eyes + outer + inner, np.int64)
    found.flags.writeable = False
    return found


@functools.cache
def regions() -> dict[str, np.ndarray]:
    """Vertex indices of skin, lips, eyes, ears and hair; together they are all vertices."""
    index = grid_vertices()
    azimuth = face_azimuth_deg()
    rows = np.arange(ROWS + 1)[:, None]
    mouth = np.abs(azimuth) / MOUTH_HALF_DEG
    eye = np.abs(np.abs(azimuth) - EYE_AZIMUTH_DEG) / EYE_HALF_DEG
    lips = (rows >= ROW_LIP_UP) & (rows <= ROW_LIP_LOW) & (mouth <= 0.98)
    eyes = (rows > ROW_LID_UP) & (rows < ROW_LID_LOW) & (eye <= 1.0)
    points = neutral_mesh().vertices[index]
    ears = ear_share(points) > 0.5
    hair = hairline_mm(points) > 0
    chosen = {"lips": lips, "eyes": eyes & ~lips, "ears": ears}
    chosen["hair"] = hair & ~ears
    chosen["skin"] = ~(lips | eyes | ears | hair)
    names = ("skin", "lips", "eyes", "ears", "hair")
    return {name: np.unique(index[chosen[name]]) for name in names}


def _hair_share(points: np.ndarray) -> np.ndarray:
    """(rows + 1, columns + 1) 0..1: how much of the hair's thickness a place has."""
    # Behind and above the ear hair starts thin, so that the ear keeps its place.
    return np.asarray(smoothstep(-1.0, 22.0, hairline_mm(points)) * beside_ears())


@functools.cache
def hair_share() -> np.ndarray:
    """(n,) 0..1: how much of the hair's thickness each vertex has."""
    index = grid_vertices()
    vertices = neutral_mesh().vertices
    share = np.empty(len(vertices))
    share[index] = _hair_share(vertices[index])
    return share


@functools.cache
def vertex_normals_of() -> np.ndarray:
    """(n, 3) unit normals of the average head."""
    return vertex_normals(neutral_mesh().vertices, neutral_mesh().triangles())


def hairline_mm(points: np.ndarray) -> np.ndarray:
    """How far (about, mm) a place of the neutral head lies behind the hairline; (..., 3) mm."""
    x, y, z = np.abs(points[..., 0]), points[..., 1], points[..., 2]
    front = 70.0 - 0.008 * x**2
    above = y - front
    # From the temple down before the ear, behind it to the nape.
    behind = np.minimum(20.0 - z, y + 12.0)
    nape = np.minimum(-40.0 - z, y + 95.0)
    return np.maximum(np.maximum(above, behind), nape)
