"""RAW decode against a mosaic whose colours are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile

from lightstage.errors import FormatError
from processing.raw import demosaic, linear_mosaic, read_raw

BLACK, WHITE = 600, 15520


def write_dng(path: Path, counts: np.ndarray) -> Path:
    """An RGGB DNG that LibRaw reads."""
    tags = [
        (50706, "B", 4, (1, 4, 0, 0)),
        (50707, "B", 4, (1, 1, 0, 0)),
        (50708, "s", 0, "Test"),
        (33421, "H", 2, (2, 2)),
        (33422, "B", 4, (0, 1, 1, 2)),
        (50710, "B", 3, (0, 1, 2)),
        (50711, "H", 1, 1),
        (50714, "H", 1, BLACK),
        (50717, "I", 1, WHITE),
        (50721, "2i", 9, (1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1)),
        (50728, "2I", 3, (1, 2, 1, 1, 2, 3)),
        (50778, "H", 1, 21),
    ]
    tifffile.imwrite(path, counts, photometric=32803, extratags=tags)
    return path


def gradient(height: int = 48, width: int = 64) -> np.ndarray:
    rows, columns = np.mgrid[:height, :width]
    return np.stack(
        [0.3 + 0.2 * columns / width, 0.2 + 0.1 * rows / height, 0.1 + 0 * rows], axis=-1
    )


def mosaic_of(rgb: np.ndarray) -> np.ndarray:
    mosaic = rgb[:, :, 1].copy()
    mosaic[::2, ::2] = rgb[::2, ::2, 0]
    mosaic[1::2, 1::2] = rgb[1::2, 1::2, 2]
    return mosaic


def counts_of(rgb: np.ndarray) -> np.ndarray:
    return np.rint(BLACK + mosaic_of(rgb) * (WHITE - BLACK)).astype(np.uint16)


def test_a_dng_of_known_colours_is_decoded_to_them(tmp_path: Path) -> None:
    rgb = gradient()
    picture = read_raw(write_dng(tmp_path / "a.dng", counts_of(rgb)), 0.99)
    inner = (slice(3, -3), slice(3, -3))
    np.testing.assert_allclose(picture.rgb[inner], rgb[inner], atol=2e-4)
    np.testing.assert_allclose(picture.neutral_from_raw, [2.0, 1.0, 1.5], rtol=1e-3)
    assert not picture.clipped.any()


def test_a_clipped_count_marks_every_pixel_that_took_from_it(tmp_path: Path) -> None:
    counts = counts_of(gradient())
    counts[20, 30] = WHITE
    clipped = read_raw(write_dng(tmp_path / "a.dng", counts), 0.99).clipped
    assert clipped[18:23, 28:33].all()
    assert clipped.sum() == 25


def test_a_truncated_dng_is_refused_with_its_name(tmp_path: Path) -> None:
    path = write_dng(tmp_path / "cut.dng", counts_of(gradient()))
    path.write_bytes(path.read_bytes()[:900])
    with pytest.raises(FormatError, match=r"cut\.dng"):
        read_raw(path, 0.99)


def test_noise_below_black_is_kept_so_that_the_dark_does_not_brighten() -> None:
    rng = np.random.default_rng(3)
    rgb = demosaic(rng.normal(0.0, 0.005, (200, 200)).astype(np.float32), "RGGB")
    assert abs(float(rgb.mean())) < 1e-4
    assert rgb.min() < -0.005


def test_black_levels_differ_by_place_in_the_mosaic() -> None:
    black = np.array([[100.0, 110.0], [120.0, 130.0]])
    counts = np.tile(black, (3, 4))
    mosaic, clipped = linear_mosaic(counts, black, 1000.0, 0.99)
    np.testing.assert_array_equal(mosaic, 0)
    assert not clipped.any()
