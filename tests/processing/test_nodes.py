"""Light at nodes and eight pixels at once, against light gathered for each pixel alone."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from processing.frames.read import Frames
from processing.lanes import LANES, above, at_most, load, root, store
from processing.lighting.lights import Shadows
from processing.readings import px_per_mm, read_pixels
from processing.refinement import finish, node_light
from processing.refinement.config import RefineConfig
from processing.refinement.every_pixel import SolvedView, photos_of, solve_view
from processing.refinement.gloss_search import find_gloss
from processing.refinement.joint import Noise, lamps_of, solve_jointly, spread_of
from processing.refinement.node_pixels import read_pixel
from processing.refinement.node_solve import OF_STATE, RESULTS, solve_eight
from processing.refinement.nodes import safe_cells
from processing.refinement.scene import prepare_scene, read_view
from processing.surface import Sight
from tests.processing import lit_ball, test_joint, test_reflectance
from tests.processing.lit_ball import PATTERNS, angle_deg
from tests.processing.test_joint import BAD, INTERFACE, LIGHTS, Skin, given_by, skin

SEEDS = st.integers(0, 2**31)
AXIS = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]], np.float32)
COUNT = len(PATTERNS)
NODE, PLACE = 6 * COUNT, 6 * COUNT + node_light.OF_PATTERN * COUNT
STATE = PLACE + node_light.OF_PLACE
LAST = STATE + OF_STATE * COUNT


def numbers(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, np.float32)


def nodes_at(s: Skin) -> tuple[np.ndarray, np.ndarray]:
    """A node at each of some pixels, itself the grid around it: its numbers and if they hold."""
    count = len(s.rgb)
    lamps = lamps_of(LIGHTS, s.place, INTERFACE)
    bends = np.zeros((count, COUNT, 2 * node_light.TERMS + 3), np.float32)
    grid = np.column_stack(
        [
            np.concatenate([bends, s.around.rest], axis=2).reshape(count, -1),
            s.start, s.specular, s.start, np.zeros((count, 3)), s.roughness,
        ]
    ).astype(np.float32)  # fmt: skip
    turn, good = node_light.turns(), np.ones(count, bool)
    fit = numbers(np.linalg.pinv(node_light.terms(turn)))
    points, views = numbers(s.place.points_mm), numbers(s.place.views)
    corners, weights = s.place.shadows.corners, s.place.shadows.weights
    node_light.grid_kernel(points, views, corners, weights, lamps, AXIS, turn, fit, good, grid)
    out = np.zeros((count, COUNT * node_light.OF_PATTERN + node_light.OF_PLACE), np.float32)
    known = np.zeros(count, bool)
    node_light.node_kernel(
        np.zeros(count, np.int64), np.arange(count), 1, np.arange(count, dtype=np.int32)[None],
        grid, points, views, numbers(s.start), np.ones((count, 2), np.float32),
        corners, weights, lamps, AXIS, known, out,
    )  # fmt: skip
    return out, known


def eight(s: Skin, table: np.ndarray, noise: Noise, rounds: int = 2) -> np.ndarray:
    """(LANES, RESULTS) of the first eight pixels."""
    ws = np.zeros((LAST + RESULTS) * LANES, np.float32)
    rows = ws.reshape(-1, LANES)
    rows[: 3 * COUNT] = s.rgb[:LANES].reshape(LANES, -1).T
    rows[NODE:STATE] = table[:LANES].T
    given = spread_of(noise, s.around)
    solve_eight(
        ws, 0, NODE, STATE, PLACE, LAST, COUNT, rounds,
        given.read2, given.shot2, given.model2, given.shade2, given.kept, node_light.WIDEST_TAN**2,
    )  # fmt: skip
    return rows[LAST:].T.copy()


def in_world(table: np.ndarray, t: np.ndarray, u: np.ndarray, n: np.ndarray) -> np.ndarray:
    """(8, 3) unit vectors from their parts along T, U and N of eight nodes."""
    first = COUNT * node_light.OF_PATTERN + node_light.FRAME
    frame = table[:LANES, first : first + 9].reshape(-1, 3, 3)
    out = n[:, None] * frame[:, 0] + t[:, None] * frame[:, 1] + u[:, None] * frame[:, 2]
    return np.asarray(out / np.linalg.norm(out, axis=1, keepdims=True))


@given(seed=SEEDS, lit=st.booleans(), shade=st.sampled_from([0.0, 0.003, 0.03]))
# The same draws in each run: with the largest `shade` a pixel of 1 in 50 draws has two minima that
# are nearly alike, and float32 may end in the other one.
@settings(max_examples=24, deadline=None, derandomize=True)
def test_eight_pixels_are_solved_as_each_alone(seed: int, lit: bool, shade: float) -> None:
    s, noise = skin(seed, LANES, lit=lit), Noise(shade=shade)
    table, known = nodes_at(s)
    assert known.all()
    found = eight(s, table, noise)
    alone = solve_jointly(given_by(s, noise))
    holds = found[:, 13] > 0
    assert holds.mean() > 0.7
    normal = in_world(table, found[:, 0], found[:, 1], np.ones(LANES))
    matte = in_world(table, found[:, 2], found[:, 3], found[:, 4])
    # Slopes here know the horizon and the interface, which the other leaves out of its steps.
    assert np.median(angle_deg(normal, alone.normal)[holds]) < 0.2
    assert angle_deg(normal, alone.normal)[holds].max() < 2
    assert np.median(angle_deg(matte, alone.matte)[holds]) < 0.6
    albedo = alone.lit / alone.power
    np.testing.assert_allclose(found[holds, 5:8], albedo[holds], atol=0.01)
    np.testing.assert_allclose(found[holds, 8:11], alone.power[holds], rtol=0.03)
    # Steeper slopes tell more.
    stated = found[holds, 14] / alone.matte_turn2[holds]
    assert stated.min() > 0.65
    assert stated.max() < 1.1


def test_nodes_hold_no_light_of_a_lobe_narrower_than_their_polynomials() -> None:
    s = skin(0, LANES)
    narrow = np.array([0.05, 0.06, 0.09, 0.119, 0.121, 0.2, 0.3, 0.45], np.float32)
    known = nodes_at(dataclasses.replace(s, roughness=narrow))[1]
    np.testing.assert_array_equal(known, narrow > 0.12)


def test_noise_turns_eight_chroma_normals_by_as_much_as_is_predicted() -> None:
    s, noise = skin(5, LANES, noise=0, off_deg=0.3), Noise(sensor=0.005, model=0, shade=0)
    table, rng = nodes_at(s)[0], np.random.default_rng(0)
    sigma = noise.sensor * np.sqrt(0.25 + s.rgb)
    each = [s.rgb + sigma * rng.normal(size=s.rgb.shape) for _ in range(300)]
    found = np.stack(
        [eight(dataclasses.replace(s, rgb=numbers(rgb)), table, noise) for rgb in each]
    )
    assert (found[..., 13] > 0).all()
    # The parts along T, U and N, two of which are nearly across the normal.
    matte = found[..., 2:5]
    spread = matte.var(axis=0).sum(axis=1)
    np.testing.assert_allclose(spread, found[..., 14].mean(axis=0), rtol=0.3)


@given(power=st.integers(-6, 6), seed=SEEDS)
@settings(max_examples=40, deadline=None)
def test_eight_normals_do_not_depend_on_the_scale_of_readings(power: int, seed: int) -> None:
    s, noise = skin(seed, LANES), Noise(sensor=0)
    scale = 10.0**power
    scaled = dataclasses.replace(s, rgb=numbers(s.rgb * scale), specular=s.specular * scale)
    known, found = (eight(x, nodes_at(x)[0], noise) for x in (s, scaled))
    both = (known[:, 13] > 0) & (found[:, 13] > 0)
    # Without a sensor's own noise a reading a thousandth of the others counts a million times as
    # much as they do, which single precision cannot hold. No sensor is like that.
    readings = s.rgb[:LANES].reshape(LANES, -1)
    both &= readings.min(axis=1) > 2e-3 * readings.max(axis=1)
    np.testing.assert_allclose(found[both, :2], known[both, :2], atol=1e-4)
    np.testing.assert_allclose(found[both, 5:8] / scale, known[both, 5:8], rtol=1e-3, atol=1e-5)


@given(
    readings=st.lists(BAD, min_size=3 * COUNT, max_size=3 * COUNT),
    specular=st.sampled_from([0.0, 0.03, 0.2]),
)
@settings(max_examples=60, deadline=None)
def test_what_holds_of_bad_readings_is_finite(readings: list[float], specular: float) -> None:
    s = skin(0, LANES)
    rgb = s.rgb.copy()
    rgb[3] = np.array(readings, np.float32).reshape(COUNT, 3)
    bad = dataclasses.replace(s, rgb=rgb, specular=np.full(LANES, specular))
    found = eight(bad, nodes_at(bad)[0], Noise())
    good = eight(dataclasses.replace(bad, rgb=s.rgb), nodes_at(bad)[0], Noise())
    if found[3, 13] > 0:
        assert np.isfinite(found[3]).all()
    others = np.arange(LANES) != 3
    np.testing.assert_array_equal(found[others], good[others])


def test_directions_across_are_unit_across_and_turn_smoothly() -> None:
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(300, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    for n in normals[normals[:, 2] > -0.45]:
        sides = np.zeros((2, 3), np.float32)
        assert node_light.across(numbers(n), AXIS, sides)
        whole = np.vstack([n, sides])
        np.testing.assert_allclose(whole @ whole.T, np.eye(3), atol=1e-5)
    assert not node_light.across(np.array([0, 0, -1], np.float32), AXIS, np.zeros((2, 3)))


def plain_finish(g: np.ndarray, limits: finish.Limits) -> dict[str, np.ndarray | float]:
    """One pixel's maps in plain float64."""
    matte, own = g[finish.MATTE : finish.MATTE + 3], g[0:3]
    chroma = limits.apart2 / (limits.apart2 + g[finish.MATTE_TURN2]) if matte.any() else 0
    agreement = float(g[0:3] @ g[15:18])
    mesh = g[15:18]
    if g[25] <= 0 or g[18] <= 0 or agreement <= 0 or g[0:3] @ g[27:30] <= 0:
        return {"confidence": 0.0, "albedo": g[20:23], "normal": mesh, "matte": mesh}
    power = g[9:12].mean()
    trust = np.sqrt(g[18]) * np.clip(g[19] / limits.edge_px, 0, 1) * np.clip(2 * agreement, 0, 1)
    trust *= np.clip(g[14] / limits.grey_saturation - 1, 0, 1) * power / (power + limits.dark_power)
    trust /= 1 + g[12] / limits.doubtful_misfit
    trust /= 1 + 1 / (max(g[13], 1e-12) * limits.doubtful_turn2)
    trust /= 1 + chroma**2 * ((matte - own) ** 2).sum() / limits.doubtful_apart2
    weight = max(trust**2, 1e-6)
    prior = g[20:23] if g[20:23].any() else g[6:9]
    lit = g[6:9] * g[9:12] * weight + limits.prior_power * prior
    share = min(trust / limits.steady_below, 1)
    normal = share * own + (1 - share) * g[15:18]
    blend = share * (chroma * matte + (1 - chroma) * own) + (1 - share) * g[15:18]
    return {
        "confidence": trust,
        "albedo": np.maximum(lit / (g[9:12] * weight + limits.prior_power), 0),
        "normal": normal / np.linalg.norm(normal),
        "matte": blend / np.linalg.norm(blend),
    }


