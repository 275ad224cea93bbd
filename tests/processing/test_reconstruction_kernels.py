import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.reconstruction.config import ReconstructConfig
from processing.reconstruction.patches import (
    MIN_SHARE,
    NO_MATCH,
    TEXTURES,
    Stereo,
    gather_patch,
    new_patch,
    plane_cost,
    source_cost,
)
from processing.reconstruction.slopes import plane_slopes
from processing.reconstruction.stereo import make_stereo
from processing.reconstruction.sweeps import polish, propagate
from processing.reconstruction.views import Level, finest_level
from tests.processing import textured_ball

CONFIG = ReconstructConfig()


def ball_level(seed: int = 0) -> Level:
    rng = np.random.default_rng(seed)
    views, _ = textured_ball.views_of(textured_ball.cameras(2), rng)
    return finest_level(views)


LEVEL = ball_level()


def kernel_cost(stereo: Stereo, row: int, column: int, w: float) -> float:
    patch = new_patch(stereo)
    count, floor = gather_patch(stereo, row, column, patch)
    a, b = stereo.slopes[row, column]
    plane = (np.float32(w), np.float32(a), np.float32(b))
    # In the types of the loops that call it, which it is compiled for in any case.
    return float(source_cost(stereo, 0, row, column, plane, patch, count, np.float32(floor)))


def plain_cost(level: Level, stereo: Stereo, row: int, column: int, w: float) -> float:
    """The same in float64, sample by sample: each a point in space, no shortcuts."""
    k_r, k_s = (np.array([[f, 0, cx], [0, g, cy], [0, 0, 1]]) for f, g, cx, cy in level.lenses[:2])
    pose_r, pose_s = level.poses[0], level.poses[1]
    rotation = pose_s[:, :3] @ pose_r[:, :3].T
    shift = pose_s[:, 3] - rotation @ pose_r[:, 3]
    slopes = stereo.slopes.astype(float)
    here, there = level.pictures[0].astype(float), level.pictures[1].astype(float)
    height, width = here.shape[:2]
    r, s, wanted = [], [], 0
    for du, dv in stereo.offsets:
        x, y = column + du, row + dv
        if not (0 <= x < width and 0 <= y < height) or np.isnan(here[y, x, 0]):
            continue
        wanted += 1
        # From pixel to pixel inverse depth changes by the mean of both slopes.
        bend = 0.5 * (slopes[row, column] + slopes[y, x]) @ [du, dv]
        point = np.linalg.inv(k_r) @ [x + 0.5, y + 0.5, 1] / (w * (1 + bend))
        p = k_s @ (rotation @ point + shift)
        if p[2] <= 0:
            continue
        px, py = p[0] / p[2] - 0.5, p[1] / p[2] - 0.5
        if not (0 <= px < width - 1 and 0 <= py < height - 1):
            continue
        x0, y0 = int(px), int(py)
        fx, fy = px - x0, py - y0
        value = (there[y0, x0] * (1 - fx) + there[y0, x0 + 1] * fx) * (1 - fy)
        value += (there[y0 + 1, x0] * (1 - fx) + there[y0 + 1, x0 + 1] * fx) * fy
        if not np.isnan(value[0]):
            r.append(here[y, x])
            s.append(value)
    if not len(r) > float(MIN_SHARE) * wanted:
        return float(NO_MATCH)
    floor = (here[row, column] ** 2).sum() * CONFIG.contrast_floor**2
    first, second = np.array(r), np.array(s)
    offset = ((second.mean(axis=0) - here[row, column]) ** 2).sum()
    floors = [floor, max(floor, offset * CONFIG.contrast_floor**2)]
    first, second = first - first.mean(axis=0), second - second.mean(axis=0)
    covariance = (first * second).mean(axis=0).sum()
    pairs = zip((first, second), floors, strict=True)
    variances = [(x**2).mean(axis=0).sum() + noise for x, noise in pairs]
    under = math.sqrt(variances[0] * variances[1])
    return 1 - covariance / under if under > 0 else 1.0


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 269), st.integers(0, 179), st.floats(950, 1100))
def test_the_kernel_is_its_plain_twin(row: int, column: int, depth_mm: float) -> None:
    stereo = make_stereo(LEVEL, 0, np.array([1]), CONFIG)
    if np.isnan(LEVEL.pictures[0, row, column, 0]):
        return
    w = float(np.float32(1 / depth_mm))
    found = kernel_cost(stereo, row, column, w)
    plain = plain_cost(LEVEL, stereo, row, column, w)
    assert found == pytest.approx(plain, abs=3e-3)


