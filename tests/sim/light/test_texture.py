"""Textures and subdivision on shapes with known answers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from lightstage.formats.mesh import Mesh, vertex_normals
from sim.light.texture import raster_uv, sample, tangent_frames, texture_of
from sim.scans.subdivide import loop_subdivide


def square(v_up: bool = True) -> Mesh:
    """A unit square in the x y plane whose UV are its x and y."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    uvs = corners[:, :2].copy()
    if not v_up:
        uvs[:, 1] = 1 - uvs[:, 1]
    faces = np.array([[0, 1, 2, 3]], np.int32)
    return Mesh(corners, faces, uvs, faces)


def test_texel_centres_follow_the_format():
    """Texel (0.5, 0.5) of the top-left corner has v = 1 - 0.5 / rows."""
    mesh = square()
    face, weights = raster_uv(mesh, 6, 4)
    assert (face >= 0).all()
    place = texture_of(mesh.vertices, mesh.triangles(), face, weights)
    assert place[0, 0] == pytest.approx([0.125, 1 - 0.5 / 6, 0])
    assert place[-1, -1] == pytest.approx([0.875, 0.5 / 6, 0])


def test_raster_leaves_texels_outside_the_charts_empty():
    mesh = square()
    assert mesh.uvs is not None
    small = Mesh(mesh.vertices, mesh.faces, mesh.uvs * 0.5, mesh.face_uvs)
    face, _ = raster_uv(small, 8, 8)
    assert (face[4:, :4] >= 0).all()
    assert (face[:4] == -1).all()
    assert (face[:, 4:] == -1).all()


def test_samples_at_texel_centres_are_the_texels():
    image = np.random.default_rng(1).random((5, 7, 3)).astype(np.float32)
    u, v = np.meshgrid((np.arange(7) + 0.5) / 7, 1 - (np.arange(5) + 0.5) / 5)
    found = sample(image, np.stack([u.ravel(), v.ravel()], axis=1))
    np.testing.assert_allclose(found.reshape(5, 7, 3), image, atol=1e-6)


def test_samples_of_a_ramp_are_linear():
    ramp = np.tile((np.arange(8) + 0.5) / 8, (4, 1))
    u = np.linspace(0.1, 0.9, 30)
    found = sample(ramp, np.stack([u, np.full(30, 0.5)], axis=1))
    np.testing.assert_allclose(found, u, atol=1e-6)


@settings(max_examples=50, deadline=None)
@given(npst.arrays(np.float64, (20, 2), elements=st.floats(-1e6, 1e6)))
def test_samples_outside_the_tile_are_clamped(uvs):
    image = np.arange(12.0).reshape(3, 4)
    found = sample(image, uvs)
    assert np.isfinite(found).all()
    assert found.min() >= 0
    assert found.max() <= 11


def test_tangents_run_along_u_and_v():
    for mesh, sign in ((square(), 1), (square(v_up=False), -1)):
        along_u, along_v, normal = tangent_frames(mesh)
        np.testing.assert_allclose(along_u, np.broadcast_to([1, 0, 0], along_u.shape), atol=1e-12)
        np.testing.assert_allclose(
            along_v, np.broadcast_to([0, sign, 0], along_v.shape), atol=1e-12
        )
        np.testing.assert_allclose(normal, np.broadcast_to([0, 0, 1], normal.shape), atol=1e-12)


def test_loop_subdivision_keeps_a_plane_flat_and_its_uv():
    grid = square()
    twice = loop_subdivide(loop_subdivide(grid))
    assert len(twice.faces) == 2 * 16
    assert np.abs(twice.vertices[:, 2]).max() == 0
    assert twice.uvs is not None
    assert twice.face_uvs is not None
    # The border stays, UV stay linear: the inner vertices alone may move within the plane.
    border = (np.abs(twice.vertices[:, :2] - 0.5) == 0.5).any(axis=1)
    np.testing.assert_allclose(
        twice.uvs[twice.face_uvs][border[twice.faces]],
        twice.vertices[twice.faces][border[twice.faces]][:, :2],
    )


def test_loop_subdivision_turns_an_octahedron_toward_a_ball():
    octahedron = Mesh(
        np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float),
        np.array(
            [
                [0, 2, 4],
                [2, 1, 4],
                [1, 3, 4],
                [3, 0, 4],
                [2, 0, 5],
                [1, 2, 5],
                [3, 1, 5],
                [0, 3, 5],
            ],
            np.int32,
        ),
    )
    mesh = octahedron
    for _ in range(4):
        mesh = loop_subdivide(mesh)
    assert len(mesh.vertices) == 2 + 4 * 4**4
    radius = np.linalg.norm(mesh.vertices, axis=1)
    assert radius.max() / radius.min() < 1.12
    outward = mesh.vertices / radius[:, None]
    normals = vertex_normals(mesh.vertices, mesh.faces)
    assert np.sum(outward * normals, axis=1).min() > 0.97
    # Loop's limit is symmetric: the six first corners share one radius.
    np.testing.assert_allclose(radius[:6], radius[0])


def test_subdivision_of_a_seam_keeps_it():
    """Two triangles share an edge but not its UV: the middle has one place and two UV."""
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    uvs = np.array([[0, 0], [0.4, 0], [0.4, 0.4], [0.6, 0], [1, 0.4], [0.6, 0.4]], float)
    mesh = Mesh(square().vertices, faces, uvs, np.array([[0, 1, 2], [3, 4, 5]], np.int32))
    fine = loop_subdivide(mesh)
    assert len(fine.vertices) == 4 + 5
    assert fine.uvs is not None
    assert len(fine.uvs) == 6 + 6