@given(seed=SEEDS)
@settings(max_examples=10, deadline=None)
def test_trust_and_what_stands_in_are_those_of_plain_float64(seed: int) -> None:
    rng = np.random.default_rng(seed)
    given_ = rng.uniform(0, 1, (20, finish.GIVEN))
    for first in (finish.NORMAL, finish.MATTE, finish.MESH, finish.VIEW):
        vectors = rng.normal([0, 0, 1.5], size=(20, 3))
        given_[:, first : first + 3] = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    given_[:, finish.CERTAINTY] = 10 ** rng.uniform(1, 5, 20)
    given_[:, finish.INSIDE] *= 8
    given_[:, finish.MATTE_TURN2] = 10 ** rng.uniform(-6, 0, 20)
    given_[::7, finish.MATTE : finish.MATTE + 3] = 0
    given_[::5, finish.USABLE] = 0
    given_[::4, finish.PRIOR : finish.PRIOR + 3] = 0
    given_[::3, finish.FACING] = 0
    given_ = numbers(given_).astype(float)
    limits, maps = finish.limits_of(RefineConfig(), doubt=3.0), finish.empty_maps(20)
    finish.finish(numbers(given_), np.arange(20), limits, maps)
    for i, row in enumerate(given_):
        known = plain_finish(row, limits)
        for name, value in known.items():
            np.testing.assert_allclose(getattr(maps, name)[i], value, atol=2e-5, err_msg=name)
    np.testing.assert_allclose(maps.specular, given_[:, finish.SPECULAR], atol=1e-6)
    np.testing.assert_allclose(maps.roughness, given_[:, finish.ROUGHNESS], atol=1e-6)


