"""Moved photographs are laid upon full, flicker and room light found and taken off, all said."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.errors import FormatError
from lightstage.formats.session import Session, SessionFile
from lightstage.patterns import SEQUENCES
from processing.decode.config import PrepareConfig
from processing.decode.diagnosis import Diagnosis, read_diagnosis, write_diagnosis
from processing.decode.diagnosis_page import grid, light_section, signed
from processing.decode.preparation import prepare_view, prepare_warnings
from processing.decode.subject_motion import Flow, monomials, solve_pair, warp
from processing.frames.small import shrunk
from processing.report import Picture, Table
from tests.processing import lit_ball
from tests.processing.lit_ball import PATTERNS, Ball

RIG = lit_ball.small_rig(1, 0.07)
SIGHT = lit_ball.see(Ball(), RIG.cameras[0])
SHAPE = SIGHT.mask.shape


def freckles(seed: int = 0) -> np.ndarray:
    """(h, w) 0.6 .. 1, spots of several sizes on the ball."""
    rng = np.random.default_rng(seed)
    fields = [cv2.GaussianBlur(rng.normal(size=SHAPE), (0, 0), s) * s for s in (1.5, 3, 6)]
    total = sum(fields)
    return np.asarray(0.8 + 0.2 * np.tanh(2 * total / np.std(total)), np.float32)


@functools.cache
def still() -> np.ndarray:
    """(P, h, w, 3) float32 of a freckled ball that holds still."""
    images = np.zeros((len(PATTERNS), *SHAPE, 3), np.float32)
    images[:, SIGHT.mask] = lit_ball.photograph(Ball(), SIGHT, RIG).transpose(1, 0, 2)
    return images * freckles()[..., None]


def noisy(images: np.ndarray) -> np.ndarray:
    sigma = 0.001 * np.sqrt(0.25 + np.maximum(images, 0))
    rng = np.random.default_rng(1)
    return np.asarray(images + sigma * rng.standard_normal(images.shape), np.float32)


def session(sequence: tuple[str, ...] = PATTERNS) -> Session:
    names = list(sequence)
    file = SessionFile(
        id="x", created_utc="", subject="s", expression="n", sequence=names, frames=[]
    )
    return Session(Path("nowhere"), file, RIG)


def prepared(images: np.ndarray, out: Path, **changes: Any) -> dict[str, Any]:
    usable = np.ones(SHAPE, bool)
    config = PrepareConfig(**changes)
    return prepare_view(out, "cam0", PATTERNS, images, usable, session(), config, {})


def moved(picture: np.ndarray, flow: Flow) -> np.ndarray:
    """The picture that shows at x + flow(x), to first order, what this one shows at x."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float32) + np.float32(0.5)
    back = np.stack([x, y], axis=-1)
    for _ in range(5):
        back = np.stack([x, y], axis=-1) - flow.at(back[..., 0], back[..., 1])
    to = (back - 0.5).astype(np.float32)
    return np.asarray(cv2.remap(picture, to[..., 0], to[..., 1], cv2.INTER_CUBIC))


def some_flow(seed: int, size_px: float) -> Flow:
    rng = np.random.default_rng(seed)
    middle = (SHAPE[1] / 2, SHAPE[0] / 2)
    return Flow(size_px * rng.normal(size=(6, 2)) * [[1], [0.5], [0.5], [0.3], [0.3], [0.3]],
                middle, SHAPE[1] / 3, 2)  # fmt: skip


@pytest.mark.parametrize("size_px", [0.5, 3.0])
def test_both_displacements_of_a_pair_are_found(size_px: float) -> None:
    flows = [some_flow(1, size_px), some_flow(2, size_px)]
    full, plus, minus = (noisy(still())[k].mean(axis=2) for k in (0, 1, 2))
    first, second = moved(plus, flows[0]), moved(minus, flows[1])
    found = solve_pair(first, second, full, np.ones(SHAPE, bool), 1.0, 1.0, 0.2)
    assert found is not None
    for flow, known, part in zip((found.first, found.second), flows, (plus, minus), strict=True):
        # A part's unlit side says nothing of its motion, and needs none.
        rows, columns = np.nonzero(part > 0.3 * full.max())
        off = flow.at(columns + 0.5, rows + 0.5) - known.at(columns + 0.5, rows + 0.5)
        assert np.median(np.hypot(*off.T)) < 0.1 + 0.03 * size_px
    assert found.after < 0.6 * found.before