@settings(max_examples=30, deadline=None)
@given(st.floats(-6, 6), st.floats(0.2, 5))
def test_cost_ignores_the_scale_of_light_and_a_gain_between_cameras(
    exponent: float, gain: float
) -> None:
    row, column, w = 130, 90, 1 / 1010
    before = kernel_cost(make_stereo(LEVEL, 0, np.array([1]), CONFIG), row, column, w)
    pictures = LEVEL.pictures * np.float32(10**exponent)
    scaled = Level(pictures, LEVEL.masks, LEVEL.normals, LEVEL.lenses, LEVEL.poses)
    after = kernel_cost(make_stereo(scaled, 0, np.array([1]), CONFIG), row, column, w)
    assert after == pytest.approx(before, abs=5e-3)
    pictures = LEVEL.pictures.copy()
    pictures[1] *= np.float32(gain)
    other = Level(pictures, LEVEL.masks, LEVEL.normals, LEVEL.lenses, LEVEL.poses)
    gained = kernel_cost(make_stereo(other, 0, np.array([1]), CONFIG), row, column, w)
    assert gained == pytest.approx(before, abs=0.05)


@settings(max_examples=40, deadline=None)
@given(
    st.sampled_from([0.0, -1.0, 1e-30, 1e12, np.nan, np.inf]),
    st.sampled_from(["all", "reference", "source", "half"]),
)
def test_degenerate_pictures_give_no_false_match(value: float, where: str) -> None:
    pictures = LEVEL.pictures.copy()
    part = {
        "all": np.s_[:],
        "reference": np.s_[:1],
        "source": np.s_[1:],
        "half": np.s_[1:, :, ::2],
    }[where]
    # Infinite pixels are masked where views are made; the kernel only ever meets NaN.
    pictures[part] = np.nan if np.isinf(value) else value
    level = Level(pictures, LEVEL.masks, LEVEL.normals, LEVEL.lenses, LEVEL.poses)
    cost = kernel_cost(make_stereo(level, 0, np.array([1]), CONFIG), 130, 90, 1 / 1010)
    assert 0 <= cost <= 2
    if where in ("all", "reference", "source"):
        assert cost > 0.5


def test_a_view_that_grazes_judges_where_no_other_can() -> None:
    row, column, w = 130, 90, 1 / 1010
    usual = make_stereo(LEVEL, 0, np.array([1]), CONFIG)
    wanted = kernel_cost(usual, row, column, w)
    for least, grazing, judged in ((0.2, 0.05, True), (1.0, 0.05, True), (1.0, 1.0, False)):
        config = dataclasses.replace(CONFIG, min_cosine=least, graze_cosine=grazing)
        stereo = make_stereo(LEVEL, 0, np.array([1]), config)
        patch = new_patch(stereo)
        count, floor = gather_patch(stereo, row, column, patch)
        plane = (np.float32(w), *stereo.slopes[row, column])
        cost = float(plane_cost(stereo, row, column, plane, patch, count, np.float32(floor)))
        # One view alone costs a little more.
        assert cost == pytest.approx(wanted + 0.05 if judged else 2.0, abs=1e-4)


def test_a_patch_of_one_colour_is_uncorrelated() -> None:
    pictures = np.full_like(LEVEL.pictures, 0.25)
    level = Level(pictures, LEVEL.masks, LEVEL.normals, LEVEL.lenses, LEVEL.poses)
    stereo = make_stereo(level, 0, np.array([1]), CONFIG)
    assert kernel_cost(stereo, 130, 90, 1 / 1010) == pytest.approx(1.0, abs=1e-5)


def test_slopes_are_those_of_the_plane() -> None:
    camera = textured_ball.cameras(1)[0]
    lens = np.array([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px])
    normal = np.array([0.3, -0.2, 0.9])
    normal /= np.linalg.norm(normal)
    origin, rays = camera.pixel_rays()
    # Depth along the optical axis of the plane normal . p = 20 mm.
    distance = (20 - origin @ normal) / (rays @ normal)
    points = origin + rays * distance[..., None]
    inverse = 1 / (points @ camera.cam_from_world[2, :3] + camera.cam_from_world[2, 3])
    normals = np.broadcast_to(normal, points.shape)
    slopes = plane_slopes(normals, lens, camera.cam_from_world)
    right = inverse[:, :-1] * (1 + slopes[:, :-1, 0])
    down = inverse[:-1] * (1 + slopes[:-1, :, 1])
    np.testing.assert_allclose(right, inverse[:, 1:], rtol=1e-6)
    np.testing.assert_allclose(down, inverse[1:], rtol=1e-6)


