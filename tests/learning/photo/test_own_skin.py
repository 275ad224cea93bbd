"""The skin of a photographed person: marks, hair, eyes, and light that was left in it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from learning.checkpoint import load_whole_face, shipped_weights
from learning.photo.face_light import harmonics
from learning.photo.own_skin import PersonTexels, PhotographedSkin, grain_beyond, light_left
from learning.photo.tone import SkinColours, skin_colours
from learning.whole.refine import TakenOut

ROWS, COLUMNS, SIZE = 192, 128, (48, 32)
NOTHING = np.zeros((ROWS, COLUMNS), bool)
SKIN = np.array([0.36, 0.2, 0.13])


@pytest.fixture(scope="module")
def people() -> SkinColours:
    return skin_colours(load_whole_face(shipped_weights())[0])


def bowl() -> np.ndarray:
    """(h, w, 3) normals of a face-like bowl."""
    rows, columns = np.mgrid[0 : SIZE[0], 0 : SIZE[1]]
    x, y = 1.2 * (columns / SIZE[1] - 0.5), 1.0 - 2 * rows / SIZE[0]
    normal = np.stack([x, 0.6 * y, np.ones_like(x)], axis=2)
    return normal / np.linalg.norm(normal, axis=2, keepdims=True)


def taken_out(
    unlit: np.ndarray,
    trust: float = 1.0,
    known: np.ndarray | None = None,
    sides: bool = False,
    low: np.ndarray | None = None,
) -> TakenOut:
    """A texture over an even light of strength .8."""
    known = ~NOTHING if known is None else known
    low = np.tile(SKIN, (*SIZE, 1)) if low is None else low
    return TakenOut(
        0.8 * unlit,
        unlit,
        known,
        known,
        np.full(known.shape, trust, np.float32),
        ~NOTHING,
        np.full((ROWS, COLUMNS, 3), 0.8),
        low,
        np.full((*SIZE, 1), 1.0),
        bowl(),
        sides,
    )


def plain(share: float = 1.0) -> np.ndarray:
    return np.tile(share * SKIN, (ROWS, COLUMNS, 1)).astype(np.float32)


def places(features: np.ndarray = NOTHING, **named: np.ndarray) -> PersonTexels:
    given = {"eyes": None, "hair": None, "other": NOTHING, **named}
    return PersonTexels(features, NOTHING, given["eyes"], given["hair"], given["other"])


def albedo_of(taken: TakenOut, where: PersonTexels, people: SkinColours) -> np.ndarray:
    own = PhotographedSkin(where, people).own(taken)
    return own.albedo(taken.unlit)


def beside(found: np.ndarray) -> np.ndarray:
    """(rows, columns) logarithm over the median."""
    log = np.log(found).mean(axis=2)
    return np.asarray(log - np.median(log))


def test_a_mole_a_brow_and_wrinkles_keep_their_strength_and_smooth_shading_does_not(
    people: SkinColours,
) -> None:
    rows, columns = np.mgrid[0:ROWS, 0:COLUMNS]
    unlit = plain()
    mole = (rows - 120) ** 2 + (columns - 90) ** 2 < 9
    brow = (abs(rows - 60) < 4) & (abs(columns - 40) < 16)
    shade = 0.12 * np.exp(-((rows - 110) ** 2 + (columns - 40) ** 2) / 200)
    unlit *= np.exp(-1.0 * mole - 1.2 * brow - shade)[..., None]
    found = beside(albedo_of(taken_out(unlit, trust=0.5), places(brow), people))
    assert found[120, 90] < -0.7
    assert np.median(found[brow]) < -1.0
    assert -0.09 < found[110, 40] < -0.01


def test_what_is_bright_where_little_is_trusted_is_light_and_no_mark(people: SkinColours) -> None:
    rows, columns = np.mgrid[0:ROWS, 0:COLUMNS]
    patch = (abs(rows - 120) < 10) & (abs(columns - 60) < 10)
    unlit = plain() * np.exp(0.8 * patch)[..., None]
    found = beside(albedo_of(taken_out(unlit, trust=0.1), places(), people))
    assert found[120, 60] < 0.25


def test_what_is_no_skin_is_filled_from_around_without_an_edge(people: SkinColours) -> None:
    unlit = plain()
    other = NOTHING.copy()
    other[100:130, 30:60] = True
    unlit[other] = 0.9, 0.9, 0.02
    found = albedo_of(taken_out(unlit), places(other=other), people)
    np.testing.assert_allclose(found[115, 45], found[115, 100], rtol=0.02)


def test_hair_keeps_its_colour_and_is_continued_in_hair_alone(people: SkinColours) -> None:
    hair = NOTHING.copy()
    hair[:80] = True
    unlit = plain()
    unlit[:80] = 0.03, 0.025, 0.02
    known = ~NOTHING
    known[:40] = False
    low = np.tile(SKIN, (*SIZE, 1))
    low[:20] = 0.05
    found = albedo_of(taken_out(unlit, known=known, low=low), places(hair=hair), people)
    over = found / np.median(found[100:], axis=(0, 1))
    expected = unlit[60, 60] / SKIN
    np.testing.assert_allclose(over[60, 64], expected, rtol=0.1)
    np.testing.assert_allclose(over[10, 64], expected, rtol=0.1)
    np.testing.assert_allclose(over[100:180, 20:100], 1, rtol=0.1)


def test_a_bald_head_is_skin_where_most_people_have_hair(people: SkinColours) -> None:
    hair = NOTHING.copy()
    hair[:80] = True
    low = np.tile(SKIN, (*SIZE, 1))
    low[:20] = 0.05
    unlit = plain()
    unlit[:80, :64] *= 0.75
    found = beside(albedo_of(taken_out(unlit, trust=0.15, low=low), places(hair=hair), people))
    assert np.abs(found).max() < 0.3


def test_blond_hair_of_the_skins_colour_is_hair_by_its_strands(people: SkinColours) -> None:
    hair = NOTHING.copy()
    hair[:80] = True
    low = np.tile(SKIN, (*SIZE, 1))
    low[:20] = 0.05
    unlit = plain()
    unlit[:80, ::3] *= 0.6
    known = ~NOTHING
    known[:40] = False
    found = albedo_of(taken_out(unlit, trust=0.15, known=known, low=low), places(hair=hair), people)
    strands = np.median(np.log(unlit[50:80]).mean(axis=2)) - np.log(SKIN).mean()
    assert beside(found)[4:30, 8:120].mean() == pytest.approx(strands, abs=0.25)


def test_strands_are_continued_with_their_size_and_without_a_mean() -> None:
    rng = np.random.default_rng(0)
    image = rng.normal(-3, 0.3, (ROWS, COLUMNS, 3))
    known = NOTHING.copy()
    known[20:60, 30:80] = True
    found = grain_beyond(image, known)
    assert np.abs(found.mean(axis=(0, 1))).max() < 0.02
    assert found[100:].std() == pytest.approx(0.3, rel=0.3)
    assert not grain_beyond(image, NOTHING).any()


def test_an_eye_that_is_not_shown_is_like_the_other_one(people: SkinColours) -> None:
    eye = NOTHING.copy()
    eye[80:96, 20:40] = True
    unlit = plain()
    unlit[eye] = 0.05, 0.03, 0.02
    known = ~eye[:, ::-1]
    both = eye | eye[:, ::-1]
    taken = taken_out(unlit, known=known, sides=True)
    found = albedo_of(taken, places(both, eyes=eye), people)
    np.testing.assert_allclose(found[:, ::-1][eye], found[eye], rtol=0.05)
    assert found[88, 30, 0] < 0.3 * found[150, 60, 0]


def test_light_that_was_left_along_the_normals_is_found_and_marks_do_not_move_it(
    people: SkinColours,
) -> None:
    values, _ = harmonics(bowl().reshape(-1, 3))
    left = 0.25 * values[:, 0].reshape(SIZE)
    large = np.kron(left, np.ones((ROWS // SIZE[0], COLUMNS // SIZE[1])))
    unlit = plain() * np.exp(large)[..., None]
    unlit[100:110, 20:40] *= 0.2
    found = light_left(taken_out(unlit), ~NOTHING).mean(axis=2)
    off = found - left
    assert np.abs(off - np.median(off)).max() < 0.12
    nothing = light_left(taken_out(unlit), NOTHING)
    assert not nothing.any()


@settings(max_examples=25, deadline=None)
@given(
    fill=st.sampled_from([1e-3, 1.0]),
    share=st.floats(0, 1),
    shown=st.floats(0, 1),
    trust=st.sampled_from([0.0, 1e-3, 1.0]),
    seed=st.integers(0, 99),
)
def test_any_texture_gives_a_finite_albedo(
    people: SkinColours, fill: float, share: float, shown: float, trust: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    unlit = rng.uniform(1e-3, 1, (ROWS, COLUMNS, 3)).astype(np.float32)
    unlit[rng.random((ROWS, COLUMNS)) < share] = fill
    known = rng.random((ROWS, COLUMNS)) < shown
    hair = NOTHING.copy()
    hair[:60] = True
    where = places(rng.random((ROWS, COLUMNS)) < 0.1, hair=hair, eyes=hair[::-1])
    found = albedo_of(taken_out(unlit, trust, known), where, people)
    assert np.isfinite(found).all()
    assert (found > 0).all()
    assert (found <= 1).all()
