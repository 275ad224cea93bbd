from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from lightstage.formats.mesh import vertex_normals
from sim.errors import SimError
from sim.head.maps import surface_normals, to_tile
from sim.head.mesh import landmarks, neutral_mesh
from sim.people.person import parametric_subject, person_skin
from sim.people.traits import Traits
from sim.skin.noise import cell_noise, gradient_noise, octaves
from sim.skin.paint import face_of, make_skin, random_complexion

ROWS = 192


def skin_of(seed: int, rows: int = ROWS):
    rng = np.random.default_rng(seed)
    face = face_of(rows, rows * 2 // 3, int(rng.integers(2**20)))
    return make_skin(random_complexion(rng), face, rng)


def plain_hash(x: int, y: int, z: int, seed: int) -> int:
    h = (x * 374761393 + y * 668265263 + z * 2147483647 + seed * 1274126177) & 0xFFFFFFFF
    h = ((h ^ (h >> 15)) * 2246822519) & 0xFFFFFFFF
    h = ((h ^ (h >> 13)) * 3266489917) & 0xFFFFFFFF
    return h ^ (h >> 16)


def plain_gradient_noise(point, cell: float, seed: int) -> float:
    p = [c / cell for c in point]
    base = [math.floor(c) for c in p]
    f = [c - b for c, b in zip(p, base, strict=True)]
    ease = [t**3 * (t * (t * 6 - 15) + 10) for t in f]
    total = 0.0
    for corner in np.ndindex(2, 2, 2):
        weight = math.prod(e if c else 1 - e for e, c in zip(ease, corner, strict=True))
        h = plain_hash(*(b + c for b, c in zip(base, corner, strict=True)), seed)
        d = [t - c for t, c in zip(f, corner, strict=True)]
        kind = h % 12
        first = d[0] if kind < 8 else d[1]
        second = d[1] if kind < 4 else d[2]
        total += weight * ((first if h & 4096 else -first) + (second if h & 8192 else -second))
    return total


def test_gradient_noise_agrees_with_its_plain_twin():
    points = np.random.default_rng(0).uniform(-90, 90, (200, 3)).astype(np.float32)
    expected = [plain_gradient_noise(p, 3.7, 11) for p in points]
    assert np.allclose(gradient_noise(points, 3.7, 11), expected, atol=1e-6)


def test_cell_noise_finds_the_nearest_of_all_scattered_points():
    rng = np.random.default_rng(1)
    queries = rng.uniform(-4, 4, (60, 3)).astype(np.float32)
    scattered = []
    for cell in np.ndindex(14, 14, 14):
        corner = np.array(cell) - 7
        h = plain_hash(*corner.tolist(), 5)
        jitter = np.array([h & 1023, (h >> 10) & 1023, (h >> 20) & 1023]) / 1023
        scattered.append(corner + 0.1 + 0.8 * jitter)
    away = np.linalg.norm(queries[:, None] - np.array(scattered), axis=-1).min(axis=1)
    # Within one cell's size the search of 27 cells is exact.
    found, label = cell_noise(queries * np.float32(1.3), 1.3, 5)
    near = away < 0.9
    assert near.sum() > 50
    assert np.allclose(found[near], 1.3 * away[near], atol=1e-5)
    assert ((label >= 0) & (label <= 1)).all()


def test_noise_has_unit_deviation_and_no_offset():
    points = np.random.default_rng(2).uniform(-500, 500, (20_000, 3))
    noise = octaves(points, 4.0, 3, 9)
    assert abs(noise.mean()) < 0.05
    assert 0.85 < noise.std() < 1.15


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.floats(-1e6, 1e6), min_size=3, max_size=3),
    st.sampled_from([1e-6, 1e-3, 1.0, 1e3, 1e6]),
    st.integers(0, 2**31),
)
def test_noise_is_finite_and_bounded_at_every_scale(point, cell_mm, seed):
    points = np.array([point], np.float32)
    assert abs(gradient_noise(points, cell_mm, seed)[0]) <= 1.2
    distance, label = cell_noise(points, cell_mm, seed)
    assert 0 <= distance[0] <= 1.8 * cell_mm
    assert 0 <= label[0] <= 1


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_noise_of_no_place_is_no_number(bad):
    points = np.array([[0.0, bad, 0.0]], np.float32)
    assert np.isnan(gradient_noise(points, 2.0, 1)[0])
    distance, label = cell_noise(points, 2.0, 1)
    assert not np.isfinite(distance[0])
    assert np.isnan(label[0])


