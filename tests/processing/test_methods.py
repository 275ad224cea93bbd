"""Methods of separation on balls whose answer is known, and the choice among them."""

from __future__ import annotations

import dataclasses
import functools
import math
import typing

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from lightstage.formats.config import make_config
from lightstage.patterns import SEQUENCES
from processing.errors import ProcessingError
from processing.frames.read import Frames
from processing.frames.window import whole
from processing.readings import px_per_mm
from processing.separation import kampouris, linear, mux, polarised, ratios
from processing.separation.choice import METHODS, chosen_method, fitting_methods
from processing.separation.config import KampourisConfig, RatiosConfig, SeparateConfig, relief_of
from processing.separation.pairs import axis_pairs
from processing.separation.view import separate_view
from processing.separation.view_readings import Pixels
from processing.view_maps import PixelMaps
from tests.processing import lit_ball, shots
from tests.processing.lit_ball import Ball, angle_deg

RIG = lit_ball.small_rig(factor=0.015)
COLOURED = shots.coloured_rig(RIG)
CAMERA = RIG.cameras[0]
SCALE = px_per_mm(CAMERA)
CONFIG = SeparateConfig()
LIGHTS = {name: shots.rig_lights(RIG, SEQUENCES[name]) for name in ("binary", "linear")}
POLARISED = shots.rig_lights(RIG, SEQUENCES["binary-polarised"])
TWO = shots.rig_lights(COLOURED, SEQUENCES["mux"])
BALL = Ball()
SIGHT = shots.middle(lit_ball.see(BALL, CAMERA))
FACING = (SIGHT.normals * SIGHT.views).sum(axis=1)
INNER = FACING > 0.4
READ = {
    "binary": shots.photograph(BALL, SIGHT, RIG, SEQUENCES["binary"]),
    "linear": shots.photograph(BALL, SIGHT, RIG, SEQUENCES["linear"]),
    "polarised": shots.photograph(BALL, SIGHT, RIG, SEQUENCES["binary-polarised"]),
    "mux": shots.photograph(BALL, SIGHT, COLOURED, SEQUENCES["mux"]),
}
CASES = {
    "linear": (linear.separate_pixels, "linear", LIGHTS["linear"]),
    "linear on binary": (linear.separate_pixels, "binary", LIGHTS["binary"]),
    "polarised": (polarised.separate_pixels, "polarised", POLARISED),
    "mux": (mux.separate_pixels, "mux", TWO),
    "kampouris": (kampouris.separate_pixels, "binary", LIGHTS["binary"]),
    "ratios": (ratios.separate_pixels, "binary", LIGHTS["binary"]),
}


def solved(case: str, config: SeparateConfig = CONFIG, rgb: np.ndarray | None = None) -> PixelMaps:
    return answer(case, config) if rgb is None else separated(case, config, rgb)


@functools.cache
def answer(case: str, config: SeparateConfig) -> PixelMaps:
    return separated(case, config, READ[CASES[case][1]])


def separated(case: str, config: SeparateConfig, rgb: np.ndarray) -> PixelMaps:
    method, _, lights = CASES[case]
    return method(pixels_of(rgb), lights, config)


def pixels_of(rgb: np.ndarray, valid: np.ndarray | None = None) -> Pixels:
    good = np.ones(len(rgb), bool) if valid is None else valid
    return Pixels(rgb, good, SIGHT.views, SIGHT.mask, SCALE)


def normal_deg(maps: PixelMaps, specular: bool = False) -> float:
    found = maps.specular_normal if specular else maps.diffuse_normal
    return float(angle_deg(found, SIGHT.normals)[INNER].mean())


def albedo_rmse(maps: PixelMaps) -> float:
    return float(np.sqrt(((maps.albedo - BALL.albedo)[INNER] ** 2).mean()))


# -- a ball's answer ----------------------------------------------------------------------------


@pytest.mark.parametrize("case", ["linear", "linear on binary", "polarised"])
def test_lobe_methods_find_a_ball_at_the_centre(case: str) -> None:
    maps = solved(case)
    assert normal_deg(maps) < 0.15
    assert normal_deg(maps, specular=True) < 0.4
    assert albedo_rmse(maps) < 0.003
    assert np.abs(maps.specular[INNER] - BALL.specular).mean() < 0.0015
    assert abs(np.median(maps.roughness[INNER]) - BALL.roughness) < 0.03
    assert maps.confidence[INNER].min() > 0.8


def test_two_coloured_shots_find_a_balls_normals_and_albedo() -> None:
    maps = solved("mux")
    assert np.median(angle_deg(maps.diffuse_normal, SIGHT.normals)[INNER]) < 1.0
    assert normal_deg(maps) < 3.5  # some pixels fall to the wrong side of a highlight
    assert albedo_rmse(maps) < 0.04
    assert abs(maps.specular[INNER].mean() - BALL.specular) < 0.006
    assert maps.confidence[INNER].mean() > 0.8


