"""A second topology of our head: closed loops of quads around eyes and mouth.

Outside of three rectangles of the vertex grid it is the grid, with the same quads. Within each,
closed rings lead from the rectangle's border to the opening: one is the lids' edge or the border of
the red of the lips, the next ones follow it inward. Every vertex has a place on the grid, so that
one sparse matrix carries whatever the grid's vertices have: positions, modes, UV, regions.
"""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import scipy.sparse as sparse
from scipy.sparse.linalg import spsolve

from sim.head.grid import (
    COLUMNS,
    ROW_LID_LOW,
    ROW_LID_UP,
    ROW_LIP_LOW,
    ROW_LIP_UP,
    ROW_MOUTH,
    ROWS,
    relaxed,
    smoothstep,
)
from sim.head.layout import layout
from sim.head.mesh import HALF, grid_quads, grid_vertices, landmarks, neutral_mesh
from sim.head.rings import TILE, Block, Chart, Opening, Positions, between, shares_of

EYE = Block(ROW_LID_UP - 7, ROW_LID_LOW + 7, 61, 83)
LIDS = Opening(ROW_LID_UP, ROW_LID_LOW, 66.5, 79, 0.5)
"""The edge of the lids; between it and the next ring is their rim, down to the eyeball."""
BALL = Opening(ROW_LID_UP + 1, ROW_LID_LOW - 1, 67, 78, 0.5)
BALL_HEIGHT = 10
"""Quads of the eyeball's patch from above to below; across it has the rest of the ring's."""
EYE_STEPS, EYE_EVEN = 7, 0.2

MOUTH = Block(ROW_LIP_UP - 6, ROW_LIP_LOW + 6, HALF - 19, HALF + 19)
MOUTH_STEPS, MOUTH_EVEN = 6, 0.5
"""Steps from the block's border to the opening, and how even they are: where lids close, skin needs
many."""
LIPS = tuple(
    Opening(ROW_LIP_UP + k, ROW_LIP_LOW - k, HALF - 14 + k / 4, HALF + 14 - k / 4, 1.0)
    for k in range(ROW_MOUTH - ROW_LIP_UP)
)
"""The border of the red of the lips, then inward to the rows beside the mouth's line."""

WINDOW = Block(20, 110, HALF - 36, HALF + 36)
"""Of the grid: what is moved is in it."""
MARGIN = 7
"""Rows and columns around a block over which the grid is evened, ever less."""
EVENING_ROUNDS = 40
BLUNT_BALL, BLUNT_MOUTH = 1.0, 0.1
"""How blunt the lines are behind closed lids (.03 mm at rest) and between the lips."""
FOLLOW = 0.5
"""How much the steps along lids and lips follow those of the block's border."""
ROUNDS = 600
"""In which the rings between are spread evenly."""

EYE_CREASES = (ROW_LID_UP, ROW_LID_UP + 1, ROW_LID_LOW - 1, ROW_LID_LOW)
MOUTH_CREASES = (ROW_MOUTH - 1, ROW_MOUTH, ROW_MOUTH + 1)


@dataclasses.dataclass(frozen=True)
class Loops:
    """The topology.

    Attributes:
        places: (k, 2) row and column of the vertex grid, of each point of the UV layout.
        vertices: (k,) int64 vertex of each of these points.
        quads: (m, 4) int32 of these points.
        carry: (n, grid's vertices) sparse: from values of the grid's vertices to the topology's.
        carry_points: (k, grid's points) sparse: the same of the UV layout's points.
    """

    places: np.ndarray
    vertices: np.ndarray
    quads: np.ndarray
    carry: sparse.csr_array
    carry_points: sparse.csr_array

    def faces(self) -> np.ndarray:
        """(m, 4) int32 vertices of each quad."""
        return self.vertices[self.quads].astype(np.int32)

    def carried(self, values: np.ndarray) -> np.ndarray:
        """Values of the grid's vertices (n_grid, ...) at this topology's (n, ...)."""
        flat = np.asarray(values, float).reshape(len(values), -1)
        return np.asarray(self.carry @ flat).reshape(-1, *values.shape[1:])


