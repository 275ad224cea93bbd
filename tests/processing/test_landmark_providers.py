"""Landmarks from programs of other environments, and of meshes that have none."""

import dataclasses
import re
import sys

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lightstage.formats.mesh import Mesh
from lightstage.formats.template import Template, default_template_path, load_template
from processing.errors import RegistrationError
from processing.registration.providers import (
    CommandLandmarks,
    DetectedLandmarks,
    landmarks_of_mesh,
)
from tests.documents import ROOT
from tests.processing.shapes import ellipsoid_template, refined

UPRIGHT = np.eye(3)
TURNS = list(np.round(Rotation.create_group("O").as_matrix()))
PICTURES = {
    "cam0": np.full((40, 30, 3), 90, np.uint8),
    "cam1": np.full((20, 50, 3), 10, np.uint8),
}


def program(tmp_path, body):
    """A detector: a Python program with FOLDER as its only argument."""
    path = tmp_path / "detector.py"
    path.write_text("import json, sys, pathlib\nfolder = pathlib.Path(sys.argv[1])\n" + body)
    return CommandLandmarks(f"{sys.executable} {path}")


def prints(value):
    return f"print(json.dumps({value!r}))\n"


def landmarks(**cameras):
    return {"schema": "lightstage.landmarks/1", "scheme": "ibug68", "points_px": cameras}


def test_a_program_sees_every_picture_and_prints_landmarks(tmp_path):
    body = (
        "import cv2\n"
        "out = {}\n"
        "for path in sorted(folder.glob('*.png')):\n"
        "    picture = cv2.imread(str(path))\n"
        "    h, w = picture.shape[:2]\n"
        "    out[path.stem] = [[w, h]] * 34 + [None] * 33 + [[int(picture[0, 0, 0]), 0]]\n"
        "print(json.dumps({'schema': 'lightstage.landmarks/1', 'scheme': 'ibug68', "
        "'points_px': out}))\n"
    )
    found = program(tmp_path, body).find(PICTURES)
    assert found["cam0"][0].tolist() == [30, 40]
    assert found["cam1"][0].tolist() == [50, 20]
    assert np.isnan(found["cam0"][40]).all()
    assert found["cam0"][67, 0] == 90


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("sys.exit('no face model')\n", "no face model"),
        ("print('hello')\n", "standard output Expecting value"),
        (prints({"schema": "lightstage.landmarks/1", "scheme": "x", "points_px": {}}), "scheme"),
        (prints(landmarks(cam0=[[1, 2]] * 67)), "68"),
        (prints(landmarks(cam7=[None] * 68)), "cam7"),
    ],
)
def test_programs_that_fail_are_named(tmp_path, body, message):
    with pytest.raises(RegistrationError, match=message) as caught:
        program(tmp_path, body).find(PICTURES)
    assert caught.value.where.startswith("landmark command")
    assert "landmarks.json:" not in str(caught.value)


def test_a_program_that_is_not_there_or_never_ends_is_named(tmp_path):
    with pytest.raises(RegistrationError, match="no-such-program"):
        CommandLandmarks("no-such-program-at-all").find(PICTURES)
    slow = program(tmp_path, "import time\ntime.sleep(60)\n")
    with pytest.raises(RegistrationError, match="timed out"):
        CommandLandmarks(slow.command, timeout_s=0.5).find(PICTURES)


class Seer:
    """Knows where the landmarks are and errs in one view; a face of another turn it overlooks."""

    def __init__(self, marks, wrong=None, turn=UPRIGHT):
        self.marks, self.wrong, self.turn, self.pictures = marks, wrong, turn, {}

    def find(self, pictures):
        from processing.registration.providers import _portrait

        self.pictures = pictures
        turned = MESH.with_vertices(MESH.vertices @ self.turn)
        out = {}
        for name in pictures:
            number, side = re.fullmatch(r"turn(\d+)([+-]\d+)", name).groups()
            others = [t for t in TURNS if not np.array_equal(t, UPRIGHT)]
            turns = [UPRIGHT] if len(pictures) == 3 and not self.found_it else others
            if len(pictures) == 3 and self.found_it:
                turns = [self.turn]
            if np.array_equal(turns[int(number)], self.turn):
                self.found_it = True
                camera = _portrait(turned, self.turn, float(side), name)
                out[name] = camera.project(self.marks @ self.turn)[0]
        if self.wrong is not None:
            next(iter(out.values()))[self.wrong] += [60, 0]
        return out

    found_it = False


