"""Heights from normals, and the mesh that they emboss."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse
from scipy.sparse.linalg import spsolve

from learning.detail.emboss import embossed
from learning.detail.height import Steps, heights_mm, solve
from learning.errors import MapsError
from learning.render.uv import rasterise
from lightstage.formats.exr import read_exr, write_exr
from lightstage.formats.mesh import Mesh, read_obj, vertex_normals, write_obj
from lightstage.formats.processed import ProcessedFolder
from tests.learning.conftest import RADIUS_MM, ball
from tests.learning.export.called import printed, refusal


def sheet(rows: int, columns: int, pitch_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """Positions and normals of a flat piece that looks along +z."""
    x, y = np.meshgrid(np.arange(columns) * pitch_mm, -np.arange(rows) * pitch_mm)
    position = np.stack([x, y, np.zeros_like(x)], axis=2)
    normal = np.zeros_like(position)
    normal[..., 2] = 1
    return position, normal


def relief(position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Heights of waves of 4 and 3 mm on a sheet, and the normals of that surface."""
    x, y = position[..., 0], position[..., 1]
    a, b = 2 * np.pi / 4.0, 2 * np.pi / 3.0
    height = 0.05 * np.sin(a * x) * np.cos(b * y)
    normal = np.stack(
        [
            -0.05 * a * np.cos(a * x) * np.cos(b * y),
            0.05 * b * np.sin(a * x) * np.sin(b * y),
            np.ones_like(x),
        ],
        axis=2,
    )
    return height, normal / np.linalg.norm(normal, axis=2, keepdims=True)


def test_waves_come_back_from_their_normals_within_a_masked_outline() -> None:
    position, base = sheet(180, 160, 0.25)
    height, fine = relief(position)
    covered = np.hypot(*(position[..., :2] - [20, -22]).transpose(2, 0, 1)) < 17
    covered[80:90, 60:75] = False  # a hole
    found, rounds = heights_mm(position, base, fine, covered, 30.0)
    off = (found - height)[covered]
    off -= off.mean()
    assert np.sqrt((off**2).mean()) < 0.06 * height[covered].std()
    assert not found[~covered].any()
    assert rounds < 60


def test_relief_longer_than_asked_is_the_meshs() -> None:
    position, base = sheet(200, 200, 0.5)
    tilt = np.radians(3)
    fine = np.broadcast_to([np.sin(tilt), 0, np.cos(tilt)], base.shape)
    found, _ = heights_mm(position, base, fine, np.ones((200, 200), bool), 30.0)
    # As a plane of three degrees it would be 5.2 mm high.
    assert np.ptp(found[:, 40:160]) < 0.05
    assert np.ptp(found) < 0.6


@pytest.mark.parametrize(("times", "kept"), [(0.25, 0.94), (1.0, 0.5), (4.0, 0.06)])
def test_a_wave_as_long_as_asked_keeps_half_its_height(times: float, kept: float) -> None:
    position, base = sheet(4, 480, 0.25)
    length = 12.0
    x, number = position[..., 0], 2 * np.pi / length
    height = 0.1 * np.sin(number * x)
    slope = 0.1 * number * np.cos(number * x)
    fine = np.stack([-slope, 0 * x, np.ones_like(x)], axis=2)
    fine /= np.linalg.norm(fine, axis=2, keepdims=True)
    found, _ = heights_mm(position, base, fine, np.ones(x.shape, bool), length / times)
    middle = slice(96, 384)
    share = (found * height)[:, middle].sum() / (height**2)[:, middle].sum()
    assert share == pytest.approx(kept, abs=0.02)


def test_a_balls_own_normals_have_no_height() -> None:
    mesh = ball()
    raster = rasterise(mesh, 96, 64)
    normal = raster.normals(mesh)
    found, _ = heights_mm(raster.interpolate(mesh.vertices), normal, normal, raster.covered, 10.0)
    assert np.abs(found).max() < 1e-12