def test_a_warp_with_the_found_flow_undoes_the_motion() -> None:
    flow = some_flow(3, 2.0)
    images = np.stack([moved(still()[0], flow)])
    usable = np.ones(SHAPE, bool)
    warp(images, {0: flow}, usable)
    inner = cv2.erode(SIGHT.mask.astype(np.uint8), np.ones((15, 15), np.uint8)) > 0
    assert np.abs(images[0] - still()[0])[inner].mean() < 0.004
    assert usable[inner].all()


def test_a_place_that_was_clipped_before_it_moved_is_not_usable() -> None:
    flow = Flow(np.array([[3.0, 0.0]]), (0.0, 0.0), 1.0, 0)
    usable = np.ones(SHAPE, bool)
    usable[50, 40] = False
    warp(still()[:1].copy(), {0: flow}, usable)
    assert not usable[50, 40]
    assert not usable[50, 37]
    assert usable[50, 30]


def test_what_comes_from_beyond_the_picture_is_not_usable_and_darkens_nothing() -> None:
    flow = Flow(np.array([[0.0, 5.0]]), (0.0, 0.0), 1.0, 0)
    images, usable = np.full((1, *SHAPE, 3), 0.5, np.float32), np.ones(SHAPE, bool)
    warp(images, {0: flow}, usable)
    assert not usable[-5:].any()
    assert usable[:-5].all()
    np.testing.assert_allclose(images[0][usable], 0.5, rtol=1e-5)


def test_monomials_are_all_products_up_to_a_degree() -> None:
    found = monomials(np.array([2.0]), np.array([3.0]), 2)[0]
    assert sorted(found) == sorted([1, 2, 3, 4, 6, 9])
    assert found[0] == 1


def test_photographs_of_something_still_are_left_as_they_are(tmp_path: Path) -> None:
    images = noisy(still())
    before = images.copy()
    facts = prepared(images, tmp_path)
    np.testing.assert_array_equal(images, before)
    assert (facts["aligned"], facts["flicker"], facts["looks_like"]) == ([], {}, {})
    assert max(facts["displaced_px"].values()) < 0.1
    assert max(map(abs, facts["ambient"])) < 1e-3
    assert prepare_warnings({"cam0": facts}) == []


def test_a_photograph_that_moved_is_laid_upon_full(tmp_path: Path) -> None:
    images = noisy(still())
    flow = some_flow(4, 2.0)
    images[3] = moved(images[3], flow)
    off = np.abs(images[3] - still()[3])[SIGHT.mask].mean()
    facts = prepared(images, tmp_path)
    assert "y+" in facts["aligned"]
    assert facts["displaced_px"]["y+"] > 1.0
    assert np.abs(images[3] - still()[3])[SIGHT.mask].mean() < 0.4 * off
    (finding,) = prepare_warnings({"cam0": facts})
    assert "moved" in finding


@pytest.mark.parametrize("number", [1, 5])
def test_a_scarf_that_moved_alone_leaves_the_face_as_it_was(tmp_path: Path, number: int) -> None:
    """The lowest quarter of the subject slips aside in one photograph, and stays there."""
    images = noisy(still())
    rows = np.flatnonzero(SIGHT.mask.any(axis=1))
    below = rows[0] + 3 * len(rows) // 4
    flow = Flow(np.array([[6.0, 0.0]]), (0.0, 0.0), 1.0, 0)
    images[number, below:] = moved(images[number], flow)[below:]
    before = images.copy()
    facts = prepared(images, tmp_path)
    assert facts["aligned"] == []
    np.testing.assert_array_equal(images, before)
    assert facts["displaced_px"][PATTERNS[number]] > 1


def test_flicker_of_one_photograph_is_evened_out_and_reported(tmp_path: Path) -> None:
    images = noisy(still())
    images[5] *= np.float32(1.04)
    facts = prepared(images, tmp_path)
    assert list(facts["flicker"]) == ["z+"]
    assert abs(facts["flicker"]["z+"] - 1.04) < 0.003
    np.testing.assert_allclose(images[5].mean(), still()[5].mean(), rtol=0.003)
    assert "z+ was 1.04 times as bright" in prepare_warnings({"cam0": facts})[0]


def test_room_light_is_found_by_colour_and_taken_off(tmp_path: Path) -> None:
    colour = np.array([0.03, 0.02, 0.01], np.float32)
    room = colour * still()[0] * (0.7 + 0.3 * np.linspace(0, 1, SHAPE[1])[:, None])
    images = noisy(still() + room.astype(np.float32))
    off = np.abs(images - still())[:, SIGHT.mask].mean()
    facts = prepared(images, tmp_path)
    known = room[SIGHT.mask].sum(axis=0) / (still()[0] + room)[SIGHT.mask].sum(axis=0)
    np.testing.assert_allclose(facts["ambient"], known, rtol=0.05)
    assert np.abs(images - still())[:, SIGHT.mask].mean() < 0.25 * off
    assert "no lamp's light" in prepare_warnings({"cam0": facts})[0]


