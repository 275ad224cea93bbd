import dataclasses

import numpy as np
import pytest

from lightstage.formats.mesh import Mesh, vertex_normals
from processing.laplacian import cotangent_laplacian, neighbour_mean, tie_components
from processing.registration.config import ModesConfig, NonrigidConfig
from processing.registration.flips import Faults, crossing_triangles, folded_triangles, mend
from processing.registration.modes import fit_modes
from processing.registration.nonrigid import fit_nonrigid
from processing.registration.rigid import Similarity
from processing.registration.target import Target, border_vertices
from tests.processing.shapes import (
    RADII_MM,
    bumpy_ellipsoid,
    ellipsoid,
    ellipsoid_template,
    refined,
    warp,
)


def fit(template, scan, landmarks_mm, **changes):
    config = dataclasses.replace(NonrigidConfig(), **changes)
    mesh = template.mesh
    return fit_nonrigid(
        mesh.vertices, mesh.triangles(), Target(scan), template.landmarks, landmarks_mm, config
    )


def test_a_known_smooth_warp_is_recovered_in_surface_and_correspondence():
    template = ellipsoid_template()
    truth = warp(template.mesh.vertices)
    moved = np.linalg.norm(truth - template.mesh.vertices, axis=1).mean()
    scan = refined(template.mesh.with_vertices(truth))
    found = fit(template, scan, truth[template.landmarks])
    error = np.linalg.norm(found.vertices - truth, axis=1)
    assert moved > 7
    assert np.median(found.distance_mm) < 0.05
    assert np.quantile(found.distance_mm, 0.95) < 0.2
    # Landmarks lie on the front; behind, tangential drift has nothing but smoothness against it.
    assert error[truth[:, 2] > 20].mean() < 0.6
    assert error.mean() < 1.1
    assert not found.faulty.any()
    assert found.matched.mean() > 0.98


def test_what_the_scan_lacks_follows_smoothly():
    template = ellipsoid_template()
    truth = warp(template.mesh.vertices)
    whole = refined(template.mesh.with_vertices(truth))
    front = (whole.vertices[whole.faces][:, :, 2] > 0).all(axis=1)
    found = fit(template, Mesh(whole.vertices, whole.faces[front]), truth[template.landmarks])
    error = np.linalg.norm(found.vertices - truth, axis=1)
    seen = truth[:, 2] > 15
    assert error[seen].mean() < 0.8
    assert np.median(found.distance_mm[seen]) < 0.05
    # The back, 100 mm from any data, is guessed within the size of the warp and keeps its shape.
    assert error[~seen].mean() < 12
    assert not found.faulty.any()
    edges = template.mesh.triangles()[:, :2]
    length = np.linalg.norm(np.diff(found.vertices[edges], axis=1)[:, 0], axis=1)
    rest = np.linalg.norm(np.diff(template.mesh.vertices[edges], axis=1)[:, 0], axis=1)
    assert (length / rest).min() > 0.4
    assert (length / rest).max() < 2.0


def test_noise_on_the_scan_is_not_copied():
    template = ellipsoid_template()
    truth = warp(template.mesh.vertices)
    scan = refined(template.mesh.with_vertices(truth))
    rng = np.random.default_rng(0)
    normals = vertex_normals(scan.vertices, scan.triangles())
    noisy = scan.vertices + 0.3 * rng.normal(size=(len(normals), 1)) * normals
    found = fit(template, scan.with_vertices(noisy), truth[template.landmarks])
    clean = Target(scan).closest(found.vertices).distance_mm
    assert np.sqrt(np.mean(clean**2)) < 0.2


def test_vertices_that_are_set_free_ignore_the_scan():
    template = ellipsoid_template()
    truth = warp(template.mesh.vertices, 3.0)
    free = np.ones(len(truth), bool)
    found = fit_nonrigid(
        template.mesh.vertices,
        template.mesh.triangles(),
        Target(refined(template.mesh.with_vertices(truth))),
        template.landmarks,
        template.mesh.vertices[template.landmarks],
        NonrigidConfig(),
        free=free,
    )
    assert np.abs(found.vertices - template.mesh.vertices).max() < 1e-6
    assert not found.matched.any()


