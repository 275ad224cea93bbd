"""The split mesh: nothing of its shape is lost, and every pixel knows where it lies on it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.formats.mesh import Mesh
from processing.splitting import in_part, split, thinned, unsplit
from processing.surface import (
    LitSurface,
    at_vertices_to,
    averaging_rounds,
    depth_edges,
    fibonacci_sphere,
    lit_surface,
    see,
)
from tests.processing import lit_ball
from tests.processing.lit_ball import Ball

RIG = lit_ball.small_rig()
CAMERA = RIG.cameras[0]
LIGHTS = lit_ball.lights_of_rig(RIG)
BALL = Ball(centre_mm=(5.0, -10.0, 3.0))


def ball_mesh(subdivisions: int) -> Mesh:
    import trimesh

    shape = trimesh.creation.icosphere(subdivisions, BALL.radius_mm)
    return Mesh(np.asarray(shape.vertices) + BALL.centre_mm, np.asarray(shape.faces, np.int32))


def surface_of(subdivisions: int, finest_mm: float) -> LitSurface:
    return lit_surface(
        ball_mesh(subdivisions), LIGHTS, offset_mm=0.3, smoothing_mm=0, directions=32,
        most_faces=10**6, finest_mm=finest_mm,
    )  # fmt: skip


def random_mesh(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    vertices = rng.normal(size=(12, 3)) * 10.0 ** rng.integers(-3, 4)
    triangles = np.stack([rng.permutation(12)[:3] for _ in range(20)]).astype(np.int32)
    return vertices, triangles


def area_vectors(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(t, 3) normals as long as the triangles' areas."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return np.asarray(np.cross(b - a, c - a) / 2)


@given(seed=st.integers(0, 2**31), times=st.integers(1, 3))
@settings(max_examples=30, deadline=None)
def test_parts_cover_their_triangle_and_face_its_way(seed: int, times: int) -> None:
    vertices, triangles = random_mesh(seed)
    known = area_vectors(vertices, triangles)
    finer, parts = vertices, triangles
    for _ in range(times):
        parts, edges = split(parts, len(finer))
        finer = np.concatenate([finer, (finer[edges[:, 0]] + finer[edges[:, 1]]) / 2])
    np.testing.assert_array_equal(finer[: len(vertices)], vertices)
    found = area_vectors(finer, parts).reshape(len(triangles), 4**times, 3)
    scale = np.abs(known).max()
    np.testing.assert_allclose(found.sum(axis=1), known, atol=1e-9 * scale)
    each = np.repeat(known[:, None] / 4**times, 4**times, axis=1)
    np.testing.assert_allclose(found, each, atol=1e-9 * scale)
    assert len(np.unique(parts)) == len(np.unique(triangles)) + len(finer) - len(vertices)


@given(seed=st.integers(0, 2**31), times=st.integers(1, 4))
@settings(max_examples=30, deadline=None)
def test_places_in_parts_are_the_same_points(seed: int, times: int) -> None:
    rng = np.random.default_rng(seed)
    vertices, triangles = random_mesh(seed)
    face = rng.integers(0, len(triangles), 200)
    weights = rng.dirichlet([0.5] * 3, 200)
    # Corners, middles of edges and the middle of the triangle, too.
    weights[:7] = [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.5, 0], [0, 0.5, 0.5], [0.5, 0, 0.5],
                   [1 / 3, 1 / 3, 1 / 3]]  # fmt: skip
    known = np.einsum("nck,nc->nk", vertices[triangles[face]], weights)
    finer, parts = vertices, triangles
    for _ in range(times):
        parts, edges = split(parts, len(finer))
        finer = np.concatenate([finer, (finer[edges[:, 0]] + finer[edges[:, 1]]) / 2])
        face, weights = in_part(face, weights)
    assert (weights > -1e-9).all()
    np.testing.assert_allclose(weights.sum(axis=1), 1, rtol=1e-9)
    found = np.einsum("nck,nc->nk", finer[parts[face]], weights)
    np.testing.assert_allclose(found, known, atol=1e-9 * np.abs(vertices).max())


@pytest.mark.parametrize(("finest_mm", "splits"), [(50.0, 0), (14.0, 1), (4.0, 3)])
def test_values_at_new_vertices_lie_halfway(finest_mm: float, splits: int) -> None:
    surface = surface_of(2, finest_mm)
    assert surface.splits == splits
    own = surface.vertices[: surface.coarse]
    np.testing.assert_allclose(surface.at_all(own), surface.vertices, atol=1e-9)
    linear = own @ [0.3, -0.2, 0.7] + 4
    np.testing.assert_allclose(
        surface.at_all(linear), surface.vertices @ [0.3, -0.2, 0.7] + 4, atol=1e-9
    )
    np.testing.assert_allclose(np.linalg.norm(surface.normals, axis=1), 1, rtol=1e-9)
    np.testing.assert_allclose(surface.average.sum(axis=1), 1, rtol=1e-9)


@pytest.mark.parametrize("finest_mm", [50.0, 4.0])
def test_a_pixels_corners_hold_its_point_and_its_lights(finest_mm: float) -> None:
    surface = surface_of(3, finest_mm)
    truth = lit_ball.see(BALL, CAMERA)
    sight = see(surface, CAMERA, truth.mask)
    corners, weights = sight.shadows.corners, sight.shadows.weights
    assert (weights > -1e-5).all()
    at = at_vertices_to(surface.vertices, corners, weights)
    np.testing.assert_allclose(at, sight.points_mm, atol=0.02)
    assert corners.max() < len(surface.vertices)
    # A convex ball shadows only what lies below its own horizon.
    seen = at_vertices_to(surface.visible.astype(np.float32), corners, weights)
    normals = (sight.points_mm - np.array(BALL.centre_mm)) / BALL.radius_mm
    to_light = LIGHTS.position_mm[None] - sight.points_mm[:, None]
    to_light /= np.linalg.norm(to_light, axis=2, keepdims=True)
    above = np.einsum("nlk,nk->nl", to_light, normals)
    assert (seen[above > 0.25] > 0.999).all()
    assert (seen[above < -0.25] < 0.001).all()


@pytest.mark.parametrize("step", [2, 3, 7])
def test_every_few_pixels_are_the_same_points(step: int) -> None:
    surface = surface_of(3, 6.0)
    foreground = lit_ball.see(BALL, CAMERA).mask
    whole, some = see(surface, CAMERA, foreground), see(surface, CAMERA, foreground, step)
    assert some.step == step
    both = np.zeros(foreground.shape, bool)
    both[::step, ::step] = some.mask
    both &= whole.mask
    # A pixel on the rim may fall to either side.
    assert both.sum() >= 0.98 * some.mask.sum()
    image = np.zeros((*foreground.shape, 3), np.float32)
    image[whole.mask] = whole.points_mm
    apart = np.linalg.norm(image[::step, ::step][some.mask] - some.points_mm, axis=1)
    facing = np.einsum("nk,nk->n", some.normals, some.views)
    assert apart[facing > 0.3].max() < 0.02


def test_only_what_cameras_see_is_asked_for_lights() -> None:
    foreground = lit_ball.see(BALL, CAMERA).mask
    mesh = ball_mesh(3)
    given_to = {"offset_mm": 0.3, "smoothing_mm": 0.0, "finest_mm": 5.0}
    surface = lit_surface(
        mesh, LIGHTS, directions=32, most_faces=10**6, seen_by=[(CAMERA, foreground)], **given_to
    )
    everywhere = lit_surface(mesh, LIGHTS, directions=32, most_faces=10**6, **given_to)
    sight = see(surface, CAMERA, foreground)
    used = np.unique(sight.shadows.corners)
    np.testing.assert_array_equal(surface.visible[used], everywhere.visible[used])
    assert surface.visible.any(axis=1).sum() < 0.9 * everywhere.visible.any(axis=1).sum()


@pytest.mark.parametrize("times", [1, 2])
def test_what_was_split_is_made_whole(times: int) -> None:
    whole = ball_mesh(2)
    vertices, triangles = whole.vertices, whole.triangles()
    for _ in range(times):
        triangles, ends = split(triangles, len(vertices))
        vertices = np.concatenate([vertices, vertices[ends].mean(axis=1)])
    found = unsplit(Mesh(vertices, triangles.astype(np.int32)), len(whole.triangles()))
    np.testing.assert_array_equal(found.triangles(), whole.triangles())
    np.testing.assert_array_equal(found.vertices, whole.vertices)
    kept, faces = thinned(Mesh(vertices, triangles.astype(np.int32)), len(whole.triangles()))
    np.testing.assert_array_equal(faces, whole.triangles())
    np.testing.assert_array_equal(kept, whole.vertices)


@given(seed=st.integers(0, 2**31), at=st.integers(0, 79), corner=st.integers(0, 2))
@settings(max_examples=30, deadline=None)
def test_a_mesh_that_was_not_split_stays(seed: int, at: int, corner: int) -> None:
    vertices, triangles = random_mesh(seed)
    np.testing.assert_array_equal(unsplit(Mesh(vertices, triangles)).triangles(), triangles)
    parts, ends = split(triangles, len(vertices))
    other = parts.astype(np.int32)
    # One corner elsewhere, and it is no split mesh.
    other[at, corner] = (other[at, corner] + 1) % (len(vertices) + len(ends))
    finer = np.concatenate([vertices, vertices[ends].mean(axis=1)])
    found = unsplit(Mesh(finer, other)).triangles()
    assert len(found) == len(other) or (at % 4 < 3 and corner == at % 4)


def test_a_denser_mesh_is_thinned_and_a_small_one_is_left() -> None:
    mesh = ball_mesh(3)
    vertices, triangles = thinned(mesh, 10**6)
    np.testing.assert_array_equal(triangles, mesh.triangles())
    np.testing.assert_array_equal(vertices, mesh.vertices)
    vertices, triangles = thinned(mesh, 400)
    assert 300 < len(triangles) <= 400
    away = np.linalg.norm(vertices - np.array(BALL.centre_mm), axis=1)
    np.testing.assert_allclose(away, BALL.radius_mm, rtol=0.03)


def test_rounds_of_averaging_spread_like_the_gaussian() -> None:
    """Over a wide hexagonal lattice, on which each vertex has six neighbours."""
    edge, sigma, side = 1.0, 2.0, 61
    rows, columns = np.meshgrid(np.arange(side), np.arange(side), indexing="ij")
    x, y = columns + 0.5 * rows, rows * np.sqrt(3) / 2
    values = np.zeros((side, side))
    values[side // 2, side // 2] = 1
    for _ in range(averaging_rounds(sigma, edge)):
        around = [(0, 0), (0, 1), (0, -1), (1, 0), (-1, 0), (1, -1), (-1, 1)]
        values = np.mean([np.roll(values, shift, (0, 1)) for shift in around], axis=0)
    x, y = x - (values * x).sum(), y - (values * y).sum()
    np.testing.assert_allclose((values * x**2).sum(), sigma**2, rtol=0.06)
    np.testing.assert_allclose((values * y**2).sum(), sigma**2, rtol=0.06)


def test_depth_edges_are_steps_and_the_end_of_the_surface_and_no_slopes() -> None:
    depth = np.full((20, 30), 500, np.float32)
    depth += np.arange(30, dtype=np.float32)
    depth[:, 15:] += 10
    depth[0] = np.inf
    depth += np.arange(20, dtype=np.float32)[:, None] * 6
    found = depth_edges(depth, 4.0)
    assert found[5:15, [14, 15]].all()
    assert found[:2].all()
    assert not found[5:15, 2:13].any()
    assert not found[5:15, 17:28].any()


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_depth_edges_are_those_of_plain_second_differences(seed: int) -> None:
    rng = np.random.default_rng(seed)
    depth = (500 + rng.normal(size=(12, 17)).cumsum(axis=0)).astype(np.float32)
    depth[rng.uniform(size=depth.shape) < 0.1] = np.inf
    where = rng.uniform(size=depth.shape) < 0.5
    far = np.pad(np.where(np.isfinite(depth), depth, 1e6).astype(float), 1, mode="edge")
    known = np.zeros(depth.shape, bool)
    for dy, dx in ((0, 1), (1, 0), (1, 1), (-1, 1)):
        ahead, behind = (far[1 + s * dy : 13 + s * dy, 1 + s * dx : 18 + s * dx] for s in (1, -1))
        known |= np.abs(ahead + behind - 2 * far[1:-1, 1:-1]) > 2.5
    np.testing.assert_array_equal(depth_edges(depth, 2.5), known)
    np.testing.assert_array_equal(depth_edges(depth, 2.5, where), known & where)


def test_fibonacci_directions_are_unit_and_even() -> None:
    found = fibonacci_sphere(1000)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, rtol=1e-12)
    np.testing.assert_allclose(found.mean(axis=0), 0, atol=2e-3)
    np.testing.assert_allclose(found.T @ found / 1000, np.eye(3) / 3, atol=3e-3)