@given(
    values=st.lists(
        st.floats(-1e6, 1e6) | st.sampled_from([0.0, np.nan, np.inf, -np.inf]),
        min_size=finish.GIVEN,
        max_size=finish.GIVEN,
    )
)
@settings(max_examples=100, deadline=None)
def test_whatever_a_pixel_is_given_its_maps_are_finite(values: list[float]) -> None:
    maps = finish.empty_maps(1)
    finish.finish(
        numbers(np.array([values])), np.zeros(1, int), finish.limits_of(RefineConfig()), maps
    )
    for name in ("matte", "normal", "albedo", "specular", "roughness", "confidence"):
        assert np.isfinite(getattr(maps, name)).all(), name


@given(
    bits=st.lists(st.integers(0, 65535), min_size=3 * COUNT, max_size=3 * COUNT),
    clipped=st.booleans(),
)
@settings(max_examples=60, deadline=None)
def test_a_pixel_is_read_as_all_are(bits: list[int], clipped: bool) -> None:
    half = np.array(bits, np.uint16).reshape(COUNT, 1, 1, 3).view(np.float16)
    white = np.array([0.9, 1.0, 1.2])
    images = half.astype(np.float32)
    frames = Frames.of(
        PATTERNS, np.where(np.isfinite(images), images, 0), np.array([[not clipped]])
    )
    photos = photos_of(frames, white, RefineConfig())
    ws = np.full(3 * COUNT * LANES, 7, np.float32)
    usable, saturation = read_pixel(photos, 0, 0, ws, 2)
    pixels = frames.pixels(np.ones((1, 1), bool))
    clean, _, colourful, good = read_pixels(pixels, frames.valid.ravel(), white, photos.dark_level)
    assert usable == good[0]
    found = ws.reshape(COUNT, 3, LANES)[:, :, 2]
    np.testing.assert_allclose(found, clean[0] / numbers(white), rtol=1e-6)
    if usable:
        np.testing.assert_allclose(saturation, colourful[0], rtol=1e-3, atol=1e-5)
    assert (np.delete(ws.reshape(-1, LANES), 2, axis=1) == 7).all()


