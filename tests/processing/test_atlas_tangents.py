"""Tangent-space normals: a renderer's reconstruction gives the world normal back."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.atlas.raster import rasterise
from processing.atlas.tangents import from_tangent_space, tangent_frames, to_tangent_space
from tests.processing.shapes import ellipsoid


def encoded(mesh, normals, world, rows=48):
    uvs, triangle_uvs = mesh.uvs, mesh.triangle_uvs()
    raster = rasterise(uvs, triangle_uvs, rows, rows * 2 // 3)
    texels = raster.texels()
    frames = tangent_frames(mesh.vertices, mesh.triangles(), uvs, triangle_uvs, normals)
    found = to_tangent_space(world(texels), raster, texels, mesh.triangles(), normals, frames)
    return found, raster, texels, frames


def decoded(tangent, mesh, normals, raster, texels, frames):
    """What a renderer does with them, in plain float64."""
    out = np.empty((len(texels), 3))
    for k, texel in enumerate(texels):
        t = raster.face.ravel()[texel]
        b1, b2 = raster.barycentric.reshape(-1, 2)[texel].astype(float)
        b = np.array([1 - b1 - b2, b1, b2])
        n = b @ normals[mesh.triangles()[t]]
        a = b @ frames.tangents[frames.corner[t]]
        world = (
            tangent[k, 0] * a + tangent[k, 1] * frames.sign[t] * np.cross(n, a) + tangent[k, 2] * n
        )
        out[k] = world / np.linalg.norm(world)
    return out


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 10**6), mirrored=st.booleans())
def test_decoding_gives_the_world_normal_back(seed, mirrored):
    mesh = ellipsoid(12, 16)
    if mirrored:
        mesh.uvs[:, 0] = 1 - mesh.uvs[:, 0]
    normals = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    rng = np.random.default_rng(seed)

    def world(texels):
        vectors = rng.normal(size=(len(texels), 3))
        return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)

    kept = {}

    def remembered(texels):
        kept["world"] = world(texels)
        return kept["world"]

    found, raster, texels, frames = encoded(mesh, normals, remembered)
    assert np.allclose(np.linalg.norm(found, axis=1), 1, atol=1e-5)
    back = decoded(found, mesh, normals, raster, texels, frames)
    usable = np.linalg.norm(frames.tangents[frames.corner[raster.face.ravel()[texels]]], axis=2)
    whole = (usable > 0).all(axis=1)
    assert whole.mean() > 0.7
    assert np.abs(back - kept["world"])[whole].max() < 1e-3
    assert (frames.sign == frames.sign[0]).all()


def test_the_meshs_own_normal_is_straight_up_and_red_points_along_u():
    mesh = ellipsoid(20, 24)
    normals = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    uvs, triangles = mesh.uvs, mesh.triangles()
    raster = rasterise(uvs, mesh.triangle_uvs(), 48, 32)
    own = raster.at(normals, triangles)
    own = own / np.linalg.norm(own, axis=1, keepdims=True)
    place = raster.at(mesh.vertices, triangles)
    middle = (np.abs(place[:, 1]) < 40) & (np.abs(place[:, 0]) < 40) & (place[:, 2] > 0)
    for tilt, expected in (([0, 0, 0], [0, 0, 1]), ([0.5, 0, 0], "red"), ([0, 0.5, 0], "green")):
        world = own + np.array(tilt)
        world /= np.linalg.norm(world, axis=1, keepdims=True)
        found, *_ = encoded(mesh, normals, lambda _, w=world: w)
        mean = found[middle].mean(axis=0)
        if expected == "red":  # u grows with x on the front
            assert mean[0] > 0.3
            assert abs(mean[1]) < 0.05
        elif expected == "green":  # v grows with y
            assert mean[1] > 0.3
            assert abs(mean[0]) < 0.05
        else:
            assert mean == pytest.approx(expected, abs=1e-3)


def test_texture_without_area_has_a_straight_normal():
    mesh = ellipsoid(6, 8)
    flat = np.zeros_like(mesh.uvs)
    frames = tangent_frames(
        mesh.vertices, mesh.triangles(), flat, mesh.triangle_uvs(), mesh.vertices / 100
    )
    assert (frames.tangents == 0).all()


def test_the_way_back_is_the_renderers_and_never_silently_wrong():
    mesh = ellipsoid(12, 16)
    normals = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    rng = np.random.default_rng(3)
    found, raster, texels, frames = encoded(mesh, normals, lambda t: rng.normal(size=(len(t), 3)))
    usable = np.linalg.norm(frames.tangents[frames.corner[raster.face.ravel()[texels]]], axis=2)
    usable = (usable > 0.5).all(axis=1)
    triangles = mesh.triangles()
    true = decoded(found, mesh, normals, raster, texels, frames)
    back = from_tangent_space(found, raster, texels, triangles, normals, frames)
    assert usable.sum() > 100
    np.testing.assert_allclose(back[usable], true[usable], atol=1e-6)
    broken = found.copy()
    broken[0::3], broken[1::3], broken[2::3] = 0, np.nan, np.inf
    flat = np.zeros_like(normals)
    for given_normals in (normals, flat):
        back = from_tangent_space(broken, raster, texels, triangles, given_normals, frames)
        size = np.linalg.norm(back, axis=1)
        # A texel without a direction has none; without a tangent it is the mesh's normal.
        assert (np.isclose(size, 1, atol=1e-5) | (size == 0)).all()
    assert not back.any()
