"""Which parts of ICT's head make a subject, and its UV tiles packed into one.

The face's tile becomes the upper 4096 x 4096 of 6144 x 4096 texels, the tile of the back of the
head the remaining 2048 x 4096. Small parts that an opaque head needs and that have textures of
their own at ICT (eyeballs, teeth, gums and tongue) go where the back's tile is empty. Left out is
what only a transparent renderer can show: lacrimal fluid, eye blend and occlusion, lashes, and the
iris meshes within the eyeballs (the iris is painted on the cornea).
"""

from __future__ import annotations

import dataclasses
import functools

import numpy as np

from lightstage.formats.mesh import Mesh
from sim.errors import SimError
from sim.scans.ict import VERTICES, IctModel

FACE, BACK, MOUTH_SOCKET, EYE_SOCKETS, GUMS, TEETH, LEFT_EYE, RIGHT_EYE = range(8)
SKIN_PARTS = (FACE, BACK)

# First and last vertex of each part in the model's files; what lies between them is left out.
_RANGES = {
    FACE: (0, 9408),
    BACK: (9409, 11247),
    MOUTH_SOCKET: (11248, 13293),
    EYE_SOCKETS: (13294, 14061),
    GUMS: (14062, 17038),
    TEETH: (17039, 21450),
    LEFT_EYE: (21451, 22220),
    RIGHT_EYE: (23021, 23790),
}
# Left, bottom, width and height in the packed tile of parts whose own tile is elsewhere.
_PLACES = {
    GUMS: (0.2344, 0.3062, 0.0970, 0.0260),
    TEETH: (0.8540, 0.1615, 0.1460, 0.0391),
    LEFT_EYE: (0.8906, 0.2031, 0.1080, 0.0720),
    RIGHT_EYE: (0.0010, 0.1608, 0.1080, 0.0720),
}


@dataclasses.dataclass(frozen=True, eq=False)
class Parts:
    """Topology of the subject within the model.

    Attributes:
        vertices: (n,) indices of the model's vertices that are kept.
        faces: (m, 4) int32 into them, -1 marks a triangle.
        uvs: (k, 2) in one 0..1 tile.
        face_uvs: (m, 4) int32 into `uvs`.
        part: (m,) part of each face.
    """

    vertices: np.ndarray
    faces: np.ndarray
    uvs: np.ndarray
    face_uvs: np.ndarray
    part: np.ndarray

    def mesh(self, vertices: np.ndarray) -> Mesh:
        """The subject's mesh at (n, 3) places of the kept vertices."""
        return Mesh(vertices, self.faces, self.uvs, self.face_uvs)

    def triangle_parts(self) -> np.ndarray:
        """(t,) part of each of the mesh's triangles."""
        return np.repeat(self.part, 1 + (self.faces[:, 3] >= 0))


@functools.lru_cache(maxsize=2)
def parts_of(model: IctModel) -> Parts:
    """Choose the parts of a subject and pack their UV.

    Raises:
        SimError: a release with other vertices, or UV outside the tiles that the packing knows.
    """
    mesh = model.mesh
    if len(mesh.vertices) != VERTICES or mesh.uvs is None or mesh.face_uvs is None:
        raise SimError(
            model.where,
            field="vertices",
            found=str(len(mesh.vertices)),
            expected=f"{VERTICES}, the first release of ICT Face Model Light",
        )
    # A part's faces may reach into the part before it (the back of the head shares the face's
    # border), so a face belongs to the part of its last vertex.
    last = mesh.faces.max(axis=1)
    part = np.full(len(last), -1)
    for name, (low, high) in _RANGES.items():
        part[(last >= low) & (last <= high)] = name
    kept = part >= 0
    faces, face_uvs, part = mesh.faces[kept], mesh.face_uvs[kept], part[kept]
    uvs = np.zeros_like(mesh.uvs)
    for name in _RANGES:
        corners = face_uvs[part == name]
        used = np.unique(corners[corners >= 0])
        uvs[used] = _pack(mesh.uvs[used], name, model)
    vertices, faces = _compact(faces)
    chosen, face_uvs = _compact(face_uvs)
    return Parts(vertices, faces, uvs[chosen], face_uvs, part)


def _pack(uv: np.ndarray, part: int, model: IctModel) -> np.ndarray:
    tile = np.floor(uv.mean(axis=0)) * [1.0, 0.0]
    local = uv - tile
    if local.min() < -1e-6 or local.max() > 1 + 1e-6:
        raise SimError(
            model.where,
            field="uv",
            found=f"{local.min():.3g} to {local.max():.3g} within a tile",
            expected="0 to 1",
        )
    if part in _PLACES:
        left, bottom, width, height = _PLACES[part]
        return np.asarray(local * [width, height] + [left, bottom])
    # By tile, not by part: the sockets of mouth and eyes lie in the back's tile.
    if tile[0] == 0:
        return np.asarray(local * [1.0, 2 / 3] + [0.0, 1 / 3])
    return np.asarray(local * [1.0, 1 / 3])


def _compact(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Indices that are used, and the faces over them."""
    real = faces >= 0
    used, inverse = np.unique(faces[real], return_inverse=True)
    out = np.full(faces.shape, -1, np.int32)
    out[real] = inverse
    return used, out