@njit
def _lanes(a: np.ndarray, b: np.ndarray, out: np.ndarray) -> None:
    x, y = load(a, 0), load(b, 0)
    store(out, 0, x / y)
    store(out, LANES, root(x))
    store(out, 2 * LANES, at_most(x, y))
    store(out, 3 * LANES, above(x, y))


def test_lanes_divide_take_roots_and_compare() -> None:
    a = np.array([1, 4, 0, -1, np.inf, np.nan, 9, 2], np.float32)
    b = np.array([2, 0, 3, 5, 2, 1, 9, np.nan], np.float32)
    out = np.zeros(4 * LANES, np.float32)
    _lanes(a, b, out)
    with np.errstate(divide="ignore", invalid="ignore"):
        known = [a / b, np.sqrt(a), np.where(a < b, a, b), np.float32(a > b)]
    np.testing.assert_allclose(out.reshape(4, LANES), known, rtol=1e-6)


@given(seed=SEEDS)
@settings(max_examples=20, deadline=None)
def test_cells_are_safe_between_four_good_nodes_of_like_depths_and_normals(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mask = rng.uniform(size=(9, 11)) < 0.95
    first = np.s_[:2, :2]  # a cell that is safe, whatever is drawn
    mask[first] = True
    number = np.full(mask.shape, -1, np.int32)
    number[mask] = np.arange(mask.sum())
    good = rng.uniform(size=mask.sum()) < 0.97
    good[number[first]] = True
    normals = rng.normal([0, 0, 5], size=(mask.sum(), 3)).astype(np.float32)
    normals[number[first]] = 0, 0, 1
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    depth = np.where(mask, 500 + rng.normal(size=mask.shape), np.inf).astype(np.float32)
    depth[first] = 500
    nothing = np.zeros(0)
    shadows = Shadows(nothing, nothing, nothing)
    sight = Sight(mask, nothing, normals, nothing, nothing, shadows, depth, 3)
    found = safe_cells(number, good, sight, 3.0)
    assert found[0, 0]
    for y, x in np.ndindex(found.shape):
        four = number[y : y + 2, x : x + 2].ravel()
        known = bool((four >= 0).all()) and bool(good[four].all())
        known = known and float(np.ptp(depth[y : y + 2, x : x + 2])) < 3.0
        known = known and (normals[four] @ normals[four].T).min() > np.cos(np.radians(20))
        assert found[y, x] == known


@functools.cache
def ball_maps() -> tuple[lit_ball.Sight, SolvedView, SolvedView]:
    """A ball's truth, its maps from nodes three pixels apart, and with each pixel's own light."""
    ball, camera = lit_ball.Ball(coated=True), test_reflectance.CAMERA
    truth = lit_ball.see(ball, camera)
    images = np.zeros((COUNT, *truth.mask.shape, 3), np.float32)
    images[:, truth.mask] = lit_ball.photograph(ball, truth, test_reflectance.RIG).swapaxes(0, 1)
    frames = Frames.of(PATTERNS, images, np.ones(truth.mask.shape, bool))
    config = RefineConfig(
        shadow_offset_mm=0.3, smoothing_mm=0, occlusion_directions=64, finest_mm=4.0,
        bounce_rays=0, depth_step_mm=20.0, gloss_pixels=600, choice_pixels=0, scattering=(0.0,),
        light_step_mm=3.01 / px_per_mm(camera),
    )  # fmt: skip
    mesh = test_reflectance.ball_mesh(ball)
    scene = prepare_scene(mesh, test_joint.LIGHTS, [(camera, truth.mask)], config)
    grid = read_view(frames, camera, truth.mask, scene, config, config.gloss_pixels)
    scene, found, _ = find_gloss(scene, [grid], config)
    nodes, alone = (
        solve_view(scene, frames, camera, truth.mask, grid, found[0], each)
        for each in (config, dataclasses.replace(config, light_step_mm=0.0))
    )
    return truth, nodes, alone


def test_a_ball_between_nodes_is_as_with_each_pixels_own_light() -> None:
    _, nodes, alone = ball_maps()
    assert nodes.between_nodes > 0.6
    assert alone.between_nodes == 0
    np.testing.assert_array_equal(nodes.mask, alone.mask)
    sure = alone.maps.confidence > 0.5
    assert sure.sum() > 1000
    for found, known in ((nodes.maps.normal, alone.maps.normal),
                         (nodes.maps.matte, alone.maps.matte)):  # fmt: skip
        off = angle_deg(found, known)[sure]
        assert np.median(off) < 0.1
        assert np.quantile(off, 0.99) < 0.8
    for name in ("albedo", "specular", "roughness", "confidence", "occlusion"):
        off = np.abs(getattr(nodes.maps, name) - getattr(alone.maps, name))[sure]
        assert np.sqrt((off**2).mean()) < 0.01, name


def test_a_balls_maps_between_nodes_are_true() -> None:
    truth, nodes, _ = ball_maps()
    normals = np.zeros((*truth.mask.shape, 3))
    normals[truth.mask] = truth.normals
    sure = nodes.maps.confidence > 0.5
    assert angle_deg(nodes.maps.normal, normals[nodes.mask])[sure].mean() < 0.5
    assert np.abs(nodes.maps.albedo[sure] - lit_ball.Ball().albedo).mean() < 0.01
