"""Relief from normals as geometry: beside a dense float64 twin, and on surfaces known exactly."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.formats.mesh import Mesh, edge_counts, read_ply, vertex_normals, write_ply
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import load_session
from lightstage.rig import Camera, Rig, default_rig
from processing.decode.config import DecodeConfig
from processing.decode.stage import decode
from processing.displacement import curved_middles
from processing.refinement.config import RefineConfig
from processing.refinement.detail import (
    STEEPEST,
    NormalView,
    displaced,
    heights,
    slopes_beyond,
    small_part,
)
from processing.refinement.stage import refine, write_detailed
from processing.splitting import split
from tests.processing.lit_ball import Ball, small_rig, write_session

CELL_MM = 1.5
WAVE_MM, HEIGHT_MM = 2.0, 0.05


def sheet(count: int = 11, cell_mm: float = CELL_MM) -> Mesh:
    """A flat square that faces the frontal camera."""
    side = (np.arange(count) - (count - 1) / 2) * cell_mm
    x, y = np.meshgrid(side, side)
    vertices = np.stack([x.ravel(), y.ravel(), np.zeros(count * count)], axis=1)
    index = np.arange(count * count).reshape(count, count)
    a, b, c, d = (index[s].ravel() for s in (np.s_[:-1, :-1], np.s_[:-1, 1:], np.s_[1:, :-1],
                                             np.s_[1:, 1:]))  # fmt: skip
    faces = np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)])
    return Mesh(vertices, faces.astype(np.int32))


def close_camera(count: int = 400) -> Camera:
    """Sees the sheet with twenty pixels a millimetre."""
    camera = default_rig().cameras[0]
    return dataclasses.replace(
        camera, width_px=count, height_px=count, cx_px=count / 2, cy_px=count / 2,
        fx_px=20.0 * 1100, fy_px=20.0 * 1100,
    )  # fmt: skip


def wave(x_mm: np.ndarray, y_mm: np.ndarray) -> np.ndarray:
    turn = 2 * np.pi / WAVE_MM
    return HEIGHT_MM * np.sin(turn * x_mm) * np.cos(turn * y_mm)


def wavy_view(tilt_deg: float = 0.0, noise_deg: float = 0.0) -> NormalView:
    """The wave's normals as the camera sees them, all of them tilted besides."""
    camera = close_camera()
    origin, rays = camera.pixel_rays()
    places = origin + rays * (-origin[2] / rays[..., 2])[..., None]
    turn = 2 * np.pi / WAVE_MM
    x, y = places[..., 0] * turn, places[..., 1] * turn
    dx = HEIGHT_MM * turn * np.cos(x) * np.cos(y) + np.tan(np.radians(tilt_deg))
    dy = -HEIGHT_MM * turn * np.sin(x) * np.sin(y)
    noise = np.random.default_rng(0).normal(0, np.radians(noise_deg), (2, *dx.shape))
    normals = np.stack([-dx - noise[0], -dy - noise[1], np.ones_like(dx)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return NormalView(camera, normals.astype(np.float32), np.ones(dx.shape, np.float32))


def inner(vertices: np.ndarray) -> np.ndarray:
    return np.abs(vertices[:, :2]).max(axis=1) < 4.0


@pytest.mark.parametrize("tilt_deg", [0.0, 3.0])
def test_a_wave_too_fine_for_the_mesh_comes_from_its_normals(tilt_deg: float) -> None:
    found = displaced(sheet(), [wavy_view(tilt_deg)], edge_mm=0.2, below_mm=3.0)
    vertices = found.mesh.vertices
    here = inner(vertices)
    true = wave(vertices[:, 0], vertices[:, 1])
    rms = np.sqrt(np.mean(true[here] ** 2))
    assert np.sqrt(np.mean((found.height_mm - true)[here] ** 2)) < 0.25 * rms
    assert found.known[here].all()
    assert np.abs(vertices[:, 2] - found.height_mm).max() < 1e-6
    normals = vertex_normals(vertices, found.mesh.faces)
    turn = 2 * np.pi / WAVE_MM
    x, y = vertices[:, 0] * turn, vertices[:, 1] * turn
    slopes = HEIGHT_MM * turn * np.stack([np.cos(x) * np.cos(y), -np.sin(x) * np.sin(y)], axis=1)
    off = -normals[:, :2] / normals[:, 2:] - slopes
    assert np.sqrt((off[here] ** 2).mean() / (slopes[here] ** 2).mean()) < 0.35


def test_noise_of_normals_hardly_moves_the_mesh() -> None:
    clean = displaced(sheet(), [wavy_view()], edge_mm=0.2, below_mm=3.0)
    noisy = displaced(sheet(), [wavy_view(noise_deg=3.0)], edge_mm=0.2, below_mm=3.0)
    assert np.abs(noisy.height_mm - clean.height_mm).std() < 0.2 * clean.height_mm.std()


def test_without_a_word_from_the_views_nothing_moves() -> None:
    view = wavy_view()
    blind = [
        dataclasses.replace(view, trust=np.zeros_like(view.trust)),
        dataclasses.replace(view, normals=np.full_like(view.normals, np.nan)),
        dataclasses.replace(
            view, camera=dataclasses.replace(view.camera, cx_px=-1e5), trust=view.trust
        ),
    ]
    for views in ([], blind):
        found = displaced(sheet(), views, edge_mm=0.4, below_mm=3.0)
        assert not found.known.any()
        assert not found.height_mm.any()


def test_a_detailed_mesh_does_not_outlive_the_run_that_it_is_of(tmp_path: Path) -> None:
    ball = Ball(coated=True)
    session = load_session(write_session(ball, small_rig(1, 0.015), tmp_path / "session"))
    folder = ProcessedFolder(tmp_path / "out")
    decode(session, folder.root, DecodeConfig())
    shape = trimesh.creation.icosphere(3, ball.radius_mm)
    mesh = Mesh(shape.vertices, np.asarray(shape.faces, np.int32))
    write_ply(mesh, folder.base_mesh)
    write_ply(mesh, folder.detailed_mesh)
    refine(session, folder.root, RefineConfig(finest_mm=6.0, choice_pixels=0, gloss_rounds=0))
    assert folder.view_path("cam0", "specular_normal").is_file()
    assert not folder.detailed_mesh.exists()


def test_a_surface_behind_another_shows_nothing() -> None:
    far, near = sheet(7), sheet(11)
    behind = Mesh(far.vertices - [0, 0, 5.0], far.faces)
    both = Mesh(
        np.concatenate([near.vertices, behind.vertices]),
        np.concatenate([near.faces, behind.faces + len(near.vertices)]),
    )
    found = displaced(both, [wavy_view()], edge_mm=0.4, below_mm=3.0)
    hidden = found.mesh.vertices[:, 2] < -2.5
    assert hidden.any()
    assert not found.known[hidden].any()
    assert found.known[~hidden].mean() > 0.8


def test_the_option_writes_a_mesh_of_what_refine_found(tmp_path: Path) -> None:
    view, folder = wavy_view(), ProcessedFolder(tmp_path)
    inside = np.zeros(view.trust.shape, bool)
    inside[80:320, 80:320] = True
    folder.write_view("cam0", "specular_normal", np.where(inside[..., None], view.normals, 0))
    folder.write_view("cam0", "confidence", np.where(inside, np.float32(0.9), 0))
    folder.write_mask("cam0", inside)
    rig = Rig(default_rig().lights, (view.camera,))
    config = RefineConfig(detail_edge_mm=0.3)
    facts = write_detailed(folder, sheet(), rig, config)
    mesh = read_ply(folder.detailed_mesh)
    assert facts["detailed_vertices"] == len(mesh.vertices)
    assert 0.1 < facts["detailed_share"] < 0.9
    assert 0.3 * HEIGHT_MM < facts["detail_rms_mm"] < HEIGHT_MM
    blurred = dataclasses.replace(config, coarse_confidence=0.95)
    assert write_detailed(folder, sheet(), rig, blurred)["detailed_share"] == 0


def test_split_edges_bend_like_the_ball_they_lie_on() -> None:
    rng = np.random.default_rng(0)
    ends = rng.normal(size=(200, 3))
    ends /= np.linalg.norm(ends, axis=1, keepdims=True)
    others = ends + 0.02 * rng.normal(size=ends.shape)
    others /= np.linalg.norm(others, axis=1, keepdims=True)
    normals = np.concatenate([ends, others])
    pairs = np.stack([np.arange(200), np.arange(200) + 200], axis=1)
    middle = curved_middles(80 * normals, normals, pairs)
    straight = 80 * normals[pairs].mean(axis=1)
    off = np.abs(np.linalg.norm(middle, axis=1) - 80)
    assert off.max() < 0.01 * np.abs(np.linalg.norm(straight, axis=1) - 80).max()


def dense_heights(
    vertices: np.ndarray, slopes: np.ndarray, known: np.ndarray, edges: np.ndarray, weight: float
) -> np.ndarray:
    """The same least squares, edge by edge, in a dense matrix."""
    rows, right = [], []
    for first, second in edges:
        if known[first] and known[second]:
            row = np.zeros(len(vertices))
            row[second], row[first] = 1, -1
            rows.append(row)
            right.append(
                0.5 * (slopes[first] + slopes[second]) @ (vertices[second] - vertices[first])
            )
    rows += list(np.sqrt(weight) * np.eye(len(vertices)))
    right += [0.0] * len(vertices)
    return np.linalg.lstsq(np.array(rows), np.array(right), rcond=None)[0]


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1), st.floats(1e-6, 1e6), st.floats(1e-3, 10), st.floats(0, 1))
def test_heights_are_those_of_the_dense_twin(
    seed: int, unit: float, weight: float, share: float
) -> None:
    rng = np.random.default_rng(seed)
    mesh = sheet(5)
    vertices = unit * (mesh.vertices + rng.normal(0, 0.1, mesh.vertices.shape))
    slopes = rng.normal(size=vertices.shape)
    known = rng.random(len(vertices)) < share
    edges = edge_counts(mesh.faces)[0]
    found = heights(vertices, slopes, known, edges, weight)
    twin = dense_heights(vertices, slopes, known, edges, weight)
    np.testing.assert_allclose(found, twin, atol=2e-4 * max(float(np.abs(twin).max()), 1e-12))