def test_the_search_finds_what_a_plain_solver_finds() -> None:
    rng = np.random.default_rng(0)
    rows, columns = 14, 11
    covered = rng.random((rows, columns)) < 0.85
    across = rng.normal(size=(rows, columns - 1))
    down = rng.normal(size=(rows - 1, columns))
    steps = Steps(
        across,
        down,
        rng.random(across.shape) * (covered[:, 1:] & covered[:, :-1]),
        rng.random(down.shape) * (covered[1:] & covered[:-1]),
        0.01 * covered,
    )
    number = np.arange(rows * columns).reshape(rows, columns)
    first = np.concatenate([number[:, :-1].ravel(), number[:-1].ravel()])
    second = np.concatenate([number[:, 1:].ravel(), number[1:].ravel()])
    weight = np.concatenate([steps.across_weight.ravel(), steps.down_weight.ravel()])
    wanted = np.concatenate([across.ravel(), down.ravel()])
    line = np.arange(len(first))
    difference = sparse.coo_matrix(
        (
            np.r_[-np.ones(len(first)), np.ones(len(first))],
            (np.r_[line, line], np.r_[first, second]),
        )
    ).tocsr()
    left = difference.T @ sparse.diags(weight) @ difference
    left = left + sparse.diags(np.where(covered, steps.hold, 1.0).ravel())
    plain = spsolve(left.tocsc(), difference.T @ (weight * wanted)).reshape(rows, columns)
    found, _ = solve(steps, covered, 1e-9)
    np.testing.assert_allclose(found, np.where(covered, plain, 0), atol=1e-4)


@given(
    scale=st.sampled_from([1e-6, 1.0, 1e6]),
    what=st.sampled_from(["nan", "zero", "backward", "noise", "none", "one texel"]),
)
@settings(max_examples=18, deadline=None)
def test_any_normals_give_finite_heights(scale: float, what: str) -> None:
    position, base = sheet(24, 20, 0.5 * scale)
    rng = np.random.default_rng(1)
    fine = base + 0.2 * rng.normal(size=base.shape)
    covered = np.ones((24, 20), bool)
    if what == "nan":
        fine[3:9, 4:7] = np.nan
        position[0, 0] = np.inf
    elif what == "zero":
        fine[:] = 0
    elif what == "backward":
        fine[:] = -base
    elif what == "none":
        covered[:] = False
    elif what == "one texel":
        covered[:] = False
        covered[3, 3] = True
    found, _ = heights_mm(position, base, fine, covered, 10 * scale)
    assert np.isfinite(found).all()
    assert not found[~covered].any()
    if what in ("zero", "backward"):
        assert not found.any()


def test_a_finer_ball_is_rounder() -> None:
    mesh = ball(rows=12, columns=16)
    count = len(mesh.vertices)
    finer = embossed(mesh, np.zeros((96, 64)), 1).vertices[count:]
    a, b, c = (mesh.vertices[mesh.triangles()[:, i]] for i in range(3))
    flat = np.concatenate([a + b, b + c, c + a]) / 2
    sagging = RADIUS_MM - np.linalg.norm(flat, axis=1).mean()
    assert np.abs(RADIUS_MM - np.linalg.norm(finer, axis=1)).mean() < 0.5 * sagging


