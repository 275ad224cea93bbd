"""Tangent-space normals as MikkTSpace defines them, so that other renderers read them right.

Tangents are averaged over the corners that share a vertex, a texture coordinate and the texture's
handedness, weighted by the corner's angle; normal and tangent are interpolated without
renormalising, the bitangent is their cross product times the handedness [Mikkelsen2008]. Green
points along +v (OpenGL, glTF, Blender; Unreal flips it on import).
"""

from __future__ import annotations

import dataclasses

import numba
import numpy as np

from processing.atlas.raster import Raster
from processing.vectors import unit


@dataclasses.dataclass(frozen=True)
class TangentFrames:
    """Tangents of a mesh with UV.

    Attributes:
        corner: (t, 3) int32 into `tangents`.
        tangents: (g, 3) unit, zero where the texture has no area.
        sign: (t,) +1 where the texture is not mirrored, -1 where it is.
    """

    corner: np.ndarray
    tangents: np.ndarray
    sign: np.ndarray


def tangent_frames(
    vertices: np.ndarray,
    triangles: np.ndarray,
    uvs: np.ndarray,
    triangle_uvs: np.ndarray,
    normals: np.ndarray,
) -> TangentFrames:
    """Tangents of every corner.

    Args:
        vertices: (n, 3) mm.
        triangles: (t, 3).
        uvs: (k, 2) OBJ texture coordinates, v upward.
        triangle_uvs: (t, 3) into them.
        normals: (n, 3) unit.

    Returns:
        TangentFrames.
    """
    p, q = vertices[triangles], uvs[triangle_uvs]
    e1, e2 = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    d1, d2 = q[:, 1] - q[:, 0], q[:, 2] - q[:, 0]
    area = d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]
    sign = np.where(area < 0, -1.0, 1.0)
    along = sign[:, None] * (d2[:, 1:] * e1 - d1[:, 1:] * e2)
    key = np.stack(
        [triangles, triangle_uvs, np.repeat(sign[:, None] > 0, 3, axis=1)], axis=-1
    ).reshape(-1, 3)
    _, corner = np.unique(key, axis=0, return_inverse=True)
    corner = corner.reshape(-1, 3)
    total = np.zeros((int(corner.max()) + 1, 3))
    for k in range(3):
        normal = normals[triangles[:, k]]
        ahead, behind = (unit(_flat(p[:, (k + step) % 3] - p[:, k], normal)) for step in (1, 2))
        angle = np.arccos(np.clip(np.einsum("ti,ti->t", ahead, behind), -1, 1))
        angle[area == 0] = 0
        weighted = angle[:, None] * unit(_flat(along, normal))
        for axis in range(3):
            total[:, axis] += np.bincount(corner[:, k], weighted[:, axis], len(total))
    return TangentFrames(corner.astype(np.int32), unit(total), sign)


def to_tangent_space(
    world: np.ndarray,
    raster: Raster,
    texels: np.ndarray,
    triangles: np.ndarray,
    normals: np.ndarray,
    frames: TangentFrames,
) -> np.ndarray:
    """World normals at texels in the frame that a renderer will rebuild there.

    Args:
        world: (k, 3) unit.
        raster: of the atlas.
        texels: (k,) flat indices.
        triangles: (t, 3).
        normals: (n, 3) the mesh's.
        frames: of the mesh.

    Returns:
        (k, 3) float32 unit; (0, 0, 1) where the texture has no tangent.
    """
    out = np.empty((len(texels), 3), np.float32)
    _encode(
        np.ascontiguousarray(world, np.float32),
        raster.face.ravel(),
        raster.barycentric.reshape(-1, 2),
        texels,
        np.ascontiguousarray(triangles, np.int32),
        np.ascontiguousarray(normals, np.float64),
        frames.corner,
        frames.tangents,
        frames.sign,
        out,
    )
    return out


def from_tangent_space(
    tangent: np.ndarray,
    raster: Raster,
    texels: np.ndarray,
    triangles: np.ndarray,
    normals: np.ndarray,
    frames: TangentFrames,
) -> np.ndarray:
    """The way back: unit normals in the mesh's axes, as a renderer rebuilds them.

    Args:
        tangent: (k, 3), green along +v.
        raster: of the atlas.
        texels: (k,) flat indices.
        triangles: (t, 3).
        normals: (n, 3) the mesh's.
        frames: of the mesh.

    Returns:
        (k, 3) float32; the mesh's normal where the texture has no tangent, zero where that is zero.
    """
    out = np.empty((len(texels), 3), np.float32)
    _decode(
        np.ascontiguousarray(tangent, np.float32),
        raster.face.ravel(),
        raster.barycentric.reshape(-1, 2),
        texels,
        np.ascontiguousarray(triangles, np.int32),
        np.ascontiguousarray(normals, np.float64),
        frames.corner,
        frames.tangents,
        frames.sign,
        out,
    )
    return out


