"""Ears found on a scan as wholes."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from lightstage.formats.mesh import Mesh
from processing.registration.ears import EarConfig, ear_guides, spread
from processing.registration.nonrigid import NonrigidConfig, fit_nonrigid
from processing.registration.stage import RegisterConfig, register_mesh
from processing.registration.target import Target
from tests.processing.shapes import RADII_MM, ellipsoid, ellipsoid_template, refined

HEAD = ellipsoid(80, 112)


def eared(vertices, shift_mm=(0.0, 0.0), size=1.0):
    """An ellipsoid's vertices with an ear on each side, pear-shaped so that turns show."""
    y, z = vertices[:, 1] - shift_mm[0], vertices[:, 2] - shift_mm[1]
    wide = size * np.where(y > 0, 12.0, 8.0)
    ear = 22 * size * np.exp(-(((y / (18 * size)) ** 2 + (z / wide) ** 2) ** 2))
    side = np.sign(vertices[:, 0]) * (np.abs(vertices[:, 0]) > 0.5 * RADII_MM[0])
    return vertices + np.stack([side * ear, 0 * y, 0 * y], axis=1), (ear > 1.5) & (side != 0)


@pytest.mark.parametrize(("shift_mm", "size"), [((0, 0), 1.0), ((-6, -12), 1.0), ((5, 8), 0.8)])
def test_an_ear_elsewhere_and_of_another_size_is_found(shift_mm, size):
    mesh, ears = eared(HEAD.vertices)
    scan, _ = eared(HEAD.vertices, shift_mm, size)
    target = Target(refined(Mesh(scan, HEAD.faces)))
    chosen, goals = ear_guides(mesh, HEAD.triangles(), ears, target, EarConfig())
    assert len(chosen) == 24
    assert ears[chosen].all()
    assert len(np.unique(chosen)) == 24
    moved = goals - mesh[chosen]
    for side in (-1, 1):
        here = np.sign(mesh[chosen, 0]) == side
        assert here.sum() == 12
        # What stands off is the ear without its root, so it is a little off in size.
        assert np.abs(moved[here][:, 1:].mean(axis=0) - shift_mm).max() < 2.5


def test_a_scan_without_ears_guides_nothing():
    mesh, ears = eared(HEAD.vertices)
    bald = Target(HEAD)
    for found in (
        ear_guides(mesh, HEAD.triangles(), ears, bald, EarConfig()),
        ear_guides(mesh, HEAD.triangles(), np.zeros_like(ears), bald, EarConfig()),
        ear_guides(mesh, HEAD.triangles(), np.ones_like(ears), bald, EarConfig()),
    ):
        assert found[0].shape == (0,)
        assert found[1].shape == (0, 3)


def test_what_is_no_ear_is_not_believed():
    mesh, ears = eared(HEAD.vertices)
    hair = HEAD.vertices * 1.2
    target = Target(Mesh(hair, HEAD.faces))
    assert not len(ear_guides(mesh, HEAD.triangles(), ears, target, EarConfig())[0])
    own = Target(refined(Mesh(mesh, HEAD.faces)))
    none = EarConfig(guides=0)
    assert not len(ear_guides(mesh, HEAD.triangles(), ears, own, none)[0])
    assert len(ear_guides(mesh, HEAD.triangles(), ears, own, EarConfig())[0])


@given(st.integers(1, 40), st.integers(0, 50), st.integers(0, 10**6), st.sampled_from([1e-6, 1e6]))
@settings(max_examples=40, deadline=None)
def test_spread_points_are_each_the_farthest(count, asked, seed, scale):
    points = np.random.default_rng(seed).normal(size=(count, 3)) * scale
    points[count // 2 :] = points[: count - count // 2]  # twins
    found = spread(points, asked)
    assert 1 <= len(found) <= max(asked, 1)
    assert len(np.unique(points[found], axis=0)) == len(found)
    for k in range(1, len(found)):
        away = [min(np.linalg.norm(p - points[j]) for j in found[:k]) for p in points]
        assert np.isclose(away[found[k]], max(away))


def test_guides_lead_and_are_never_left_out():
    template = ellipsoid_template()
    rest = template.mesh.vertices
    scan = Target(refined(template.mesh))
    back = np.flatnonzero(rest[:, 2] < -0.7 * RADII_MM[2])
    lead = back[spread(rest[back], 6)]
    turn = Rotation.from_rotvec([0, 0, 0.3]).as_matrix()
    goals = scan.closest(rest[lead] @ turn.T).point
    slid = np.linalg.norm(goals - rest[lead], axis=1)
    off = {}
    for guides in (None, (lead, goals)):
        found = fit_nonrigid(
            rest,
            template.mesh.triangles(),
            scan,
            template.landmarks,
            rest[template.landmarks],
            NonrigidConfig(),
            guides=guides,
        )
        assert found.contradicted.shape == (68,)
        assert not found.faulty.any()
        off[guides is None] = np.linalg.norm(found.vertices[lead] - goals, axis=1)
    assert slid.mean() > 5
    assert off[True].mean() > 0.9 * slid.mean()
    assert off[False].mean() < 0.3 * slid.mean()


def test_registration_asks_for_ears_where_the_template_has_them():
    template = ellipsoid_template()
    bare = template.mesh.vertices
    vertices, ears = eared(bare)
    regions = {**template.regions, "ears": np.flatnonzero(ears)}
    template = dataclasses.replace(
        template, mesh=template.mesh.with_vertices(vertices), regions=regions
    )
    truth, _ = eared(bare, (-3.0, -6.0))
    marks = vertices[template.landmarks]
    found = {}
    for guides in (12, 0):
        config = RegisterConfig(ears=EarConfig(guides=guides, least_points=10))
        scan = refined(template.mesh.with_vertices(truth))
        found[guides], facts = register_mesh(scan, marks, template, config)
        assert facts["ear_guides"] == (22 if guides else 0)  # 11 vertices an ear
    assert np.abs(found[12] - found[0]).max() > 0
