"""Hair over the forehead is found by the person's own colours, and skin is not taken for it."""

from __future__ import annotations

import numpy as np
import pytest

from learning.photo.fringe import Forehead
from learning.render.uv import rasterise
from lightstage.formats.template import default_template_path, load_template

SKIN, BLOND, BLACK = (0.55, 0.40, 0.32), (0.50, 0.34, 0.17), (0.03, 0.025, 0.02)
ROWS = 384


@pytest.fixture(scope="module")
def forehead() -> Forehead:
    template = load_template(default_template_path())
    return Forehead(template, rasterise(template.mesh, ROWS, ROWS * 2 // 3))


def strip(forehead: Forehead, rows: int) -> np.ndarray:
    """The forehead's texels within so many rows of the hair's lower border, in the middle."""
    columns = np.arange(ROWS * 2 // 3)
    lowest = ROWS - 1 - np.argmax(forehead.hair[::-1, columns.size // 2])
    within = np.arange(ROWS)[:, None] < lowest + rows
    return forehead.forehead & within & (np.abs(columns - columns.size // 2) < 30)


def painted(
    forehead: Forehead, hair: tuple[float, ...], hanging: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """(rows, columns, 3) an albedo with hair on the scalp and where it hangs, mottled."""
    shown = (forehead.hair | hanging)[..., None]
    mottled = np.exp(0.08 * rng.standard_normal((*hanging.shape, 3)))
    return np.where(shown, hair, SKIN) * mottled


@pytest.mark.parametrize("hair", [BLOND, BLACK])
def test_a_fringe_is_found_and_the_skin_below_it_stays(
    forehead: Forehead, hair: tuple[float, ...]
) -> None:
    hanging = strip(forehead, 20)
    assert hanging.sum() > 500
    albedo = painted(forehead, hair, hanging, np.random.default_rng(1))
    everything = np.ones_like(hanging)
    found = forehead.fringe(albedo, everything, np.zeros_like(hanging))
    assert found[hanging].mean() > 0.95
    assert found[forehead.forehead & ~strip(forehead, 24)].mean() < 0.02
    assert not found[~forehead.forehead].any()


def test_a_fringe_in_bright_light_with_a_dark_end_is_found_whole_and_a_parting_stays_skin(
    forehead: Forehead,
) -> None:
    """A highlight makes hair as light as skin, and its lower end is in its own shadow."""
    hanging, columns = strip(forehead, 30), np.arange(ROWS * 2 // 3) - ROWS // 3
    everything = np.ones_like(hanging)
    albedo = painted(forehead, BLOND, hanging, np.random.default_rng(3))
    albedo[hanging & (np.abs(columns) < 12)] = SKIN
    albedo[hanging & ~strip(forehead, 20)] = 0.6 * np.array(SKIN)
    found = forehead.fringe(albedo, everything, np.zeros_like(hanging))
    assert found[hanging].mean() > 0.92
    assert found[forehead.forehead & ~strip(forehead, 34)].mean() < 0.02
    parted = strip(forehead, 30) & (np.abs(columns) > 22)
    albedo = painted(forehead, BLOND, parted, np.random.default_rng(4))
    found = forehead.fringe(albedo, everything, np.zeros_like(hanging))
    assert found[parted].mean() > 0.9
    assert found[hanging & (np.abs(columns) < 18)].mean() < 0.05


def test_a_bald_head_a_lone_patch_and_a_face_without_texels_have_none(forehead: Forehead) -> None:
    rng = np.random.default_rng(2)
    nothing = np.zeros((ROWS, ROWS * 2 // 3), bool)
    bald = painted(forehead, tuple(0.9 * np.array(SKIN)), nothing, rng)
    assert not forehead.fringe(bald, ~nothing, nothing).any()
    patch = strip(forehead, 30) & ~strip(forehead, 15)
    lone = painted(forehead, BLACK, patch, rng)
    assert forehead.fringe(lone, ~nothing, nothing)[patch].mean() < 0.02
    assert not forehead.fringe(lone, nothing, nothing).any()


@pytest.mark.parametrize("value", [0.0, np.nan, np.inf, -1.0, 1e6, 1e-6])
def test_any_albedo_gives_an_answer(forehead: Forehead, value: float) -> None:
    nothing = np.zeros((ROWS, ROWS * 2 // 3), bool)
    albedo = np.full((*nothing.shape, 3), value)
    assert not forehead.fringe(albedo, ~nothing, nothing).any()