def test_grazing_unknown_and_backward_normals_give_finite_slopes() -> None:
    camera = textured_ball.cameras(1)[0]
    lens = np.array([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px])
    for normal in ([0, 0, 0], [1, 0, 0], [0, 0, -1], [0, 1, -1e-9]):
        normals = np.broadcast_to(np.array(normal, float), (20, 30, 3))
        slopes = plane_slopes(normals, lens, camera.cam_from_world)
        assert np.isfinite(slopes).all()
        assert np.abs(slopes).max() < 0.1


def test_matching_pictures_have_the_channels_that_kernels_expect() -> None:
    assert LEVEL.pictures.shape[-1] == TEXTURES


@pytest.mark.parametrize("off_px", [0.0, 0.2, 0.4, 3.0])
def test_a_depth_is_at_rest_where_the_plain_costs_have_their_least(off_px: float) -> None:
    """`polish` marks what a float64 twin finds: a minimum between, within a share of the step."""
    stereo = make_stereo(LEVEL, 0, np.array([1]), CONFIG)
    picture = LEVEL.pictures[0]
    height, width = picture.shape[:2]
    lens, pose = LEVEL.lenses[0], LEVEL.poses[0]
    middle = float(np.linalg.norm(pose[:, 3])) - textured_ball.RADIUS_MM
    depth = np.zeros((height, width), np.float32)
    rows, columns = np.arange(height // 2 - 6, height // 2 + 6, 3), np.arange(14, 22, 3)
    step = float(stereo.step)
    for row in rows:
        for column in columns:
            if not math.isnan(picture[row, column, 0]):
                depth[row, column] = 1 / middle + off_px * step
    assert lens.shape == (4,)
    cost, out, still = np.zeros_like(depth), np.zeros_like(depth), np.ones(depth.shape, bool)
    delta = np.float32(0.5) * stereo.step
    polish(stereo, delta, 1, depth, cost, out, still, np.float32(0.5))
    assert not still[depth == 0].any()
    for row, column in np.argwhere(depth > 0):
        w = float(depth[row, column])
        three = [plain_cost(LEVEL, stereo, row, column, w + k * float(delta)) for k in (-1, 0, 1)]
        curvature = three[0] - 2 * three[1] + three[2]
        move = 0.5 * (three[0] - three[2]) / curvature if curvature > 0 else math.inf
        if abs(abs(move) - 0.5) > 0.02:
            assert still[row, column] == (abs(move) < 0.5), (row, column, three)


def test_a_pixel_at_rest_tries_nothing_near_and_everything_far() -> None:
    """Small steps are left to those not at rest; a neighbour's far plane is tried by all."""
    stereo = make_stereo(LEVEL, 0, np.array([1]), CONFIG)
    middle = float(np.linalg.norm(LEVEL.poses[0][:, 3])) - textured_ball.RADIUS_MM
    shape = LEVEL.pictures.shape[1:3]
    reaches, deltas = np.array([1, 3], np.int64), np.array([0.5, 0.25], np.float32)
    valid = ~np.isnan(LEVEL.pictures[0][..., 0])

    def swept(depth: np.ndarray, still: np.ndarray) -> np.ndarray:
        found = depth.copy()
        cost = np.full(shape, NO_MATCH, np.float32)
        for colour in (0, 1):
            propagate(stereo, reaches, deltas, np.float32(0.01), colour, still, found, cost)
        return found

    flat = np.where(valid, np.float32(1 / middle), np.float32(0))
    # Neighbours' planes differ by less than half a pixel here, so only small steps could move one.
    bent = stereo.slopes.copy()
    stereo = stereo._replace(slopes=np.zeros_like(bent))
    moved = swept(flat, np.zeros(shape, bool)) != flat
    assert moved[valid].mean() > 0.3
    np.testing.assert_array_equal(swept(flat, np.ones(shape, bool)), flat)
    far = flat.copy()
    far[:, ::5] += np.float32(4) * stereo.step * valid[:, ::5]
    assert (swept(far, np.ones(shape, bool)) != far)[valid].any()
