"""A part of a head beside its skin: a mesh with one material that moves with the head."""

from __future__ import annotations

import dataclasses

import numpy as np

from lightstage.formats.mesh import Mesh, vertex_normals


@dataclasses.dataclass(frozen=True)
class Material:
    """A surface without maps of its own, but a picture of its colour.

    Attributes:
        name: of the material.
        colour: linear albedo.
        roughness: perceptual, 0..1.
        picture: PNG of the colour, sRGB, in place of `colour`; None of most.
        clear: whether light passes and the gloss alone is seen, as of the cornea and of tears.
    """

    name: str
    colour: tuple[float, float, float]
    roughness: float
    picture: bytes | None = None
    clear: bool = False


@dataclasses.dataclass(frozen=True)
class Part:
    """A part in the axes of the head's mesh.

    Attributes:
        name: of the object.
        mesh: triangles, mm; with a texture coordinate for each vertex where there is a picture.
        material: of its whole surface.
        morphs: by name (k, 3) offsets of its vertices, mm; it stays where a name is missing.
    """

    name: str
    mesh: Mesh
    material: Material
    morphs: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)

    def normals(self, offsets: np.ndarray | float = 0.0) -> np.ndarray:
        """(k, 3) unit normals, with offsets of its vertices."""
        found = vertex_normals(self.mesh.vertices + offsets, self.mesh.triangles())
        lost = np.linalg.norm(found, axis=1) < 0.5
        found[lost] = (0, 0, 1)
        return found

    def posed(self, name: str | None) -> Part:
        """The part with one of its morphs in its mesh."""
        if name not in self.morphs:
            return self
        mesh = self.mesh.with_vertices(self.mesh.vertices + self.morphs[name])
        return dataclasses.replace(self, mesh=mesh)

    def turned(self, turn: np.ndarray) -> Part:
        """The part in other axes: rows times a (3, 3) matrix."""
        return dataclasses.replace(
            self,
            mesh=self.mesh.with_vertices(self.mesh.vertices @ turn),
            morphs={name: offsets @ turn for name, offsets in self.morphs.items()},
        )


def rotated(places: np.ndarray, centre: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """(k, 3) places turned about a point by a rotation."""
    return np.asarray((places - centre) @ matrix.T + centre)


def sheet(rows: int, columns: int, closed: bool) -> np.ndarray:
    """(t, 3) triangles between rows of vertices, row by row; the columns may be a ring."""
    index = np.arange(rows * columns).reshape(rows, columns)
    if closed:
        index = np.column_stack([index, index[:, :1]])
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    halves = [np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)]
    return np.stack(halves, axis=2).reshape(-1, 3).astype(np.int32)


def capped(triangles: np.ndarray, ring: np.ndarray, tip: int) -> np.ndarray:
    """Triangles with a fan that closes a ring of vertices at a tip."""
    fan = np.stack([ring, np.full(len(ring), tip), np.roll(ring, -1)], axis=1)
    return np.concatenate([triangles, fan]).astype(np.int32)