def test_an_embossed_ball_is_closed_and_as_high_as_its_map() -> None:
    mesh = ball()
    height = np.full((96, 64), 0.5)
    finer = embossed(mesh, height, 1)
    assert len(finer.faces) == 4 * len(mesh.triangles())
    plain = embossed(mesh, 0 * height, 1)
    moved = np.linalg.norm(finer.vertices - plain.vertices, axis=1)
    np.testing.assert_allclose(moved, 0.5, atol=1e-6)
    edges = np.sort(finer.triangles()[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    before = np.sort(mesh.triangles()[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)

    def borders(lines: np.ndarray) -> int:
        return int((np.unique(lines, axis=0, return_counts=True)[1] == 1).sum())

    assert borders(edges) == 2 * borders(before)  # no border but the ball's own seam, split
    assert (vertex_normals(finer.vertices, finer.triangles()) * finer.vertices).sum(1).min() >= 0
    with pytest.raises(MapsError, match="subdivide"):
        embossed(mesh, height, 12)
    with pytest.raises(MapsError, match="texture coordinates"):
        embossed(Mesh(mesh.vertices, mesh.faces), height, 1)


@pytest.fixture
def bumpy(people: list[ProcessedFolder], tmp_path: Path) -> ProcessedFolder:
    """A person whose specular normals have waves."""
    shutil.copytree(people[0].root, tmp_path / "person")
    folder = ProcessedFolder(tmp_path / "person")
    normal = folder.read_atlas("specular_normal")
    rng = np.random.default_rng(2)
    fine = normal + 0.1 * rng.normal(size=normal.shape) * (normal != 0).any(axis=2, keepdims=True)
    folder.write_atlas(
        "specular_normal", fine / np.maximum(np.linalg.norm(fine, axis=2), 1e-6)[..., None]
    )
    return folder


def test_the_command_writes_heights_and_a_mesh(bumpy: ProcessedFolder, tmp_path: Path) -> None:
    out = tmp_path / "D"
    words = ["detail", bumpy.root, "--out", out, "--subdivide", "1", "--json"]
    facts = json.loads(printed(*words).splitlines()[-1])
    height = read_exr(out / "displacement.exr")
    assert 0.01 < facts["height_rms_mm"] < 5
    assert height.std() == pytest.approx(facts["height_rms_mm"], rel=0.5)
    mesh = read_obj(out / "embossed.obj")
    assert len(mesh.faces) == facts["triangles"]
    assert np.linalg.norm(mesh.vertices, axis=1).mean() == pytest.approx(RADIUS_MM, rel=0.15)
    printed(*words)  # an earlier one is replaced


@pytest.mark.parametrize(
    ("more", "word"),
    [
        (["--longest-mm", "0"], "--longest-mm"),
        (["--subdivide", "9"], "--subdivide"),
        (["--longest-mm", "nan"], "--longest-mm"),
    ],
)
def test_what_is_out_of_bounds_is_refused(
    bumpy: ProcessedFolder, tmp_path: Path, more: list[str], word: str
) -> None:
    assert word in refusal("detail", bumpy.root, "--out", tmp_path / "D", *more)
    assert not (tmp_path / "D").exists()


def test_maps_without_finer_normals_are_refused(
    people: list[ProcessedFolder], tmp_path: Path
) -> None:
    folder = shutil.copytree(people[0].root, tmp_path / "plain")
    mesh = read_obj(ProcessedFolder(folder).registered_mesh)
    normal = rasterise(mesh, 96, 64).normals(mesh)
    write_exr(folder / "atlas" / "specular_normal.exr", normal)
    assert "the mesh's own normals" in refusal("detail", folder, "--out", tmp_path / "D")


def without_uv(folder: ProcessedFolder) -> None:
    mesh = read_obj(folder.registered_mesh)
    write_obj(Mesh(mesh.vertices, mesh.faces), folder.registered_mesh)


def with_nan(folder: ProcessedFolder) -> None:
    normal = folder.read_atlas("specular_normal")
    normal[3, 3] = np.nan
    write_exr(folder.atlas_path("specular_normal"), normal)


def without_normals(folder: ProcessedFolder) -> None:
    folder.atlas_path("specular_normal").unlink()


@pytest.mark.parametrize(
    ("spoil", "word"),
    [
        (without_uv, "uv: found none"),
        (with_nan, "specular_normal.exr"),
        (without_normals, "specular_normal.exr"),
    ],
)
def test_bad_maps_and_meshes_are_refused_and_nothing_is_written(
    bumpy: ProcessedFolder, tmp_path: Path, spoil: Callable[[ProcessedFolder], None], word: str
) -> None:
    folder = ProcessedFolder(shutil.copytree(bumpy.root, tmp_path / "copy"))
    spoil(folder)
    err = refusal("detail", folder.root, "--out", tmp_path / "D")
    assert word in err
    assert "Traceback" not in err
    assert not (tmp_path / "D").exists()
