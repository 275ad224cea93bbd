"""Hair and bare skin of one person's scalp, by their colours."""

from __future__ import annotations

import numpy as np
import pytest

from learning.whole.scalp import hair_share, skin_over_scalp

SKINS = {"light": (0.55, 0.38, 0.30), "dark": (0.14, 0.08, 0.05)}
HAIRS = {
    "black on light": ("light", (0.02, 0.015, 0.012)),
    "blond on light": ("light", (0.45, 0.30, 0.12)),
    "grey on light": ("light", (0.22, 0.22, 0.22)),
    "black on dark": ("dark", (0.02, 0.018, 0.017)),
    "white on dark": ("dark", (0.50, 0.50, 0.48)),
}
ROWS, COLUMNS = 192, 128
SCALP = np.zeros((ROWS, COLUMNS), bool)
SCALP[:96] = True
ALL = np.ones_like(SCALP)


def share_of(unlit: np.ndarray, skin: str, trust: float, shown: np.ndarray = ALL) -> np.ndarray:
    low = np.broadcast_to(SKINS[skin], (24, 16, 3)).copy()
    low[:12] = 0.03
    skin_log = skin_over_scalp(low, SCALP, ALL)
    return hair_share(unlit, shown, SCALP, skin_log, np.full(SCALP.shape, trust))


def head(skin: str, hair: tuple[float, ...], begins: int) -> np.ndarray:
    """A texture whose hair ends at a row, with noise."""
    unlit = np.broadcast_to(SKINS[skin], (ROWS, COLUMNS, 3)).copy()
    unlit[:begins] = hair
    noise = np.random.default_rng(5).standard_normal((ROWS, COLUMNS, 1))
    return np.asarray(np.clip(unlit * np.exp(0.08 * noise), 1e-3, 1))


@pytest.mark.parametrize("begins", [20, 60, 96, 98])
@pytest.mark.parametrize("case", HAIRS)
def test_hair_begins_where_its_colour_does(case: str, begins: int) -> None:
    skin, hair = HAIRS[case]
    share = share_of(head(skin, hair, begins), skin, 0.6)
    assert share[: begins - 3].mean() > 0.97
    assert share[begins + 3 :].mean() < 0.03


@pytest.mark.parametrize("skin", SKINS)
def test_a_bald_head_has_no_hair_whether_its_light_is_known_well_or_not(skin: str) -> None:
    unlit = head(skin, SKINS[skin], 0)
    assert not share_of(unlit, skin, 0.7).any()
    unlit[:50] *= np.exp(-0.6)
    assert not share_of(unlit, skin, 0.15).any()
    # As much darker in a light that is known well, it is hair.
    assert share_of(unlit, skin, 0.9)[:45].mean() > 0.97


def test_a_strand_as_light_as_skin_is_hair_and_bare_skin_reaches_down_to_the_face() -> None:
    unlit = head("light", HAIRS["black on light"][1], 60)
    bare = head("light", SKINS["light"], 0)
    strand, temple = np.s_[20:40, 30:90], np.s_[30:60, 100:]
    unlit[strand], unlit[temple] = bare[strand], bare[temple]
    share = share_of(unlit, "light", 0.6)
    assert share[strand].min() == 1
    assert not share[33:60, 103:].any()


def test_hair_over_the_forehead_ends_softly() -> None:
    share = share_of(head("light", HAIRS["black on light"][1], 150), "light", 0.6)
    assert share[:96].min() > 0.97
    assert 0.6 > share[97, 64] > 0.3
    assert not share[104:].any()
    assert np.abs(np.diff(share[:, 64])).max() < 0.4


def test_what_nothing_shows_has_hair_only_on_a_head_that_has() -> None:
    shown = ALL.copy()
    shown[:, :64] = False
    with_hair = share_of(head("light", HAIRS["black on light"][1], 60), "light", 0.6, shown)
    assert with_hair[:80, :40].min() > 0.97
    assert not with_hair[110:].any()
    assert not share_of(head("light", SKINS["light"], 0), "light", 0.6, shown).any()


def test_a_scalp_that_is_hardly_shown_has_most_peoples_hair() -> None:
    unlit = head("light", SKINS["light"], 0)
    np.testing.assert_array_equal(share_of(unlit, "light", 0.6, ~SCALP), SCALP)


def test_nothing_of_most_peoples_hair_is_in_the_skin_that_continues_under_it() -> None:
    low = np.broadcast_to(SKINS["light"], (24, 16, 3)).copy()
    low[:12] = 0.03
    # As a texel at the border is half hair.
    low[12] = 0.2
    found = np.exp(skin_over_scalp(low, SCALP, ALL))
    np.testing.assert_allclose(found, np.broadcast_to(SKINS["light"], found.shape), rtol=1e-5)