@given(st.lists(st.floats(-5, 5), min_size=3, max_size=3), st.booleans())
def test_slopes_turn_the_normal_into_the_given_one(values: list[float], known: bool) -> None:
    normal = np.array([[0.0, 0.6, 0.8]])
    unit = np.array([values]) + 3 * normal
    unit /= max(float(np.linalg.norm(unit)), 1e-9)
    slopes = slopes_beyond(unit, normal, np.array([known]))
    assert np.isfinite(slopes).all()
    steep = float(np.linalg.norm(slopes))
    assert steep <= STEEPEST + 1e-9
    along = float(unit[0] @ normal[0])
    if not known or along <= 0.1:
        assert steep == 0
    elif steep < 0.99 * STEEPEST:
        turned = normal - slopes
        np.testing.assert_allclose(turned / np.linalg.norm(turned), unit, atol=1e-9)


@pytest.mark.parametrize("splits", [0, 2])
def test_what_is_the_same_everywhere_is_no_relief(splits: int) -> None:
    mesh = sheet(20)
    count, triangles, halfway = len(mesh.vertices), mesh.faces.astype(np.int64), []
    for _ in range(splits):
        triangles, ends = split(triangles, count)
        halfway.append(ends)
        count += len(ends)
    known = np.ones(count, bool)
    known[:40] = False
    slopes = np.where(known[:, None], [0.3, -0.2, 0.0], 0.0)
    found = small_part(slopes, known, halfway, edge_counts(mesh.faces)[0], 4.0)
    assert np.abs(found).max() < 1e-9
