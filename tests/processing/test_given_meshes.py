"""A user's own mesh of the head, and meshes of what else casts shadows."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from lightstage.formats.mesh import Mesh, read_ply, write_obj, write_ply
from lightstage.formats.processed import ProcessedFolder
from lightstage.rig import default_rig
from processing.errors import ReconstructionError
from processing.frames.read import Frames
from processing.rays import MeshRays
from processing.reconstruction.given import facts_of_occluders, given_mesh, read_given
from processing.refinement.config import RefineConfig
from processing.refinement.every_pixel import solve_view
from processing.refinement.gloss_search import find_gloss
from processing.refinement.scene import prepare_scene, read_view
from tests.processing import lit_ball
from tests.processing.lit_ball import Ball, angle_deg
from tests.processing.shapes import ellipsoid

BALL = Ball(coated=True)
CAMERAS = default_rig().scaled(0.02).cameras


def ball_mesh(radius_mm: float = 95.0, subdivisions: int = 4) -> Mesh:
    import trimesh

    shape = trimesh.creation.icosphere(subdivisions, radius_mm)
    return Mesh(np.asarray(shape.vertices, float), np.asarray(shape.faces, np.int32))


def head() -> Mesh:
    """An egg with a nose: no motion but none leaves it where it is."""
    mesh = ellipsoid()
    scaled = 90 * mesh.vertices / np.abs(mesh.vertices).max() * (1.0, 1.3, 1.1)
    nose = np.exp(-np.sum((scaled - (5, 10, 95)) ** 2, axis=1) / 600)
    return Mesh(scaled + nose[:, None] * (0, -5, 25), mesh.triangles())


def plate(x_mm: float, half_mm: float) -> Mesh:
    """A square across the x axis."""
    y, z = half_mm * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]).T
    corners = np.column_stack([np.full(4, x_mm), y, z])
    return Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32))


def on_surface(mesh: Mesh, count: int, rng: np.random.Generator) -> np.ndarray:
    corners = mesh.vertices[mesh.faces[rng.integers(0, len(mesh.faces), count)]]
    return np.einsum("nk,nkd->nd", rng.dirichlet(np.ones(3), count), corners)


def test_an_occluder_stops_rays_and_is_never_met() -> None:
    camera = CAMERAS[0]
    mesh = ball_mesh()
    toward = camera.centre_mm / np.linalg.norm(camera.centre_mm)
    shield = plate(0, 30)
    turn = Rotation.align_vectors(toward[None], [[1.0, 0, 0]])[0]
    shield = Mesh(turn.apply(shield.vertices) + 200 * toward, shield.faces)
    alone, both = (MeshRays(mesh.vertices, mesh.faces, other) for other in (None, shield))
    first, second = alone.cast_camera(camera), both.cast_camera(camera)
    everywhere = np.ones((camera.height_px, camera.width_px), bool)
    stopped = both.stopped(camera, everywhere).ravel()
    assert 20 < stopped.sum() < (first.face >= 0).sum()
    assert not alone.stopped(camera, everywhere).any()
    assert (second.face[stopped] == -1).all()
    assert np.isinf(second.distance_mm[stopped]).all()
    np.testing.assert_array_equal(second.face[~stopped], first.face[~stopped])
    some = np.zeros_like(everywhere)
    some[::2] = True
    np.testing.assert_array_equal(both.stopped(camera, some), some & stopped.reshape(some.shape))


def test_shadows_of_an_occluder_are_no_shape_of_the_skin() -> None:
    """A plate beside the ball hides lamps; without it in the scene the normals turn away."""
    rig = lit_ball.small_rig(1, 0.02)
    camera, lights = rig.cameras[0], lit_ball.lights_of_rig(rig)
    truth, wall = lit_ball.see(BALL, camera), plate(140, 120)
    to_light = rig.positions_mm[:, None] - truth.points_mm
    along = (140 - truth.points_mm[:, 0]) / to_light[..., 0]
    met = truth.points_mm + along[..., None] * to_light
    hidden = (along > 0) & (along < 1) & (np.abs(met[..., 1:]) < 120).all(axis=2)
    assert 0.05 < hidden.mean() < 0.4
    images = np.zeros((len(lit_ball.PATTERNS), *truth.mask.shape, 3), np.float32)
    images[:, truth.mask] = lit_ball.photograph(BALL, truth, rig, ~hidden).transpose(1, 0, 2)
    frames = Frames.of(lit_ball.PATTERNS, images, np.ones(truth.mask.shape, bool))
    config = RefineConfig(
        smoothing_mm=0, occlusion_directions=64, finest_mm=4.0, bounce_rays=0, choice_pixels=0
    )
    normals = np.zeros((*truth.mask.shape, 3))
    normals[truth.mask] = truth.normals
    errors = []
    for occluders in (wall, None):
        scene = prepare_scene(ball_mesh(), lights, [(camera, truth.mask)], config, occluders)
        view = read_view(frames, camera, truth.mask, scene, config)
        scene, found, _ = find_gloss(scene, [view], config)
        maps = solve_view(scene, frames, camera, truth.mask, view, found[0], config)
        mask, facing = maps.mask, normals[maps.mask]
        inner = (facing @ (camera.centre_mm / np.linalg.norm(camera.centre_mm))) > 0.4
        inner &= facing[:, 0] > 0
        found_normals = maps.maps.pixel_maps().diffuse_normal
        errors.append(float(angle_deg(found_normals, facing)[inner].mean()))
        assert mask.sum() > 1000
    assert errors[0] < 0.7
    assert errors[1] > 4 * errors[0]


@pytest.mark.parametrize(
    ("factor", "message"), [(0.001, "Is it in metres? Then multiply it by 1000"), (0.1, "in cm")]
)
def test_a_mesh_in_another_unit_is_reported(tmp_path: Path, factor: float, message: str) -> None:
    path = write_ply(Mesh(factor * head().vertices, head().faces), tmp_path / "head.ply")
    with pytest.raises(ReconstructionError, match=re.escape(message)):
        given_mesh(path, CAMERAS, np.zeros((0, 3)))
    with pytest.raises(ReconstructionError, match=re.escape(message)):
        read_given(path)


def test_faces_that_look_inward_are_turned_and_reported(tmp_path: Path) -> None:
    shape = head()
    points = on_surface(shape, 300, np.random.default_rng(0))
    path = write_obj(Mesh(shape.vertices, shape.faces[:, ::-1]), tmp_path / "head.obj")
    found = given_mesh(path, CAMERAS, points)
    assert found.warnings == ["the faces of head.obj pointed inward and were turned"]
    np.testing.assert_array_equal(found.mesh.faces, shape.faces)
    kept = given_mesh(write_obj(shape, tmp_path / "other.obj"), CAMERAS, points)
    assert kept.warnings == []
    np.testing.assert_array_equal(kept.mesh.faces, shape.faces)
    assert kept.facts["points_to_mesh_mm"] < 0.01


@given(
    seed=st.integers(0, 2**32 - 1),
    shift=st.tuples(*[st.floats(-25, 25)] * 3),
    degrees=st.floats(0, 8),
    outside=st.floats(0, 0.15),
)
@settings(max_examples=15, deadline=None)
def test_a_mesh_elsewhere_is_reported_with_the_motion_that_would_mend_it(
    seed: int, shift: tuple[float, float, float], degrees: float, outside: float
) -> None:
    """Some points lie off the mesh, as hair and clothes do."""
    rng = np.random.default_rng(seed)
    shape, turn = head(), Rotation.from_rotvec(np.radians(degrees) * unit(rng.normal(size=3)))
    away = turn.apply(shape.vertices) + shift
    points = on_surface(shape, 500, rng)
    points[: round(outside * 500)] += rng.uniform(20, 40, (round(outside * 500), 3))
    there = cKDTree(on_surface(Mesh(away, shape.faces), 20_000, rng))
    with tempfile.TemporaryDirectory() as folder:
        path = write_ply(Mesh(away, shape.faces), Path(folder) / "head.ply")
        if np.median(there.query(points)[0]) < 3.5:
            return  # a head that slides along itself hardly leaves its points
        with pytest.raises(ReconstructionError, match="if it were moved by") as caught:
            given_mesh(path, CAMERAS, points)
    message = re.search(
        r"fit within (\S+) mm .* moved by \((\S+), (\S+), (\S+)\)", str(caught.value)
    )
    assert message is not None
    left_mm, *back = (float(word) for word in message.groups())
    middle = points.mean(axis=0)
    # A turn about the egg's own axis hardly moves its surface, and is not found.
    assert left_mm < 0.8
    assert np.abs(np.array(back) - (middle - (turn.apply(middle) + shift))).max() < 4


def unit(vector: np.ndarray) -> np.ndarray:
    return np.asarray(vector / np.linalg.norm(vector))


def test_another_head_is_no_matter_of_place(tmp_path: Path) -> None:
    points = on_surface(head(), 300, np.random.default_rng(1))
    path = write_ply(ball_mesh(160), tmp_path / "other.ply")
    with pytest.raises(ReconstructionError, match="of another person"):
        given_mesh(path, CAMERAS, points)


def test_a_mesh_that_no_camera_sees_and_one_that_nothing_checks(tmp_path: Path) -> None:
    shape = head()
    away = write_ply(
        Mesh(shape.vertices + np.array([0, 9000, 0]), shape.faces), tmp_path / "away.ply"
    )
    with pytest.raises(ReconstructionError, match="no camera of the rig sees"):
        given_mesh(away, CAMERAS, np.zeros((0, 3)))
    here = write_ply(shape, tmp_path / "here.ply")
    assert (
        "could not be checked: 0 points" in given_mesh(here, CAMERAS, np.zeros((0, 3))).warnings[0]
    )


def test_occluders_that_hold_the_face_are_refused() -> None:
    mesh, where = ball_mesh(), Path("all.ply")
    whole = Mesh(1.01 * mesh.vertices, mesh.faces)
    with pytest.raises(ReconstructionError, match="hides 100% of the skin"):
        facts_of_occluders(where, whole, mesh, CAMERAS)
    some = facts_of_occluders(where, plate(140, 120), mesh, CAMERAS)
    assert 0 < some["occluders_hide_share"] < 0.5


def test_a_run_takes_a_given_mesh_and_occluders_from_one_camera_alone(
    tmp_path: Path, run_command: Callable[..., Any]
) -> None:
    session = lit_ball.write_session(BALL, lit_ball.small_rig(1, 0.02), tmp_path / "session")
    out, mesh = tmp_path / "out", ball_mesh()
    path = write_ply(mesh, tmp_path / "ball.ply")
    # In front of the ball's lower half.
    wall = plate(0, 60)
    wall = Mesh(wall.vertices[:, [1, 2, 0]] + (0, -70, 130), wall.faces)
    others = write_ply(wall, tmp_path / "wall.ply")
    quick = tmp_path / "quick.toml"
    quick.write_text(
        "[refine]\nfinest_mm = 4.0\nocclusion_directions = 64\nbounce_rays = 0\nchoice_pixels = 0\n"
    )
    words = ["run", session, "--out", out, "--config", quick, "--until", "refine"]
    tiny = write_ply(Mesh(mesh.vertices / 1000, mesh.faces), tmp_path / "tiny.ply")
    for option, file, message in (
        ("--mesh", tiny, "in metres"),
        ("--mesh", tmp_path / "none.ply", "no such file"),
        ("--occluders", tiny, "in metres"),
        ("--occluders", session / "rig.json", "suffix '.json'"),
    ):
        refused = run_command("processing", *words, option, file)
        assert refused.code == 2, refused.err
        assert message in refused.err
        assert not out.exists()
    done = run_command("processing", *words, "--mesh", path, "--occluders", others)
    assert done.code == 0, done.err
    # What a stage warns of is told when it ran, and not again.
    assert "warning: reconstruct: whether ball.ply is where the photographs" in done.err
    folder = ProcessedFolder(out)
    np.testing.assert_allclose(read_ply(folder.base_mesh).vertices, mesh.vertices)
    assert folder.occluders.is_file()
    camera = lit_ball.small_rig(1, 0.02).cameras[0]
    foreground = lit_ball.see(BALL, camera).mask
    hidden = MeshRays(mesh.vertices, mesh.faces, wall).stopped(camera, foreground)
    assert hidden.sum() > 200
    assert not (folder.read_mask("cam0") & hidden).any()
    report = (out / "report.html").read_text()
    assert "What else casts shadows" in report
    assert "could not be checked" in report
    again = run_command("processing", *words, "--mesh", path, "--occluders", others)
    assert "up to date" in again.out
    assert "warning:" not in again.err
    misspelt = run_command("processing", *words[:-1], "refin")
    assert "--until: found 'refin', expected decode, separate" in misspelt.err
    write_ply(Mesh(wall.vertices + np.array([0, 0, 5]), wall.faces), others)
    words[-1] = "reconstruct"
    moved = run_command("processing", *words, "--mesh", path, "--occluders", others, "--json")
    assert '"ran": ["reconstruct"]' in moved.out
    without = run_command("processing", *words, "--mesh", path)
    assert without.code == 0, without.err
    assert not folder.occluders.exists()


def test_a_given_mesh_is_cleaned_and_the_report_gets_what_went(tmp_path: Path) -> None:
    shape = head()
    points = on_surface(shape, 300, np.random.default_rng(0))
    crumb = np.array([[0, 0, 300], [1, 0, 300], [0, 1, 300.0]])
    faces = [shape.faces, shape.faces[::7], np.array([[0, 1, 2]], np.int32) + len(shape.vertices)]
    damaged = Mesh(np.concatenate([shape.vertices, crumb]), np.concatenate(faces))
    found = given_mesh(write_ply(damaged, tmp_path / "head.ply"), CAMERAS, points)
    np.testing.assert_array_equal(found.mesh.vertices, shape.vertices)
    assert len(found.mesh.faces) == len(shape.faces)
    twice = len(shape.faces[::7])
    assert found.facts["given_mesh_cleaned"] == {
        "duplicate_triangles": twice, "triangles_of_islands": 1, "unused_vertices": 3,
    }  # fmt: skip
    words = f"duplicate triangles {twice}, triangles of islands 1, unused vertices 3"
    assert found.warnings == [f"head.ply was cleaned: {words}"]