def test_crossed_shots_alone_give_twice_their_reading_as_albedo() -> None:
    """A matte ball: parallel and crossed shots hold a half each, and nothing is specular."""
    matte = dataclasses.replace(BALL, specular=0.0)
    rgb = shots.photograph(matte, SIGHT, RIG, SEQUENCES["binary-polarised"])
    maps = solved("polarised", rgb=rgb)
    assert albedo_rmse(maps) < 0.002
    assert maps.specular[INNER].mean() < 0.002


def test_published_formulas_need_an_even_field_and_no_highlight() -> None:
    even = make_config(SeparateConfig, {"ratios": {"field": "lights"}}, "test")
    plain, fitted = solved("ratios"), solved("ratios", even)
    chroma = solved("ratios", dataclasses.replace(even, normals="chroma"))
    assert normal_deg(plain) > 8
    assert normal_deg(chroma) < 0.15 < 2 < normal_deg(fitted) < normal_deg(plain)


def test_red_normals_feel_the_highlight_less_than_blue_ones() -> None:
    """Skin is bright in red, and a highlight adds alike to all channels."""
    config = dataclasses.replace(CONFIG, ratios=RatiosConfig(field="lights"))
    red, blue = (
        normal_deg(solved("ratios", dataclasses.replace(config, normals=part)))
        for part in ("red", "blue")
    )
    assert 1 < red < 0.6 * blue
    by_lobe = normal_deg(solved("linear on binary", dataclasses.replace(CONFIG, normals="red")))
    assert by_lobe > 1


def even_field(albedo: np.ndarray, specular: float, sigma: float) -> np.ndarray:
    """(n, 6, 3) x+ x- .. z- of the ball's normals in an even field, the lobe a Gaussian."""
    normals, views = SIGHT.normals[INNER], SIGHT.views[INNER]
    mirrored = 2 * (normals * views).sum(axis=1)[:, None] * normals - views
    shots_ = []
    for axis in range(3):
        beyond = np.arcsin(np.clip(mirrored[:, axis], -1, 1)) / sigma
        share = 0.5 * (1 + np.array([math.erf(x / math.sqrt(2)) for x in beyond]))
        for sign, part in ((1, share), (-1, 1 - share)):
            light = (1 + sign * normals[:, axis]) / 2
            shots_.append(light[:, None] * albedo + specular * part[:, None])
    rgb = np.stack(shots_, axis=1)
    return (rgb + np.random.default_rng(0).normal(0, 0.001, rgb.shape)).astype(np.float32)


@pytest.mark.parametrize("albedo", [(0.55, 0.33, 0.22), (0.2, 0.1, 0.06)])
def test_weighted_pairs_and_the_median_beat_the_maximum_in_an_even_field(
    albedo: tuple[float, float, float],
) -> None:
    rgb = even_field(np.array(albedo), 0.03, math.radians(16))
    pairs = np.arange(6).reshape(3, 2)
    errors = []
    for combine in ("weighted", "median", "maximum"):
        config = make_config(KampourisConfig, {"combine": combine}, "test")
        specular, _, _ = kampouris.published_parts(rgb, pairs, config)
        errors.append(float(np.sqrt(((specular - 0.03) ** 2).mean())))
    assert 0.011 < errors[0] < 0.018
    assert 0.013 < errors[1] < 0.034
    assert errors[2] > 1.15 * max(errors[:2])


def test_pooled_specular_parts_vary_less() -> None:
    sharp = solved("kampouris").specular[INNER]
    config = dataclasses.replace(CONFIG, kampouris=KampourisConfig(pool_mm=15.0))
    assert solved("kampouris", config).specular[INNER].std() < 0.9 * sharp.std()


# -- float64 twins ------------------------------------------------------------------------------


def plain_parts(rgb: np.ndarray, told: KampourisConfig) -> tuple[float, list[float]]:
    """One pixel of x+ x- y+ y- z+ z-: the published delta as it is written, and diffuse means."""
    deltas, weights, diffuse = [], [], []
    for plus, minus in zip(rgb[0::2].astype(float), rgb[1::2].astype(float), strict=True):
        values = [plus.max(), minus.max()]
        chromas = [plus.max() - plus.min(), minus.max() - minus.min()]
        means = [plus.mean(), minus.mean()]
        if min(values) <= 0:
            deltas.append(0.0)
            weights.append(0.0)
            diffuse += means
            continue
        g = 0 if means[0] >= means[1] else 1
        if told.combine == "weighted":
            g = 0 if chromas[0] * values[1] <= chromas[1] * values[0] else 1
        c = 1 - g
        pure = chromas[c] / values[c]
        delta, weight = 0.0, 0.0
        if pure >= told.least_saturation:
            delta = values[g] - chromas[g] / pure
            delta = min(max(delta, 0.0), max(values[g] - chromas[g], 0.0), told.most_specular)
            ratio = means[c] / max(means[g], 1e-12)
            weight = max(ratio, 0.0) ** 2 / (1 + ratio**2) * pure**2
        deltas.append(delta)
        weights.append(weight)
        means[g] -= delta
        diffuse += means
    whole = {
        "maximum": max(deltas),
        "median": sorted(deltas)[1],
        "mean": sum(deltas) / 3,
        "weighted": float(np.dot(weights, deltas)) / max(sum(weights), 1e-30),
    }[told.combine]
    return whole, diffuse


