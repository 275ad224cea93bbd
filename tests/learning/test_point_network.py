"""Template points by the network: warps, drawn faces, its trunk, its training."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from learning.checkpoint import AVERAGE, save_checkpoint, shipped_points
from learning.errors import CheckpointError
from learning.photo.config import FitConfig
from learning.photo.marks import face_marks
from learning.photo.shape_fit import detector_places
from learning.points.config import PointsConfig
from learning.points.faces import Faces
from learning.points.layout import SIDE_PX, Layout, layout_of, thin_plates
from learning.points.network import FAMILY, PointNetwork, finder_of, load_points, shipped_finder
from learning.points.raster import FAR, draw, normals_of
from learning.points.train import examples_of, likelihood, mirrored, scored, trained
from learning.points.trunk import Trunk, fill_from_wheel
from lightstage.faces.detect import Face
from lightstage.faces.face_mesh import COUNT, SIZE_PX
from lightstage.faces.weights import LANDMARKS, outputs_of
from lightstage.formats.mesh import vertex_normals
from lightstage.formats.template import Template, default_template_path, load_template
from tests.programs import run_program

LAYERS = ("p_re_lu_2", "p_re_lu_5", "p_re_lu_8", "p_re_lu_11", "p_re_lu_14", "p_re_lu_16")


@pytest.fixture(scope="module")
def template() -> Template:
    return load_template(default_template_path())


@pytest.fixture(scope="module")
def layout(template: Template) -> Layout:
    return layout_of(template, FitConfig())


@pytest.fixture(scope="module")
def faces(template: Template) -> Faces:
    return Faces(template, FitConfig(), [np.full((48, 32, 3), 0.3, np.float32)])


def photographed(layout: Layout, turn: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """(468, 2) the detector's points, exactly the mean head's, turned and moved."""
    points = np.full((COUNT, 2), np.nan)
    points[layout.there] = layout.control @ turn.T + shift
    return points


def test_the_trunk_gives_what_opencv_gives() -> None:
    trunk = Trunk()
    fill_from_wheel(trunk)
    picture = np.random.default_rng(0).random((SIZE_PX, SIZE_PX, 3), np.float32)
    expected = outputs_of(LANDMARKS, picture, LAYERS)
    with torch.no_grad():
        read, last = trunk(torch.from_numpy(picture.transpose(2, 0, 1)[None].copy()))
    for ours, theirs in zip([*read, last], expected, strict=True):
        assert np.abs(np.ravel(ours.numpy()) - theirs).max() < 1e-4


def test_thin_plates_keep_a_turn_exactly_and_go_through_their_points() -> None:
    rng = np.random.default_rng(1)
    control, at = rng.random((40, 2)), rng.random((30, 2))
    plates = thin_plates(control, at)
    turn, shift = rng.normal(size=(2, 2)), rng.normal(size=2)
    np.testing.assert_allclose(plates @ (control @ turn + shift), at @ turn + shift, atol=1e-6)
    values = np.sin(4 * control[:, 0]) * np.cos(5 * control[:, 1])
    assert np.abs(thin_plates(control, control) @ values - values).max() < 0.02


def test_of_the_mean_head_in_a_plane_nothing_remains(layout: Layout) -> None:
    turn = 300 * np.array([[0.9, -0.2], [0.2, 0.9]])
    points = photographed(layout, turn, np.array([100.0, 50.0]))
    np.testing.assert_allclose(layout.similarity(points), turn, rtol=1e-6)
    np.testing.assert_allclose(layout.beside_mm(points), 0, atol=1e-6)
    true = layout.places @ turn.T + [100.0, 50.0]
    np.testing.assert_allclose(layout.residual_mm(true, points), 0, atol=1e-4)
    moved = layout.residual_mm(true + turn @ [0.01, 0.0], points)
    np.testing.assert_allclose(
        moved, np.tile([0.01 * layout.side_mm, 0], (len(true), 1)), atol=1e-4
    )


@pytest.mark.parametrize("size", [90.0, 128.0, 700.0])
def test_a_warped_picture_shows_a_point_at_its_place(layout: Layout, size: float) -> None:
    points = photographed(layout, size * np.eye(2), np.array([40.0, 30.0]))
    picture = np.zeros((850, 850, 3), np.uint8)
    at = layout.places[100] * size + [40.0, 30.0]
    radius = max(2.0, 4 * size / SIDE_PX)
    cv2.circle(picture, tuple(np.round(16 * (at - 0.5)).astype(int).tolist()), int(16 * radius),
               (255, 255, 255), -1, shift=4)  # fmt: skip
    square = layout.warped(picture, points)[..., 0].astype(float)
    rows, columns = np.mgrid[:SIDE_PX, :SIDE_PX] + 0.5
    middle = np.array([(square * columns).sum(), (square * rows).sum()]) / square.sum()
    assert np.abs(middle - SIDE_PX * layout.places[100]).max() < 0.5


def test_a_photograph_beside_which_the_face_lies_gives_a_square(layout: Layout) -> None:
    picture = np.full((60, 50, 3), 7, np.uint8)
    for shift in (np.array([-4000.0, 10.0]), np.array([4000.0, 4000.0])):
        square = layout.warped(picture, photographed(layout, 300 * np.eye(2), shift))
        assert square.shape == (SIDE_PX, SIDE_PX, 3)


def test_the_depth_buffer_agrees_with_its_plain_twin() -> None:
    rng = np.random.default_rng(3)
    points = (rng.random((30, 3)) * [20, 20, 5] + [0, 0, 10]).astype(np.float32)
    triangles = rng.integers(0, 30, (25, 3)).astype(np.int32)
    opacity = rng.random(30).astype(np.float32)
    depth = np.full((20, 20), FAR, np.float32)
    face, share = np.full((20, 20), -1, np.int32), np.zeros((20, 20, 2), np.float32)
    draw(points, triangles, opacity, depth, face, share)
    expected = np.full((20, 20), float(FAR))
    for t in triangles:
        corners = points[t].astype(float)
        edges = np.column_stack([corners[1, :2] - corners[0, :2], corners[2, :2] - corners[0, :2]])
        if abs(np.linalg.det(edges)) < 1e-9:
            continue
        for row in range(20):
            for column in range(20):
                v, w = np.linalg.solve(edges, [column + 0.5, row + 0.5] - corners[0, :2])
                weights = np.array([1 - v - w, v, w])
                if weights.min() >= 0 and weights @ opacity[t] >= 0.5:
                    expected[row, column] = min(expected[row, column], weights @ corners[:, 2])
    same = np.abs(depth - expected) < 1e-3
    # An edge may fall on either side of a pixel's centre by rounding.
    assert same.mean() > 0.99
    assert ((face >= 0) == (depth < FAR)).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e30, 0.0, -5.0])
def test_bad_corners_are_not_drawn(bad: float) -> None:
    points = np.array([[1, 1, bad], [8, 1, 5], [1, 8, 5], [bad, bad, bad]], np.float32)
    triangles = np.array([[0, 1, 2], [3, 1, 2], [1, 1, 1]], np.int32)
    depth = np.full((9, 9), FAR, np.float32)
    face, share = np.full((9, 9), -1, np.int32), np.zeros((9, 9, 2), np.float32)
    draw(points, triangles, np.ones(4, np.float32), depth, face, share)
    assert np.isfinite(depth).all()
    assert (depth > 0).all()


def test_normals_are_those_of_the_mesh(template: Template) -> None:
    mesh = template.mesh
    found = normals_of(mesh.vertices.astype(np.float32), mesh.triangles().astype(np.int32))
    expected = vertex_normals(mesh.vertices, mesh.triangles())
    assert np.abs(found - expected).max() < 1e-3
    flat = normals_of(np.zeros((3, 3), np.float32), np.array([[0, 1, 2]], np.int32))
    assert (flat == 0).all()


def test_a_drawn_face_is_where_its_points_are(faces: Faces, layout: Layout) -> None:
    one, other = (faces.drawn(np.random.default_rng(5)) for _ in range(2))
    assert (one.picture == other.picture).all()
    assert one.picture.std() > 5
    inside = one.points_px[layout.vertices]
    assert ((inside > 0) & (inside < len(one.picture))).mean() > 0.9
    assert (one.facing[layout.vertices] > 0).mean() > 0.5


def test_training_brings_points_nearer(
    faces: Faces, layout: Layout, template: Template, tmp_path: Path
) -> None:
    found = detector_places(template)
    assert found is not None
    rng = np.random.default_rng(7)
    examples = examples_of(faces, layout, found[0], mirrored(template), 8, rng)
    assert len(examples.pictures) >= 8
    torch.manual_seed(0)
    network = PointNetwork(len(layout.control), len(layout.vertices))
    fill_from_wheel(network.trunk)
    network.set_layout(layout, template)
    everything = examples.batch(np.arange(len(examples.pictures)))
    with torch.no_grad():
        before = float(likelihood(network.eval(), everything))
    config = PointsConfig(epochs=12, batch=4, average=0.5)
    average = trained(network, examples, config)
    with torch.no_grad():
        assert float(likelihood(average, everything)) < before - 0.5
    figures = scored(average, examples)
    assert figures["points_mm"] < figures["detector_mm"]
    # What is saved is found again, but for the rounding of half floats.
    halved = {name: value.half() for name, value in average.named_parameters()}
    about = {
        "family": FAMILY,
        "config": dataclasses.asdict(config),
        "data_fingerprint": "",
        "held_out": [],
        "texture_rows": 48,
        "metrics": figures,
        "step_seconds": 0.0,
    }
    save_checkpoint(tmp_path, 1, {AVERAGE: {**average.state_dict(), **halved}}, about)
    loaded, checkpoint = load_points(tmp_path)
    assert checkpoint.metrics == figures
    with torch.no_grad():
        difference = loaded(*everything[:2])[0] - average(*everything[:2])[0]
    assert difference.abs().max() < 0.1
    (tmp_path / checkpoint.files[AVERAGE]["name"]).write_bytes(b"cut")
    with pytest.raises(CheckpointError):
        load_points(tmp_path)


def test_the_shipped_network_is_our_templates_alone(template: Template) -> None:
    finder = shipped_finder(template)
    assert finder is not None
    larger = template.mesh.with_vertices(1.01 * template.mesh.vertices)
    assert shipped_finder(dataclasses.replace(template, mesh=larger)) is None
    about = load_points(shipped_points())[1]
    assert about.metrics["points_mm"] < 0.8 * about.metrics["detector_mean_off_mm"]
    size = sum(path.stat().st_size for path in shipped_points().glob("*.safetensors"))
    assert size < 3e6


def test_points_are_nearer_to_the_truth_than_the_detectors(
    faces: Faces, layout: Layout, template: Template
) -> None:
    """On faces drawn from another seed than the training's, without their own skins."""
    finder = shipped_finder(template)
    assert finder is not None
    found = detector_places(template)
    assert found is not None
    examples = examples_of(
        faces, layout, found[0], mirrored(template), 6, np.random.default_rng(99)
    )
    figures = scored(finder.network, examples)
    assert figures["points_mm"] < 0.8 * figures["detector_mm"]


