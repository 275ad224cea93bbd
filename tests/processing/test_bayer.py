"""The demosaic against its plain twin in float64, and what clips, flats and edges do to it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import convolve

from processing.colour import ColourCorrection
from processing.frames.window import Window, whole
from processing.raw.bayer import NOISE
from processing.raw.mosaic import develop_mosaic, development, neutral_gains
from tests.processing.made_raw import BLACK, WHITE, counts_of, gradient

ORDERS = {
    "RGGB": np.array([[0, 1], [1, 2]]),
    "GRBG": np.array([[1, 0], [2, 1]]),
    "BGGR": np.array([[2, 1], [1, 0]]),
    "GBRG": np.array([[1, 2], [0, 1]]),
}
PLAIN = np.concatenate([np.eye(3), np.zeros((3, 3))], axis=1)
CROSSED = np.array([[1.9, -0.3, -0.05], [-0.2, 1.3, -0.1], [0.02, -0.4, 1.6]])
HALF = 2.0**-11
"""Half a unit in the last place of a half float, relative."""


def demosaic_twin(mosaic: np.ndarray, colours: np.ndarray) -> np.ndarray:
    """(h, w, 3) float64 from a balanced mosaic of even size: the method in whole pictures."""

    def filtered(values: np.ndarray, kernel: np.ndarray) -> np.ndarray:
        return np.asarray(convolve(values, kernel, mode="mirror"))

    places = np.tile(colours, (mosaic.shape[0] // 2, mosaic.shape[1] // 2))
    sign = np.where(places == 1, 1.0, -1.0)
    line = np.array([-0.25, 0.5, 0.5, 0.5, -0.25])
    binomial = np.array([1, 4, 6, 4, 1]) / 16
    cross = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]]) / 5
    smooth, rough = [], []
    for kernel, soft in ((line[None], binomial[None]), (line[:, None], binomial[:, None])):
        raw = sign * (mosaic - filtered(mosaic, kernel))
        smooth.append(filtered(raw, soft))
        rough.append(filtered((raw - smooth[-1]) ** 2, cross) + NOISE**2)
    share = rough[1] / (rough[0] + rough[1])
    difference = np.where(places == 1, 0, smooth[1] + share * (smooth[0] - smooth[1]))
    green = mosaic + difference
    between = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]]) / 4
    red, blue = (green - filtered(np.where(places == c, difference, 0), between) for c in (0, 2))
    return np.stack([red, green, blue], axis=-1)


def twin(
    counts: np.ndarray, colours: np.ndarray, coefficients: np.ndarray, white: float
) -> np.ndarray:
    """Levels, demosaic and colours in float64."""
    places = np.tile(colours, (counts.shape[0] // 2, counts.shape[1] // 2))
    balance = neutral_gains(coefficients[:, :3])
    share = (counts - float(BLACK)) / (white - BLACK)
    rgb = demosaic_twin(share * balance[places], colours) / balance
    matrix, bent = coefficients[:, :3], coefficients[:, 3:]
    return ColourCorrection(matrix, coefficients if bent.any() else None).apply(rgb)


def developed(
    counts: np.ndarray,
    colours: np.ndarray,
    coefficients: np.ndarray = PLAIN,
    window: Window | None = None,
    white: float = WHITE,
    **more: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray]:
    window = window or whole(counts.shape)
    how = development(
        colours, np.full((2, 2), float(BLACK)), white, white - BLACK, 0.99, coefficients, 1.0
    )
    out, clipped = np.zeros((*window.shape, 3), np.float16), np.zeros(window.shape, np.uint8)
    flat, ambient = more.get("flat"), more.get("ambient")
    place = (0, 0), counts.shape, window
    develop_mosaic(counts, *place, how, flat, ambient, out, clipped)
    return out.astype(np.float32), clipped


def random_counts(seed: int, height: int = 24, width: int = 40) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, WHITE, (height, width)).astype(np.uint16)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("bent", [False, True])
def test_the_fast_demosaic_is_its_twin(order: str, bent: bool) -> None:
    counts = random_counts(1)
    coefficients = np.concatenate([CROSSED, 0.3 * CROSSED if bent else np.zeros((3, 3))], axis=1)
    found, _ = developed(counts, ORDERS[order], coefficients)
    exact = twin(counts, ORDERS[order], coefficients, WHITE)
    np.testing.assert_allclose(found, exact, rtol=HALF, atol=2e-4)


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 1000),
    rows=st.integers(1, 20),
    columns=st.integers(1, 20),
    level=st.sampled_from([0, 1, 599, 600, 601, 15519, 65535]),
)
def test_any_counts_give_finite_values_that_are_the_twins(
    seed: int, rows: int, columns: int, level: int
) -> None:
    rng = np.random.default_rng(seed)
    counts = rng.integers(0, 65536, (2 * rows, 2 * columns)).astype(np.uint16)
    counts[rng.uniform(size=counts.shape) < 0.3] = level
    found, clipped = developed(counts, ORDERS["RGGB"])
    assert np.isfinite(found).all()
    exact = twin(counts, ORDERS["RGGB"], PLAIN, WHITE)
    np.testing.assert_allclose(found, exact, rtol=HALF, atol=5e-4)
    share = (counts - float(BLACK)) / (WHITE - BLACK)
    assert (clipped[share >= 0.9901] > 0).all()
    assert bool(clipped.any()) == bool((share >= 0.99).any())


@pytest.mark.parametrize("scale", [1e-6, 1e-3, 1.0, 1e3])
def test_the_results_follow_the_scale_of_the_colours(scale: float) -> None:
    counts = random_counts(2)
    one, _ = developed(counts, ORDERS["RGGB"], PLAIN)
    how = development(
        ORDERS["RGGB"],
        np.full((2, 2), float(BLACK)),
        WHITE,
        WHITE - BLACK,
        0.99,
        scale * PLAIN,
        1 / scale,
    )
    out, clipped = np.zeros((*counts.shape, 3), np.float16), np.zeros(counts.shape, np.uint8)
    develop_mosaic(counts, (0, 0), counts.shape, whole(counts.shape), how, None, None, out, clipped)
    np.testing.assert_allclose(out, one, rtol=2 * HALF, atol=1e-5)


@settings(max_examples=25, deadline=None)
@given(
    top=st.integers(0, 20),
    left=st.integers(0, 30),
    height=st.integers(1, 24),
    width=st.integers(1, 40),
)
def test_a_window_is_what_the_whole_picture_shows_there(
    top: int, left: int, height: int, width: int
) -> None:
    counts = random_counts(3)
    window = Window(top, left, min(height, 24 - top), min(width, 40 - left))
    everything, marks = developed(counts, ORDERS["GRBG"], PLAIN)
    found, clipped = developed(counts, ORDERS["GRBG"], PLAIN, window)
    np.testing.assert_array_equal(found, everything[window.slices])
    np.testing.assert_array_equal(clipped, marks[window.slices])


def test_strips_of_columns_meet_without_a_seam() -> None:
    counts = random_counts(4, 16, 2400)
    found, _ = developed(counts, ORDERS["RGGB"])
    exact = twin(counts, ORDERS["RGGB"], PLAIN, WHITE)
    np.testing.assert_allclose(found, exact, rtol=HALF, atol=2e-4)


def test_margins_of_the_file_are_no_part_of_the_picture() -> None:
    counts = random_counts(5, 30, 50)
    counts[:4], counts[:, :6] = 65535, 65535
    how = development(
        ORDERS["RGGB"], np.full((2, 2), float(BLACK)), WHITE, WHITE - BLACK, 0.99, PLAIN, 1.0
    )
    size = (24, 40)
    out, clipped = np.zeros((*size, 3), np.float16), np.zeros(size, np.uint8)
    develop_mosaic(counts, (4, 6), size, whole(size), how, None, None, out, clipped)
    inner, marks = developed(np.ascontiguousarray(counts[4:28, 6:46]), ORDERS["RGGB"])
    np.testing.assert_array_equal(out, inner)
    np.testing.assert_array_equal(clipped, marks)


def test_smooth_colours_come_back_as_they_were() -> None:
    rgb = gradient()
    found, clipped = developed(counts_of(rgb), ORDERS["RGGB"])
    inner = (slice(6, -6), slice(6, -6))
    np.testing.assert_allclose(found[inner], rgb[inner], atol=3e-4)
    assert not clipped.any()


def test_it_errs_less_than_bilinear_on_edges_of_any_direction() -> None:
    rows, columns = np.mgrid[:128, :128]
    for angle in np.deg2rad([0, 20, 45, 70, 90]):
        wave = np.sin(0.9 * (columns * np.cos(angle) + rows * np.sin(angle)))
        rgb = 0.4 + 0.2 * wave[..., None] * np.array([1.0, 0.9, 0.8])
        counts = counts_of(rgb)
        found, _ = developed(counts, ORDERS["RGGB"])
        mosaic = (counts - float(BLACK)) / (WHITE - BLACK)
        places = np.tile(ORDERS["RGGB"], (64, 64))
        between = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]]) / 4
        plus = np.array([[0, 1, 0], [1, 4, 1], [0, 1, 0]]) / 4
        plain = np.stack(
            [
                convolve(np.where(places == c, mosaic, 0), plus if c == 1 else between)
                for c in range(3)
            ],
            axis=-1,
        )
        inner = (slice(8, -8), slice(8, -8))
        ours, theirs = (np.sqrt(((x - rgb)[inner] ** 2).mean()) for x in (found, plain))
        assert ours < 0.6 * theirs


@pytest.mark.parametrize("place", [(20, 30), (20, 31), (21, 30), (21, 31), (0, 0), (47, 63)])
def test_a_clipped_count_marks_its_colour_where_it_was_used(place: tuple[int, int]) -> None:
    counts = counts_of(gradient())
    counts[place] = WHITE
    _, clipped = developed(counts, ORDERS["RGGB"])
    bit = 1 << int(ORDERS["RGGB"][place[0] % 2, place[1] % 2])
    expected = np.zeros_like(clipped)
    rows = slice(max(place[0] - 2, 0), place[0] + 3)
    expected[rows, max(place[1] - 2, 0) : place[1] + 3] = bit
    np.testing.assert_array_equal(clipped, expected)


def test_noise_below_black_is_kept_so_that_the_dark_does_not_brighten() -> None:
    rng = np.random.default_rng(3)
    counts = np.rint(rng.normal(BLACK, 75, (200, 200))).astype(np.uint16)
    found, _ = developed(counts, ORDERS["RGGB"])
    assert abs(float(found.mean())) < 1e-4
    assert found.min() < -0.005


def test_black_levels_differ_by_place_in_the_mosaic() -> None:
    black = np.array([[100.0, 110.0], [120.0, 130.0]])
    how = development(ORDERS["RGGB"], black, 1000.0, 870.0, 0.99, PLAIN, 1.0)
    counts = np.tile(black, (6, 8)).astype(np.uint16)
    out, clipped = np.ones((12, 16, 3), np.float16), np.zeros((12, 16), np.uint8)
    develop_mosaic(counts, (0, 0), (12, 16), whole((12, 16)), how, None, None, out, clipped)
    np.testing.assert_array_equal(out, 0)
    assert not clipped.any()


def test_a_flat_undoes_what_the_lens_took() -> None:
    rgb = np.full((64, 96, 3), 0.5)
    rows, columns = np.mgrid[:64, :96]
    share = 1 - 0.4 * ((rows - 32) ** 2 + (columns - 48) ** 2) / 3328
    counts = counts_of(rgb * share[..., None])
    window = Window(4, 6, 50, 80)
    gains = np.ascontiguousarray((1 / share)[window.grown(8, (64, 96)).slices], np.float32)
    found, _ = developed(counts, ORDERS["RGGB"], PLAIN, window, flat=gains)
    np.testing.assert_allclose(found, 0.5, atol=1e-3)


def test_ambient_light_is_taken_off_after_the_colours() -> None:
    counts = random_counts(6)
    ambient = np.random.default_rng(7).uniform(0, 0.3, (*counts.shape, 3)).astype(np.float32)
    lit, _ = developed(counts, ORDERS["RGGB"])
    less, _ = developed(counts, ORDERS["RGGB"], ambient=ambient)
    np.testing.assert_allclose(less, lit - ambient, rtol=2 * HALF, atol=1e-3)


@pytest.mark.parametrize(
    "matrix", [np.zeros((3, 3)), np.diag([1.0, 1.0, -1.0]), np.full((3, 3), np.nan)]
)
def test_a_matrix_without_a_neutral_leaves_the_mosaic_as_it_is(matrix: np.ndarray) -> None:
    np.testing.assert_array_equal(neutral_gains(matrix), 1)


def test_windows_beyond_the_picture_are_refused() -> None:
    counts = random_counts(8)
    with pytest.raises(ValueError, match="Window"):
        developed(counts, ORDERS["RGGB"], PLAIN, Window(0, 0, 25, 40))
    with pytest.raises(ValueError, match="pixels"):
        developed(counts[:1], ORDERS["RGGB"], PLAIN)
