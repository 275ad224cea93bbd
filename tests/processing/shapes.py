"""Shapes with known answers for the tests of registration and atlas."""

from __future__ import annotations

import numpy as np

from lightstage.formats.mesh import Mesh
from lightstage.formats.template import Modes, Template
from lightstage.rig import Camera, look_at

RADII_MM = np.array([75.0, 105.0, 95.0])


def ellipsoid(rings: int = 40, around: int = 56) -> Mesh:
    """A closed ellipsoid of a head's size with UV; its seam is at the back, its front is +z."""
    v = (np.arange(1, rings) / rings)[:, None]
    u = (np.arange(around) / around)[None]
    polar, azimuth = np.pi * v, 2 * np.pi * (u - 0.5)
    ring = np.stack(
        np.broadcast_arrays(
            np.sin(polar) * np.sin(azimuth), np.cos(polar), np.sin(polar) * np.cos(azimuth)
        ),
        axis=-1,
    )
    poles = np.array([[0.0, 1, 0], [0, -1, 0]])
    vertices = np.concatenate([ring.reshape(-1, 3), poles]) * RADII_MM
    north, south = len(vertices) - 2, len(vertices) - 1
    uvs = [(c / around, 1 - r / rings) for r in range(rings + 1) for c in range(around + 1)]
    faces, face_uvs = [], []
    for r in range(rings):
        for c in range(around):
            here, right = (r - 1) * around + c, (r - 1) * around + (c + 1) % around
            below, below_right = here + around, right + around
            t = r * (around + 1) + c
            if r == 0:
                faces.append((north, below, below_right))
                face_uvs.append((t, t + around + 1, t + around + 2))
                continue
            faces.append((here, below if r < rings - 1 else south, right))
            face_uvs.append((t, t + around + 1, t + 1))
            if r < rings - 1:
                faces.append((below, below_right, right))
                face_uvs.append((t + around + 1, t + around + 2, t + 1))
    return Mesh(vertices, np.array(faces, np.int32), np.array(uvs), np.array(face_uvs, np.int32))


def bumpy_ellipsoid() -> Mesh:
    """An ellipsoid with a nose, so that no rotation maps it onto itself."""
    mesh = ellipsoid()
    x, y, z = mesh.vertices.T
    nose = 25 * np.exp(-(x**2 + (y + 10) ** 2) / 400) * (z > 0)
    brow = 6 * np.exp(-((np.abs(x) - 30) ** 2 + (y - 30) ** 2) / 500) * (z > 0)
    return mesh.with_vertices(mesh.vertices + np.stack([0 * x, 0 * x, nose + brow], axis=1))


def ellipsoid_template(*, modes: bool = False) -> Template:
    """A template on the bumpy ellipsoid: 68 landmarks spread over its front."""
    mesh = bumpy_ellipsoid()
    front = np.flatnonzero(mesh.vertices[:, 2] > 20)
    picks = front[np.linspace(0, len(front) - 1, 68).round().astype(int)]
    shape = None
    if modes:
        x, y, z = (mesh.vertices / RADII_MM).T
        wide = np.stack([8 * x, 0 * x, 0 * x], axis=1)
        chin = np.stack([0 * x, -10 * (y < 0) * y**2, 4 * (y < 0) * y**2], axis=1)
        jaw = np.stack([0 * x, -15 * (y < -0.3) * (y + 0.3) ** 2 * (z > 0), 0 * x], axis=1)
        shape = Modes(np.stack([wide, chin]), jaw[None], ("jaw",))
    return Template(
        name="ellipsoid",
        mesh=mesh,
        landmarks=picks.astype(np.int64),
        regions={"skin": np.arange(len(mesh.vertices))},
        licence="",
        source="",
        modes=shape,
    )


def refined(mesh: Mesh) -> Mesh:
    """Each triangle cut into four: a scan of finer topology than the template's."""
    triangles = mesh.triangles()
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    unique, place = np.unique(edges, axis=0, return_inverse=True)
    middle = place.reshape(-1, 3) + len(mesh.vertices)
    vertices = np.concatenate([mesh.vertices, mesh.vertices[unique].mean(axis=1)])
    a, b, c = triangles.T
    ab, bc, ca = middle.T
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    faces = np.concatenate([np.stack(p, axis=1) for p in parts])
    return Mesh(vertices, faces.astype(np.int32))


def warp(points: np.ndarray, size_mm: float = 6.0) -> np.ndarray:
    """A smooth known displacement of waves of 150 mm and more."""
    x, y, z = points.T / 60.0
    push = np.stack([np.sin(y + 0.4), np.cos(0.8 * x + z), np.sin(0.7 * y - 0.5 * x)], axis=1)
    return points + size_mm * push


def camera(
    name: str, azimuth_deg: float, elevation_deg: float = 0.0, *, dist: bool = False
) -> Camera:
    """A portrait camera at 1100 mm that looks at the origin, 0.8 mm a pixel there."""
    a, e = np.deg2rad([azimuth_deg, elevation_deg])
    place = 1100 * np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
    return Camera(
        id=name,
        serial="1",
        model="test",
        width_px=240,
        height_px=330,
        fx_px=1400,
        fy_px=1400,
        cx_px=121.3,
        cy_px=163.9,
        dist=(0.08, -0.05, 0.001, -0.0007, 0.01) if dist else (0, 0, 0, 0, 0),
        cam_from_world=look_at(place, np.zeros(3)),
    )