def test_noise_is_the_same_on_any_number_of_threads():
    import numba

    points = np.random.default_rng(3).uniform(-50, 50, (5000, 3)).astype(np.float32)
    many = gradient_noise(points, 2.0, 4)
    before = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        one = gradient_noise(points, 2.0, 4)
    finally:
        numba.set_num_threads(before)
    assert np.array_equal(one, many)


MAPS = ("diffuse_albedo", "specular_albedo", "roughness", "translucency", "relief_mm")


@settings(max_examples=5, deadline=None, phases=[Phase.explicit, Phase.generate])
@given(st.integers(0, 2**32 - 1))
def test_skin_is_physical_for_any_seed(seed):
    skin = skin_of(seed, 96)
    for name in MAPS:
        assert np.isfinite(getattr(skin, name)).all()
    assert skin.diffuse_albedo.min() > 0
    assert skin.diffuse_albedo.max() < 1
    red, green, blue = skin.diffuse_albedo[skin.skin].mean(axis=0)
    assert 0.04 < red < 0.65
    assert red > green > blue > 0.01
    assert 0.02 < skin.specular_albedo[skin.skin].mean() < 0.035
    rough = skin.roughness[skin.skin]
    assert 0.12 <= rough.min() <= rough.max() <= 0.42
    assert np.abs(skin.relief_mm).max() < 0.6
    assert 0 <= skin.translucency.min() <= skin.translucency.max() <= 1


def test_the_same_seed_gives_the_same_bytes_and_another_seed_does_not():
    one, same, other = skin_of(5, 96), skin_of(5, 96), skin_of(6, 96)
    for name in (*MAPS, "skin"):
        assert getattr(one, name).tobytes() == getattr(same, name).tobytes()
        assert getattr(one, name).tobytes() != getattr(other, name).tobytes()


def test_lips_are_redder_and_brows_darker_than_the_cheek():
    skin = person_skin(8, Traits("female", 25.0, 2), ROWS)
    mesh = neutral_mesh()
    grid = to_tile(mesh.vertices, *skin.skin.shape)

    def colour(place) -> np.ndarray:
        near = np.linalg.norm(grid - np.array(place, np.float32), axis=-1) < 4
        return skin.diffuse_albedo[near].mean(axis=0)

    cheek, brow = colour(mesh.vertices[landmarks()[14]]), colour(mesh.vertices[landmarks()[24]])
    lip = colour(mesh.vertices[landmarks()[57]] + (0, 3, 0))
    assert lip[0] / lip[1] > 1.15 * cheek[0] / cheek[1]
    assert brow.mean() < 0.85 * cheek.mean()


def test_maps_of_another_size_show_the_same_person():
    small, large = skin_of(3, 192), skin_of(3, 384)
    halved = large.diffuse_albedo.reshape(192, 2, 128, 2, 3).mean(axis=(1, 3))
    both = small.skin & large.skin.reshape(192, 2, 128, 2).all(axis=(1, 3))
    assert np.abs(halved - small.diffuse_albedo)[both].mean() < 0.02


