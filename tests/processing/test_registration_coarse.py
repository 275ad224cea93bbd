"""The template of fewer vertices that coarse stiffnesses run on."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.formats.mesh import Mesh
from processing.registration.coarse import coarsened
from processing.registration.config import NonrigidConfig
from processing.registration.nonrigid import fit_nonrigid
from processing.registration.target import Target, border_vertices
from tests.processing.shapes import ellipsoid, ellipsoid_template, refined, warp


def plain_patches(vertices, triangles, cell_mm, kept):
    """Sets of vertices that edges within a cube connect, by walking; kept ones are alone."""
    cell = [tuple(c) for c in np.floor(vertices / cell_mm).astype(int)]
    near = [set() for _ in vertices]
    for a, b, c in triangles:
        for i, j in ((a, b), (b, c), (c, a)):
            if cell[i] == cell[j] and not {i, j} & set(kept):
                near[i].add(j)
                near[j].add(i)
    seen, patches = set(), set()
    for start in range(len(vertices)):
        if start in seen:
            continue
        patch, open_ends = {start}, [start]
        while open_ends:
            for other in near[open_ends.pop()] - patch:
                patch.add(other)
                open_ends.append(other)
        seen |= patch
        patches.add(frozenset(patch))
    return patches


@given(st.integers(0, 1000), st.sampled_from([1e-6, 3.0, 9.0, 30.0, 1e6]))
@settings(max_examples=25, deadline=None)
def test_patches_are_those_of_a_plain_walk(seed, cell_mm):
    rng = np.random.default_rng(seed)
    mesh = ellipsoid(8, 10)
    vertices = mesh.vertices + rng.normal(size=mesh.vertices.shape)
    triangles = mesh.triangles()[rng.random(len(mesh.faces)) < 0.9]
    kept = rng.choice(len(vertices), 3, replace=False)
    found = coarsened(vertices, triangles, cell_mm, kept)
    groups = {frozenset(np.flatnonzero(found.patch == k)) for k in range(len(found.chosen))}
    assert groups == plain_patches(vertices, triangles, cell_mm, kept)
    assert np.array_equal(found.patch[found.chosen], np.arange(len(found.chosen)))
    assert np.array_equal(found.chosen[found.patch[kept]], kept)
    assert (found.triangles != np.roll(found.triangles, 1, axis=1)).all()
    ordered = np.sort(found.triangles, axis=1)
    assert len(np.unique(ordered, axis=0)) == len(ordered)


def test_touching_sheets_stay_two_and_borders_stay_where_they_are():
    mesh = ellipsoid()
    half = mesh.triangles()[(mesh.vertices[mesh.triangles()][:, :, 1] > 0).all(axis=1)]
    count = len(mesh.vertices)
    both = np.concatenate([mesh.vertices, mesh.vertices + 0.01])
    found = coarsened(both, np.concatenate([half, half + count]), 12.0, np.zeros(0, np.int64))
    for patch in range(len(found.chosen)):
        inside = np.flatnonzero(found.patch == patch)
        assert (inside < count).all() or (inside >= count).all()
    border = border_vertices(half, count)
    touched = np.unique(found.patch[:count][border])
    assert border[found.chosen[touched]].all()


@pytest.mark.parametrize("stiffness_mm", [NonrigidConfig().stiffness_mm, (80.0, 40.0)])
def test_a_fit_that_begins_coarse_ends_where_one_on_the_whole_template_does(stiffness_mm):
    template = ellipsoid_template()
    truth = warp(template.mesh.vertices)
    scan = Target(refined(template.mesh.with_vertices(truth)))
    usual = NonrigidConfig(stiffness_mm=stiffness_mm, coarse_cell_mm=15.0)
    whole = dataclasses.replace(usual, coarse_cell_mm=0.0)
    first, second = (
        fit_nonrigid(
            template.mesh.vertices,
            template.mesh.triangles(),
            scan,
            template.landmarks,
            truth[template.landmarks],
            config,
        )
        for config in (usual, whole)
    )
    apart = np.linalg.norm(first.vertices - second.vertices, axis=1)
    assert apart.max() > 0
    assert apart.mean() < 0.5
    assert abs(np.median(first.distance_mm) - np.median(second.distance_mm)) < 0.1
    assert first.residual < 0.05


def test_a_template_without_triangles_keeps_all_its_vertices():
    empty = Mesh(np.eye(3), np.zeros((0, 3), np.int32))
    found = coarsened(empty.vertices, empty.triangles(), 100.0, np.array([1]))
    assert len(found.chosen) == 3
    assert len(found.triangles) == 0
