"""Our template's skin, opened between its lips and its lids; UV and places stay as they are."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np

from lightstage.formats.mesh import Mesh
from lightstage.formats.template import default_template_path, load_template

CENTRE_MM, RADIUS_MM = np.array([31.5, -8.0, 68.5]), 12.2
"""Of the left eyeball in the template, over which its lids are modelled; that of a grown-up has a
diameter of 22.0 to 24.8 mm [Bekerman2014]."""
COLUMNS = 112
"""Number of columns of the template's grid of quads."""
CORNER = 3
"""Columns beside a corner of the mouth over which the lips part."""
WITHIN_MM = 11.7
"""From the ball's axis: what is farther out is the eye's corner, and stays."""


@dataclasses.dataclass(frozen=True)
class Lines:
    """Rows and columns of the template's grid of quads at lips and lids.

    Attributes:
        mesh: the template's.
        landmarks: (68,) vertices of iBUG's landmarks.
        grid: (rows, columns) vertices.
        uv: (rows, columns) texture coordinates.
        mouth: row of the line between the lips, and the columns of its corners.
        eyes: of the right and the left eye the rows and columns on the ball that are left out:
            first and last row, first and last column.
    """

    mesh: Mesh
    landmarks: np.ndarray
    grid: np.ndarray
    uv: np.ndarray
    mouth: tuple[int, int, int]
    eyes: tuple[tuple[int, int, int, int], tuple[int, int, int, int]]

    def lips(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Columns between the mouth's corners; the vertices above and below the line between."""
        row, first, last = self.mouth
        columns = np.arange(first + 1, last)
        return columns, self.grid[row - 1, columns], self.grid[row + 1, columns]


@functools.cache
def template_lines() -> Lines:
    """Lines of our own template."""
    template = load_template(default_template_path())
    mesh = template.mesh
    assert mesh.face_uvs is not None
    grid, uv = _grid(mesh.faces), _grid(mesh.face_uvs)
    marks = template.landmarks

    def place(vertex: int) -> tuple[int, int]:
        row, column = np.argwhere(grid == vertex)[0]
        return int(row), int(column)

    (row, first), (_, last) = place(marks[48]), place(marks[54])
    eyes = []
    for side in (-1, 1):
        away = mesh.vertices[:, :2] - CENTRE_MM[:2] * (side, 1)
        inside = np.zeros(len(mesh.vertices), bool)
        inside[template.regions["eyes"]] = True
        inside &= np.linalg.norm(away, axis=1) < WITHIN_MM
        rows, columns = np.nonzero(inside[grid])
        eyes.append((int(rows.min()), int(rows.max()), int(columns.min()), int(columns.max())))
    return Lines(mesh, marks, grid, uv, (row, first, last), (eyes[0], eyes[1]))


def _grid(quads: np.ndarray) -> np.ndarray:
    """Arrange the corners of a grid's quads in (rows, columns), without the last row.

    Left and right of the middle they begin at different corners.
    """
    of = quads.reshape(-1, COLUMNS, 4)
    left = np.arange(COLUMNS) < COLUMNS // 2
    first = np.where(left, of[..., 1], of[..., 0])
    beside = np.where(left, of[..., 0], of[..., 3])
    return np.column_stack([first, beside[:, -1]])


def is_ours(mesh: Mesh) -> bool:
    """Test a mesh for our own template's triangles and texture coordinates."""
    own = template_lines().mesh
    return (
        len(mesh.vertices) == len(own.vertices)
        and np.array_equal(mesh.faces, own.faces)
        and mesh.face_uvs is not None
        and own.face_uvs is not None
        and np.array_equal(mesh.face_uvs, own.face_uvs)
    )


@dataclasses.dataclass(frozen=True)
class Opened:
    """A skin with openings.

    Attributes:
        mesh: the skin; its first vertices and texture coordinates are those that it had.
        upper: (k,) vertices of the upper lip's inner edge, from the right corner to the left one.
        lower: (k,) of the lower lip's; both begin and end with the mouth's corners.
    """

    mesh: Mesh
    upper: np.ndarray
    lower: np.ndarray

    def carried(self, offsets: np.ndarray) -> np.ndarray:
        """(n', 3) of the skin with openings: each lip's inner edge moves as the lip does.

        Args:
            offsets: (n, 3) of the closed skin.
        """
        columns, above, below = template_lines().lips()
        # Beside a corner the lips' edges part little by little, as the corner itself does not.
        count = np.arange(len(columns))
        share = np.minimum(1, (1 + np.minimum(count, count[::-1])) / CORNER)[:, None]
        line = (1 - share) * offsets[self.upper[1:-1]]
        out = np.concatenate([offsets, line + share * offsets[below]])
        out[self.upper[1:-1]] = line + share * offsets[above]
        return out


def opened(mesh: Mesh) -> Opened:
    """Open a skin of our template between the lips and over the eyeballs.

    The lips' line is doubled. What was painted inward of a lip's or lid's edge, such as teeth,
    lashes and the eye's white, is replaced by the lip or lid, mirrored at the edge.
    """
    lines = template_lines()
    assert mesh.uvs is not None
    assert mesh.face_uvs is not None
    grid, uv = lines.grid, lines.uv
    wide = grid.shape[1] - 1
    faces, corners = mesh.faces.copy(), mesh.face_uvs.copy()
    quad = np.arange(len(faces)).reshape(-1, wide)
    shown = [np.arange(len(mesh.uvs))]

    def repaint(quads: np.ndarray, old: np.ndarray, other: np.ndarray) -> None:
        """Show other texture at some corners of some quads."""
        corners[quads] = _renumbered(corners[quads], old, sum(map(len, shown)))
        shown.append(other)

    row, first, last = lines.mouth
    columns, _, _ = lines.lips()
    between = np.arange(first, last)
    below = quad[row, between]
    copies = len(mesh.vertices) + np.arange(len(columns))
    faces[below] = _renumbered(faces[below], grid[row, columns], len(mesh.vertices))
    repaint(quad[row - 1, between], uv[row, columns], uv[row - 2, columns])
    repaint(below, uv[row, columns], uv[row + 2, columns])
    gone = np.zeros(len(faces), bool)
    for top, bottom, inner, outer in lines.eyes:
        here = np.arange(inner, outer + 1)
        beside = np.arange(inner - 1, outer + 1)
        repaint(quad[top - 1, beside], uv[top, here], uv[top - 2, here])
        repaint(quad[bottom, beside], uv[bottom, here], uv[bottom + 2, here])
        gone[quad[top:bottom, inner:outer]] = True
    ends = grid[row, [first, last]]
    upper = np.array([ends[0], *grid[row, columns], ends[1]])
    lower = np.array([ends[0], *copies, ends[1]])
    skin = Mesh(
        np.concatenate([mesh.vertices, mesh.vertices[grid[row, columns]]]),
        faces[~gone],
        mesh.uvs[np.concatenate(shown)],
        corners[~gone],
    )
    return Opened(skin, upper, lower)


def _renumbered(quads: np.ndarray, old: np.ndarray, first: int) -> np.ndarray:
    """Quads whose numbers among `old` become `first`, `first` + 1, ..."""
    place = np.argsort(old)
    found = np.minimum(np.searchsorted(old, quads, sorter=place), len(old) - 1)
    return np.where(old[place[found]] == quads, first + place[found], quads)