@given(
    values=st.lists(
        st.floats(-0.1, 2) | st.sampled_from([0.0, 1.0, 1e-6]), min_size=18, max_size=18
    ),
    combine=st.sampled_from(kampouris.COMBINES),
    scale=st.integers(-6, 6).map(lambda power: 10.0**power),
)
@settings(max_examples=80, deadline=None)
def test_published_parts_agree_with_the_plain_twin(
    values: list[float], combine: str, scale: float
) -> None:
    rgb = (np.array(values).reshape(1, 6, 3) * scale).astype(np.float32)
    high, spread = rgb[0].max(axis=1).astype(float), np.ptp(rgb[0].astype(float), axis=1)
    # Which of a pair is purer by less than single precision holds is nobody's to say.
    apart = np.abs(spread[0::2] * high[1::2] - spread[1::2] * high[0::2])
    assume(((apart == 0) | (apart > 1e-6 * scale**2)).all())
    config = make_config(
        KampourisConfig, {"combine": combine, "most_specular": 0.2 * scale}, "test"
    )
    pairs = axis_pairs(("x+", "x-", "y+", "y-", "z+", "z-"))
    specular, vector, diffuse = kampouris.published_parts(rgb, pairs, config)
    known, parts = plain_parts(rgb[0], config)
    np.testing.assert_allclose(specular[0], known, atol=1e-4 * scale)
    np.testing.assert_allclose(diffuse[0], parts, atol=1e-4 * scale)
    assert np.isfinite(vector).all()
    assert np.linalg.norm(vector) < 1.0001


# -- pixels that tell nothing -------------------------------------------------------------------

BAD = {
    "black": lambda x: 0 * x,
    "dead channel": lambda x: x * np.array([1, 0, 1], np.float32),
    "negative": lambda x: -x,
    "nan": lambda x: x * np.float32(np.nan),
    "infinite": lambda x: x + np.float32(np.inf),
    "huge": lambda x: x * np.float32(1e37),
    "tiny": lambda x: x * np.float32(1e-6),
    "clipped": lambda x: x,
}


@pytest.mark.parametrize("case", list(CASES))
def test_bad_pixels_are_zero_with_no_confidence_and_harm_no_other(case: str) -> None:
    method, read, lights = CASES[case]
    rgb = READ[read].copy()
    valid = np.ones(len(rgb), bool)
    bad = np.arange(len(rgb)) % 7 == 0
    for k, change in enumerate(BAD.values()):
        some = np.flatnonzero(bad)[k :: len(BAD)]
        rgb[some] = change(rgb[some])
    valid[some] = False
    with np.errstate(all="raise", under="ignore"):
        maps = method(pixels_of(rgb, valid), lights, CONFIG)
    for field in dataclasses.fields(maps):
        values = getattr(maps, field.name)
        assert np.isfinite(values).all(), field.name
        assert not values[bad].any(), field.name
    apart = angle_deg(maps.diffuse_normal, solved(case).diffuse_normal)[~bad & INNER]
    assert np.median(apart) < 0.1


@pytest.mark.parametrize("case", list(CASES))
def test_a_view_without_any_good_pixel_gives_empty_maps(case: str) -> None:
    method, read, lights = CASES[case]
    rgb = np.zeros_like(READ[read])
    maps = method(pixels_of(rgb), lights, CONFIG)
    for field in dataclasses.fields(maps):
        assert not getattr(maps, field.name).any(), field.name


def test_grey_pixels_show_nothing_by_colour_and_all_by_polarisation() -> None:
    grey = dataclasses.replace(BALL, albedo=(0.4, 0.4, 0.4))
    by_colour = shots.photograph(grey, SIGHT, RIG, SEQUENCES["binary"])
    assert not solved("linear on binary", rgb=by_colour).confidence.any()
    assert not solved("kampouris", rgb=by_colour).confidence.any()
    through = shots.photograph(grey, SIGHT, RIG, SEQUENCES["binary-polarised"])
    maps = solved("polarised", rgb=through)
    assert normal_deg(maps) < 0.15
    assert maps.confidence[INNER].min() > 0.8