TEMPLATE = ellipsoid_template()
MESH = refined(TEMPLATE.mesh)
MARKS = TEMPLATE.mesh.vertices[TEMPLATE.landmarks]


def test_a_mesh_is_rendered_and_its_landmarks_are_triangulated():
    seer = Seer(MARKS, wrong=30)
    found, turn = landmarks_of_mesh(Mesh(MESH.vertices, MESH.faces), seer, 2.5, MARKS)
    assert np.linalg.norm(found.points_mm - MARKS, axis=1).max() < 0.01
    assert [outlier.landmark_idx for outlier in found.outliers] == [30]
    assert np.array_equal(turn, UPRIGHT)
    for picture in seer.pictures.values():
        # A head in the middle of the picture, on black.
        lit = picture[..., 0] > 30
        assert 0.15 < lit.mean() < 0.8
        assert lit[512, 512]
        assert not lit[0, 0]


@pytest.fixture
def small_pictures(monkeypatch):
    """Of 27 pictures whose every pixel is a ray, where nobody looks at a pixel."""
    monkeypatch.setattr("processing.registration.providers.PICTURE_PX", 128)


@pytest.mark.usefixtures("small_pictures")
def test_a_mesh_that_lies_on_its_side_is_turned_until_a_face_is_seen():
    turn = TURNS[11]
    lying = MESH.with_vertices(MESH.vertices @ turn)
    found, used = landmarks_of_mesh(lying, Seer(MARKS, turn=turn), 2.5, MARKS)
    assert np.array_equal(used, turn)
    assert np.linalg.norm(found.points_mm @ turn.T - MARKS, axis=1).max() < 0.01


@pytest.mark.usefixtures("small_pictures")
def test_no_face_in_any_picture_is_reported():
    class Blind:
        def find(self, pictures):
            return dict.fromkeys(pictures, np.full((68, 2), np.nan))

    with pytest.raises(RegistrationError, match="23 other turns"):
        landmarks_of_mesh(TEMPLATE.mesh, Blind(), 2.5, MARKS)


@pytest.fixture(scope="module")
def template() -> Template:
    return load_template(default_template_path())


def test_the_detector_leaves_out_pictures_without_a_face(template: Template) -> None:
    sheet = cv2.imread(str(ROOT / "docs" / "people.jpg"))[:270, :, ::-1]
    pictures = {"cam0": sheet[:, 327:490], "cam1": np.zeros((90, 60, 3), np.uint8)}
    found = {}
    for name, shape in (
        ("own", template),
        ("ibug", dataclasses.replace(template, face_points=None)),
    ):
        stated = DetectedLandmarks(shape).find(pictures)
        assert [*stated] == ["cam0"]
        assert stated["cam0"].shape == (68, 2)
        found[name] = stated["cam0"][17:]
    # The two ways mean the same places but for what a landmark is taken to be.
    away = np.linalg.norm(found["own"] - found["ibug"], axis=1)
    eyes = np.linalg.norm(found["ibug"][45 - 17] - found["ibug"][36 - 17])
    assert np.isfinite(away).mean() > 0.9
    assert np.nanmean(away) < 0.06 * eyes
    assert DetectedLandmarks(template).find({"cam1": pictures["cam1"]}) == {}


def test_the_detector_finds_a_bare_meshs_landmarks(template: Template) -> None:
    marks = template.mesh.vertices[template.landmarks]
    found = landmarks_of_mesh(template.mesh, DetectedLandmarks(template), 5.0, marks)
    away = np.linalg.norm(found.landmarks.points_mm - marks, axis=1)
    assert np.isfinite(away[17:]).sum() > 45
    assert np.nanmean(away) < 5.0
    assert np.array_equal(found.turn, np.eye(3))
