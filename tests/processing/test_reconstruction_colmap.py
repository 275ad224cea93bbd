import dataclasses
import shutil
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pycolmap
import pytest

from lightstage.errors import FormatError
from processing.reconstruction.colmap_folder import (
    read_colmap,
    read_map,
    write_colmap,
    write_map,
)
from processing.reconstruction.config import ReconstructConfig
from processing.reconstruction.stage import reconstruct_views
from processing.reconstruction.stereo import pick_sources
from processing.reconstruction.views import Level, View, finest_level
from tests.processing import textured_ball
from tests.processing.textured_ball import RADIUS_MM

CONFIG = ReconstructConfig(cell_mm=4.0, trim_mm=6.0, agree_mm=1.5)
CAMERAS = textured_ball.cameras(4, 0.035)
NAMES = [camera.id for camera in CAMERAS]


def exact() -> tuple[list[View], Level, list[np.ndarray]]:
    """Views of the ball and their true inverse depth."""
    views, points = textured_ball.views_of(CAMERAS, np.random.default_rng(5))
    depths = []
    for view, places in zip(views, points, strict=True):
        pose = view.camera.cam_from_world
        depth = places @ pose[2, :3] + pose[2, 3]
        depths.append(np.where(view.mask, 1 / depth, 0).astype(np.float32))
    return views, finest_level(views), depths


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    _, level, depths = exact()
    folder = tmp_path_factory.mktemp("colmap") / "workspace"
    write_colmap(folder, NAMES, level, depths, pick_sources(CAMERAS, [True] * 4, CONFIG))
    return folder


def test_depths_come_back(workspace: Path) -> None:
    _, level, depths = exact()
    found, costs = read_colmap(workspace, NAMES, level)
    for true, kept, cost in zip(depths, found, costs, strict=True):
        np.testing.assert_allclose(kept, true, rtol=1e-6)
        assert ((cost < 1) == (true > 0)).all()


def test_colmaps_own_fusion_takes_them(
    workspace: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pycolmap.logging, "logtostderr", True)
    options = pycolmap.StereoFusionOptions()
    options.num_threads = 1
    options.min_num_pixels = 2
    options.max_reproj_error = 0.6
    (tmp_path / "fused").mkdir()
    fused = pycolmap.stereo_fusion(tmp_path / "fused", workspace, options=options)
    places = np.array([point.xyz for point in fused.points3D.values()])
    assert len(places) > 200
    # It does not interpolate: a pixel is 1.8 mm wide.
    assert np.median(np.abs(np.linalg.norm(places, axis=1) - RADIUS_MM)) < 0.6


def test_colmap_reads_the_model_and_the_order_of_matching(workspace: Path) -> None:
    scene = pycolmap.Reconstruction(workspace / "sparse")
    assert scene.num_images() == 4
    assert scene.num_points3D() > 50
    for image in scene.images.values():
        camera = CAMERAS[NAMES.index(image.name.removesuffix(".pgm"))]
        np.testing.assert_allclose(
            image.cam_from_world().matrix(), camera.cam_from_world, atol=1e-6
        )
        for point in image.points2D:
            if point.has_point3D():
                place = scene.point3D(point.point3D_id).xyz
                assert np.abs(camera.project(place)[0][0] - point.xy).max() < 0.01
    lines = (workspace / "stereo" / "patch-match.cfg").read_text().splitlines()
    assert lines[::2] == [f"{name}.pgm" for name in NAMES]
    assert "cam0.pgm" in lines[3]


def test_the_stage_fuses_what_lies_in_a_folder(workspace: Path, tmp_path: Path) -> None:
    views, _, _ = exact()
    config = dataclasses.replace(
        CONFIG, colmap_from=str(workspace), colmap_to=str(tmp_path / "again")
    )
    mesh = reconstruct_views(views, config)[0]
    assert np.median(np.abs(np.linalg.norm(mesh.vertices, axis=1) - RADIUS_MM)) < 0.1
    assert (tmp_path / "again" / "stereo" / "fusion.cfg").is_file()


def test_maps_are_colmaps_own(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    depth = rng.uniform(500, 900, (5, 7)).astype(np.float32)
    normals = rng.normal(size=(5, 7, 3)).astype(np.float32)
    write_map(depth, tmp_path / "d.bin")
    write_map(normals, tmp_path / "n.bin")
    theirs = pycolmap.DepthMap()
    theirs.read(tmp_path / "d.bin")
    assert (theirs.width, theirs.height) == (7, 5)
    np.testing.assert_array_equal(np.array(theirs.to_array()), depth)
    np.testing.assert_array_equal(read_map(tmp_path / "d.bin")[..., 0], depth)
    np.testing.assert_array_equal(read_map(tmp_path / "n.bin"), normals)
    for name, content in {"text": b"hello", "short": b"7&5&1&abcd", "empty": b""}.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(FormatError):
            read_map(tmp_path / name)
    (tmp_path / "long").write_bytes((tmp_path / "d.bin").read_bytes() + b"more")
    with pytest.raises(FormatError, match="bytes"):
        read_map(tmp_path / "long")


def test_folders_that_are_none_are_refused(workspace: Path, tmp_path: Path) -> None:
    _, level, depths = exact()
    with pytest.raises(FormatError, match="no depth map"):
        read_colmap(tmp_path, NAMES, level)
    cut = dataclasses.replace(level, masks=level.masks[:, :-2])
    with pytest.raises(FormatError, match="found a map of"):
        read_colmap(workspace, NAMES, cut)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "letter.txt").write_text("mine")
    with pytest.raises(FormatError):
        write_colmap(tmp_path / "other", NAMES, level, depths, [np.arange(1)] * 4)
    assert (tmp_path / "other" / "letter.txt").read_text() == "mine"


def test_what_colmap_made_of_a_workspace_is_not_lost_with_it(
    workspace: Path, tmp_path: Path
) -> None:
    _, level, depths = exact()
    ours = Path(shutil.copytree(workspace, tmp_path / "ours"))
    sources = pick_sources(CAMERAS, [True] * 4, CONFIG)
    (ours / "fused.ply").write_text("ply")
    with pytest.raises(FormatError, match=r"ours: found fused\.ply, which the command did not"):
        write_colmap(ours, NAMES, level, depths, sources)
    config = dataclasses.replace(CONFIG, colmap_to=str(ours))
    with (
        patch("processing.reconstruction.stage.match_views", side_effect=AssertionError),
        pytest.raises(FormatError, match="fused"),
    ):
        reconstruct_views(exact()[0], config)
    (ours / "fused.ply").rename(tmp_path / "fused.ply")
    write_colmap(ours, NAMES, level, depths, sources)
