"""What is wrong with a template's surface: borders, edges of three triangles, slivers, seams."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from lightstage.formats.mesh import connected, directed_edges, edge_counts


class Border(NamedTuple):
    """One open border of a surface.

    Attributes:
        vertices: (k,) indices, in no order.
        length_mm: of all its edges.
        middle: (3,) mean of its vertices, mm.
    """

    vertices: np.ndarray
    length_mm: float
    middle: np.ndarray


def borders(vertices: np.ndarray, triangles: np.ndarray) -> list[Border]:
    """Open borders, the longest first.

    Args:
        vertices: (n, 3) mm.
        triangles: (t, 3).
    """
    edges, counts = edge_counts(triangles)
    open_edges = edges[counts == 1]
    label = connected(open_edges, len(vertices))
    length = np.linalg.norm(vertices[open_edges[:, 0]] - vertices[open_edges[:, 1]], axis=1)
    out = []
    for each in np.unique(label[open_edges[:, 0]]):
        own = label[open_edges[:, 0]] == each
        some = np.unique(open_edges[own])
        out.append(Border(some, float(length[own].sum()), vertices[some].mean(axis=0)))
    return sorted(out, key=lambda border: -border.length_mm)


def crowded_edges(triangles: np.ndarray) -> np.ndarray:
    """(t,) bool: triangles with an edge that more than two triangles have."""
    edges, counts = edge_counts(triangles)
    return _with_edge(triangles, edges[counts > 2])


def turned_against(triangles: np.ndarray) -> np.ndarray:
    """(t,) bool: triangles that run round an edge the same way as a neighbour, so that one of the
    two faces inward.
    """
    ends = directed_edges(triangles)
    count = int(triangles.max()) + 1
    keys, times = np.unique(ends[:, 0] * count + ends[:, 1], return_counts=True)
    twice = keys[times > 1]
    return np.asarray(np.isin(ends[:, 0] * count + ends[:, 1], twice).reshape(-1, 3).any(axis=1))


def slivers(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(t,) bool: triangles without area, up to a millionth of their longest side's square."""
    corners = vertices[triangles]
    sides = corners - np.roll(corners, 1, axis=1)
    longest = (sides**2).sum(axis=2).max(axis=1)
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    return np.asarray(area <= 1e-6 * longest)


def not_joined(vertices: np.ndarray, triangles: np.ndarray, joined_mm: float) -> np.ndarray:
    """(n,) bool: vertices of open borders that are where another vertex of a border is.

    Programs that cut a mesh along the borders of its texture leave such.
    """
    edges, counts = edge_counts(triangles)
    on_border = np.unique(edges[counts == 1])
    out = np.zeros(len(vertices), bool)
    if len(on_border) > 1:
        away = np.asarray(cKDTree(vertices[on_border]).query(vertices[on_border], k=2)[0])[:, 1]
        out[on_border[away <= joined_mm]] = True
    return out


def _with_edge(triangles: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """(t,) bool: triangles that have one of some edges, the lower vertex first."""
    ends = np.sort(directed_edges(triangles), axis=1)
    count = int(triangles.max()) + 1
    wanted = edges[:, 0] * count + edges[:, 1]
    return np.asarray(np.isin(ends[:, 0] * count + ends[:, 1], wanted).reshape(-1, 3).any(axis=1))