def test_normals_of_a_flat_relief_are_the_meshs_own():
    mesh = neutral_mesh()
    found = surface_normals(mesh, np.zeros((192, 128), np.float32))
    smooth = to_tile(vertex_normals(mesh.vertices, mesh.triangles()), 192, 128)
    smooth /= np.linalg.norm(smooth, axis=-1, keepdims=True)
    assert np.abs(found - smooth).max() < 1e-5


@pytest.mark.parametrize("slope", [(0.1, 0.0, 0.0), (0.0, 0.1, 0.0), (-0.05, 0.08, 0.1)])
def test_normals_lean_away_from_a_rising_relief(slope):
    # A relief h = g . p has the surface gradient g - n (n . g): known in closed form.
    mesh = neutral_mesh()
    rows, columns = 384, 256
    height = to_tile(mesh.vertices, rows, columns) @ np.array(slope, np.float32)
    found = surface_normals(mesh, height)
    normal = surface_normals(mesh, np.zeros((rows, columns), np.float32))
    gradient = np.array(slope) - normal * (normal @ np.array(slope))[..., None]
    expected = normal - gradient
    expected /= np.linalg.norm(expected, axis=-1, keepdims=True)
    angle = np.degrees(np.arccos(np.clip((found * expected).sum(-1), -1, 1)))
    # Smooth normals differ a little from the faceted surface the relief is measured on.
    face = to_tile(mesh.vertices, rows, columns)[..., 2] > 40
    assert np.median(angle[face]) < 0.3
    assert np.percentile(angle[face], 95) < 2.0


def test_subject_sits_in_the_stage_with_unit_normals():
    person = parametric_subject("p", 7, texture_rows=ROWS)
    assert person.diffuse_albedo.shape == (192, 128, 3)
    assert person.diffuse_albedo.dtype == np.float32
    assert np.abs(np.linalg.norm(person.normal, axis=-1) - 1).max() < 1e-5
    turn, shift = person.head_from_world[:, :3], person.head_from_world[:, 3]
    assert np.allclose(turn @ turn.T, np.eye(3))
    assert np.linalg.det(turn) == pytest.approx(1)
    assert np.degrees(np.arccos((np.trace(turn) - 1) / 2)) < 8
    head_mm = person.mesh.vertices @ turn.T + shift
    assert np.abs(head_mm - neutral_mesh().vertices).max() < 25
    assert np.allclose(person.landmarks_mm, person.mesh.vertices[landmarks()])
    assert np.linalg.norm(person.landmarks_mm[27:].mean(axis=0)) < 30
    assert person.landmarks_mm[30, 2] > 20
    assert 0.2 < person.skin.mean() < 0.8


def test_a_persons_expressions_share_head_skin_and_pose():
    neutral = parametric_subject("p", 4, texture_rows=96)
    smile = parametric_subject("p", 4, "smile", texture_rows=96)
    assert np.array_equal(neutral.diffuse_albedo, smile.diffuse_albedo)
    assert np.array_equal(neutral.head_from_world, smile.head_from_world)
    moved = np.linalg.norm(neutral.mesh.vertices - smile.mesh.vertices, axis=1)
    assert 4 < moved.max() < 12
    assert np.median(moved) < 0.1


def test_subject_of_the_same_seed_has_the_same_bytes():
    one, two = (parametric_subject("p", 9, texture_rows=96) for _ in range(2))
    for field in ("diffuse_albedo", "normal", "landmarks_mm", "head_from_world", "roughness"):
        assert getattr(one, field).tobytes() == getattr(two, field).tobytes()
    assert one.mesh.vertices.tobytes() == two.mesh.vertices.tobytes()


@pytest.mark.parametrize("rows", [0, 95, 100, -3])
def test_a_size_that_the_tile_cannot_have_is_refused(rows):
    with pytest.raises(SimError, match="multiple of 3"):
        parametric_subject("p", 1, texture_rows=rows)


def test_an_unknown_expression_is_refused():
    with pytest.raises(SimError, match="neutral, smile"):
        parametric_subject("p", 1, "sneer", texture_rows=96)
