"""A mesh drawn from three sides: lit, or in the colours of a value at each vertex."""

from __future__ import annotations

import numpy as np

from lightstage.formats.mesh import Mesh, vertex_normals
from processing.rays import Hits, MeshRays, interpolate
from processing.report import display_error

SIDES_DEG = (-50.0, 0.0, 50.0)
INSIDE = (60, 80, 160)
"""Colour of a mesh's inside."""
UNKNOWN = 40
"""Grey of what has no value."""


def side_hits(mesh: Mesh, side_deg: float, side_px: int) -> Hits:
    """What parallel rays of a square picture meet, in row order.

    Args:
        mesh: mm, its face looking along +z.
        side_deg: turn about y; positive from the mesh's left.
        side_px: of the picture.
    """
    turn = np.deg2rad(side_deg)
    toward = np.array([np.sin(turn), 0.0, np.cos(turn)])
    across = np.array([np.cos(turn), 0.0, -np.sin(turn)])
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    reach = 0.5 * float(np.linalg.norm(high - low))
    at = (np.arange(side_px) + 0.5) / side_px * 2 - 1
    start = 0.5 * (low + high) + 2 * reach * toward
    start = start + 0.75 * reach * (at[None, :, None] * across - at[:, None, None] * [0, 1, 0])
    flat = start.reshape(-1, 3)
    rays = MeshRays(mesh.vertices, mesh.triangles())
    return rays.cast(flat, np.broadcast_to(-toward, flat.shape))


def lit_sides(mesh: Mesh, side_px: int, tints: np.ndarray | None = None) -> np.ndarray:
    """(side_px, 3 side_px, 3) uint8: the mesh lit from above, on white; its inside is blue.

    Args:
        mesh: mm, its face looking along +z.
        side_px: rows.
        tints: (t, 3) colours of its triangles, 0..1; None for grey alone.
    """
    normals = vertex_normals(mesh.vertices, mesh.triangles())
    shown = []
    for side_deg in SIDES_DEG:
        hits = side_hits(mesh, side_deg, side_px)
        normal = interpolate(normals, mesh.triangles(), hits)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
        turn = np.deg2rad(side_deg)
        toward = np.array([np.sin(turn), 0.0, np.cos(turn)])
        across = np.array([np.cos(turn), 0.0, -np.sin(turn)])
        lamp = toward + 0.5 * across + np.array([0.0, 0.6, 0.0])
        shade = np.clip(normal @ (lamp / np.linalg.norm(lamp)), 0, 1)
        grey = np.repeat(np.round(30 + 215 * shade)[:, None], 3, axis=1)
        if tints is not None:
            grey = np.round(grey * tints[hits.face])
        grey[normal @ toward < 0] = INSIDE
        grey[hits.face < 0] = 255
        shown.append(grey.astype(np.uint8).reshape(side_px, side_px, 3))
    return np.concatenate(shown, axis=1)


def coloured_sides(mesh: Mesh, values: np.ndarray, largest: float, side_px: int) -> np.ndarray:
    """(side_px, 3 side_px, 3) uint8: values in the colours of `display_error`, on white.

    Args:
        mesh: mm, its face looking along +z.
        values: (v,) of its vertices, not negative; NaN is drawn grey.
        largest: the value of the brightest colour.
        side_px: rows.
    """
    known = np.isfinite(values)
    pair = np.stack([np.where(known, values, 0), known], axis=1)
    shown = []
    for side_deg in SIDES_DEG:
        hits = side_hits(mesh, side_deg, side_px)
        value, share = interpolate(pair, mesh.triangles(), hits).T
        image = display_error(value[None], largest)[0]
        image[share < 0.5] = UNKNOWN
        image[hits.face < 0] = 255
        shown.append(image.reshape(side_px, side_px, 3))
    return np.concatenate(shown, axis=1)