def test_marks_are_the_detectors_alone_where_there_is_no_network(template: Template) -> None:
    alone, both = face_marks(template, None), face_marks(template, shipped_finder(template))
    assert alone is not None
    assert both is not None
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(100, 200, (COUNT, 2)), rng.normal(size=COUNT)])
    face = Face(points[:, :2], points[:, 2], 1.0, (100.0, 100.0, 200.0, 200.0))
    picture = rng.integers(0, 255, (300, 300, 3), np.uint8).astype(np.uint8)
    detected, weight = alone.of(picture, face)
    assert (weight == 1).all()
    points_px, weight = both.of(picture, face)
    assert len(points_px) == len(weight) == len(both.places.weights)
    np.testing.assert_array_equal(points_px[: len(detected)], detected)
    assert np.isfinite(points_px[len(detected) :]).all()
    assert (weight[: len(detected)] == 1).all()
    assert (weight > 0).all()


def test_a_network_of_other_vertices_is_not_used(template: Template, layout: Layout) -> None:
    network = PointNetwork(len(layout.control), len(layout.vertices))
    network.set_layout(layout, template)
    assert finder_of(network, template) is not None
    network.vertices += len(template.mesh.vertices)
    assert finder_of(network, template) is None


def test_a_run_is_not_trained_over(tmp_path: Path) -> None:
    (tmp_path / "checkpoint.json").write_text("{}")
    words = ["train-points", "--data", tmp_path, "--out", tmp_path]
    ended = run_program("learning", *words)
    assert ended.code == 2
    assert "a run that is there already" in ended.err