# -- which method -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("sequence", "coloured", "method"),
    [
        ("binary", False, "colour"),
        ("linear", False, "linear"),
        ("binary-polarised", False, "polarised"),
        ("linear-polarised", False, "polarised"),
        ("mux", True, "mux"),
    ],
)
def test_auto_takes_the_method_that_the_patterns_are_for(
    sequence: str, coloured: bool, method: str
) -> None:
    lights = shots.rig_lights(COLOURED if coloured else RIG, SEQUENCES[sequence])
    assert chosen_method(lights, CONFIG) == method
    assert method in METHODS


def test_the_configuration_takes_every_method_and_no_other() -> None:
    named = typing.get_args(typing.get_type_hints(SeparateConfig)["method"])
    assert set(named) == {"auto", *METHODS}


@pytest.mark.parametrize("method", METHODS)
def test_every_method_is_tried_on_a_ball(method: str) -> None:
    # `colour` has balls of its own in test_coarse.py and test_reflectance.py.
    assert method == "colour" or METHODS[method].separate in {case[0] for case in CASES.values()}


@pytest.mark.parametrize("sequence", ["mux", "full", "polarised"])
def test_patterns_that_fix_no_normal_fit_no_method(sequence: str) -> None:
    lights = shots.rig_lights(RIG, SEQUENCES[sequence])
    assert fitting_methods(lights) == []
    with pytest.raises(ProcessingError, match="three directions"):
        chosen_method(lights, CONFIG)


def test_one_bank_alone_is_not_separated() -> None:
    names = tuple(name for name in SEQUENCES["binary-polarised"] if name.endswith("cross"))
    assert fitting_methods(shots.rig_lights(RIG, names)) == []


@pytest.mark.parametrize(
    ("sequence", "values", "message"),
    [
        ("binary", {"method": "polarised"}, "separate.method"),
        ("linear", {"method": "kampouris"}, "linear, colour"),
        ("binary", {"method": "ratios", "specular_normals": "mirror"}, "specular_normals"),
        ("mux", {"normals": "red"}, "separate.normals"),
    ],
)
def test_a_method_that_cannot_do_what_it_is_set_to_reports_it(
    sequence: str, values: dict[str, str], message: str
) -> None:
    rig = COLOURED if sequence == "mux" else RIG
    lights = shots.rig_lights(rig, SEQUENCES[sequence])
    with pytest.raises(ProcessingError, match=message):
        chosen_method(lights, make_config(SeparateConfig, values, "test"))


def test_each_choice_of_specular_normals_does_something() -> None:
    found = {}
    for relief in ("mirror", "detail", "diffuse"):
        config = dataclasses.replace(CONFIG, specular_normals=relief, normals="red")
        assert relief_of(linear.RELIEF, config) == relief
        found[relief] = solved("linear on binary", config).specular_normal[INNER]
    assert angle_deg(found["mirror"], found["diffuse"]).mean() > 0.1
    assert angle_deg(found["detail"], found["diffuse"]).mean() > 0.01
    assert angle_deg(found["mirror"], found["detail"]).mean() > 0.05


@pytest.mark.parametrize("method", ["kampouris", "ratios"])
def test_photographs_that_a_method_does_not_use_change_nothing(method: str) -> None:
    lights, shape = LIGHTS["binary"], SIGHT.mask.shape
    half = np.zeros((8, *shape, 3), np.float16)
    half[:7, SIGHT.mask] = READ["binary"].transpose(1, 0, 2)
    half[7] = 300.0
    names = (*lights.patterns, "single-1")
    more = Frames(names, half, 1.0, whole(shape), shape, np.zeros(shape, np.uint8))
    few = dataclasses.replace(more, patterns=names[:7], half=half[:7])
    both = dataclasses.replace(lights.of((*lights.patterns, "x+")), patterns=names)
    one = separate_view(method, few, SIGHT.mask, CAMERA, lights, CONFIG)
    other = separate_view(method, more, SIGHT.mask, CAMERA, both, CONFIG)
    assert one.confidence.any()
    for field in dataclasses.fields(one):
        np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name))


@pytest.mark.parametrize("case", ["linear", "polarised"])
def test_a_sigma_of_0_leaves_each_pixel_its_own(case: str) -> None:
    fit = dataclasses.replace(
        SeparateConfig().linear, roughness_pool_mm=0.0, specular_pool_mm=0.0, detail_mm=0.0
    )
    maps = solved(case, SeparateConfig(linear=fit, polarised=fit))
    assert np.isfinite(maps.specular).all()
    assert np.ptp(maps.specular[INNER]) > 1e-6
