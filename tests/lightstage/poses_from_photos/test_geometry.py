"""Scale, clicked points and axes on their own: exact on exact input, else refused."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from lightstage.errors import FormatError, LightstageError, MotionError
from lightstage.formats.exr import write_exr
from lightstage.poses_from_photos.lengths import Length, find_scale, parse_length
from lightstage.poses_from_photos.pictures import evened, read_grey
from lightstage.poses_from_photos.points import place, read_clicks
from lightstage.poses_from_photos.world import looked_at, moved, turn_between, turned_by_cameras
from lightstage.rig import Camera, default_rig

RIG = default_rig().scaled(0.1)
CAMERAS = {camera.id: camera for camera in RIG.cameras}


def bent(camera: Camera) -> Camera:
    return dataclasses.replace(camera, dist=(0.3, 0.0, 0.0, 0.0, 0.0))


def clicks_on(point: np.ndarray, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    return {name: bent(CAMERAS[name]).project(point[None])[0][0] for name in names}


BENT = {name: bent(camera) for name, camera in CAMERAS.items()}


@given(
    st.lists(st.floats(-80, 80), min_size=3, max_size=3),
    st.sets(st.sampled_from(sorted(CAMERAS)), min_size=2),
)
def test_a_clicked_point_is_where_it_was_clicked(point: list[float], names: set[str]) -> None:
    found = place("p", clicks_on(np.array(point), tuple(sorted(names))), BENT)
    np.testing.assert_allclose(found.position, point, atol=1e-3)
    assert found.residual_px < 1e-3


def test_a_click_in_another_place_is_named() -> None:
    clicks = clicks_on(np.zeros(3), ("cam0", "cam1", "cam2"))
    clicks["cam1"] = clicks["cam1"] + [0, 60]
    with pytest.raises(MotionError, match=r"point p: found clicks that do not meet.*cam1"):
        place("p", clicks, BENT)
    with pytest.raises(MotionError, match="clicked in cam0"):
        place("p", {"cam0": clicks["cam0"], "cam77": clicks["cam2"]}, BENT)
    twice = {"cam0": BENT["cam0"], "twin": BENT["cam0"]}
    with pytest.raises(MotionError, match="from one direction"):
        place("p", {"cam0": clicks["cam0"], "twin": clicks["cam0"]}, twice)


@given(st.floats(1e-6, 1e6))
def test_scale_is_that_of_the_length(unit_mm: float) -> None:
    small = {
        name: dataclasses.replace(
            camera, cam_from_world=moved(camera, 1 / unit_mm, np.eye(3), np.zeros(3))
        )
        for name, camera in BENT.items()
    }
    apart = float(np.linalg.norm(CAMERAS["cam0"].centre_mm - CAMERAS["cam3"].centre_mm))
    clicks = {
        name: clicks_on(np.array(point), ("cam0", "cam1", "cam2"))
        for name, point in (("a", [-40.0, 0, 0]), ("b", [40.0, 0, 0]))
    }
    scale = find_scale([Length("cam0", "cam3", apart), Length("a", "b", 80.0)], small, clicks)
    assert abs(scale.mm_per_unit / unit_mm - 1) < 1e-5
    assert not scale.warnings()


def test_lengths_that_contradict_each_other() -> None:
    apart = float(np.linalg.norm(CAMERAS["cam0"].centre_mm - CAMERAS["cam3"].centre_mm))
    other = float(np.linalg.norm(CAMERAS["cam1"].centre_mm - CAMERAS["cam2"].centre_mm))
    one = Length("cam0", "cam3", apart)
    scale = find_scale([one, Length("cam1", "cam2", 1.04 * other)], CAMERAS, {})
    assert len(scale.warnings()) == 2
    with pytest.raises(MotionError, match="contradict each other"):
        find_scale([one, Length("cam1", "cam2", 1000 * other)], CAMERAS, {})
    with pytest.raises(MotionError, match="2 problems"):
        find_scale([Length("cam0", "7", 5.0), Length("eye", "cam1", 5.0)], CAMERAS, {})


@pytest.mark.parametrize("text", ["", "a:b", "a:b=0", "a:b=-3", "a:b=nan", "a:b=inf", "a:a=4",
                                  "a=4", "a:b:c=4", "a:b=1e99", "a:b=4mm"])  # fmt: skip
def test_a_length_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(MotionError, match="FIRST:SECOND=MM"):
        parse_length(text)


def test_a_length_reads_as_it_is_written() -> None:
    assert parse_length(" cam0:cam3=952.6 ") == Length("cam0", "cam3", 952.6)
    assert parse_length(str(Length("36", "45", 90.5))) == Length("36", "45", 90.5)


@pytest.mark.parametrize(
    "points",
    [[], {"cam0": [1, 2]}, {"cam0": {"a": [1]}}, {"cam0": {"a": [1, None]}}, {"cam0": {"a": "x"}},
     {"cam0": {"a": [float("nan"), 1]}}],
)  # fmt: skip
def test_points_that_are_none_are_refused(tmp_path: Path, points: object) -> None:
    path = tmp_path / "points.json"
    path.write_text(json.dumps({"schema": "lightstage.points/1", "points_px": points}))
    with pytest.raises(FormatError, match="points_px"):
        read_clicks(path)


@given(st.integers(0, 2**32 - 1), st.floats(1e-3, 1e3))
def test_the_turn_between_points_is_found(seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    here = rng.normal(size=(7, 3))
    turn = Rotation.random(rng=rng).as_matrix()
    found, misfit = turn_between(here, scale * here @ turn.T + rng.normal(size=3))
    np.testing.assert_allclose(found, turn, atol=1e-9)
    assert misfit < 1e-9


@given(st.integers(0, 2**32 - 1), st.floats(1e-3, 1e3))
def test_the_world_is_upright_and_faces_the_frontal_camera(seed: int, scale: float) -> None:
    """Whatever turn, shift and unit the solver left, the default rig's own axes come back."""
    rng = np.random.default_rng(seed)
    turn, shift = Rotation.random(rng=rng).as_matrix(), rng.normal(0, 100, 3)
    loose = {
        name: dataclasses.replace(camera, cam_from_world=moved(camera, scale, turn, shift))
        for name, camera in CAMERAS.items()
    }
    middle = scale * turn @ -shift
    back, front = turned_by_cameras(loose, middle)
    assert front == "cam0"
    origin = looked_at(loose, middle)
    for name, camera in loose.items():
        pose = moved(camera, 1 / scale, back, origin)
        np.testing.assert_allclose(pose, CAMERAS[name].cam_from_world, rtol=1e-3, atol=5.0)
    below = loose["cam0"].centre_mm - scale * turn[:, 1]
    with pytest.raises(MotionError, match="straight above"):
        turned_by_cameras(loose, below, "cam0")


