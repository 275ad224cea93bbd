"""A part of a head beside its skin: a mesh with one material that moves with the head."""

from __future__ import annotations

import dataclasses

import numpy as np

from lightstage.formats.mesh import vertex_normals


@dataclasses.dataclass(frozen=True)
class Part:
    """A part in the axes of the head's mesh; both sides of its triangles are shown.

    Attributes:
        name: of the object.
        places: (k, 3) of its vertices, mm.
        triangles: (t, 3).
        colours: (k, 3) linear albedo; in the mouth times the light that comes in between the lips.
        roughness: perceptual, 0..1.
        morphs: by name (k, 3) offsets of its vertices, mm; it stays where a name is missing.
    """

    name: str
    places: np.ndarray
    triangles: np.ndarray
    colours: np.ndarray
    roughness: float
    morphs: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)

    def normals(self) -> np.ndarray:
        """(k, 3) unit normals."""
        return directed(vertex_normals(self.places, self.triangles))

    def turned(self, offsets: np.ndarray) -> np.ndarray:
        """(k, 3) differences of the normals after (k, 3) offsets of the vertices."""
        return directed(vertex_normals(self.places + offsets, self.triangles)) - self.normals()


def directed(normals: np.ndarray) -> np.ndarray:
    """(n, 3) normals; +z where all triangles of a vertex are degenerate."""
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(length > 0.5, normals, [0.0, 0.0, 1.0])


def joined(name: str, parts: list[Part]) -> Part:
    """One part of several with a material, which have no morphs yet."""
    starts = np.cumsum([0, *(len(each.places) for each in parts[:-1])])
    return Part(
        name,
        np.concatenate([each.places for each in parts]),
        np.concatenate([each.triangles + k for each, k in zip(parts, starts, strict=True)]),
        np.concatenate([each.colours for each in parts]),
        parts[0].roughness,
    )


def sheet(rows: int, columns: int, closed: bool) -> np.ndarray:
    """(t, 3) triangles between rows of vertices, row by row; the columns may be a ring."""
    index = np.arange(rows * columns).reshape(rows, columns)
    if closed:
        index = np.column_stack([index, index[:, :1]])
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    halves = [np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)]
    return np.stack(halves, axis=2).reshape(-1, 3).astype(np.int32)
