"""The linear algebra of registration against plain answers; landmarks that others contradict."""

import dataclasses

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.formats.mesh import Mesh
from processing.laplacian import cotangent_laplacian
from processing.registration.config import GateConfig, NonrigidConfig, PlateConfig
from processing.registration.matches import Matcher
from processing.registration.nonrigid import fit_nonrigid, hovering
from processing.registration.plate import Plate, Springs, contradicted
from processing.registration.target import Target
from tests.processing.shapes import ellipsoid, ellipsoid_template, refined, warp

SMALL = ellipsoid(8, 10)
EXACT = PlateConfig(iterations=2000, settled_mm=1e-9)


def springs_of(rng, count, weight):
    springs = Springs.none(count)
    chosen = rng.permutation(count)[: count // 2]
    normal = rng.normal(size=(len(chosen), 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    matrix = normal[:, :, None] * normal[:, None, :] + 0.1 * np.eye(3)
    springs.add(chosen, weight * matrix, rng.normal(size=(len(chosen), 3)))
    return springs


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10**6), stiffness=st.sampled_from([0.5, 3.0, 30.0, 200.0]))
def test_the_plate_agrees_with_a_dense_solve(seed, stiffness):
    rng = np.random.default_rng(seed)
    count = len(SMALL.vertices)
    plate = Plate(SMALL.vertices, SMALL.triangles(), EXACT)
    springs = springs_of(rng, count, 100.0)
    for level in (3 * stiffness, stiffness):  # the second factor uses the first one's order
        plate.stiffen(level, springs)
    found = plate.solve(springs, np.zeros((count, 3)))
    stretch, _ = cotangent_laplacian(SMALL.vertices, SMALL.triangles())
    inverse = sp.diags(1 / plate.areas)
    bend = stretch @ inverse @ stretch
    matrix = stiffness**4 * bend + EXACT.stretch_share * stiffness**2 * stretch
    dense = np.kron(matrix.toarray(), np.eye(3)) + 1e-9 * np.diag(np.repeat(plate.areas, 3))
    for i in range(count):
        dense[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] += springs.stiffness[i]
    truth = np.linalg.solve(dense, springs.pull.ravel()).reshape(-1, 3)
    assert np.abs(found - truth).max() < 1e-4
    # What it says of its residual is what it left.
    left = np.linalg.norm(dense @ found.ravel() - springs.pull.ravel())
    text = plate.worst_residual * np.linalg.norm(springs.pull)
    assert text == pytest.approx(left, rel=0.2, abs=1e-6)


def test_smooth_is_the_solve_of_equal_springs():
    count = len(SMALL.vertices)
    plate = Plate(SMALL.vertices, SMALL.triangles(), EXACT)
    springs = Springs.none(count)
    springs.add(np.arange(count), np.tile(5 * np.eye(3), (count, 1, 1)), SMALL.vertices)
    plate.stiffen(10.0, springs)
    assert np.allclose(
        plate.smooth(springs.pull), plate.solve(springs, np.zeros((count, 3))), atol=1e-5
    )


def test_a_plate_where_nothing_pulls_stays():
    plate = Plate(SMALL.vertices, SMALL.triangles(), PlateConfig())
    springs = Springs.none(len(SMALL.vertices))
    plate.stiffen(10.0, springs)
    assert np.abs(plate.solve(springs, np.zeros_like(SMALL.vertices))).max() == 0


def process(rng, count):
    """A smooth random field at points on a line, and its covariance with noise on the diagonal."""
    place = np.sort(rng.uniform(0, 10, size=count))
    reach = np.exp(-((place[:, None] - place[None]) ** 2) / 8) + 1e-4 * np.eye(count)
    return np.linalg.cholesky(reach) @ rng.normal(size=(count, 3)), reach


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6), scale=st.sampled_from([1e-3, 1.0, 1e3]))
def test_contradicted_landmarks_are_found_and_others_kept(seed, scale):
    rng = np.random.default_rng(seed)
    gaps, reach = process(rng, 40)
    assert not contradicted(gaps, reach, 0.5, 6.0).any()
    gaps[7] += [3, 0, 0]
    gaps[30] += [0, -3, 0]
    found = contradicted(scale * gaps, reach, 0.5 * scale, 6.0)
    assert np.flatnonzero(found).tolist() == [7, 30]


def test_never_more_than_a_quarter_is_left_out():
    rng = np.random.default_rng(0)
    _, reach = process(rng, 20)
    assert contradicted(rng.normal(size=(20, 3)) ** 7 * 100, reach, 0.1, 1.0).sum() <= 5


def test_a_landmark_that_hovers_is_found_unless_over_a_hole():
    scan = refined(ellipsoid())
    marks = scan.vertices[::150].copy()
    marks[3] *= 1.05
    found = hovering(marks, Target(scan), NonrigidConfig())
    assert np.flatnonzero(found).tolist() == [3]
    near = np.linalg.norm(scan.vertices[scan.faces].mean(axis=1) - marks[3], axis=1)
    holed = Mesh(scan.vertices, scan.faces[near > 12])
    assert not hovering(marks, Target(holed), NonrigidConfig())[3]


def half(mesh, height):
    return Mesh(
        mesh.vertices, mesh.faces[(mesh.vertices[mesh.faces][:, :, 1] > height).all(axis=1)]
    )


