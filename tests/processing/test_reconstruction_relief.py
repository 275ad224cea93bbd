import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse
from scipy.sparse.linalg import spsolve

from processing.reconstruction.config import ReconstructConfig
from processing.reconstruction.relief import low_pass, normals_of, solve, with_relief
from processing.reconstruction.slopes import plane_slopes

LENS = np.array([1500.0, 1500.0, 80.0, 60.0])
POSE = np.hstack([np.diag([1.0, -1.0, -1.0]), [[0.0], [0.0], [1000.0]]])
SHAPE = (120, 160)
PIXEL_MM = 1000 / 1500


def surface(wave_mm: float = 6.0, height_mm: float = 0.15) -> tuple[np.ndarray, np.ndarray]:
    """(h, w, 3) points of a curved and finely waved surface, and its normals."""
    fx, fy, cx, cy = LENS
    u, v = np.meshgrid(np.arange(SHAPE[1]) + 0.5, np.arange(SHAPE[0]) + 0.5)
    ray = np.stack([(u - cx) / fx, -(v - cy) / fy], axis=-1)
    z = np.zeros(SHAPE)
    k = 2 * np.pi / wave_mm
    for _ in range(30):
        x, y = ray[..., 0] * (1000 - z), ray[..., 1] * (1000 - z)
        z = -(x * x + y * y) / 160 + height_mm * np.sin(k * x) * np.cos(k * y)
    dx = -x / 80 + height_mm * k * np.cos(k * x) * np.cos(k * y)
    dy = -y / 80 - height_mm * k * np.sin(k * x) * np.sin(k * y)
    normals = np.stack([-dx, -dy, np.ones(SHAPE)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return np.stack([x, y, z], axis=-1), normals


def turned(normals: np.ndarray, degrees: float) -> np.ndarray:
    """Normals tipped by a slowly changing angle, this much at most."""
    y, x = np.indices(normals.shape[:2]) / 100.0
    tip = np.radians(degrees) * np.stack([np.cos(3 * x + y), np.sin(2 * y - x), 0 * x], axis=-1)
    out = normals + tip
    return out / np.linalg.norm(out, axis=-1, keepdims=True)


def degrees_off(found: np.ndarray, true: np.ndarray) -> float:
    inside = np.isfinite(found[..., 0])
    return float(np.degrees(np.arccos(np.clip((found * true).sum(-1)[inside], -1, 1))).mean())


def normals_by(points: np.ndarray) -> np.ndarray:
    """Of a grid, by differences."""
    across, down = np.gradient(points, axis=1), np.gradient(points, axis=0)
    out = np.cross(down, across)
    return out / np.linalg.norm(out, axis=-1, keepdims=True)


def relief(
    points: np.ndarray, normals: np.ndarray, bias_mm: float = 8.0, doubt_deg: float = 2.0
) -> tuple[np.ndarray, np.ndarray]:
    known = np.linalg.norm(normals, axis=-1) > 0.5
    slopes = plane_slopes(normals.astype(np.float32), LENS, POSE)
    config = ReconstructConfig(relief_mm=2.0, bias_mm=bias_mm, doubt_deg=doubt_deg)
    return with_relief(points.astype(np.float32), slopes, known, LENS, POSE, config)


@pytest.mark.parametrize("bias_deg", [0.0, 3.0])
def test_noisy_points_take_the_relief_of_normals_and_not_their_bias(bias_deg: float) -> None:
    true, normals = surface()
    rng = np.random.default_rng(0)
    ray = true - [0, 0, 1000]
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    noisy = true + ray * rng.normal(0, 0.08, (*SHAPE, 1))
    given_normals = turned(normals, bias_deg)
    moved, mended = relief(noisy, given_normals)
    before = np.abs(((noisy - true) * ray).sum(-1)).mean()
    after = np.abs(((moved - true) * ray).sum(-1))[8:-8, 8:-8].mean()
    assert after < 0.5 * before
    assert degrees_off(normals_by(moved)[8:-8, 8:-8], normals[8:-8, 8:-8]) < 0.3 * degrees_off(
        normals_by(noisy)[8:-8, 8:-8], normals[8:-8, 8:-8]
    )
    if bias_deg:
        off, left = degrees_off(given_normals, normals), degrees_off(mended, normals)
        assert left < 0.5 * off


def test_without_taking_the_bias_off_the_surface_bends() -> None:
    true, normals = surface()
    tipped = turned(normals, 3.0)
    z = true[..., 2]
    kept = np.abs(relief(true, tipped)[0][..., 2] - z).mean()
    bent = np.abs(relief(true, tipped, 100.0)[0][..., 2] - z).mean()
    assert kept < 0.4 * bent


def test_normals_that_are_wrong_in_a_hollow_move_points_less_when_doubted() -> None:
    true, normals = surface()
    # As shadows and light between the walls of a furrow do: its sides look flatter than they are.
    x = true[..., :1]
    wrong = np.concatenate([np.radians(20) * x * np.exp(-((x / 4) ** 2)) / 4, 0 * x, 0 * x], axis=2)
    tipped = normals + wrong
    tipped /= np.linalg.norm(tipped, axis=-1, keepdims=True)
    near = np.abs(true[..., 0]) < 8
    moves, turns = [], []
    for doubt_deg in (2.0, 90.0):
        moved, mended = relief(true, tipped, 8.0, doubt_deg)
        moves.append(np.linalg.norm(moved - true, axis=-1)[near].max())
        turns.append(degrees_off(mended[near], normals[near]))
    assert moves[0] < 0.8 * moves[1]
    assert turns[0] < 0.8 * turns[1]


def test_exact_points_and_normals_stay() -> None:
    true, normals = surface()
    moved, mended = relief(true, normals)
    assert np.abs(moved - true).max() < 0.03
    assert degrees_off(mended, normals) < 0.2


def test_slopes_and_normals_are_each_others_inverse() -> None:
    _, normals = surface()
    slopes = plane_slopes(normals.astype(np.float32), LENS, POSE)
    found = normals_of(slopes[..., 0], slopes[..., 1], LENS, POSE)
    assert np.abs(found - normals).max() < 1e-5


def plain_solution(
    misses: list[np.ndarray], links: list[np.ndarray], valid: np.ndarray, weight: float
) -> np.ndarray:
    """The same by a sparse direct solver, link by link."""
    count = valid.size
    index = np.arange(count).reshape(valid.shape)
    rows, columns, values, rhs = [], [], [], []
    ends = [(index[:, :-1], index[:, 1:]), (index[:-1], index[1:])]
    for (one, two), miss, link in zip(ends, misses, links, strict=True):
        for a, b, m in zip(one[link], two[link], miss[link], strict=True):
            rows += [len(rhs), len(rhs)]
            columns += [b, a]
            values += [1.0, -1.0]
            rhs.append(-m)
    for k in range(count):
        rows.append(len(rhs))
        columns.append(k)
        values.append(np.sqrt(weight))
        rhs.append(0.0)
    matrix = sparse.coo_array((values, (rows, columns)), shape=(len(rhs), count)).tocsc()
    found = spsolve((matrix.T @ matrix).tocsc(), matrix.T @ np.array(rhs))
    return np.where(valid, found.reshape(valid.shape), 0.0)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000), st.floats(-6, 6), st.floats(0.001, 1.0), st.floats(0.0, 0.9))