def test_progress_reaches_its_total():
    calls = []
    template = ellipsoid_template()
    fit_nonrigid(
        template.mesh.vertices,
        template.mesh.triangles(),
        Target(template.mesh),
        template.landmarks,
        template.mesh.vertices[template.landmarks],
        NonrigidConfig(stiffness_mm=(20.0, 10.0), iterations=2),
        progress=lambda done, total: calls.append((done, total)),
    )
    assert calls[-1] == (4, 4)
    assert [done for done, _ in calls] == sorted(done for done, _ in calls)
    assert len(calls) >= 3


def test_modes_of_a_known_person_are_recovered():
    template = ellipsoid_template(modes=True)
    assert template.modes is not None
    head = template.mesh.vertices + 1.5 * template.modes.identity[0]
    head = head - 1.0 * template.modes.identity[1] + 0.3 * template.modes.expression[0]
    angle = 0.2
    turn = np.array(
        [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    )
    pose = Similarity(turn, np.array([5.0, -12, 8]))
    world = pose.apply(head)
    found = fit_modes(
        template,
        template.mesh.triangles(),
        Target(refined(template.mesh.with_vertices(world))),
        world[template.landmarks],
        Similarity(np.eye(3), np.zeros(3)),
        ModesConfig(),
        free=np.zeros(len(head), bool),
    )
    assert np.allclose(found.identity, [1.5, -1.0], atol=0.15)
    assert np.allclose(found.expression, [0.3], atol=0.15)
    assert np.linalg.norm(found.vertices - world, axis=1).mean() < 0.6
    assert found.world_from_head.scale == pytest.approx(1, abs=0.01)


def test_expressions_stay_between_none_and_full():
    template = ellipsoid_template(modes=True)
    assert template.modes is not None
    opposite = template.mesh.vertices - 2.0 * template.modes.expression[0]
    found = fit_modes(
        template,
        template.mesh.triangles(),
        Target(template.mesh.with_vertices(opposite)),
        opposite[template.landmarks],
        Similarity(np.eye(3), np.zeros(3)),
        ModesConfig(),
        free=np.zeros(len(opposite), bool),
    )
    assert found.expression[0] == pytest.approx(0, abs=1e-6)


def test_closest_points_match_brute_force():
    mesh = ellipsoid(12, 16)
    triangles = mesh.triangles()
    rng = np.random.default_rng(0)
    queries = rng.normal(size=(40, 3)) * RADII_MM
    found = Target(mesh).closest(queries)
    for query, point, distance in zip(queries, found.point, found.distance_mm, strict=True):
        plain = min(_to_triangle(query, *mesh.vertices[t]) for t in triangles)
        assert distance == pytest.approx(plain, abs=1e-3)
        assert np.linalg.norm(point - query) == pytest.approx(distance)


def _to_triangle(p, a, b, c):
    """Distance to the plane where the foot lies inside, else to the nearest edge."""
    normal = np.cross(b - a, c - a)
    if not normal.any():
        return np.inf
    normal /= np.linalg.norm(normal)
    foot = p - normal * (normal @ (p - a))
    sides = [normal @ np.cross(v - u, foot - u) for u, v in ((a, b), (b, c), (c, a))]
    if min(sides) >= 0:
        return abs(normal @ (p - a))
    edges = []
    for u, v in ((a, b), (b, c), (c, a)):
        share = np.clip((p - u) @ (v - u) / ((v - u) @ (v - u)), 0, 1)
        edges.append(np.linalg.norm(u + share * (v - u) - p))
    return min(edges)


def test_closest_points_on_an_open_border_are_flagged():
    mesh = bumpy_ellipsoid()
    front = (mesh.vertices[mesh.faces][:, :, 2] > 0).all(axis=1)
    target = Target(Mesh(mesh.vertices, mesh.faces[front]))
    found = target.closest(np.array([[0.0, 0, -200], [0.0, 0, 200], [30.0, 30, 110]]))
    assert found.border.tolist() == [True, False, False]
    assert not border_vertices(mesh.triangles(), len(mesh.vertices)).any()


def test_degenerate_triangles_of_a_scan_do_no_harm():
    mesh = ellipsoid()
    faces = np.concatenate([mesh.faces, [[0, 0, 1], [5, 5, 5]]]).astype(np.int32)
    found = Target(Mesh(mesh.vertices, faces)).closest(mesh.vertices * 1.1)
    assert np.isfinite(found.point).all()
    assert np.allclose(np.linalg.norm(found.normal, axis=1), 1)


def test_laplacian_knows_areas_constants_and_linear_functions():
    mesh = ellipsoid(60, 80)
    sphere = mesh.vertices / RADII_MM * 50
    stiffness, areas = cotangent_laplacian(sphere, mesh.triangles())
    assert areas.sum() == pytest.approx(4 * np.pi * 50**2, rel=5e-3)
    assert np.abs(stiffness @ np.ones(len(sphere))).max() < 1e-9
    # On a sphere the coordinates are eigenfunctions: 2 / r^2.
    ratio = (sphere * (stiffness @ sphere)).sum() / (areas[:, None] * sphere**2).sum()
    assert ratio == pytest.approx(2 / 50**2, rel=0.02)
    assert np.abs((stiffness - stiffness.T).data).max(initial=0) < 1e-12


def test_laplacian_of_slivers_and_points_is_finite():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 1e-12, 0], [2, 2, 2]])
    stiffness, areas = cotangent_laplacian(vertices, np.array([[0, 1, 2], [3, 3, 3]]))
    assert np.isfinite(stiffness.toarray()).all()
    assert np.isfinite(areas).all()
    assert np.linalg.eigvalsh(stiffness.toarray()).min() > -1e-9


