"""Ears found on a scan as wholes."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial import cKDTree

from lightstage.formats.mesh import Mesh
from processing.registration.config import EarConfig, NonrigidConfig, PlateConfig, RegisterConfig
from processing.registration.ears import ears_in_place, find_ears
from processing.registration.flips import Faults
from processing.registration.nonrigid import fit_nonrigid
from processing.registration.stage import register_mesh
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
    found = find_ears(mesh, HEAD.triangles(), ears, target, EarConfig())
    assert len(found) == 2
    for ear, pose in found:
        assert ears[ear].all()
        moved = pose.apply(mesh[ear]) - mesh[ear]
        # What stands off is the ear without its root, so it is a little off in size.
        assert np.abs(moved[:, 1:].mean(axis=0) - shift_mm).max() < 2.5


def test_an_ear_in_place_lies_where_it_was_found_and_the_face_stays():
    mesh, ears = eared(HEAD.vertices)
    scan, _ = eared(HEAD.vertices, (-6, -12))
    target = Target(refined(Mesh(scan, HEAD.faces)))
    triangles = HEAD.triangles()
    found = find_ears(mesh, triangles, ears, target, EarConfig())
    moved = ears_in_place(mesh, triangles, found, PlateConfig(), 35.0)
    for ear, pose in found:
        assert np.abs(moved[ear] - pose.apply(mesh[ear])).max() < 0.3
    far = cKDTree(mesh[ears]).query(mesh)[0] > 35
    assert np.abs(moved[far] - mesh[far]).max() < 0.3
    assert not Faults(mesh, triangles).all(moved).any()
    assert ears_in_place(mesh, triangles, [], PlateConfig(), 35.0) is mesh


def test_a_scan_without_ears_shows_none():
    mesh, ears = eared(HEAD.vertices)
    bald = Target(HEAD)
    for found in (
        find_ears(mesh, HEAD.triangles(), ears, bald, EarConfig()),
        find_ears(mesh, HEAD.triangles(), np.zeros_like(ears), bald, EarConfig()),
        find_ears(mesh, HEAD.triangles(), np.ones_like(ears), bald, EarConfig()),
    ):
        assert found == []


def test_what_is_no_ear_is_not_believed():
    mesh, ears = eared(HEAD.vertices)
    hair = HEAD.vertices * 1.2
    target = Target(Mesh(hair, HEAD.faces))
    assert not find_ears(mesh, HEAD.triangles(), ears, target, EarConfig())
    own = Target(refined(Mesh(mesh, HEAD.faces)))
    unsought = EarConfig(sought=False)
    assert not find_ears(mesh, HEAD.triangles(), ears, own, unsought)
    assert len(find_ears(mesh, HEAD.triangles(), ears, own, EarConfig())) == 2


def test_registration_asks_for_ears_where_the_template_has_them():
    template = ellipsoid_template()
    finer = refined(template.mesh)
    bare = finer.vertices
    vertices, ears = eared(bare)
    regions = {"skin": np.arange(len(bare)), "ears": np.flatnonzero(ears)}
    template = dataclasses.replace(template, mesh=finer.with_vertices(vertices), regions=regions)
    truth, _ = eared(bare, (-3.0, -6.0))
    marks = vertices[template.landmarks]
    scan = template.mesh.with_vertices(truth)
    off = {}
    for sought in (True, False):
        config = RegisterConfig(ears=EarConfig(sought=sought, least_points=10))
        laid, facts = register_mesh(scan, marks, template, config)
        assert facts["ears_found"] == (2 if sought else 0)
        mesh = Target(template.mesh.with_vertices(laid))
        off[sought] = np.quantile(mesh.closest(truth[ears]).distance_mm, 0.9)
    assert off[True] < 0.5 * off[False]


def test_landmarks_nearby_do_not_carry_away_an_ear_that_lies_in_its_place():
    vertices, ears = eared(HEAD.vertices)
    triangles = HEAD.triangles()
    target = Target(refined(Mesh(vertices, HEAD.faces)))
    away = cKDTree(vertices[ears]).query(vertices)[0]
    marks = np.flatnonzero((away > 5) & (away < 12))[::6]
    goals = vertices[marks] + [0.0, 12.0, 0.0]
    config = NonrigidConfig().down_to(40.0)
    carried = [
        np.median(np.linalg.norm(fit.vertices[ears] - vertices[ears], axis=1))
        for fit in (
            fit_nonrigid(
                vertices, triangles, target, marks, goals, config, both_ways=ears, in_place=at
            )
            for at in (None, ears)
        )
    ]
    assert carried[0] > 5
    assert carried[1] < 1