@dataclasses.dataclass(frozen=True)
class _Part:
    """What replaces a block: points, the first of them its border's, and quads of them.

    Attributes:
        block: it.
        border: (b, 2) int, row and column of the grid's points that are the first b points.
        places: (p, 2) of all points.
        quads: (m, 4) of these points.
        creases: rows at which the surface has an edge.
        blunt: (k, 3) points of a line at which skin folds, and those above and below.
        bluntness: how much of these two's mean such a point has.
    """

    block: Block
    border: np.ndarray
    places: np.ndarray
    quads: np.ndarray
    creases: tuple[int, ...]
    blunt: np.ndarray
    bluntness: float

    def carry(self) -> sparse.csr_array:
        """(p - b, grid's points) weights of the points within the border."""
        count, first = len(self.places), len(self.border)
        line, above, below = self.blunt.T
        own = np.ones(count)
        own[line] -= self.bluntness
        half = np.full(len(line), 0.5 * self.bluntness)
        rows = np.concatenate([np.arange(count), line, line])
        columns = np.concatenate([np.arange(count), above, below])
        mix = sparse.csr_array((np.concatenate([own, half, half]), (rows, columns)))
        return sparse.csr_array((mix @ point_weights(self.places, self.creases))[first:])


@functools.cache
def loops() -> Loops:
    """The topology of the average head."""
    eye, mouth = _eye(), _mouth()
    parts = (eye, _other_side(eye), mouth)
    flat = np.arange((ROWS + 1) * (COLUMNS + 1)).reshape(ROWS + 1, COLUMNS + 1)
    kept, cells = np.ones(flat.shape, bool), np.ones((ROWS, COLUMNS), bool)
    for block in (part.block for part in parts):
        kept[block.top + 1 : block.bottom, block.left + 1 : block.right] = False
        cells[block.top : block.bottom, block.left : block.right] = False
    number = np.full(flat.size, -1)
    number[flat[kept]] = np.arange(kept.sum())
    quads = [number[grid_quads(flat)[cells.ravel()]]]
    places = [slid_places()[kept]]
    carry = [point_weights(places[0], ())]
    count = int(kept.sum())
    for part in parts:
        row, column = part.border.T
        border = len(row)
        new = np.arange(len(part.places) - border) + count
        quads.append(np.concatenate([number[flat[row, column]], new])[part.quads])
        places.append(part.places[border:])
        carry.append(part.carry())
        count += len(new)
    points = np.concatenate(places)
    carry_points = sparse.csr_array(sparse.vstack(carry))
    vertices, carry_vertices = _welded(carry_points, int(kept.sum()), flat[kept])
    made = Loops(
        points, vertices, np.concatenate(quads).astype(np.int32), carry_vertices, carry_points
    )
    return dataclasses.replace(made, quads=_best_cut(made))


def _welded(
    carry_points: sparse.csr_array, kept: int, of_grid: np.ndarray
) -> tuple[np.ndarray, sparse.csr_array]:
    """Vertex of each point, in the grid's order and then the new ones, and the vertices' matrix."""
    index = grid_vertices().ravel()
    _, old = np.unique(index[of_grid], return_inverse=True)
    added = carry_points.shape[0] - kept
    vertices = np.concatenate([old, old.max() + 1 + np.arange(added)]).astype(np.int64)
    _, first = np.unique(vertices, return_index=True)
    ones = np.ones(len(index))
    to_vertex = sparse.csr_array((ones, (np.arange(len(index)), index)))
    return vertices, sparse.csr_array(carry_points[first] @ to_vertex)


def _positions(creases: tuple[int, ...]) -> Positions:
    """Where places are on the average head."""
    points = neutral_mesh().vertices[grid_vertices()].reshape(-1, 3)
    return lambda places: np.asarray(point_weights(places, creases) @ points)


