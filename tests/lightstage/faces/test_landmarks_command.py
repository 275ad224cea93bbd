"""`lightstage landmarks`: what it writes, which face it takes, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from lightstage.errors import FormatError
from lightstage.faces.upright_srgb import read_photo
from lightstage.formats.landmarks import read_points_px
from lightstage.poses_from_photos.points import read_clicks
from tests.documents import ROOT


@pytest.fixture(scope="module")
def photos(tmp_path_factory) -> Path:
    """Photographs of one, of two and of nobody, in all kinds of files."""
    folder = tmp_path_factory.mktemp("photographs")
    sheet = cv2.imread(str(ROOT / "docs" / "people.jpg"))
    one = sheet[:270, 327:490]
    grey = cv2.cvtColor(one, cv2.COLOR_BGR2GRAY)
    clear = np.dstack([one, np.full(one.shape[:2], 9, np.uint8)])
    kinds = {
        "one.png": one,
        "grey.png": grey,
        "deep.tif": one.astype(np.uint16) * 257,
        "clear.png": clear,
        "two.jpg": sheet[:270, 327:653],
        "none.png": np.zeros((80, 60, 3), np.uint8),
        "pixel.png": np.full((1, 1, 3), 128, np.uint8),
    }
    for name, pixels in kinds.items():
        assert cv2.imwrite(str(folder / name), pixels)
    (folder / "text.png").write_text("no picture")
    (folder / "cut.png").write_bytes((folder / "one.png").read_bytes()[:40])
    return folder


def test_points_are_written_by_photograph_in_both_schemes(photos, tmp_path, run_command):
    for scheme, count in (("mediapipe468", 468), ("ibug68", 68)):
        out, picture = tmp_path / f"{scheme}.json", tmp_path / f"{scheme}.png"
        done = run_command(
            "lightstage", "landmarks", str(photos / "one.png"), "--out", str(out),
            "--scheme", scheme, "--picture", str(picture), "--json",
        )  # fmt: skip
        assert done.code == 0, done.err
        points = read_points_px(out, scheme)["one"]
        assert points.shape == (count, 2)
        # The sides of the jaw turn away from the camera; nearly all else is seen.
        assert np.isfinite(points).all(axis=1).mean() > 0.8
        assert scheme == "mediapipe468" or np.isfinite(points[17:]).all(axis=1).mean() > 0.9
        shown = cv2.imread(str(picture))
        assert shown.shape[0] == 768
        assert (shown == [0, 255, 0]).all(axis=2).sum() > 2 * count
        assert json.loads(done.out)["photographs"]["one"]["presence"] > 0.9
    assert len(read_clicks(tmp_path / "ibug68.json")) > 50
    with pytest.raises(FormatError, match=r"found 'mediapipe468', expected 'ibug68'.*--scheme"):
        read_points_px(tmp_path / "mediapipe468.json")


def test_grey_deep_and_transparent_photographs_show_the_same_face(photos, tmp_path, run_command):
    names = ["one.png", "grey.png", "deep.tif", "clear.png"]
    out = tmp_path / "points.json"
    done = run_command(
        "lightstage", "landmarks", *(str(photos / name) for name in names), "--out", str(out)
    )
    assert done.code == 0, done.err
    points = read_points_px(out, "mediapipe468")
    assert [*points] == ["one", "grey", "deep", "clear"]
    for other in ("grey", "deep", "clear"):
        assert np.nanmean(np.abs(points[other] - points["one"])) < 1.5


def test_of_two_faces_the_largest_is_taken_and_reported(photos, tmp_path, run_command):
    found = {}
    for number in (1, 2):
        out = tmp_path / f"{number}.json"
        words = [str(photos / "two.jpg"), "--out", str(out), "--face", str(number)]
        done = run_command("lightstage", "landmarks", *words)
        assert done.code == 0, done.err
        assert "two.jpg: 2 faces" in done.err
        found[number] = np.nanmean(read_points_px(out, "mediapipe468")["two"], axis=0)
    assert abs(found[1][0] - found[2][0]) > 100
    out = tmp_path / "3.json"
    words = [str(photos / "two.jpg"), "--out", str(out), "--face", "3"]
    done = run_command("lightstage", "landmarks", *words)
    assert done.code == 2
    assert "found 2 faces, no number 3" in done.err
    assert not out.exists()


def test_a_photograph_without_a_face_is_left_out_and_alone_refused(photos, tmp_path, run_command):
    out = tmp_path / "points.json"
    words = [str(photos / "one.png"), str(photos / "none.png"), "--out", str(out)]
    done = run_command("lightstage", "landmarks", *words)
    assert done.code == 0
    assert "none.png: no face" in done.err
    assert [*read_points_px(out, "mediapipe468")] == ["one"]
    for name in ("none.png", "pixel.png"):
        out = tmp_path / "no.json"
        done = run_command("lightstage", "landmarks", str(photos / name), "--out", str(out))
        assert done.code == 2
        assert "found no face, expected a face of at least a tenth" in done.err
        assert not out.exists()


@pytest.mark.parametrize(
    ("name", "message"),
    [("text.png", "another kind of file"), ("cut.png", "a PNG that cannot be read")],
)
def test_what_is_no_photograph_is_refused(photos, name, message):
    with pytest.raises(FormatError, match=f"found {message}"):
        read_photo(photos / name)


def test_two_photographs_of_one_name_are_refused(photos, tmp_path, run_command):
    words = [str(photos / "one.png")] * 2
    done = run_command("lightstage", "landmarks", *words, "--out", str(tmp_path / "o.json"))
    assert done.code == 2
    assert "found one twice" in done.err
