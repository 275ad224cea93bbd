"""Colour and gloss of what is no skin on ICT's head: eyeballs, teeth, gums, the mouth's inside."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy import ndimage

from lightstage.formats.mesh import Mesh
from sim.head.grid import smoothstep
from sim.scans.ict_tile import EYE_SOCKETS, GUMS, LEFT_EYE, MOUTH_SOCKET, RIGHT_EYE, TEETH, Parts
from sim.skin.noise import octaves
from sim.skin.paint import Complexion, Skin

IRIS_MM, PUPIL_MM = 5.9, 1.7


@dataclasses.dataclass(frozen=True)
class _Material:
    albedo: tuple[float, float, float]
    specular: float
    roughness: float
    translucency: float


# Linear albedo by eye; water and enamel at normal incidence: 0.02 (n 1.33) to 0.05 (n 1.6).
_MATERIALS = {
    MOUTH_SOCKET: _Material((0.16, 0.045, 0.04), 0.024, 0.25, 0.3),
    EYE_SOCKETS: _Material((0.24, 0.09, 0.075), 0.024, 0.3, 0.3),
    GUMS: _Material((0.36, 0.13, 0.12), 0.024, 0.22, 0.4),
    TEETH: _Material((0.62, 0.54, 0.40), 0.045, 0.2, 0.2),
    LEFT_EYE: _Material((0.46, 0.41, 0.375), 0.026, 0.2, 0.05),
    RIGHT_EYE: _Material((0.46, 0.41, 0.375), 0.026, 0.2, 0.05),
}


def paint_inner_parts(
    skin: Skin,
    positions_mm: np.ndarray,
    face: np.ndarray,
    parts: Parts,
    resting: Mesh,
    complexion: Complexion,
) -> Skin:
    """The skin's maps with all other parts painted over.

    Args:
        skin: maps over the subject's texture.
        positions_mm: (rows, columns, 3) of the resting face.
        face: (rows, columns) triangle of each texel, -1 where none.
        parts: of the subject.
        resting: mesh of the resting face.
        complexion: whose iris it is.
    """
    maps = {
        name: getattr(skin, name).copy()
        for name in ("diffuse_albedo", "specular_albedo", "roughness", "translucency")
    }
    part = np.where(face >= 0, parts.triangle_parts()[np.maximum(face, 0)], -1)
    for name, material in _MATERIALS.items():
        here = part == name
        colour = np.broadcast_to(np.array(material.albedo, np.float32), (int(here.sum()), 3))
        if name in (LEFT_EYE, RIGHT_EYE):
            colour = _eye(positions_mm[here], resting, parts, name, complexion)
        maps["diffuse_albedo"][here] = colour
        maps["specular_albedo"][here] = material.specular
        maps["roughness"][here] = material.roughness
        maps["translucency"][here] = material.translucency
    # A renderer's sample at an island's rim reaches beyond it: there the island goes on.
    bare = face < 0
    nearest = ndimage.distance_transform_edt(bare, return_distances=False, return_indices=True)
    rows, columns = (index[bare] for index in nearest)
    for values in maps.values():
        values[bare] = values[rows, columns]
    anisotropy = None if skin.anisotropy is None else np.where(part >= 2, 0.0, skin.anisotropy)
    if anisotropy is not None:
        anisotropy = anisotropy.astype(np.float32)
    return dataclasses.replace(skin, anisotropy=anisotropy, **maps)


def _eye(
    points: np.ndarray, resting: Mesh, parts: Parts, eye: int, complexion: Complexion
) -> np.ndarray:
    """(n, 3) linear albedo of an eyeball's texels: pupil, iris, limbus, sclera with veins."""
    of_eye = parts.part == eye
    corners, uv_corners = parts.faces[of_eye], parts.face_uvs[of_eye]
    real = corners >= 0
    ball = resting.vertices[np.unique(corners[real])]
    centre = (ball.min(axis=0) + ball.max(axis=0)) / 2
    # The cornea's top is the middle of the eyeball's own tile.
    uv = parts.uvs[uv_corners[real]]
    middle = (uv.min(axis=0) + uv.max(axis=0)) / 2
    top = corners[real][np.linalg.norm(uv - middle, axis=1).argmin()]
    axis = resting.vertices[top] - centre
    axis /= np.linalg.norm(axis)
    right = np.cross([0.0, 1.0, 0.0], axis)
    right /= np.linalg.norm(right)
    offset = points - centre
    x, y = offset @ right, offset @ np.cross(axis, right)
    radius, turn = np.hypot(x, y), np.arctan2(y, x)
    behind = offset @ axis < 0
    place = np.ascontiguousarray(points, np.float32)
    seed = 17 if eye == LEFT_EYE else 18
    white = np.array(_MATERIALS[eye].albedo) * (1 + 0.04 * octaves(place, 3.0, 2, seed))[:, None]
    vein = 1 - np.abs(octaves(place * np.array([0.35, 1, 1], np.float32), 2.2, 1, seed + 2))
    vein = smoothstep(0.8, 1.0, vein) * smoothstep(6.5, 10.0, radius)
    flush = smoothstep(7.0, 15.0, radius)
    white = white * (1 - (0.10 * vein + 0.16 * flush)[:, None] * np.array([0.4, 1.0, 1.0]))
    ray = np.stack([4.6 * np.cos(turn), 4.6 * np.sin(turn), 0.35 * radius], axis=-1)
    fibres = 1 + 0.22 * octaves(ray.astype(np.float32), 1.1, 3, seed + 4)
    ring = fibres * (1 - 0.6 * smoothstep(4.7, 5.9, radius)) * (0.8 + 0.06 * radius)
    iris = ring[:, None] * np.array(complexion.iris)
    iris *= smoothstep(PUPIL_MM - 0.2, PUPIL_MM + 0.25, radius)[:, None]
    inside = smoothstep(IRIS_MM + 0.4, IRIS_MM - 0.3, radius) * ~behind
    out = white + inside[:, None] * (iris - white) + 0.004
    # Lids and lashes shade the ball below them, as in any texture of a photographed eye.
    shade = 1 - 0.5 * smoothstep(2.0, 6.5, y) - 0.2 * smoothstep(-3.5, -6.5, y)
    shade *= 1 - 0.3 * smoothstep(7.0, 12.0, np.abs(x))
    return np.asarray(np.clip(out * shade[:, None], 0.004, 0.9), np.float32)