def test_swapped_photographs_are_named_and_nothing_is_warped(tmp_path: Path) -> None:
    images = noisy(still())
    images[[1, 4]] = images[[4, 1]]
    before = images.copy()
    facts = prepared(images, tmp_path)
    assert facts["looks_like"] == {"x+": "y-", "y-": "x+"}
    np.testing.assert_array_equal(images, before)
    assert any("looks like" in stated for stated in prepare_warnings({"cam0": facts}))


def test_patterns_without_pairs_are_left_alone(tmp_path: Path) -> None:
    images = noisy(still())[:1]
    usable = np.ones(SHAPE, bool)
    config = PrepareConfig()
    alone = session(SEQUENCES["full"])
    facts = prepare_view(tmp_path, "cam0", ("full",), images, usable, alone, config, {})
    assert facts["ambient"] is None
    assert read_diagnosis(tmp_path, "cam0").ambient is None
    assert light_section(tmp_path, {"sums": {"cam0": facts}}) is not None


@given(
    fill=st.sampled_from([0.0, -0.01, 1.0, 6e4, np.nan, np.inf, -np.inf]),
    half=st.booleans(),
    scale=st.floats(-6, 4).map(lambda power: 10.0**power),
)
@settings(max_examples=12, deadline=None)
def test_whatever_is_read_the_checks_end_without_a_word(
    tmp_path_factory: pytest.TempPathFactory, fill: float, half: bool, scale: float
) -> None:
    images = (still()[:, 100:200:3, 80:180:3] * np.float32(scale)).astype(
        np.float16 if half else np.float32
    )
    images[2, 5:20, 5:20] = fill
    usable = np.isfinite(images).all(axis=(0, 3))
    out, forced = tmp_path_factory.mktemp("checks"), PrepareConfig(forced=True)
    with np.errstate(all="raise", under="ignore"):
        facts = prepare_view(out, "cam0", PATTERNS, images, usable, session(), forced, {})
    assert all(np.isfinite(x) for x in facts["ambient"] or [])
    assert np.isfinite(read_diagnosis(out, "cam0").whole).all()


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_small_pictures_are_the_means_of_their_cells(dtype: type) -> None:
    picture: np.ndarray = np.random.default_rng(0).uniform(0, 2, (23, 31, 3)).astype(dtype)
    known = picture[:20, :28].astype(float).reshape(5, 4, 7, 4, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(shrunk(picture, 4), known, rtol=1e-5)


def test_the_report_shows_a_row_a_camera(tmp_path: Path) -> None:
    facts = prepared(noisy(still()), tmp_path)
    stated = {"sums": {"cam0": facts}, "clipped_share_of_foreground": {"cam0": 0.0123}}
    section = light_section(tmp_path, stated)
    assert section is not None
    picture, table = section.parts
    assert isinstance(picture, Picture)
    assert isinstance(table, Table)
    assert len(table.rows[0]) == len(table.header)
    dark = {"cam0": {**facts, "ambient": [-1e-6, 0.0, 0.012]}}
    dark_table = light_section(tmp_path, {"sums": dark}).parts[1]
    assert "0.00, 0.00, 1.20" in dark_table.rows[0]
    view = read_diagnosis(tmp_path, "cam0")
    one, two = grid({"cam0": view}), grid({"cam0": view, "cam1": view})
    assert one.dtype == np.uint8
    assert one.shape[1] == two.shape[1]
    assert two.shape[0] > 1.8 * one.shape[0]


def test_pictures_with_a_changed_byte_are_named_and_no_defect(tmp_path: Path) -> None:
    picture = np.random.default_rng(0).random((20, 30, 3)).astype(np.float32)
    path = write_diagnosis(tmp_path, "cam0", Diagnosis(picture, picture[..., 0]))
    good = path.read_bytes()
    for place in range(200, 2200, 200):
        path.write_bytes(good[:place] + bytes([good[place] ^ 0xFF]) + good[place + 1 :])
        with pytest.raises(FormatError, match=path.name):
            read_diagnosis(tmp_path, "cam0")


def test_more_is_red_and_less_is_blue() -> None:
    shown = signed(np.array([[-1.0, 0.0, 1.0]]), 1.0)[0].astype(int)
    assert shown[0, 2] > shown[0, 0] + 100
    assert len(set(shown[1])) == 1
    assert shown[2, 0] > shown[2, 2] + 100
