"""Where a texture over its light tells of the skin, and where it does not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from learning.networks.whole_face import DARKEST
from learning.whole.unlit import (
    LIGHT_OFF,
    OWN_DEVIATION,
    SHINE_OFF,
    in_the_dark,
    light_edges,
    matt,
    misplaced,
    over_light,
    trusted,
)


def test_an_edge_of_a_shadow_is_left_out_and_a_slow_fall_is_not() -> None:
    level = np.linspace(1.0, 0.5, 384, dtype=np.float32)[:, None] * np.ones((1, 256), np.float32)
    covered = np.ones(level.shape, bool)
    assert not light_edges(level, covered).any()
    level[:, 100:] *= 0.3
    found = light_edges(level, covered)
    assert found[:, 99:101].all()
    assert not found[:, :96].any()
    assert not found[:, 104:].any()


def test_a_lit_patch_where_shadow_was_expected_is_no_mark_and_a_mole_is() -> None:
    """Near a shadow's edge what differs much is its place in error; far from it, a mark."""
    rows, columns = 384, 256
    edges = np.zeros((rows, columns), bool)
    edges[200:203, :128] = True
    ratio = np.ones((rows, columns, 3), np.float32)
    ratio[196:200, 20:100] = 0.2
    ratio[300:312, 180:192] = 0.2
    ratio[201, 60] = 0.5
    everywhere = np.ones((rows, columns), bool)
    found = misplaced(ratio, edges, everywhere)
    assert found[197:199, 24:96].all()
    assert not found[290:320].any()
    assert not found[:, 140:].any()
    # A smaller difference is detail, near an edge too.
    assert not misplaced(np.full_like(ratio, 1.3), edges, everywhere).any()
    # And so is a person who is lighter than was thought.
    assert np.array_equal(misplaced(2 * ratio, edges, everywhere), found)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_edges_in_light_of_any_strength_leave_a_mask(scale: float) -> None:
    level = np.full((96, 64), scale, np.float32)
    level[:, 32:] = 0
    edges = light_edges(level, np.ones((96, 64), bool))
    ratio = np.full((96, 64, 3), scale, np.float32)
    assert not misplaced(ratio, edges, ~edges).any()
    nothing_known = misplaced(ratio, edges, np.zeros((96, 64), bool))
    # Light that is dark everywhere has no edges.
    assert nothing_known.any() == (scale > 1)
    assert not nothing_known[:, 48:].any()


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_what_is_black_beside_the_face_is_in_a_shadow_and_a_black_beard_is_not(
    scale: float,
) -> None:
    texture = np.full((96, 64, 3), 0.35 * scale)
    texture[10:20] = 0.05 * scale
    texture[40:50] = 0.001 * scale
    photographed = np.ones((96, 64), bool)
    photographed[:, :10] = False
    found = in_the_dark(texture, photographed)
    assert found[40:50, 10:].all()
    assert found.sum() == 10 * 54
    # In darkness nothing is darker than the rest; nothing photographed has no median.
    assert not in_the_dark(0 * texture, photographed).any()
    assert not in_the_dark(texture, ~photographed & False).any()


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_a_highlight_stronger_than_the_texture_leaves_no_black_spot(scale: float) -> None:
    """The highlight grows from none to five times the texture; the albedo falls by .35 at most."""
    texture = scale * np.full((8, 200, 3), (0.3, 0.2, 0.1), np.float32)
    shine = np.linspace(0, 5, 200)[:, None] * scale * np.array([0.1, 0.1, 0.1])
    shine = np.broadcast_to(shine, texture.shape)
    irradiance = np.full_like(texture, max(scale, 1.0))
    found = over_light(texture, irradiance, shine)
    plain = np.clip((texture.astype(float) - shine) / irradiance, DARKEST, 1)
    matte = matt(texture, shine)
    assert matte.any()
    assert not matte.all()
    np.testing.assert_allclose(found[matte], plain[matte], rtol=1e-5)
    least = np.maximum(0.649 * texture / irradiance, DARKEST)
    assert (found >= least - 1e-9).all()
    # The highlight grows by .0025 a texel: no texel differs from the next by more than that.
    assert np.abs(np.diff(np.log(found[0]), axis=0)).max() < 0.04


def test_black_and_negative_texels_over_any_highlight_are_the_darkest_skin() -> None:
    texture = np.zeros((2, 2, 3))
    texture[1] = -0.1
    found = over_light(texture, np.ones((2, 2, 3)), np.full((2, 2, 3), 0.5))
    np.testing.assert_array_equal(found, np.float32(DARKEST))


def test_trust_is_the_share_of_the_skins_own_variance_in_what_is_seen_of_it() -> None:
    """Drawn skins under a light that is wrong by a tilt and a highlight, and their regression."""
    rng, count, normals_off = np.random.default_rng(0), 400_000, 0.06
    texture = np.full((1, 3, 3), 0.5)
    shine = np.zeros((1, 3, 3))
    shine[0, 2] = 0.1
    slope = np.array([[[0.0, 0.0], [1.2, -0.5], [0.3, 0.2]]])
    level = np.array([[4.0, 1.0, 0.3]])
    found = trusted(texture, shine, level, slope, normals_off)[0]
    own = OWN_DEVIATION * rng.standard_normal(count)
    tilt = normals_off * rng.standard_normal((count, 2))
    highlight = SHINE_OFF * rng.standard_normal(count)
    light = LIGHT_OFF * rng.standard_normal(count)
    for texel in range(3):
        mirrored = shine[0, texel, 0] / (texture - shine)[0, texel, 0]
        seen = own + tilt @ slope[0, texel] + mirrored * highlight + light / level[0, texel]
        assert found[texel] == pytest.approx(own @ seen / (seen @ seen), abs=0.01)
    assert found[0] > 0.98
    assert found[1:].max() < 0.8


ANY = st.one_of(st.floats(-1e6, 1e6), st.sampled_from([0.0, 1e-30, 1e6, -1e6]))


@settings(deadline=None, max_examples=50)
@given(
    arrays(float, (3, 2, 3), elements=ANY),
    arrays(float, (3, 2, 3), elements=st.floats(0, 1e6)),
    arrays(float, (3, 2), elements=st.floats(0, 1e6)),
    arrays(float, (3, 2, 2), elements=st.floats(-3, 3)),
    st.floats(0, 1),
)
def test_trust_is_between_none_and_all_whatever_is_photographed(
    texture: np.ndarray,
    shine: np.ndarray,
    level: np.ndarray,
    slope: np.ndarray,
    normals_off: float,
) -> None:
    found = trusted(texture, shine, level, slope, normals_off)
    assert ((found >= 0) & (found <= 1)).all()
    # A tilt, a highlight or less light never adds to it.
    assert (trusted(texture, shine, level, slope, normals_off + 0.1) <= found + 1e-6).all()
    assert (trusted(texture, shine, 0.5 * level, slope, normals_off) <= found + 1e-6).all()
    assert (found <= trusted(texture, 0 * shine, level, slope, normals_off) + 1e-6).all()
