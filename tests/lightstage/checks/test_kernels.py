"""Cells summed in one pass equal the plain twin's, whatever the numbers."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.checks.kernels import FAR, REACH, cells_kernel

BAYERS = [[[0, 1], [1, 2]], [[1, 0], [2, 1]], [[2, 1], [1, 0]], [[1, 2], [0, 1]], [[1, 1], [1, 1]]]


def run(counts, colours, black, white, quads):
    rows, columns = counts.shape[0] // 2 // quads, counts.shape[1] // 2 // quads
    light, detail = np.full((rows, columns, 3), np.nan), np.full((rows, columns, 3), np.nan)
    clipped, extremes = np.full((rows, columns, 3), -7), np.empty(4)
    cells_kernel(counts, colours, black, white, quads, light, detail, clipped, extremes)
    return light, detail, clipped, extremes


def pooled(plane: np.ndarray, quads: int) -> np.ndarray:
    """(rows, quads, columns, quads) of the whole cells."""
    rows, columns = plane.shape[0] // quads, plane.shape[1] // quads
    return plane[: rows * quads, : columns * quads].reshape(rows, quads, columns, quads)


def cells_twin(
    counts: np.ndarray, colours: np.ndarray, black: np.ndarray, white: float, quads: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The kernel's light, detail and clipped, of the same shapes, in plain float64."""
    wide = counts.astype(float)
    high, long = wide.shape[0] // 2, wide.shape[1] // 2
    rows, columns = high // quads, long // quads
    light = np.zeros((rows, columns, 3))
    clipped = np.zeros((rows, columns, 3), np.int64)
    number = np.zeros(3)
    planes: list[np.ndarray] = []
    for y in range(2):
        for x in range(2):
            plane = wide[y : 2 * high : 2, x : 2 * long : 2]
            above = np.where(np.isfinite(plane), plane - black[y, x], 0.0)
            full = np.where(np.isfinite(plane), plane, black[y, x]) >= white
            colour = colours[y, x]
            light[..., colour] += pooled(above, quads).sum(axis=(1, 3))
            clipped[..., colour] += pooled(full, quads).sum(axis=(1, 3))
            number[colour] += quads**2
            if colour == 1:
                planes.append(above)
    light /= np.maximum(number, 1)
    green = np.mean(planes, axis=0)
    detail = np.zeros((rows, columns, 3))
    if len(planes) == 2:
        detail[..., 0] = pooled(0.5 * (planes[1] - planes[0]) ** 2, quads).mean(axis=(1, 3))
    for index, lag in ((1, 1), (2, FAR)):
        energy = np.zeros_like(green)
        inner = slice(0, max(high - REACH, 0)), slice(0, max(long - REACH, 0))
        here = green[inner]
        tall, broad = here.shape
        across = (
            here - 2 * green[:tall, lag : lag + broad] + green[:tall, 2 * lag : 2 * lag + broad]
        )
        down = here - 2 * green[lag : lag + tall, :broad] + green[2 * lag : 2 * lag + tall, :broad]
        energy[inner] = 0.5 * (across**2 + down**2)
        detail[..., index] = pooled(energy, quads).mean(axis=(1, 3))
    return light, detail, clipped


@settings(max_examples=60)
@given(
    seed=st.integers(0, 2**32 - 1),
    height=st.integers(8, 60),
    width=st.integers(8, 60),
    quads=st.integers(1, 4),
    bayer=st.sampled_from(BAYERS),
    scale=st.sampled_from([1e-6, 1.0, 1e6]),
    wild=st.sampled_from([0.0, 0.1]),
)
def test_cells_are_those_of_the_plain_twin(seed, height, width, quads, bayer, scale, wild):
    rng = np.random.default_rng(seed)
    counts = (scale * rng.normal(1.0, 1.0, (height, width))).astype(np.float32)
    odd = rng.random(counts.shape)
    counts[odd < wild] = np.nan
    counts[odd < wild / 2] = np.inf
    colours = np.array(bayer)
    black = scale * rng.normal(0.1, 0.1, (2, 2))
    white = 2.0 * scale
    ours = run(counts, colours, black, white, quads)
    twin = cells_twin(counts, colours, black, white, quads)
    for name, a, b in zip(("light", "detail", "clipped"), ours, twin, strict=False):
        size = max(float(np.abs(b).max(initial=0.0)), 1e-300)
        # With one colour alone the four of a quad are no pair: the twin knows no such noise.
        skip = 1 if name == "detail" and bayer == BAYERS[4] else 0
        np.testing.assert_allclose(a[..., skip:], b[..., skip:], rtol=1e-9, atol=1e-11 * size)


def test_uint16_counts_and_a_part_of_a_larger_picture_are_summed_alike():
    counts = np.random.default_rng(3).integers(500, 16384, (50, 44)).astype(np.uint16)
    part = counts[4:, 2:40]
    colours, black = np.array(BAYERS[0]), np.full((2, 2), 600.0)
    ours = run(part, colours, black, 16383.0, 3)
    for a, b in zip(ours, cells_twin(part, colours, black, 16383.0, 3), strict=False):
        np.testing.assert_allclose(a, b, rtol=1e-12)


def test_extremes_tell_the_pile_at_the_top_and_what_is_no_number():
    counts = np.ones((16, 16), np.float32)
    counts[2, 3], counts[4, 4:9] = np.nan, 9.0
    counts[15, 15] = -4.0
    extremes = run(counts, np.array(BAYERS[0]), np.zeros((2, 2)), 100.0, 2)[3]
    assert extremes.tolist() == [-4.0, 9.0, 5.0, 1.0]


@pytest.mark.parametrize("value", [0, 16383])
def test_a_constant_picture_has_no_detail(value):
    counts = np.full((32, 32), value, np.uint16)
    light, detail, clipped, _ = run(counts, np.array(BAYERS[0]), np.zeros((2, 2)), 16383.0, 4)
    assert (light == value).all()
    assert not detail.any()
    assert clipped.sum() == (32 * 32 if value == 16383 else 0)
