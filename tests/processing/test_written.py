"""Writing of exact maps, rays to many lights, and averages over neighbours, beside plain twins."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse

from lightstage.errors import FormatError
from lightstage.formats.processed import ProcessedFolder
from processing.coarse_maps import write_coarse
from processing.frames.read import write_foreground
from processing.rays import MeshRays
from processing.refinement.gloss import smooth
from processing.refinement.written import write_refined
from processing.view_maps import MAP_NAMES, PixelMaps


def maps_of(count: int, value: float) -> PixelMaps:
    three = (np.full((count, 3), value, np.float32) for _ in range(3))
    one = (np.full(count, value, np.float32) for _ in range(3))
    return PixelMaps(*three, *one)


def written_coarse(out: Path, mask: np.ndarray, value: float) -> None:
    """A view's coarse maps, all of one value."""
    write_foreground(out, "a", mask)
    write_coarse(out, "a", maps_of(int(mask.sum()), value))


def test_coarse_maps_fill_the_meshs_holes(tmp_path) -> None:
    folder = ProcessedFolder(tmp_path)
    coarse, mask = np.zeros((2, 6, 5), bool)
    coarse[1:4], mask[2:6, 1:] = True, True
    written_coarse(tmp_path, coarse, 0.5)
    count, mean = write_refined(folder, "a", mask, maps_of(16, 0.25), np.full(16, 0.75), 0.5)
    only = coarse & ~mask
    assert count == 16 + only.sum()
    assert mean == 0.25
    np.testing.assert_array_equal(folder.read_mask("a"), coarse | mask)
    for name in MAP_NAMES.values():
        image = folder.read_view("a", name)
        assert (image[mask] == 0.25).all()
        assert (image[only] == (0.25 if name == "confidence" else 0.5)).all()
        assert (image[~(coarse | mask)] == 0).all()
    open_sky = folder.read_view("a", "ambient_occlusion")
    assert (open_sky[mask] == 0.75).all()
    assert (open_sky[only] == 1).all()
    assert (open_sky[~(coarse | mask)] == 0).all()


def test_without_coarse_maps_there_are_the_meshs_pixels_alone(tmp_path) -> None:
    folder, mask = ProcessedFolder(tmp_path), np.eye(4, dtype=bool)
    assert write_refined(folder, "a", mask, maps_of(4, 0.5), np.ones(4), 0.5) == (4, 0.5)
    np.testing.assert_array_equal(folder.read_mask("a"), mask)


def test_pixels_of_an_occluder_keep_no_coarse_maps(tmp_path) -> None:
    folder = ProcessedFolder(tmp_path)
    everywhere, mask = np.ones((4, 4), bool), np.zeros((4, 4), bool)
    written_coarse(tmp_path, everywhere, 0.5)
    mask[0], others = True, np.zeros((4, 4), bool)
    others[2:] = True
    assert write_refined(folder, "a", mask, maps_of(4, 0.5), np.ones(4), 0.5, others)[0] == 8
    np.testing.assert_array_equal(folder.read_mask("a"), ~others)
    assert (folder.read_view("a", "confidence")[others] == 0).all()


def test_values_beyond_half_floats_are_refused(tmp_path) -> None:
    with pytest.raises(FormatError, match="65504"):
        write_refined(
            ProcessedFolder(tmp_path), "a", np.ones((2, 2), bool), maps_of(4, 7e4), np.ones(4), 1
        )


@given(seed=st.integers(0, 2**32 - 1), scale=st.sampled_from([1e-6, 1.0, 1e6]))
@settings(max_examples=20, deadline=None)
def test_averages_are_those_of_a_sparse_product(seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    values = scale * rng.normal(size=(30, 5))
    average = sparse.csr_array(sparse.random_array((30, 30), density=0.2, rng=rng))
    average.indptr, average.indices = (
        x.astype(np.int64) for x in (average.indptr, average.indices)
    )
    known = average @ (average @ values)
    np.testing.assert_allclose(smooth(values, average, 2), known, rtol=1e-12, atol=1e-12 * scale)
    np.testing.assert_array_equal(smooth(values, average, 0), values)


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_a_point_sees_what_is_above_it_and_not_behind_a_wall(seed: int) -> None:
    rng = np.random.default_rng(seed)
    # A wall at z = 5, of x < 0 alone.
    wall = np.array([[-1e3, -1e3, 5], [0, -1e3, 5], [0, 1e3, 5], [-1e3, 1e3, 5]])
    rays = MeshRays(wall, np.array([[0, 1, 2], [0, 2, 3]]))
    points = np.column_stack([rng.uniform(-9, 9, (40, 2)), np.zeros(40)])
    normals = rng.normal(size=(40, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    normals[0] = 0
    targets = np.column_stack([rng.uniform(-50, 50, (30, 2)), rng.uniform(6, 60, 30)])
    found = rays.visible(points, normals, targets, offset_mm=0.0)
    ray = targets[None] - points[:, None]
    height = np.einsum("nmk,nk->nm", ray, normals)
    met = points[:, None, 0] + ray[..., 0] * (5 / ray[..., 2])
    sure = (np.abs(height) > 1e-3) & (np.abs(met) > 1e-2)
    sure[0] = True
    np.testing.assert_array_equal(found[sure], ((height > 0) & (met > 0))[sure])