def test_cameras_that_all_look_one_way_are_upright_too() -> None:
    side_by_side = {
        f"c{k}": dataclasses.replace(
            CAMERAS["cam0"],
            cam_from_world=np.c_[np.diag([1.0, -1.0, -1.0]), [60.0 * k, 0, 900]],
        )
        for k in range(3)
    }
    turn, front = turned_by_cameras(side_by_side, np.zeros(3))
    np.testing.assert_allclose(turn[1], [0, 1, 0], atol=1e-6)
    assert front == "c0" or front == "c1"


def test_pictures_of_nothing_show_nothing(tmp_path: Path) -> None:
    for image in (np.zeros((80, 90)), np.full((80, 90), -1.0)):
        grey, lit = evened(image.astype(np.float32))
        assert not lit.any()
        assert not grey.any()
    image = np.full((80, 90, 3), 0.5, np.float32)
    image[3, 4] = [np.nan, np.inf, -np.inf]
    picture = read_grey(write_exr(tmp_path / "a.exr", image, half=False))
    assert (picture.width_px, picture.height_px, picture.times) == (90, 80, 1)
    assert picture.lit[40:].all()
    write_exr(tmp_path / "tiny.exr", image[40:60])
    with pytest.raises(FormatError, match="64 a side"):
        read_grey(tmp_path / "tiny.exr")
    with pytest.raises(LightstageError, match="none"):
        read_grey(tmp_path / "none.exr")


@given(st.floats(1e-6, 1e6))
def test_the_picture_does_not_depend_on_the_light_s_unit(unit: float) -> None:
    light = np.random.default_rng(1).uniform(0, 1, (96, 96)).astype(np.float32)
    one, other = evened(light), evened((light * unit).astype(np.float32))
    assert np.abs(one[0].astype(int) - other[0].astype(int)).max() <= 2
    assert (one[1] == other[1]).mean() > 0.999


def test_a_large_raw_becomes_a_small_picture(tmp_path: Path, dng) -> None:  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(0)
    (tmp_path / "a.dng").write_bytes(dng(rng.integers(600, 4000, (300, 200)), 200, 300))
    picture = read_grey(tmp_path / "a.dng")
    assert (picture.width_px, picture.height_px, picture.times) == (200, 300, 2)
    assert picture.grey.shape == (150, 100)
    (tmp_path / "cut.dng").write_bytes((tmp_path / "a.dng").read_bytes()[:3000])
    with pytest.raises(FormatError, match=r"3000 bytes.*truncated"):
        read_grey(tmp_path / "cut.dng")