@numba.njit(cache=True, parallel=True)
def _encode(
    world: np.ndarray,
    face: np.ndarray,
    barycentric: np.ndarray,
    texels: np.ndarray,
    triangles: np.ndarray,
    normals: np.ndarray,
    corner: np.ndarray,
    tangents: np.ndarray,
    sign: np.ndarray,
    out: np.ndarray,
) -> None:
    for k in numba.prange(len(texels)):
        n0, n1, n2, a0, a1, a2, s0, s1, s2 = _frame(
            texels[k], face, barycentric, triangles, normals, corner, tangents, sign
        )
        # Cramer's rule for x a + y b + z n = world.
        p0, p1, p2 = _cross(s0, s1, s2, n0, n1, n2)
        q0, q1, q2 = _cross(n0, n1, n2, a0, a1, a2)
        r0, r1, r2 = _cross(a0, a1, a2, s0, s1, s2)
        volume = a0 * p0 + a1 * p1 + a2 * p2
        w0, w1, w2 = world[k, 0], world[k, 1], world[k, 2]
        x, y, z = 0.0, 0.0, 1.0
        if abs(volume) > 1e-12:
            x = (w0 * p0 + w1 * p1 + w2 * p2) / volume
            y = (w0 * q0 + w1 * q1 + w2 * q2) / volume
            z = (w0 * r0 + w1 * r1 + w2 * r2) / volume
        length = np.sqrt(x * x + y * y + z * z)
        if not length > 1e-12:
            x, y, z, length = 0.0, 0.0, 1.0, 1.0
        out[k, 0] = x / length
        out[k, 1] = y / length
        out[k, 2] = z / length


@numba.njit(cache=True, parallel=True)
def _decode(
    tangent: np.ndarray,
    face: np.ndarray,
    barycentric: np.ndarray,
    texels: np.ndarray,
    triangles: np.ndarray,
    normals: np.ndarray,
    corner: np.ndarray,
    tangents: np.ndarray,
    sign: np.ndarray,
    out: np.ndarray,
) -> None:
    for k in numba.prange(len(texels)):
        n0, n1, n2, a0, a1, a2, s0, s1, s2 = _frame(
            texels[k], face, barycentric, triangles, normals, corner, tangents, sign
        )
        x, y, z = tangent[k, 0], tangent[k, 1], tangent[k, 2]
        if s0 * s0 + s1 * s1 + s2 * s2 <= 1e-18:
            x, y, z = np.float32(0), np.float32(0), np.float32(1)
        w0 = x * a0 + y * s0 + z * n0
        w1 = x * a1 + y * s1 + z * n1
        w2 = x * a2 + y * s2 + z * n2
        length = np.sqrt(w0 * w0 + w1 * w1 + w2 * w2)
        if not 1e-12 < length < np.inf:
            w0, w1, w2, length = 0.0, 0.0, 0.0, 1.0
        out[k, 0] = w0 / length
        out[k, 1] = w1 / length
        out[k, 2] = w2 / length


@numba.njit(cache=True)
def _frame(
    texel: int,
    face: np.ndarray,
    barycentric: np.ndarray,
    triangles: np.ndarray,
    normals: np.ndarray,
    corner: np.ndarray,
    tangents: np.ndarray,
    sign: np.ndarray,
) -> tuple[float, float, float, float, float, float, float, float, float]:
    t = face[texel]
    b1, b2 = barycentric[texel, 0], barycentric[texel, 1]
    b0 = 1.0 - b1 - b2
    i, j, m = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    n0 = b0 * normals[i, 0] + b1 * normals[j, 0] + b2 * normals[m, 0]
    n1 = b0 * normals[i, 1] + b1 * normals[j, 1] + b2 * normals[m, 1]
    n2 = b0 * normals[i, 2] + b1 * normals[j, 2] + b2 * normals[m, 2]
    i, j, m = corner[t, 0], corner[t, 1], corner[t, 2]
    a0 = b0 * tangents[i, 0] + b1 * tangents[j, 0] + b2 * tangents[m, 0]
    a1 = b0 * tangents[i, 1] + b1 * tangents[j, 1] + b2 * tangents[m, 1]
    a2 = b0 * tangents[i, 2] + b1 * tangents[j, 2] + b2 * tangents[m, 2]
    s0, s1, s2 = _cross(n0, n1, n2, a0, a1, a2)
    return n0, n1, n2, a0, a1, a2, sign[t] * s0, sign[t] * s1, sign[t] * s2


@numba.njit(cache=True, inline="always")
def _cross(
    a0: float, a1: float, a2: float, b0: float, b1: float, b2: float
) -> tuple[float, float, float]:
    return a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0


def _flat(vectors: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """The part of (n, 3) vectors across unit normals."""
    flat: np.ndarray = vectors - np.einsum("ni,ni->n", vectors, normals)[:, None] * normals
    return flat
