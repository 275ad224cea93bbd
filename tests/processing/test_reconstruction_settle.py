import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.formats.mesh import Mesh, vertex_normals
from processing.reconstruction.settle import (
    LEAST,
    OFF,
    REACH,
    ROUNDS,
    SHORT,
    TURNED,
    facing,
    settled,
)

RADIUS_MM = 20.0
SCENES = given(
    seed=st.integers(0, 10**6),
    sigma=st.floats(0.2, 2.0),
    shift=st.sampled_from([0.0, 1e5]),
    bad=st.sampled_from([np.nan, np.inf, -np.inf, 1e12]),
)
"""Points drawn, how far they are averaged, how far from the origin, and what bad ones are."""


def cap(step_mm: float, radius_mm: float = RADIUS_MM) -> Mesh:
    """The upper part of a ball, its vertices about `step_mm` apart."""
    count = int(16 / step_mm)
    x, y = np.meshgrid(np.linspace(-8, 8, count), np.linspace(-8, 8, count))
    z = np.sqrt(radius_mm**2 - x**2 - y**2)
    index = np.arange(count * count).reshape(count, count)
    a, b, c, d = (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1])
    faces = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    return Mesh(np.stack([x, y, z], axis=-1).reshape(-1, 3), faces.astype(np.int32))


def points_on_ball(step_mm: float = 0.25) -> tuple[np.ndarray, np.ndarray]:
    points = cap(step_mm).vertices
    return points, points / RADIUS_MM


def error_mm(vertices: np.ndarray) -> np.ndarray:
    inside = (np.abs(vertices[:, :2]) < 6.5).all(axis=1)
    return np.abs(np.linalg.norm(vertices[inside], axis=1) - RADIUS_MM)


def plain(mesh: Mesh, points: np.ndarray, normals: np.ndarray, sigma: float) -> np.ndarray:
    """The same, over all points, one vertex after the other."""
    vertices = mesh.vertices.astype(float)
    for _ in range(ROUNDS):
        own, moved = vertex_normals(vertices, mesh.faces), vertices.copy()
        for k, (p, n) in enumerate(zip(vertices, own, strict=True)):
            apart = points - p
            off = apart @ n
            across = (apart**2).sum(axis=1) - off**2
            with np.errstate(invalid="ignore"):
                kept = (across < (REACH * sigma) ** 2) & (np.abs(off) < OFF * sigma)
                kept &= normals @ n > TURNED
            weight = np.exp(-0.5 * across[kept] / sigma**2)
            both = 0.5 * (off + (apart * normals).sum(axis=1))[kept]
            if weight.sum() > LEAST:
                moved[k] = p + (weight * both).sum() / weight.sum() * n
        vertices = moved
    return vertices


def test_vertices_come_onto_a_bent_surface_without_bias() -> None:
    mesh = cap(1.2, RADIUS_MM - 0.1)
    rng = np.random.default_rng(0)
    rough = Mesh(mesh.vertices + rng.normal(0, 0.05, mesh.vertices.shape), mesh.faces)
    found = settled(rough, *points_on_ball(), 0.6)
    assert np.median(error_mm(rough.vertices)) > 0.08
    # A plane through the points' mean alone would lie sigma^2 / R = .018 mm too deep.
    assert error_mm(found.vertices).max() < 0.004


def test_noise_of_points_is_averaged() -> None:
    points, normals = points_on_ball()
    noise = np.random.default_rng(1).normal(0, 0.05, len(points))
    found = settled(cap(1.2), points + noise[:, None] * normals, normals, 0.6)
    assert np.median(error_mm(found.vertices)) < 0.01


