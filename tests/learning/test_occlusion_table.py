from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from learning.errors import CheckpointError
from learning.occlusion_run import occlusion_table_for
from learning.render.occlusion_model import (
    OcclusionConfig,
    OcclusionTable,
    bake_dome,
    bake_table,
    default_occlusion,
    load_occlusion,
)
from lightstage.formats.template import default_template_path, load_template
from tests.learning.conftest import ball
from tests.learning.scenes import screen


def front(count: int = 40) -> np.ndarray:
    rng = np.random.default_rng(3)
    way = rng.normal(size=(count, 3))
    way[:, 2] = np.abs(way[:, 2]) + 0.5
    return way / np.linalg.norm(way, axis=1, keepdims=True)


def test_baked_shadows_are_those_of_geometry_and_cosines_are_left_out() -> None:
    seen, covered = bake_dome(screen(), 60, np.array([[0, 0, 1.0], [1, 0, 1], [0, 0, -1]]))
    assert covered.all()
    pictures = seen.reshape(3, 60, 40)
    x = (np.arange(40) + 0.5) / 40 * 100 - 50
    y = 50 - (np.arange(60) + 0.5) / 60 * 100
    under = (np.abs(x)[None] < 10) & (np.abs(y)[:, None] < 10)
    np.testing.assert_array_equal(pictures[0], ~under)
    # Light from +x throws the wall's shadow 30 mm toward -x.
    beside = (np.abs(x + 30)[None] < 10) & (np.abs(y)[:, None] < 10)
    assert (pictures[1] != ~beside).mean() < 0.01
    assert pictures[2].all()


def test_table_is_exact_where_baked_and_better_than_the_nearest_picture_between() -> None:
    table = bake_table(screen(), OcclusionConfig(rows=48, directions=600))
    baked = torch.from_numpy(table.directions[:50]).float()
    exact = table.mixed(baked).numpy()
    np.testing.assert_allclose(exact.reshape(50, -1), table.pictures(np.arange(50)), atol=1e-4)
    toward = front()
    truth = bake_dome(screen(), 48, toward)[0]
    found = table.for_lights(torch.from_numpy(1000 * toward).float(), (48, 32)).numpy()
    nearest = table.pictures(np.argmax(toward @ table.directions.T, axis=1))
    error = np.square(found.reshape(40, -1) - truth).mean()
    assert error < 0.9 * np.square(nearest - truth).mean()
    assert error < 0.01


def test_table_is_differentiable_in_the_lights_and_a_dark_side_pulls_them() -> None:
    table = bake_table(screen(), OcclusionConfig(rows=24, directions=300))
    light = torch.tensor([[0.05, 0.1, 1.0], [0.4, 0.1, 0.7]]).double().requires_grad_()
    assert torch.autograd.gradcheck(table.mixed, (light,), eps=1e-7, atol=1e-4)


def test_saved_table_reads_back_and_a_damaged_one_is_refused(tmp_path: Path) -> None:
    table = bake_table(screen(), OcclusionConfig(rows=12, directions=20))
    found = load_occlusion(table.save(tmp_path / "t.npz"))
    np.testing.assert_array_equal(found.bits, table.bits)
    np.testing.assert_array_equal(found.covered, table.covered)
    np.testing.assert_array_equal(found.face >= 0, table.covered)
    OcclusionTable(table.bits, table.covered, found.face[1:]).save(tmp_path / "face.npz")
    with pytest.raises(CheckpointError, match="face"):
        load_occlusion(tmp_path / "face.npz")
    with pytest.raises(CheckpointError, match="no such file"):
        load_occlusion(tmp_path / "none.npz")
    (tmp_path / "bad.npz").write_bytes(b"PK nothing")
    with pytest.raises(CheckpointError, match="expected a table"):
        load_occlusion(tmp_path / "bad.npz")
    OcclusionTable(table.bits[:, :3], table.covered, table.face).save(tmp_path / "cut.npz")
    with pytest.raises(CheckpointError, match="bits"):
        load_occlusion(tmp_path / "cut.npz")


def test_the_shipped_table_is_our_templates() -> None:
    mesh = load_template(default_template_path()).mesh
    table, toward = default_occlusion(), front(3)
    rows, columns = table.covered.shape
    truth = bake_dome(mesh, rows, toward)[0]
    found = table.for_lights(torch.from_numpy(toward).float(), (rows, columns)).numpy()
    assert np.abs(found[:, table.covered] - truth).mean() < 0.015
    big = table.for_lights(torch.from_numpy(toward).float(), (2 * rows, 2 * columns))
    assert big.shape == (3, 2 * rows, 2 * columns)


def test_a_table_of_another_uv_is_refused(tmp_path: Path) -> None:
    mesh = load_template(default_template_path()).mesh
    assert occlusion_table_for(None, mesh) is default_occlusion()
    other = bake_table(ball(), OcclusionConfig(rows=24, directions=20)).save(tmp_path / "ball.npz")
    assert len(occlusion_table_for(other, ball()).bits) == 20
    with pytest.raises(CheckpointError, match=r"ball\.npz, uv: found \d+% of the texels"):
        occlusion_table_for(other, mesh)
    with pytest.raises(CheckpointError, match="--shadows baked"):
        occlusion_table_for(None, ball())