def test_the_solver_is_its_plain_twin(seed: int, power: float, weight: float, gap: float) -> None:
    rng = np.random.default_rng(seed)
    shape = (9, 13)
    valid = rng.random(shape) > gap
    links = [valid[:, 1:] & valid[:, :-1], valid[1:] & valid[:-1]]
    links = [link & (rng.random(link.shape) > 0.1) for link in links]
    misses = [rng.normal(0, 10**power, link.shape) for link in links]
    found = solve(misses, links, valid, weight, 1e-9, 1000)
    plain = plain_solution(misses, links, valid, weight)
    assert np.abs(found - plain).max() <= 1e-5 * max(np.abs(plain).max(), 1e-300)


def test_holes_jumps_and_pixels_without_normals() -> None:
    true, normals = surface()
    points, guide = true.copy(), normals.copy()
    points[20:40, 30:50] = np.nan
    points[:, 100:] += (points[:, 100:] - [0, 0, 1000]) * 0.02
    guide[80:90] = 0
    moved, mended = relief(points, guide)
    assert np.isnan(moved[20:40, 30:50]).all()
    assert np.isnan(mended[80:90]).all()
    assert np.isfinite(moved[80:90]).all()
    # A step of 20 mm between two surfaces is no relief: it stays.
    assert np.nanmax(np.abs(moved - points)) < 0.1
    empty, none = relief(np.full_like(points, np.nan), guide)
    assert np.isnan(empty).all()
    assert np.isnan(none).all()


def test_low_pass_keeps_a_constant_and_leaves_gaps_out() -> None:
    links = np.ones((40, 60), bool)
    links[10:20] = False
    values = np.where(links, 3.0, np.nan)
    for sigma in (2.0, 12.0):
        found = low_pass(values, links, sigma)
        assert np.abs(found[links] - 3).max() < 0.02
    assert (low_pass(values, np.zeros_like(links), 5.0) == 0).all()
