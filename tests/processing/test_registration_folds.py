"""Parts that are asked both ways, and folds that are the scan's own."""

import numpy as np
import pytest

from lightstage.formats.mesh import Mesh
from processing.registration.both_ways import BothWays, vertex_areas
from processing.registration.config import BothWaysConfig, NonrigidConfig
from processing.registration.flips import Faults, against_scan
from processing.registration.nonrigid import fit_nonrigid
from processing.registration.plate import Springs
from processing.registration.target import Target


def sheet(side, step, height):
    """A square sheet of vertices, (n, 3) mm and (t, 3); z by a function of x and y."""
    at = step * np.arange(side) - step * (side - 1) / 2
    x, y = (a.ravel() for a in np.meshgrid(at, at))
    cell = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).reshape(-1, 1)
    triangles = (cell + np.array([0, 1, side, 1, side + 1, side])).reshape(-1, 3)
    return np.stack([x, y, height(x, y)], axis=1), triangles.astype(np.int32)


def ridge(x, y):
    return 9 * np.exp(-((x / 4.0) ** 2)) * np.exp(-((y / 14) ** 2))


FLAT, FACES = sheet(19, 3.0, lambda x, _: 0 * x)
RIDGED = Target(Mesh(*sheet(73, 0.75, ridge)))
CONFIG = NonrigidConfig(stiffness_mm=(20.0, 10.0, 5.0, 2.5, 1.2), coarse_cell_mm=0.0)


def test_a_steep_ridge_is_reached_when_the_scan_asks_too():
    middle = np.abs(FLAT[:, :2]).max(axis=1) < 20
    top = RIDGED.vertices[np.linalg.norm(RIDGED.vertices[:, :2] / [2, 8], axis=1) < 1]
    marks = np.array([0, 18, 342, 360])
    left = {}
    for both in (None, middle):
        found = fit_nonrigid(FLAT, FACES, RIDGED, marks, FLAT[marks], CONFIG, both_ways=both)
        assert not Faults(FLAT, FACES, RIDGED).all(found.vertices).any()
        mesh = Target(Mesh(found.vertices, FACES))
        left[both is None] = np.quantile(mesh.closest(top).distance_mm, 0.95)
    assert left[False] < 1.0
    assert left[False] < 0.5 * left[True]


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_springs_of_both_ways_are_symmetric_positive_and_finite(scale):
    rest = FLAT + np.random.default_rng(2).normal(size=FLAT.shape) * 0.3
    config = BothWaysConfig(around_mm=12 * scale, least_mm=4 * scale, from_mm=25 * scale)
    target = Target(Mesh(scale * RIDGED.vertices, RIDGED.triangles))
    areas = vertex_areas(scale * rest, FACES)
    assert areas.sum() == pytest.approx(vertex_areas(scale * rest, FACES[::-1]).sum())
    part = BothWays(scale * rest, FACES, np.ones(len(rest), bool), areas, target, config)
    springs = Springs.none(len(rest))
    part.draw(springs, scale * rest, np.zeros_like(rest), 5.0 * scale)
    assert np.isfinite(springs.pull).all()
    assert np.allclose(springs.stiffness, springs.stiffness.swapaxes(1, 2), atol=1e-9 * scale**2)
    assert np.linalg.eigvalsh(springs.stiffness).min() > -1e-9 * scale**2
    assert np.abs(springs.pull).max() > 0
    off = Springs.none(len(rest))
    part.draw(off, scale * rest, np.zeros_like(rest), 26.0 * scale)
    assert not off.pull.any()


def test_a_part_without_vertices_or_far_from_the_scan_pulls_nothing():
    areas = vertex_areas(FLAT, FACES)
    for chosen, away in ((np.zeros(len(FLAT), bool), 0.0), (np.ones(len(FLAT), bool), 500.0)):
        part = BothWays(FLAT + away, FACES, chosen, areas, RIDGED, BothWaysConfig())
        springs = Springs.none(len(FLAT))
        part.draw(springs, FLAT + away, np.zeros_like(FLAT), 5.0)
        assert not springs.pull.any()


def test_a_crease_of_the_scan_is_no_fold_and_one_beside_it_is():
    bent = FLAT.copy()
    right = FLAT[:, 0] > 0
    bent[right] = np.stack([-0.9 * FLAT[right, 0], FLAT[right, 1], -0.4 * FLAT[right, 0]], axis=1)
    scan = Target(Mesh(bent, FACES))
    assert Faults(FLAT, FACES).folded(bent).any()
    assert not Faults(FLAT, FACES, scan).folded(bent).any()
    assert Faults(FLAT, FACES, RIDGED).folded(bent).any()
    assert not against_scan(bent, FACES, scan).any()
    assert against_scan(bent, FACES[:, ::-1], scan).mean() > 0.8
