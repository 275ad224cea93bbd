"""Slopes of planes beside a plain float64 twin."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.reconstruction.slopes import STEEPEST, plane_slopes


def twin(normals, lens, pose):
    height, width = normals.shape[:2]
    fx, fy, cx, cy = lens
    x = (np.arange(width) + 0.5 - cx) / fx
    y = (np.arange(height) + 0.5 - cy) / fy
    sight = np.stack(np.broadcast_arrays(x[None, :], y[:, None], 1.0), axis=-1)
    sight /= np.linalg.norm(sight, axis=-1, keepdims=True)
    local = normals.astype(float) @ pose[:, :3].T
    unknown = ~(np.linalg.norm(local, axis=-1) > 0.5)
    local[unknown] = -sight[unknown]
    facing = -np.einsum("hwk,hwk->hw", local, sight)
    bend = np.maximum(STEEPEST - facing, 0)
    local = local - bend[..., None] * sight
    along = np.einsum("hwk,hwk->hw", local, sight) * np.sqrt(1 + x[None, :] ** 2 + y[:, None] ** 2)
    return np.stack([local[..., 0] / (fx * along), local[..., 1] / (fy * along)], axis=-1)


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    focal=st.sampled_from([1.0, 300.0, 1e6]),
    aside=st.sampled_from([0.0, 0.5, 30.0]),
    odd=st.sampled_from([0.0, np.nan, 1e-6, 1e6]),
)
def test_slopes_are_the_twins(seed, focal, aside, odd):
    rng = np.random.default_rng(seed)
    height, width = rng.integers(1, 12, 2)
    normals = rng.normal(size=(height, width, 3)).astype(np.float32)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    normals[rng.uniform(size=(height, width)) < 0.2] *= np.float32(odd)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    pose = np.column_stack([turn, rng.normal(size=3)])
    lens = np.array([focal, 1.1 * focal, aside * width, aside * height])
    found, right = plane_slopes(normals, lens, pose), twin(normals, lens, pose)
    assert np.isfinite(found).all()
    assert np.allclose(found, right, rtol=1e-5, atol=1e-6 / focal)
