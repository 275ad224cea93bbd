"""Tiles hold every covered texel once, and what is skipped changes nothing."""

import dataclasses

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.formats.mesh import vertex_normals
from processing.atlas.tiles import bound, tiled
from processing.atlas.weights import Texels
from processing.rays import MeshRays, interpolate
from tests.processing.atlas_samples import blended, look, samples_of
from tests.processing.shapes import bumpy_ellipsoid, camera


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    rows=st.integers(1, 40),
    columns=st.integers(1, 40),
    side=st.integers(1, 50),
    share=st.sampled_from([0.0, 0.02, 0.5, 1.0]),
)
def test_tiles_hold_every_covered_texel_once(seed, rows, columns, side, share):
    covered = np.random.default_rng(seed).uniform(size=(rows, columns)) < share
    face = np.where(covered, 3, -1).astype(np.int32)
    found = tiled(face, side)
    assert np.array_equal(np.sort(found.flat), np.flatnonzero(covered))
    assert (np.diff(found.start) > 0).all()
    for first, last in zip(found.start[:-1], found.start[1:], strict=True):
        row, column = np.divmod(found.flat[first:last], columns)
        assert len(np.unique(row // side)) == len(np.unique(column // side)) == 1


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    spread=st.sampled_from([0.0, 0.1, 1.0, 10.0]),
    far=st.sampled_from([0.0, 3.0, 100.0, 1e4]),
    least=st.sampled_from([0.0, 0.15, 0.9]),
)
def test_no_texel_that_faces_a_view_is_in_a_skipped_tile(seed, spread, far, least):
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=(12, 1, 3))
    normals = axis + spread * rng.normal(size=(12, 20, 3))
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    places = 50 * rng.normal(size=(12, 1, 3)) + 5 * rng.normal(size=(12, 20, 3))
    start = np.arange(0, 241, 20)
    flat = (places.reshape(-1, 3).astype(np.float32), normals.reshape(-1, 3).astype(np.float32))
    eye = places[0, 0] + far * rng.normal(size=3)
    trust = np.ones(240, np.float32)
    trust[:20] = 0
    kept = bound(start, *flat, trust).seen_from(eye, least)
    way = eye - flat[0]
    cosine = np.einsum("nk,nk->n", way, flat[1]) / np.maximum(np.linalg.norm(way, axis=1), 1e-12)
    faces = (cosine > least).reshape(12, 20).any(axis=1)
    faces[0] = False
    assert set(np.flatnonzero(faces)) <= set(kept)
    assert 0 not in kept


def test_skipped_tiles_change_no_sample():
    mesh = bumpy_ellipsoid()
    triangles = mesh.triangles()
    normals = vertex_normals(mesh.vertices, triangles)
    cam = camera("a", 40)
    hits = MeshRays(mesh.vertices, triangles).cast_camera(cam)
    shape = (cam.height_px, cam.width_px)
    order = np.lexsort(np.floor(mesh.vertices / 40).T)
    texels = Texels.of(
        mesh.vertices[order].astype(np.float32),
        normals[order].astype(np.float32),
        np.ones(len(normals), np.float32),
        np.append(np.arange(0, len(normals), 20), len(normals)),
    )
    wide = np.full(len(texels.start) - 1, np.pi)
    every = dataclasses.replace(texels, bounds=dataclasses.replace(texels.bounds, spread_rad=wide))
    found = [
        look(cam, mesh, some, interpolate(normals, triangles, hits).reshape(*shape, 3))
        for some in (texels, every)
    ]
    assert found[0].tiles < 0.8 * found[1].tiles
    assert len(found[0].reading.slot) > 300
    for name in ("slot", "pixel", "weight"):
        assert np.array_equal(getattr(found[0].reading, name), getattr(found[1].reading, name))


def test_detail_of_views_that_hardly_count_is_skipped_below_what_half_floats_tell():
    rng = np.random.default_rng(1)
    weights = rng.uniform(0.001, 1, size=(4, 300)).astype(np.float32)
    pictures = (0.4 + 0.1 * rng.normal(size=(4, 40, 40, 3))).astype(np.float16)
    pixel = rng.uniform(4, 36, size=(300, 2)).astype(np.float32)
    views = [
        (samples_of(pixel, weight, (40, 40)), picture)
        for weight, picture in zip(weights, pictures, strict=True)
    ]
    found = [blended(300, views, best) for best in (None, weights.max(axis=0))]
    assert (weights < 0.1 * weights.max(axis=0)).mean() > 0.05
    assert np.abs(found[0] - found[1]).max() < 2**-12  # half of a half float's step near .4
