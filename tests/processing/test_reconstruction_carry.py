import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.reconstruction.carry import _cosines, carried, disagreement, placed_over
from processing.reconstruction.config import ReconstructConfig
from processing.reconstruction.grow import (
    CARRIED,
    CONFIRMED,
    FEWEST,
    JUMP_MM,
    MATCHED,
    NONE,
    WINDOW_PX,
    Grown,
    grow,
)
from processing.reconstruction.slopes import plane_slopes
from processing.reconstruction.views import Level, depth_to_points
from tests.processing import textured_ball
from tests.processing.test_reconstruction_relief import LENS, POSE, surface, turned

PIXEL = 1 / LENS[0]
SHAPE = (120, 160)


def bowl(tip_deg: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(h, w) ln of inverse depth of a curved surface, slopes by its normals, and their cosine."""
    points, normals = surface(height_mm=0.0)
    depth = points @ POSE[2, :3] + POSE[2, 3]
    slopes = plane_slopes(turned(normals, tip_deg).astype(np.float32), LENS, POSE)
    sight = np.array([0, 0, 1000.0]) - points
    sight /= np.linalg.norm(sight, axis=2, keepdims=True)
    return -np.log(depth), slopes, np.einsum("hwk,hwk->hw", sight, normals).astype(np.float32)


def test_points_of_a_depth_map_project_to_its_pixels_and_its_normals_meet_the_sight() -> None:
    camera = textured_ball.cameras(3, factor=0.02)[2]
    lens = np.array([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px])
    pose = camera.cam_from_world
    height, width = camera.height_px, camera.width_px
    rng = np.random.default_rng(0)
    inverse_depth = 1 / rng.uniform(900, 1100, (height, width))
    points = depth_to_points(inverse_depth, lens, pose)
    pixels, depth = camera.project(points.reshape(-1, 3))
    row, column = np.mgrid[:height, :width] + 0.5
    np.testing.assert_allclose(pixels, np.stack([column, row], 2).reshape(-1, 2), atol=1e-2)
    np.testing.assert_allclose(depth, 1 / inverse_depth.ravel(), rtol=1e-5)
    normals = rng.normal(size=(height, width, 3))
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    sight = camera.centre_mm - points
    sight /= np.linalg.norm(sight, axis=2, keepdims=True)
    found = _cosines(normals.astype(np.float32), lens, pose)
    np.testing.assert_allclose(found, (normals * sight).sum(axis=2), atol=1e-4)


def off_mm(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    return np.abs(found - true) * np.exp(-true)


def plain_grow(
    confirmed: np.ndarray,
    matched: np.ndarray,
    slopes: np.ndarray,
    doubt: np.ndarray,
    cosine: np.ndarray,
    agree_mm: float,
    carry_mm: float,
) -> Grown:
    """The same in float64, pixel by pixel."""
    depth = confirmed.astype(float).copy()
    kind = np.where(np.isfinite(depth), CONFIRMED, NONE)
    risk = np.zeros(depth.shape)
    by_match = True
    while True:
        taken = {}
        for row, column in np.argwhere((kind == NONE) & (cosine > 0)):
            rows = slice(max(row - WINDOW_PX, 0), row + WINDOW_PX + 1)
            columns = slice(max(column - WINDOW_PX, 0), column + WINDOW_PX + 1)
            y, x = np.nonzero(kind[rows, columns] != NONE)
            y, x = y + rows.start, x + columns.start
            if len(y) < FEWEST:
                continue
            apart = np.stack([column - x, row - y], axis=1)
            mean = 0.5 * (slopes[y, x].astype(float) + slopes[row, column])
            planes = depth[y, x] + (mean * apart).sum(axis=1)
            z = planes.mean()
            steps = np.hypot(*apart.T) * doubt[row, column] * np.exp(-planes) * cosine[row, column]
            nearest = (risk[y, x] + steps).min()
            if not np.ptp(planes) * math.exp(-z) < JUMP_MM:
                continue
            if by_match:
                off = abs(matched[row, column] - z) * math.exp(-z) * cosine[row, column]
                if off < agree_mm + nearest:
                    taken[row, column] = matched[row, column], MATCHED, 0.0
            elif nearest < carry_mm:
                taken[row, column] = z, CARRIED, nearest
        if not taken and not by_match:
            return Grown(depth, kind, risk)
        for at, values in taken.items():
            depth[at], kind[at], risk[at] = values
        by_match = bool(taken)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.floats(-6, 6))
def test_growing_is_that_of_its_plain_twin_at_every_scale(seed: int, exponent: float) -> None:
    rng = np.random.default_rng(seed)
    part = np.s_[50:64, 70:86]
    true, slopes, cosine = (np.ascontiguousarray(values[part]) for values in bowl(8.0))
    confirmed = np.where(rng.random(true.shape) < 0.15, true, np.nan)
    matched = np.where(rng.random(true.shape) < 0.4, true + 2e-3 * rng.normal(size=true.shape), 0.0)
    matched[matched == 0] = np.nan
    cosine = np.where(rng.random(true.shape) < 0.9, cosine, 0).astype(np.float32)
    doubt = rng.uniform(0.05, 0.3, true.shape) * PIXEL
    ours = grow(confirmed, matched, slopes, doubt, cosine, 0.4, 0.3)
    plain = plain_grow(confirmed, matched, slopes, doubt, cosine, 0.4, 0.3)
    np.testing.assert_array_equal(ours.kind, plain.kind)
    np.testing.assert_allclose(ours.depth, plain.depth, atol=1e-7)
    np.testing.assert_allclose(ours.risk_mm, plain.risk_mm, atol=1e-5)
    # A world of another size, with its own jumps: the same is taken.
    scale = 10.0**exponent
    shifted = grow(
        confirmed - math.log(scale), matched - math.log(scale), slopes, doubt, cosine,
        0.4 * scale, 0.3 * scale, JUMP_MM * scale,
    )  # fmt: skip
    np.testing.assert_array_equal(shifted.kind, ours.kind)


def test_normals_carry_a_surface_on_as_far_as_they_are_trusted() -> None:
    true, slopes, cosine = bowl()
    confirmed = np.where(np.arange(SHAPE[1])[None] < 60, true, np.nan)
    doubt = np.full(SHAPE, 0.05 * PIXEL)
    none = np.full(SHAPE, np.nan)
    reached = []
    for carry_mm in (0.0, 0.1, 0.3):
        grown = grow(confirmed, none, slopes, doubt, cosine, 0.4, carry_mm)
        new = grown.kind == CARRIED
        reached.append(int(new.sum(axis=1).max()))
        assert (grown.kind == CONFIRMED).sum() == np.isfinite(confirmed).sum()
        assert not new.any() or off_mm(grown.depth, true)[new].max() < 0.02
        assert np.isnan(grown.depth[grown.kind == NONE]).all()
    # 0.05 mm of doubt a mm: 2 and 6 mm on, where a pixel is 2/3 mm wide.
    assert reached[0] == 0
    assert reached[1:] == [pytest.approx(3, abs=2), pytest.approx(9, abs=2)]


def test_matches_that_lie_on_the_surface_are_taken_and_others_are_not() -> None:
    true, slopes, cosine = bowl()
    confirmed = np.where(np.arange(SHAPE[1])[None] < 60, true, np.nan)
    rng = np.random.default_rng(2)
    wrong = rng.random(SHAPE) < 0.3
    matched = true + np.where(wrong, 3.0, 0.05 * rng.normal(size=SHAPE)) / np.exp(-true)
    grown = grow(confirmed, matched, slopes, np.full(SHAPE, 0.05 * PIXEL), cosine, 0.4, 0.3)
    assert (grown.kind[:, 60:150] > NONE).mean() > 0.99
    assert (grown.kind[wrong] != MATCHED).all()
    assert (grown.kind[:, 60:150][~wrong[:, 60:150]] == MATCHED).mean() > 0.95
    assert np.percentile(off_mm(grown.depth, true)[grown.kind > NONE], 95) < 0.2


def test_a_surface_ends_where_the_depth_jumps() -> None:
    true, slopes, cosine = bowl()
    behind = np.arange(SHAPE[1])[None] >= 60
    stepped = true - np.where(behind, 6.0, 0) / np.exp(-true)
    near = np.arange(SHAPE[1])[None] < 50
    confirmed = np.where(near, stepped, np.nan)
    doubt = np.full(SHAPE, 0.05 * PIXEL)
    grown = grow(confirmed, stepped, slopes, doubt, cosine, 0.4, 0.2)
    assert (grown.kind[:, 50:60] == MATCHED).all()
    assert (grown.kind[:, 60:] != MATCHED).all()
    # Between two surfaces that meet nowhere nothing is carried on.
    both = np.where(np.abs(np.arange(SHAPE[1]) - 59.5)[None] > 1, stepped, np.nan)
    bridged = grow(both, np.full(SHAPE, np.nan), slopes, doubt, cosine, 0.4, 5.0)
    assert (bridged.kind[:, 59:61] == NONE).all()


@pytest.mark.parametrize("value", [0.0, np.nan, np.inf, -np.inf, 1e6, -1e6])
@pytest.mark.parametrize("which", ["matched", "slopes", "doubt", "cosine"])
def test_what_is_not_finite_is_not_carried_on(value: float, which: str) -> None:
    true, slopes, cosine = bowl()
    given_ = {
        "matched": true.copy(),
        "slopes": slopes.copy(),
        "doubt": np.full(SHAPE, 0.05 * PIXEL),
        "cosine": cosine.copy(),
    }
    given_[which][30:60, 60:90] = value
    confirmed = np.where(np.arange(SHAPE[1])[None] < 60, true, np.nan)
    grown = grow(confirmed, *given_.values(), 0.4, 0.3)
    new = grown.kind > NONE
    np.testing.assert_array_equal(np.isfinite(grown.depth), new)
    away = np.ones(SHAPE, bool)
    away[25:65, 55:95] = False
    assert np.percentile(off_mm(grown.depth, true)[new & away], 99) < 0.5


def test_without_confirmed_points_there_is_nothing_to_go_on_from() -> None:
    true, slopes, cosine = bowl()
    grown = grow(np.full(SHAPE, np.nan), true, slopes, np.full(SHAPE, 1e-4), cosine, 0.4, 1.0)
    assert not grown.kind.any()
    assert np.isnan(grown.depth).all()


def test_normals_are_turned_to_the_points_around_and_doubted_by_as_much() -> None:
    true, right, cosine = bowl()
    _, tipped, _ = bowl(10.0)
    bias, doubt = disagreement(true, tipped, cosine, PIXEL)
    inside = np.s_[10:-10, 10:-10]
    before, after = np.abs(tipped - right)[inside], np.abs(tipped + bias - right)[inside]
    assert after.mean() < 0.2 * before.mean()
    assert doubt[inside].min() > 0.049 * PIXEL
    none, least = disagreement(np.full(SHAPE, np.nan), tipped, cosine, PIXEL)
    assert not none.any()
    np.testing.assert_allclose(least[inside], 0.05 * PIXEL / cosine[inside] ** 2, rtol=1e-5)


def two_views(shift: float) -> tuple[np.ndarray, np.ndarray]:
    """Two cameras beside each other before a wall: its points, and pixel_from_world."""
    poses = np.stack([POSE, POSE + np.array([[0, 0, 0, shift], [0] * 4, [0] * 4])])
    matrix = np.array([[LENS[0], 0, LENS[2]], [0, LENS[1], LENS[3]], [0, 0, 1]])
    wall = np.full(SHAPE, 1e-3)
    points = np.stack([depth_to_points(wall, LENS, pose) for pose in poses])
    return points, np.stack([matrix @ pose for pose in poses])


def kept_of(
    points: np.ndarray, kinds: np.ndarray, masks: np.ndarray, projections: np.ndarray
) -> np.ndarray:
    cosines = np.stack([np.full(SHAPE, 0.5), np.full(SHAPE, 0.6)]).astype(np.float32)
    kept = np.zeros(SHAPE, bool)
    placed_over(0, points, kinds.astype(np.int8), cosines, masks, projections, 3.0, kept)
    return kept


def test_what_another_view_has_or_contradicts_is_left_out() -> None:
    points, projections = two_views(40.0)
    masks = np.ones((2, *SHAPE), bool)
    alone = np.stack([np.full(SHAPE, CARRIED), np.full(SHAPE, NONE)])
    assert kept_of(points, alone, masks, projections).all()
    # 40 mm beside each other at 1 m: pixels lie 60 apart.
    background = masks.copy()
    background[1, :, 80:] = False
    assert (~kept_of(points, alone, background, projections)).sum(axis=1).max() == 80
    for other in (CONFIRMED, MATCHED):
        both = np.stack([alone[0], np.full(SHAPE, other)])
        shared = kept_of(points, both, masks, projections)
        assert not shared[:, :100].any()
        assert shared[:, 100:].all()
    for away, stays in ((10.0, False), (-10.0, True)):
        # Behind the wall stands another that the other view is sure of: the first would hide it.
        moved = points.copy()
        moved[1, ..., 2] -= away
        both = np.stack([alone[0], np.full(SHAPE, CONFIRMED)])
        assert kept_of(moved, both, masks, projections)[:, :100].all() == stays


def plain_laid_over(
    view: int,
    positions: np.ndarray,
    kinds: np.ndarray,
    cosines: np.ndarray,
    masks: np.ndarray,
    projections: np.ndarray,
    near_mm: float,
) -> np.ndarray:
    """The same in float64, point by point."""
    kept = kinds[view] == CONFIRMED
    for at in np.argwhere(kinds[view] > CONFIRMED):
        row, column = at
        place = np.append(positions[view, row, column].astype(float), 1.0)
        good = True
        for k in range(len(projections)):
            seen = projections[k] @ place
            if k == view or not seen[2] > 0:
                continue
            x, y = seen[:2] / seen[2]
            if not (0 <= x < kinds.shape[2] and 0 <= y < kinds.shape[1]):
                continue
            cell = k, int(y), int(x)
            if not masks[cell]:
                good = False
                continue
            if kinds[cell] == NONE:
                continue
            there = projections[k, 2] @ np.append(positions[cell].astype(float), 1.0)
            behind = there - seen[2]
            if kinds[cell] == CONFIRMED:
                good &= bool(behind <= -near_mm)
            elif abs(behind) < near_mm:
                here, other = cosines[view, row, column], cosines[cell]
                good &= bool(here > other or (here == other and view < k))
        kept[row, column] = good
    return kept


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.floats(-6, 6))
def test_laying_over_is_that_of_its_plain_twin_at_every_scale(seed: int, exponent: float) -> None:
    rng = np.random.default_rng(seed)
    shape, scale = (3, 7, 9), 10.0**exponent
    rows, columns = np.indices(shape[1:])
    positions = np.empty((*shape, 3))
    projections = np.empty((3, 3, 4))
    for k in range(3):
        depth = 100 + rng.normal(0, 3, shape[1:])
        # Cameras side by side: a pixel each is a millimetre across at 100 mm.
        matrix = np.array([[100, 0, 4.5], [0, 100, 3.5], [0, 0, 1.0]])
        shift = np.array([rng.uniform(-3, 3), rng.uniform(-2, 2), 0])
        local = np.stack([(columns + 0.5 - 4.5) / 100, (rows + 0.5 - 3.5) / 100, depth * 0 + 1], -1)
        positions[k] = scale * (local * depth[..., None] - shift)
        projections[k] = matrix @ np.concatenate([np.eye(3), scale * shift[:, None]], axis=1)
    kinds = rng.integers(NONE, CARRIED + 1, shape).astype(np.int8)
    positions[kinds == NONE] = np.nan
    cosines = rng.integers(1, 5, shape).astype(np.float32) / 4
    masks = rng.random(shape) < 0.8
    given_ = positions.astype(np.float32), kinds, cosines, masks, projections, 3.0 * scale
    for view in range(3):
        kept = np.zeros(shape[1:], bool)
        placed_over(view, *given_, kept)
        np.testing.assert_array_equal(kept, plain_laid_over(view, *given_))


def test_confirmed_points_stay_whatever_others_see() -> None:
    points, projections = two_views(40.0)
    kinds = np.full((2, *SHAPE), CONFIRMED)
    assert kept_of(points, kinds, np.zeros((2, *SHAPE), bool), projections).all()


def level_of(tip_deg: float) -> tuple[Level, np.ndarray]:
    """One view of the bowl as a level, and its points."""
    points, normals = surface(height_mm=0.0)
    tipped = turned(normals, tip_deg).astype(np.float32)
    level = Level(
        np.zeros((1, *SHAPE, 4), np.float32),
        np.ones((1, *SHAPE), bool),
        tipped[None],
        LENS[None],
        POSE[None],
    )
    return level, points.astype(np.float32)


@pytest.mark.parametrize("carry_mm", [0.1, 0.3])
def test_a_view_goes_on_on_its_own(carry_mm: float) -> None:
    level, points = level_of(5.0)
    confirmed = np.where(np.arange(SHAPE[1])[None, :, None] < 60, points, np.nan)
    config = dataclasses.replace(ReconstructConfig(), carry_mm=carry_mm)
    slopes = [plane_slopes(level.normals[0], LENS, POSE)]
    nothing = [np.zeros(SHAPE, np.float32)], [np.full(SHAPE, 2.0, np.float32)]
    found, kinds = carried(level, *nothing, confirmed[None], slopes, config)
    new = kinds[0] == CARRIED
    assert new.any()
    assert not (kinds == MATCHED).any()
    np.testing.assert_array_equal(found[0][kinds[0] == CONFIRMED], points[kinds[0] == CONFIRMED])
    # No farther off than the doubt that ended it, but for what is tipped beyond the mean.
    assert np.abs(found[0][new][:, 2] - points[new][:, 2]).max() < carry_mm + 0.1