def _eye() -> _Part:
    """The eye of x > 0."""
    border = _places_of(EYE.border())
    count, positions = len(border), _positions(EYE_CREASES)
    shares = shares_of(border, FOLLOW, positions)
    lids = LIDS.ring(shares, positions)
    ball = _even_halves(BALL.ring(shares, positions))
    rings = [border, *_led(border, lids, EYE_STEPS, EYE_EVEN), lids, ball]
    # The patch's own border: its places are found with those within.
    quads = [_strips(count, len(rings) + 1)]
    height, width = BALL_HEIGHT, count // 2 - BALL_HEIGHT
    patch = np.empty((height + 1, width + 1), int)
    ring = (np.arange(count) + height // 2) % count
    patch[0] = ring[: width + 1]
    patch[:, -1] = ring[width : width + height + 1]
    patch[-1, ::-1] = ring[width + height : 2 * width + height + 1]
    patch[::-1, 0] = np.append(ring[2 * width + height :], ring[0])
    patch += len(rings) * count
    inner = (len(rings) + 1) * count
    patch[1:-1, 1:-1] = inner + np.arange((height - 1) * (width - 1)).reshape(height - 1, -1)
    quads.append(_cells(patch))
    fixed = np.concatenate(rings)
    every = np.concatenate(quads)
    # Closed lids have a cleft behind them, whose bottom is the middle row.
    row = height // 2
    blunt = np.stack([patch[row, 1:-1], patch[row - 1, 1:-1], patch[row + 1, 1:-1]], axis=1)
    places = _evened(fixed, every)
    return _Part(EYE, EYE.border(), places, every, EYE_CREASES, blunt, BLUNT_BALL)


def _mouth() -> _Part:
    border = _places_of(MOUTH.border())
    count, positions = len(border), _positions(MOUTH_CREASES)
    half = count // 2
    shares = shares_of(border, FOLLOW, positions)
    lips = [_even_sided(opening.ring(shares, positions)) for opening in LIPS]
    skin = [_even_sided(ring) for ring in _led(border, lips[0], MOUTH_STEPS, MOUTH_EVEN)]
    rings = [border, *skin, *lips]
    # The mouth's line joins the innermost ring's halves.
    over = rings[-1][1:half]
    line = np.stack([np.full(half - 1, float(ROW_MOUTH)), over[:, 1]], axis=1)
    last = (len(rings) - 1) * count
    middle = len(rings) * count + np.arange(half - 1)
    upper = last + np.arange(1, half)
    lower = last + np.arange(count - 1, half, -1)
    left, right = last, last + half
    ends = [[left, lower[0], middle[0], upper[0]], [right, upper[-1], middle[-1], lower[-1]]]
    fill = [_cells(np.stack([upper, middle, lower])), np.array(ends)]
    quads = np.concatenate([_strips(count, len(rings)), *fill])
    blunt = np.stack([middle, upper, lower], axis=1)
    places = np.concatenate([*rings, line])
    return _Part(MOUTH, MOUTH.border(), places, quads, MOUTH_CREASES, blunt, BLUNT_MOUTH)


@functools.cache
def slid_places() -> np.ndarray:
    """(rows + 1, columns + 1, 2) places of the grid's points, evened around the blocks.

    Beside the corners of eyes and mouth the grid's rows bend, as no loop around them does.
    """
    row, column = np.meshgrid(np.arange(ROWS + 1.0), np.arange(COLUMNS + 1.0), indexing="ij")
    share = np.zeros(row.shape)
    for block in (EYE, _mirrored(EYE), MOUTH):
        beyond = np.maximum(block.top - row, row - block.bottom)
        beside = np.maximum(block.left - column, column - block.right)
        away = np.maximum(np.maximum(beyond, beside), 0) / MARGIN
        share = np.maximum(share, 1 - smoothstep(0, 1, away))
    # The nose stays as it is, and landmarks where they are.
    nose = (row > EYE.bottom) & (row < MOUTH.top) & (np.abs(column - HALF) < 10)
    share[nose | (row <= WINDOW.top) | (row >= WINDOW.bottom)] = 0
    share[np.isin(grid_vertices(), landmarks())] = 0
    evened = relaxed(layout() * TILE, share, EVENING_ROUNDS)
    places = np.stack([row, column], axis=-1)
    moved = np.argwhere(share > 0).T
    places[tuple(moved)] = Chart(WINDOW).places(evened[tuple(moved)])
    return 0.5 * (places + places[:, ::-1] * (1, -1) + (0, COLUMNS))


def _places_of(points: np.ndarray) -> np.ndarray:
    """(n, 2) places of points of the grid, (n, 2) row and column."""
    return np.asarray(slid_places()[tuple(points.T)])


def _mirrored(block: Block) -> Block:
    return Block(block.top, block.bottom, COLUMNS - block.right, COLUMNS - block.left)


def _led(border: np.ndarray, inner: np.ndarray, steps: int, even: float) -> list[np.ndarray]:
    """Places of the rings from a block's border to an inner one."""
    chart = Chart(WINDOW)
    rings = between(chart.of(border), chart.of(inner), steps, ROUNDS, even)
    return [chart.places(ring) for ring in rings]


def _even_sided(ring: np.ndarray) -> np.ndarray:
    """A ring about the face's middle, made exactly as far to one side as to the other."""
    other = (len(ring) // 2 - np.arange(len(ring))) % len(ring)
    return 0.5 * (ring + ring[other] * (1, -1) + (0, COLUMNS))


def _even_halves(ring: np.ndarray) -> np.ndarray:
    """A ring whose points below its ends' row are under those above, as far away."""
    below = -np.arange(len(ring)) % len(ring)
    return 0.5 * (ring + ring[below] * (-1, 1) + (2 * ring[0, 0], 0))


def _strips(count: int, rings: int) -> np.ndarray:
    """Quads between rings of so many points, counter-clockwise seen from outside."""
    here = np.arange(count)
    after = (here + 1) % count
    first = np.arange(rings - 1)[:, None] * count
    corners = (first + here, first + count + here, first + count + after, first + after)
    return np.stack(corners, axis=-1).reshape(-1, 4)


def _cells(index: np.ndarray) -> np.ndarray:
    """Quads of a rectangle of points, counter-clockwise where rows run downward."""
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    return np.stack([a, b, c, d], axis=-1).reshape(-1, 4)


def _evened(fixed: np.ndarray, quads: np.ndarray) -> np.ndarray:
    """Places of all points of quads, of which the first are fixed and the others in the middle of
    their neighbours, so that within a convex ring no quad is turned over [Tutte1963].
    """
    count = int(quads.max()) + 1
    ends = np.stack([quads, np.roll(quads, -1, axis=1)], axis=-1).reshape(-1, 2)
    ends = np.unique(np.sort(ends, axis=1), axis=0)
    joined = sparse.coo_array((np.ones(len(ends)), tuple(ends.T)), shape=(count, count)).tocsr()
    joined = joined + joined.T
    degree = sparse.diags_array(joined.sum(axis=1))
    free = np.arange(len(fixed), count)
    system = sparse.csc_array((degree - joined)[free])
    found = spsolve(system[:, free], -system[:, : len(fixed)] @ fixed)
    return np.concatenate([fixed, found])


def _other_side(part: _Part) -> _Part:
    """The same on the other side of the face."""
    return dataclasses.replace(
        part,
        block=_mirrored(part.block),
        border=part.border * (1, -1) + (0, COLUMNS),
        places=part.places * (1, -1) + (0, COLUMNS),
        quads=part.quads[:, [0, 3, 2, 1]],
    )


def _best_cut(made: Loops) -> np.ndarray:
    """Quads that begin at the shorter diagonal, where they are not the grid's own."""
    quads = made.quads.copy()
    new = (made.places[quads] % 1 != 0).any(axis=(1, 2))
    vertices = made.carried(neutral_mesh().vertices)[made.vertices]
    a, b, c, d = np.moveaxis(vertices[quads], 1, 0)
    first, second = np.linalg.norm(c - a, axis=1), np.linalg.norm(d - b, axis=1)
    turn = new & (second < first * (1 - 1e-6))
    quads[turn] = np.roll(quads[turn], -1, axis=1)
    return quads


def point_weights(places: np.ndarray, creases: tuple[int, ...]) -> sparse.csr_array:
    """(k, grid's points) sparse: cubic interpolation of the grid at (k, 2) places.

    Along each column pieces of cubic curves [Catmull1974] end at the rows of `creases`, where the
    surface has an edge; a piece of two rows is straight.
    """
    rows = _line_weights(places[:, 0], ROWS + 1, creases)
    columns = _line_weights(places[:, 1], COLUMNS + 1, ())
    place, row = np.nonzero(rows)
    which, column = np.nonzero(columns[place])
    place, row = place[which], row[which]
    weight = rows[place, row] * columns[place, column]
    shape = (len(places), (ROWS + 1) * (COLUMNS + 1))
    return sparse.csr_array((weight, (place, row * (COLUMNS + 1) + column)), shape=shape)


def _line_weights(at: np.ndarray, count: int, creases: tuple[int, ...]) -> np.ndarray:
    """(k, count) weights of values at 0, 1, .. for their cubic curve at (k,) places."""
    ends = np.zeros(count, bool)
    ends[[0, count - 1, *creases]] = True
    start = np.clip(np.floor(at).astype(int), 0, count - 2)
    t = (at - start)[:, None]
    slope = np.eye(count)
    inside = np.arange(1, count - 1)
    central = np.zeros((count, count))
    central[inside, inside + 1], central[inside, inside - 1] = 0.5, -0.5
    low, high = central[start], central[start + 1]
    for which, begin in ((low, True), (high, False)):
        edge = start if begin else start + 1
        sign = 1 if begin else -1
        at_end = ends[edge]
        short = at_end & ends[edge + sign]
        which[at_end] = 0
        for step, long_weight, short_weight in ((0, -1.5, -1.0), (1, 2.0, 1.0), (2, -0.5, 0.0)):
            weight = np.where(short, short_weight, long_weight)
            place = np.clip(edge + sign * step, 0, count - 1)
            which[at_end, place[at_end]] += sign * weight[at_end]
    near, far = slope[start], slope[start + 1]
    return np.asarray(
        (2 * t**3 - 3 * t**2 + 1) * near
        + (t**3 - 2 * t**2 + t) * low
        + (3 * t**2 - 2 * t**3) * far
        + (t**3 - t**2) * high
    )