@settings(max_examples=25, deadline=None)
@SCENES
def test_it_is_its_plain_twin(seed: int, sigma: float, shift: float, bad: float) -> None:
    rng = np.random.default_rng(seed)
    mesh = cap(4.0)
    points, normals = points_on_ball(1.5)
    points = points + rng.normal(0, 0.3, points.shape)
    normals = np.where(rng.random((len(points), 1)) < 0.1, -normals, normals)
    points[rng.random(len(points)) < 0.05] = bad
    moved = Mesh(mesh.vertices + shift, mesh.faces)
    found = settled(moved, points + shift, normals, sigma).vertices - shift
    twin = plain(mesh, points[np.abs(points).max(axis=1) < 1e6], normals_of(points, normals), sigma)
    np.testing.assert_allclose(found, twin, atol=1e-6)


def plain_facing(
    mesh: Mesh, points: np.ndarray, normals: np.ndarray, sigma: float
) -> tuple[np.ndarray, np.ndarray]:
    """The same, over all points, one vertex after the other."""
    own = vertex_normals(mesh.vertices, mesh.faces)
    out, known = own.copy(), np.zeros(len(own), bool)
    for k, (p, n) in enumerate(zip(mesh.vertices, own, strict=True)):
        apart = points - p
        off = apart @ n
        across = (apart**2).sum(axis=1) - off**2
        kept = (across < (REACH * sigma) ** 2) & (np.abs(off) < OFF * sigma)
        kept &= normals @ n > TURNED
        weight = np.exp(-0.5 * across[kept] / sigma**2)
        total = weight @ normals[kept]
        length = np.linalg.norm(total)
        if weight.sum() > LEAST and length > SHORT * weight.sum():
            out[k], known[k] = total / length, True
    return out, known


@settings(max_examples=25, deadline=None)
@SCENES
def test_what_points_face_is_its_plain_twin(
    seed: int, sigma: float, shift: float, bad: float
) -> None:
    rng = np.random.default_rng(seed)
    mesh = cap(4.0)
    points, normals = points_on_ball(1.0)
    points = points + rng.normal(0, 0.2, points.shape)
    normals = normals + rng.normal(0, 0.3, normals.shape)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points[rng.random(len(points)) < 0.05] = bad
    found, known = facing(Mesh(mesh.vertices + shift, mesh.faces), points + shift, normals, sigma)
    good = np.abs(points).max(axis=1) < 1e6
    twin, twin_known = plain_facing(mesh, points[good], normals[good], sigma)
    np.testing.assert_array_equal(known, twin_known)
    np.testing.assert_allclose(found, twin, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, atol=1e-9)


def test_points_that_contradict_each_other_show_no_direction() -> None:
    mesh = cap(2.0)
    points, normals = points_on_ball()
    tipped = normals + 0.9 * np.where(np.arange(len(points))[:, None] % 2, 1.0, -1.0) * [1, 0, 0]
    tipped /= np.linalg.norm(tipped, axis=1, keepdims=True)
    found, known = facing(mesh, points, tipped, 0.6)
    assert not known.any()
    np.testing.assert_array_equal(found, vertex_normals(mesh.vertices, mesh.faces))


def normals_of(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore"):
        return normals[np.abs(points).max(axis=1) < 1e6]


def test_a_mesh_stays_where_there_is_nothing_to_go_by() -> None:
    mesh = cap(2.0)
    points, normals = points_on_ball()
    none = np.zeros((0, 3))
    for found in (
        settled(mesh, none, none, 0.6),
        settled(mesh, points, normals, 0.0),
        settled(mesh, points + 50.0, normals, 0.6),
        settled(mesh, points, -normals, 0.6),
    ):
        np.testing.assert_array_equal(found.vertices, mesh.vertices)


@pytest.mark.parametrize("threads", [1, 2])
def test_threads_do_not_change_it(threads: int) -> None:
    if threads > numba.config.NUMBA_NUM_THREADS:
        pytest.skip("one processor")
    mesh = cap(1.2, RADIUS_MM - 0.1)
    usual = settled(mesh, *points_on_ball(), 0.6).vertices
    before = numba.get_num_threads()
    try:
        numba.set_num_threads(threads)
        found = settled(mesh, *points_on_ball(), 0.6).vertices
    finally:
        numba.set_num_threads(before)
    np.testing.assert_array_equal(found, usual)
