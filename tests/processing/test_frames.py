"""Decoded photographs on the disk: what is written comes back, and only what is asked is read."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from lightstage.errors import FormatError
from processing.frames.drafts import HALVES, NOT_A_NUMBER, Marks, frames_path, new_frames
from processing.frames.read import Frames, power_of_two, read_frames, write_frames
from processing.frames.small import (
    SmallPictures,
    bright_side,
    cell_means,
    cell_side,
    small_pictures,
)
from processing.frames.window import Window, box_of, whole

PATTERNS = ("full", "x+", "x-")


def some_frames(height: int = 9, width: int = 11) -> tuple[np.ndarray, np.ndarray, Frames]:
    rng = np.random.default_rng(height)
    images = rng.normal(0.3, 1.0, (3, height, width, 3)).astype(np.float32)
    valid = rng.uniform(size=(height, width)) > 0.2
    return images, valid, Frames.of(PATTERNS, images, valid)


def windowed(frames: Frames, window: Window) -> Frames:
    """The same frames of which only a window was kept."""
    half, clipped = frames.half[:, *window.slices].copy(), frames.clipped[window.slices].copy()
    return Frames(frames.patterns, half, frames.scale, window, frames.shape, clipped)


def test_frames_are_mapped_and_not_read(tmp_path: Path) -> None:
    images, valid, frames = some_frames()
    write_frames(tmp_path, "cam0", frames)
    found = read_frames(tmp_path, "cam0")
    assert isinstance(found.half, np.memmap)
    np.testing.assert_allclose(found.images, images, rtol=5e-4, atol=1e-6)
    np.testing.assert_array_equal(found.valid, valid)


def test_outside_of_the_window_nothing_is_valid_and_all_reads_zero(tmp_path: Path) -> None:
    images, valid, frames = some_frames()
    window = Window(2, 3, 5, 6)
    write_frames(tmp_path, "cam0", windowed(frames, window))
    found = read_frames(tmp_path, "cam0")
    inside = np.zeros((9, 11), bool)
    inside[2:7, 3:9] = True
    np.testing.assert_array_equal(found.valid, valid & inside)
    expected = np.where(inside[..., None], images, 0)
    np.testing.assert_allclose(found.images, expected, rtol=5e-4, atol=1e-6)
    np.testing.assert_array_equal(found.image(1), found.images[1])


@settings(max_examples=40, deadline=None)
@given(
    mask=hnp.arrays(bool, (9, 11)),
    top=st.integers(0, 8),
    left=st.integers(0, 10),
    height=st.integers(1, 9),
    width=st.integers(1, 11),
)
def test_pixels_are_those_of_the_whole_pictures(
    mask: np.ndarray, top: int, left: int, height: int, width: int
) -> None:
    window = Window(top, left, min(height, 9 - top), min(width, 11 - left))
    frames = windowed(some_frames()[2], window)
    expected = frames.images[:, mask].transpose(1, 0, 2)
    np.testing.assert_array_equal(frames.pixels(mask), expected)


def test_a_mask_of_another_size_is_refused() -> None:
    with pytest.raises(ValueError, match="mask"):
        some_frames()[2].pixels(np.ones((4, 4), bool))


@pytest.mark.parametrize("wild", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_what_is_no_number_becomes_zero_and_not_valid(wild: float, scale: float) -> None:
    images, _, _ = some_frames()
    images = images * np.float32(scale)
    images[1, 4, 5, 2] = wild
    frames = Frames.of(PATTERNS, images, np.ones((9, 11), bool))
    assert np.isfinite(frames.images).all()
    assert frames.clipped[4, 5] == NOT_A_NUMBER
    assert np.flatnonzero(~frames.valid.ravel()).tolist() == [4 * 11 + 5]
    rest = frames.valid
    np.testing.assert_allclose(
        frames.images[:, rest], images[:, rest], rtol=5e-4, atol=1e-6 * scale
    )


@given(st.floats(1e-25, 1e25))
def test_a_scale_is_a_power_of_two_that_reaches_the_peak(peak: float) -> None:
    scale = power_of_two(peak)
    assert scale / 2 < peak <= scale
    assert np.frexp(scale)[0] == 0.5


@pytest.mark.parametrize("peak", [0.0, np.nan, np.inf, -1.0])
def test_without_a_peak_the_scale_is_one(peak: float) -> None:
    assert power_of_two(peak) == 1.0


def test_a_write_that_fails_leaves_the_frames_before_it(tmp_path: Path) -> None:
    images, _, frames = some_frames()
    write_frames(tmp_path, "cam0", frames)
    place = (PATTERNS, 1.0, whole((9, 11)), (9, 11))

    def fail() -> None:
        with new_frames(tmp_path, "cam0", *place) as draft:
            draft.half[:] = 7
            raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        fail()
    found = read_frames(tmp_path, "cam0")
    np.testing.assert_allclose(found.images, images, rtol=5e-4, atol=1e-6)
    assert [path.name for path in frames_path(tmp_path, "cam0").parent.iterdir()] == ["cam0"]


def test_damaged_frames_are_named(tmp_path: Path) -> None:
    write_frames(tmp_path, "cam0", some_frames()[2])
    folder = frames_path(tmp_path, "cam0")
    np.save(folder / HALVES, np.zeros((3, 4, 4, 3), np.float16))
    with pytest.raises(FormatError, match="Run the stage"):
        read_frames(tmp_path, "cam0")
    (folder / HALVES).write_bytes(b"nothing")
    with pytest.raises(FormatError, match="cam0"):
        read_frames(tmp_path, "cam0")
    facts = json.loads((folder / "frames.json").read_text())
    (folder / "frames.json").write_text(json.dumps({**facts, "schema": "processing.frames/2"}))
    with pytest.raises(FormatError, match="newer"):
        read_frames(tmp_path, "cam0")


@given(hnp.arrays(bool, hnp.array_shapes(min_dims=2, max_dims=2, max_side=8)))
def test_the_box_holds_all_of_a_mask_and_nothing_more(mask: np.ndarray) -> None:
    box = box_of(mask)
    assert box.empty == (not mask.any())
    inner = mask[box.slices]
    assert inner.sum() == mask.sum()
    if not box.empty:
        edges = (inner[0], inner[-1], inner[:, 0], inner[:, -1])
        assert all(edge.any() for edge in edges)
        np.testing.assert_array_equal(box.placed(inner, mask.shape), mask)


def test_windows_grow_to_the_picture_and_meet() -> None:
    window = Window(2, 3, 4, 5)
    assert window.grown(3, (8, 20)) == Window(0, 0, 8, 11)
    assert window.and_also(Window(4, 0, 10, 5)) == Window(4, 3, 2, 2)
    assert window.and_also(Window(7, 0, 1, 1)).empty
    assert not Window(5, 0, 4, 4).inside((8, 8))


@pytest.mark.parametrize(
    ("shape", "cell"), [((30, 41), 4), ((31, 40), 5), ((8, 8), 8), ((5, 9), 1)]
)
def test_small_pictures_of_rows_are_those_of_the_whole(shape: tuple[int, int], cell: int) -> None:
    rng = np.random.default_rng(5)
    half: np.ndarray = rng.uniform(-0.1, 3, (3, *shape, 3)).astype(np.float16)
    found = SmallPictures.empty(shape, PATTERNS[:3], cell)
    for name, picture in zip(PATTERNS[:3], half, strict=True):
        for top in reversed(range(0, shape[0], 2 * cell)):
            found.add(name, top, picture[top : top + 2 * cell])
    rows, columns = shape[0] // cell, shape[1] // cell
    for name, picture in zip(PATTERNS[:3], half, strict=True):
        part = picture[: rows * cell, : columns * cell].astype(float)
        means = part.reshape(rows, cell, columns, cell, 3).mean(axis=(1, 3))
        np.testing.assert_allclose(found.small[name], means, rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(cell_means(picture, cell), means, rtol=1e-5, atol=1e-6)
    assert found.side == 1
    np.testing.assert_allclose(found.bright, np.maximum(half.max(axis=(0, 3)), 0), rtol=1e-6)


def test_squares_of_a_large_picture_hold_the_brightest_mean() -> None:
    shape = (2100, 2500)
    half: np.ndarray = np.random.default_rng(6).uniform(0, 2, (2, *shape, 3)).astype(np.float16)
    side, cell = bright_side(shape), cell_side(shape, 5.0)
    assert side == 2
    assert cell == 4
    found = small_pictures(half, ("a", "b"), cell)
    means = half.astype(np.float32).reshape(2, 1050, 2, 1250, 2, 3).mean(axis=(2, 4))
    np.testing.assert_allclose(found.bright, means.max(axis=(0, 3)), rtol=1e-5)
    with pytest.raises(ValueError, match="squares"):
        SmallPictures.empty(shape, ("a",), 3)
    with pytest.raises(ValueError, match="begins no cell"):
        found.add("a", 2, half[0, :4])


def test_marks_of_parts_are_those_of_the_whole() -> None:
    bits: np.ndarray = (np.random.default_rng(7).random((12, 9)) > 0.9).astype(np.uint8) * 3
    parts = [Marks.of(bits[top : top + 5], top * 9) for top in (0, 5, 10)]
    joined, whole_one = Marks.joined(parts), Marks.of(bits)
    np.testing.assert_array_equal(joined.places, whole_one.places)
    np.testing.assert_array_equal(joined.bits, whole_one.bits)


def test_only_the_patterns_that_are_asked_for_are_read() -> None:
    images, _, frames = some_frames()
    mask = np.random.default_rng(8).random(images.shape[1:3]) > 0.4
    some = frames.pixels(mask, ("x-", "full"))
    np.testing.assert_array_equal(some, frames.pixels(mask)[:, [2, 0]])
    assert frames.pixels(mask, ()).shape == (mask.sum(), 0, 3)
