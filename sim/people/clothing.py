"""Clothes on a simulated person: grey cloth that casts shadows and is no skin."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from lightstage.formats.mesh import Mesh
from sim.errors import SimError
from sim.people.subject import Subject

AROUND = 120
DOWN = 24
CHIN = 8
"""Number of the chin among the landmarks."""
BELOW_CHIN_MM = 20.0
"""Where a collar's upper edge is."""
SLICE_MM = 15.0
"""Half the height of the part of the neck that a collar is fitted to."""
CLEARANCE_MM = 8.0
"""Between neck and collar."""
COLLAR_MM = 30.0
"""A collar's height; below it the shoulders begin."""
SHOULDERS_MM = 90.0
"""How far the shoulders reach out and down."""
INSIDE_MM = 3.0
"""Least distance between the cloth and the body below it."""
STRIP = 8
"""Rows of texels that hold the cloth's colour."""
CLOTH_ROUGHNESS = 0.5


def collar(subject: Subject) -> Mesh:
    """A standing collar and the shoulders below it, around a subject's own neck; mm, world.

    Raises:
        SimError: a subject without a neck.
    """
    to_head = subject.head_from_world
    points = subject.mesh.vertices @ to_head[:, :3].T + to_head[:, 3]
    chin = to_head[:, :3] @ subject.landmarks_mm[CHIN] + to_head[:, 3]
    top_mm = chin[1] - BELOW_CHIN_MM
    neck = points[np.abs(points[:, 1] - (top_mm - COLLAR_MM / 2)) < SLICE_MM]
    # The face ends in front of the neck; what reaches farther forward is chin.
    neck = neck[neck[:, 2] < chin[2] - 20]
    if len(neck) < 30:
        raise SimError(
            f"subject {subject.name}",
            found="no neck below the chin",
            expected="a mesh that continues below it",
        )
    middle = (neck.min(axis=0) + neck.max(axis=0)) / 2
    off = neck - middle
    turn = np.arctan2(off[:, 2], off[:, 0])
    place = np.floor((turn / (2 * np.pi) % 1) * AROUND).astype(int)
    radius = np.zeros(AROUND)
    np.maximum.at(radius, place, np.hypot(off[:, 0], off[:, 2]))
    empty = radius == 0
    at = np.arange(AROUND)
    radius = np.interp(at, at[~empty], radius[~empty], period=AROUND)
    radius = gaussian_filter1d(radius, 3, mode="wrap") + CLEARANCE_MM
    angle = 2 * np.pi * (at + 0.5) / AROUND
    out = np.stack([np.cos(angle), np.zeros(AROUND), np.sin(angle)], axis=1)
    shares = np.linspace(0, 1, DOWN)
    wide = SHOULDERS_MM * np.maximum(2 * shares - 1, 0)
    heights = top_mm - COLLAR_MM * np.minimum(2 * shares, 1) - 0.5 * wide
    body = points[points[:, 2] < chin[2] - 20]
    reach = _outside(radius + wide[:, None], heights, body - (middle[0], 0, middle[2]))
    lowest = body[:, 1].min() - INSIDE_MM
    if heights[-1] > lowest:
        # A body that continues below the shoulders is covered down to its end.
        heights[-1] = lowest
    rings = [
        ring[:, None] * out + (middle[0], height, middle[2])
        for ring, height in zip(reach, heights, strict=True)
    ]
    vertices = (np.concatenate(rings) - to_head[:, 3]) @ to_head[:, :3]
    above = (np.arange(DOWN - 1)[:, None] * AROUND + at).ravel()
    beside = (np.arange(DOWN - 1)[:, None] * AROUND + (at + 1) % AROUND).ravel()
    upper = np.stack([above, beside, beside + AROUND], axis=1)
    lower = np.stack([above, beside + AROUND, above + AROUND], axis=1)
    return Mesh(vertices, np.concatenate([upper, lower]).astype(np.int32))


def _outside(reach: np.ndarray, heights: np.ndarray, body: np.ndarray) -> np.ndarray:
    """Rings of cloth, made wider where a body would poke through them.

    Args:
        reach: (r, AROUND) distance from the axis, mm.
        heights: (r,) of the rings, falling.
        body: (n, 3) points around the axis, +y up.
    """
    place = (np.arctan2(body[:, 2], body[:, 0]) / (2 * np.pi) % 1 * AROUND).astype(int) % AROUND
    off = np.hypot(body[:, 0], body[:, 2])
    out = reach.copy()
    for k in range(len(heights)):
        above, below = heights[max(k - 1, 0)], heights[min(k + 1, len(heights) - 1)]
        there = (body[:, 1] <= above) & (body[:, 1] >= below)
        widest = np.zeros(AROUND)
        np.maximum.at(widest, place[there], off[there] + INSIDE_MM)
        excess = maximum_filter1d(np.maximum(widest - reach[k], 0), 5, mode="wrap")
        if excess.any():
            out[k] += gaussian_filter1d(excess, 1, mode="wrap")
    return out


def dressed(
    subject: Subject,
    clothes: Mesh,
    albedo: tuple[float, float, float],
    specular: float = 0.0,
    roughness: float = CLOTH_ROUGHNESS,
) -> Subject:
    """A subject that wears clothes, hair or glasses: of one colour, no skin.

    Args:
        subject: the person.
        clothes: mm, world; triangles whose outside is seen.
        albedo: linear.
        specular: what it mirrors at normal incidence; cloth is matt.
        roughness: of that mirror.

    Returns:
        The subject with the clothes in its mesh, and a strip of texels for them below its textures.
    """
    mesh, rows = subject.mesh, len(subject.diffuse_albedo)
    assert mesh.uvs is not None

    def with_strip(image: np.ndarray, value: float | tuple[float, ...]) -> np.ndarray:
        strip = np.zeros((STRIP, *image.shape[1:]), image.dtype)
        strip[:] = value
        return np.concatenate([image, strip])

    triangles, count = clothes.triangles(), len(mesh.vertices)
    faces = np.concatenate([mesh.triangles(), triangles + count]).astype(np.int32)
    uvs = mesh.uvs.copy()
    uvs[:, 1] = (uvs[:, 1] * rows + STRIP) / (rows + STRIP)
    uvs = np.concatenate([uvs, [[0.5, STRIP / 2 / (rows + STRIP)]]])
    of_cloth = np.full(triangles.shape, len(mesh.uvs))
    face_uvs = np.concatenate([mesh.triangle_uvs(), of_cloth]).astype(np.int32)
    stretched = subject.anisotropy
    return dataclasses.replace(
        subject,
        mesh=Mesh(np.concatenate([mesh.vertices, clothes.vertices]), faces, uvs, face_uvs),
        diffuse_albedo=with_strip(subject.diffuse_albedo, albedo),
        specular_albedo=with_strip(subject.specular_albedo, specular),
        roughness=with_strip(subject.roughness, roughness),
        normal=with_strip(subject.normal, 0.0),
        translucency=with_strip(subject.translucency, 0.0),
        skin=with_strip(subject.skin, False),
        anisotropy=None if stretched is None else with_strip(stretched, 0.0),
    )