def test_loose_parts_are_tied_to_the_body():
    body = ellipsoid(10, 12)
    eye = ellipsoid(4, 6)
    vertices = np.concatenate([body.vertices, eye.vertices * 0.1 + [30, 30, 80]])
    triangles = np.concatenate([body.triangles(), eye.triangles() + len(body.vertices)])
    tie = tie_components(vertices, triangles, 2.0)
    assert np.abs(tie @ np.ones(len(vertices))).max() < 1e-12
    assert (tie.diagonal()[len(body.vertices) :] == 2.0).all()
    assert tie_components(body.vertices, body.triangles(), 2.0).nnz == 0


def test_a_fold_is_found_and_mended():
    mesh = bumpy_ellipsoid()
    triangles = mesh.triangles()
    folded = mesh.vertices.copy()
    victim = int(np.argmax(folded[:, 2]))
    folded[victim] += [14, 3, -2]
    assert folded_triangles(mesh.vertices, folded, triangles).any()
    assert not folded_triangles(mesh.vertices, mesh.vertices, triangles).any()
    mended, faulty, before = mend(Faults(mesh.vertices, triangles), folded, triangles, rounds=20)
    assert before > 0
    assert not faulty.any()
    assert not folded_triangles(mesh.vertices, mended, triangles).any()
    # The rings around a fault move too; edges are up to 13 mm long here.
    far = np.linalg.norm(folded - folded[victim], axis=1) > 50
    assert np.array_equal(mended[far], folded[far])


def test_what_is_mended_ends_without_a_step():
    # Two sheets joined at one side, the upper pushed through the lower.
    side = np.arange(25.0)
    x, y = (a.ravel() for a in np.meshgrid(np.concatenate([side, side[::-1][1:]]), side))
    upper = np.tile(np.arange(49) > 24, 25)
    rest = np.stack([x, y, np.where(upper, 4.0, 0.0)], axis=1)
    near = np.exp(-((x - 10) ** 2 + (y - 12) ** 2) / 18)
    pushed = rest - np.outer(upper * near, [0, 0, 7.0])
    cell = (np.arange(24)[:, None] * 49 + np.arange(48)).reshape(-1, 1)
    triangles = (cell + np.array([0, 1, 49, 1, 50, 49])).reshape(-1, 3)
    mended, faulty, before = mend(Faults(rest, triangles), pushed, triangles, rounds=20)
    assert before > 0
    assert not faulty.any()
    joined = neighbour_mean(triangles, len(rest))
    rough = np.linalg.norm(mended - joined @ mended, axis=1)
    at_rest = np.linalg.norm(rest - joined @ rest, axis=1)
    assert (rough - at_rest).max() < 0.25


def test_crossing_triangles_are_found_and_neighbours_are_not():
    flat = np.array([[0.0, 0, 0], [10, 0, 0], [0, 10, 0]])
    through = np.array([[2.0, 2, -3], [3, 2, 5], [2, 3, 5]])
    beside = np.array([[20.0, 0, 0], [30, 0, 0], [20, 10, 1]])
    vertices = np.concatenate([flat, through, beside])
    triangles = np.arange(9).reshape(3, 3)
    assert crossing_triangles(vertices, triangles).tolist() == [True, True, False]
    mesh = bumpy_ellipsoid()
    assert not crossing_triangles(mesh.vertices, mesh.triangles()).any()
