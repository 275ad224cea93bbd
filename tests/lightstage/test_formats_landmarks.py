"""68 landmarks in pictures and on meshes."""

import json

import numpy as np
import pytest

from lightstage.errors import FormatError
from lightstage.formats.landmarks import (
    read_clicked,
    read_points_mm,
    read_points_px,
    write_points_mm,
    write_points_px,
)


def points(size):
    made = np.random.default_rng(size).uniform(-100, 900, (68, size)).round(4)
    made[5] = made[20] = np.nan
    return made


def test_points_survive_their_files_with_hidden_ones(tmp_path):
    px = {"cam0": points(2), "cam1": points(2) + 1}
    read = read_points_px(write_points_px(px, tmp_path / "px.json"))
    assert sorted(read) == ["cam0", "cam1"]
    for camera, expected in px.items():
        assert np.allclose(read[camera], expected, atol=1e-4, equal_nan=True)
    mm = points(3)
    assert np.allclose(
        read_points_mm(write_points_mm(mm, tmp_path / "mm.json")), mm, equal_nan=True
    )
    assert json.loads((tmp_path / "mm.json").read_text())["points_mm"][5] is None


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ({"scheme": "w300", "points_mm": []}, "scheme"),
        ([], "scheme: found None, expected 'ibug68'"),
        (
            {"schema": "lightstage.landmarks/2", "scheme": "ibug68", "points_mm": []},
            "newer version",
        ),
        ({"scheme": "ibug68"}, "points_mm: found NoneType, expected 68 entries"),
        ({"scheme": "ibug68", "points_mm": [None] * 67}, "found 67, expected 68"),
        (
            {"scheme": "ibug68", "points_mm": [None] * 67 + [[1, 2]]},
            r"points_mm\[67\]: found \[1, 2",
        ),
        ({"scheme": "ibug68", "points_mm": [None] * 67 + [["a", 1, 2]]}, r"points_mm\[67\]"),
        ({"scheme": "ibug68", "points_mm": [[1, True, 2]] * 68}, r"points_mm\[0\]: found \[1, T"),
        ({"scheme": "ibug68", "points_mm": [[1, 1e300, 2]] * 68}, r"points_mm\[0\]: found"),
    ],
)
def test_other_landmarks_are_refused(tmp_path, value, message):
    path = tmp_path / "l.json"
    path.write_text(json.dumps(value))
    with pytest.raises(FormatError, match=message):
        read_points_mm(path)


@pytest.mark.parametrize(("points", "found"), [({}, "none"), ({"points_px": [1]}, "list")])
def test_what_is_no_table_of_cameras_is_named(tmp_path, points, found):
    path = tmp_path / "landmarks.json"
    path.write_text(json.dumps({"schema": "lightstage.landmarks/1", "scheme": "ibug68", **points}))
    with pytest.raises(FormatError, match=f"points_px: found {found}, expected points by camera"):
        read_points_px(path)


def test_each_kind_of_landmarks_is_named_where_the_other_is_wanted(tmp_path):
    path = write_points_px({"cam0": points(2)}, tmp_path / "landmarks.json")
    with pytest.raises(FormatError, match=r"in a session's pictures.*expected points_mm"):
        read_points_mm(path)
    path = write_points_mm(points(3), tmp_path / "mm.json")
    with pytest.raises(FormatError, match=r"landmarks on a mesh.*expected points_px"):
        read_points_px(path)


def test_landmarks_in_pictures_need_their_schema(tmp_path):
    path = tmp_path / "l.json"
    path.write_text(json.dumps({"scheme": "ibug68", "points_px": {}}))
    with pytest.raises(FormatError, match="schema"):
        read_points_px(path)
    write_points_px({"cam0": points(2)}, path)
    value = json.loads(path.read_text())
    value["points_px"]["cam0"].pop()
    path.write_text(json.dumps(value))
    with pytest.raises(FormatError, match=r"points_px.cam0: found 67"):
        read_points_px(path)


def test_landmarks_of_a_camera_that_the_rig_lacks_are_refused(tmp_path, small_rig):
    px = points(2) / 25  # of 32 x 48
    path = write_points_px({"cam0": px, "Cam1": px}, tmp_path / "landmarks.json")
    with pytest.raises(FormatError, match=r"points_px: found Cam1, expected cameras of rig\.json"):
        read_clicked(path, small_rig)
    write_points_px({"cam0": px}, path)
    assert list(read_clicked(path, small_rig)) == ["cam0"]


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (
            lambda share, _: share,
            r"points_px.cam0: found all points within 0\.\d+ px of .* shares",
        ),
        (
            lambda share, size: share * size * [4, 1],
            r"found most points around \(82\.85, 29\.96\), outside",
        ),
        (lambda share, size: share * size - [0, size[1]], "expected pixels of 32 x 48"),
    ],
    ids=["shares of the sides", "a larger copy", "above"],
)
def test_landmarks_that_are_no_pixels_of_their_photograph_are_refused(
    tmp_path, small_rig, points, message
):
    size = np.array([small_rig.cameras[0].width_px, small_rig.cameras[0].height_px])
    share = np.random.default_rng(0).uniform(0.3, 0.9, (68, 2))
    path = write_points_px({"cam0": points(share, size)}, tmp_path / "landmarks.json")
    with pytest.raises(FormatError, match=message):
        read_clicked(path, small_rig)
    guessed = share * size * [1.3, 1]  # some are outside: the photograph cuts the face off
    read_clicked(write_points_px({"cam0": guessed}, path), small_rig)