def test_borders_follow_borders_but_not_a_cut_through_the_middle():
    mesh = half(ellipsoid(), -60.0)
    hidden = np.zeros(len(mesh.vertices), bool)
    shorter, cut = half(refined(ellipsoid()), -52.0), half(refined(ellipsoid()), 20.0)
    near = Matcher(mesh.triangles(), Target(shorter), hidden, GateConfig())
    assert len(near.match(mesh.vertices, 20.0).border) > 30
    far = Matcher(mesh.triangles(), Target(cut), hidden, GateConfig())
    assert len(far.match(mesh.vertices, 20.0).border) == 0
    off = Matcher(mesh.triangles(), Target(shorter), hidden, GateConfig(borders=False))
    assert len(off.match(mesh.vertices, 20.0).border) == 0


def test_the_gate_widens_with_the_way_to_the_nearest_landmark():
    mesh = ellipsoid()
    away = Mesh(1.15 * mesh.vertices, mesh.faces)
    hidden = np.zeros(len(mesh.vertices), bool)
    far = np.linspace(0.0, 60.0, len(hidden))
    matcher = Matcher(mesh.triangles(), Target(away), hidden, GateConfig(), far)
    found = matcher.match(mesh.vertices, 2.5)
    wide = found.closest.distance_mm < np.maximum(3.0, 0.7 * far)
    assert np.array_equal(found.follows, wide)
    assert 0 < wide.sum() < len(wide)
    narrow = Matcher(mesh.triangles(), Target(away), hidden, GateConfig())
    assert not narrow.match(mesh.vertices, 2.5).follows.any()


def leaning(share):
    """A head on a neck that the scan leans forward; worst distance of the neck to the scan, mm."""
    template = ellipsoid_template()
    rest = template.mesh.vertices * [1, 2, 1]
    truth = rest.copy()
    truth[:, 2] += 0.7 * np.clip(-40 - rest[:, 1], 0, None)
    marks = template.landmarks[rest[template.landmarks, 1] > 0]
    found = fit_nonrigid(
        rest,
        template.mesh.triangles(),
        Target(refined(template.mesh.with_vertices(truth))),
        marks,
        truth[marks],
        NonrigidConfig(gate=GateConfig(far_share=share)),
    )
    return np.quantile(found.distance_mm[rest[:, 1] < -60], 0.95)


def test_a_neck_that_leans_far_is_followed():
    assert leaning(0.7) < 0.2
    assert leaning(0.0) > 3


@given(st.integers(0, 10**6), st.sampled_from([0.0, 0.001, 0.5, 5.0]))
@settings(max_examples=15, deadline=None)
def test_what_has_not_moved_keeps_its_closest_point(seed, step_mm):
    rng = np.random.default_rng(seed)
    mesh = ellipsoid(12, 16)
    hidden = rng.random(len(mesh.vertices)) < 0.2
    target = Target(Mesh(1.01 * mesh.vertices, mesh.faces))
    skips = Matcher(mesh.triangles(), target, hidden, GateConfig())
    anew = Matcher(
        mesh.triangles(), target, hidden, dataclasses.replace(GateConfig(), unmoved_mm=-1.0)
    )
    place = mesh.vertices.copy()
    for _ in range(3):
        some = rng.random(len(place)) < 0.5
        place = place + step_mm * some[:, None] * rng.normal(size=place.shape)
        first, second = skips.match(place, 20.0), anew.match(place, 20.0)
        longer = first.closest.distance_mm - second.closest.distance_mm
        assert longer.min() > -1e-3  # Open3D's float32
        assert longer.max() < 2 * GateConfig().unmoved_mm + 1e-3
        assert np.array_equal(first.follows, second.follows)
    assert anew.kept == 0
    assert anew.queried == skips.queried == 3 * len(place)
    assert (skips.kept == 2 * len(place)) == (step_mm < 0.1)


def test_hidden_vertices_follow_cavities_only():
    outside = ellipsoid()
    inner = outside.with_vertices(outside.vertices * 0.9)
    both = Mesh(
        np.concatenate([outside.vertices, inner.vertices]),
        np.concatenate([outside.faces, inner.faces + len(outside.vertices)]),
    )
    hidden = np.ones(len(outside.vertices), bool)
    shell = Matcher(outside.triangles(), Target(both), hidden, GateConfig())
    assert not shell.match(outside.vertices, 10.0).follows.any()
    assert shell.match(inner.vertices, 10.0).follows.mean() > 0.9


@pytest.mark.parametrize("noise_mm", [0.0, 0.1, 0.4])
def test_noise_is_measured(noise_mm):
    mesh = refined(refined(ellipsoid()))
    rng = np.random.default_rng(1)
    out = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    noisy = mesh.with_vertices(mesh.vertices + noise_mm * rng.normal(size=(len(out), 1)) * out)
    assert Target(noisy).noise_mm() == pytest.approx(noise_mm, rel=0.15, abs=0.03)


def test_threads_do_not_change_the_result(tmp_path):
    """Registered in two processes, of one thread and of two."""
    import os
    import subprocess
    import sys

    code = (
        "import sys, numpy as np\n"
        "from tests.processing.test_registration_plate import registered\n"
        "np.save(sys.argv[1], registered())\n"
    )
    found = []
    for threads in ("1", "2"):
        names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
        environment = {**os.environ, **dict.fromkeys(names, threads)}
        path = tmp_path / f"{threads}.npy"
        subprocess.run([sys.executable, "-c", code, str(path)], check=True, env=environment)
        found.append(np.load(path))
    assert np.abs(found[0] - found[1]).max() < 1e-6


def registered():
    template = ellipsoid_template()
    truth = warp(template.mesh.vertices)
    scan = refined(template.mesh.with_vertices(truth))
    config = dataclasses.replace(NonrigidConfig(), stiffness_mm=(40.0, 10.0, 3.0))
    marks = truth[template.landmarks]
    mesh = template.mesh
    return fit_nonrigid(
        mesh.vertices, mesh.triangles(), Target(scan), template.landmarks, marks, config
    ).vertices
