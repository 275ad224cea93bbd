"""Eyes that are open, and unusual photographs: what the fit's notes tell about them."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from learning.photo import command
from learning.photo.command import FitRequest, read_all
from learning.photo.eye_texels import eye_texels, with_eyes
from learning.photo.eyes import EYES, SKIN, openings
from learning.photo.picture import read_photograph
from learning.photo.shape_fit import aside_deg
from learning.photo.unwrap import unwrap
from learning.render.uv import rasterise
from lightstage.errors import LightstageError
from lightstage.faces import detect_faces
from lightstage.faces.detect import Face
from lightstage.faces.schemes import FACE_MESH, ibug68, seen_points
from lightstage.formats.template import Template, default_template_path
from processing.colour import srgb_from_linear
from tests.learning.photo.scene import Shot, camera_at


@pytest.fixture(scope="module")
def light(shot: Shot) -> np.ndarray:
    """(h, w, 3) linear."""
    return read_photograph(shot.path).rgb_linear


@pytest.fixture(scope="module")
def marks(light: np.ndarray) -> np.ndarray:
    """(68, 2) as detected."""
    shown = np.round(255 * srgb_from_linear(light)).astype(np.uint8)
    return ibug68(seen_points(detect_faces(shown)[0], FACE_MESH))


def over_eyes(light: np.ndarray, marks: np.ndarray, colour: np.ndarray, size: float) -> np.ndarray:
    """The photograph with a disc before each eye; its radius in widths of the eye."""
    out = light.copy()
    for each in EYES:
        eye = marks[each]
        if np.isfinite(eye).all():
            radius = int(size * np.ptp(eye[:, 0]))
            centre = np.round(eye.mean(axis=0)).astype(int).tolist()
            cv2.circle(out, centre, radius, colour.tolist(), -1)
    return out


def are_open(light: np.ndarray, marks: np.ndarray) -> bool:
    """Whether an eye's white is seen."""
    return bool(np.isfinite(openings(light, marks)).any())


def skin_of(light: np.ndarray, marks: np.ndarray) -> np.ndarray:
    places = np.round(marks[list(SKIN)][np.isfinite(marks[list(SKIN)]).all(axis=1)]).astype(int)
    return np.asarray(np.median(light[places[:, 1], places[:, 0]], axis=0), light.dtype)


@pytest.mark.parametrize("brightness", [0.1, 1.0, 10.0])
def test_open_eyes_show_white_at_any_exposure_and_hidden_or_closed_ones_none(
    light: np.ndarray, marks: np.ndarray, brightness: float
) -> None:
    glasses = over_eyes(light, marks, np.full(3, 0.005, light.dtype), 1.0)
    lids = over_eyes(light, marks, skin_of(light, marks), 0.6)
    assert are_open(brightness * light, marks)
    assert not are_open(brightness * glasses, marks)
    assert not are_open(brightness * lids, marks)


def test_a_photograph_without_colour_tells_no_white_from_lids(
    light: np.ndarray, marks: np.ndarray
) -> None:
    grey = np.repeat(light.mean(axis=2, keepdims=True), 3, axis=2)
    assert not are_open(grey, marks)


def test_eyes_that_are_turned_away_or_a_few_pixels_wide_tell_nothing(
    light: np.ndarray, marks: np.ndarray
) -> None:
    away = marks.copy()
    away[36:48] = np.nan
    assert not are_open(light, away)
    assert not are_open(cv2.resize(light, None, fx=0.2, fy=0.2), marks * 0.2)
    assert not are_open(light, np.full((68, 2), np.nan))
    assert not are_open(0 * light, marks)


@settings(max_examples=40, deadline=None)
@given(
    fill=st.sampled_from([0.0, -1.0, np.nan, np.inf, 1e-6, 1e6]),
    share=st.floats(0, 1),
    scale=st.sampled_from([1e-6, 1.0, 1e3, 1e6]),
    lost=st.integers(0, 68),
    seed=st.integers(0, 99),
)
def test_any_pixels_and_landmarks_give_an_answer_or_none(
    fill: float, share: float, scale: float, lost: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    rgb = rng.random((30, 40, 3))
    rgb[rng.random((30, 40)) < share] = fill
    marks = scale * rng.standard_normal((68, 2))
    marks[rng.permutation(68)[:lost]] = np.nan
    found = openings(rgb, marks)
    assert found.shape == (2, 3, 2)
    assert not np.isinf(found).any()


def drawn(light: np.ndarray) -> np.ndarray:
    """White paper with dark lines where the photograph has edges."""
    grey = np.round(255 * srgb_from_linear(light.mean(axis=2))).astype(np.uint8)
    lines = cv2.Canny(grey, 30, 80)
    return np.repeat((1.0 - 0.98 * (cv2.dilate(lines, np.ones((2, 2))) > 0))[:, :, None], 3, axis=2)


def in_sunglasses(light: np.ndarray, marks: np.ndarray) -> np.ndarray:
    return over_eyes(light, marks, np.full(3, 0.005, light.dtype), 0.9)


def behind_a_hand(light: np.ndarray, marks: np.ndarray) -> np.ndarray:
    """Four fingers before the mouth."""
    out = light.copy()
    mouth, wide = marks[48:60].mean(axis=0), np.ptp(marks[48:60, 0])
    for finger in range(4):
        centre = np.round(mouth + wide * np.array([0.4 * finger - 0.6, 0.2])).astype(int)
        axes = (int(0.18 * wide), int(0.9 * wide))
        colour = (skin_of(light, marks) * (0.8 + 0.1 * finger)).tolist()
        cv2.ellipse(out, centre.tolist(), axes, 8, 0, 360, colour, -1)
    return out


def half_hidden(light: np.ndarray, marks: np.ndarray) -> np.ndarray:
    """Half a face: the other one is behind a wall, as far as a profile goes."""
    out = light.copy()
    out[:, int(marks[30, 0]) :] = 0.3
    return out


def asked(odd: np.ndarray, template: Template, folder: Path) -> tuple[np.ndarray, str]:
    """Landmarks and notes of a photograph."""
    path = folder / "odd.png"
    cv2.imwrite(str(path), np.round(255 * srgb_from_linear(odd))[:, :, ::-1].astype(np.uint8))
    request = FitRequest((path,), default_template_path(), folder / "F")
    photographs, _, notes = read_all(request, template)
    return photographs[0].landmarks_px, " ".join(notes)


@pytest.mark.parametrize("change", [in_sunglasses, behind_a_hand, half_hidden])
def test_glasses_a_hand_and_half_a_face_give_landmarks_all_the_same(
    light: np.ndarray, marks: np.ndarray, template: Template, tmp_path: Path, change
) -> None:
    found, _ = asked(change(light, marks), template, tmp_path)
    assert np.isfinite(found).all(axis=1).mean() > 0.3


def test_a_drawing_in_which_no_face_is_found_is_one_refusal(
    light: np.ndarray, template: Template, tmp_path: Path
) -> None:
    with pytest.raises(LightstageError, match=r"odd\.png.*no face"):
        asked(drawn(light), template, tmp_path)


def test_a_face_that_the_detector_doubts_is_mentioned(
    light: np.ndarray, template: Template, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def doubting(shown: np.ndarray) -> list[Face]:
        return [dataclasses.replace(face, presence=0.65) for face in detect_faces(shown)]

    monkeypatch.setattr(command, "detect_faces", doubting)
    assert "65 % sure that this is a face" in asked(light, template, tmp_path)[1]


def test_the_templates_eyes_show_the_open_eyes_wherever_the_shape_has_them(
    light: np.ndarray, marks: np.ndarray, shot: Shot, template: Template
) -> None:
    found = openings(light, marks)
    assert np.isfinite(found).all()
    right, left = found
    assert right[0, 0] < left[0, 0]
    for opening, each in zip(found, EYES, strict=True):
        width = np.ptp(marks[each][:, 0])
        assert 0.5 < np.linalg.norm(opening[1]) / width < 1.4
        assert 0.15 < np.linalg.norm(opening[2]) / width < 1.0
    # One white of each eye in shade: the iris is still within.
    shaded = light.copy()
    for each in EYES:
        eye = marks[each]
        shaded[:, int(eye[:, 0].mean()) : int(eye[:, 0].max()) + 20] *= 0.1
    for opening, each in zip(openings(shaded, marks), EYES, strict=True):
        middle = marks[each].mean(axis=0)[0]
        assert opening[0, 0] < middle < opening[0, 0] + opening[1, 0]
    raster = rasterise(shot.mesh, 192, 128)
    eyes = eye_texels(template, raster)
    assert eyes is not None
    assert not (eyes.texels[0] & eyes.texels[1]).any()
    place = eyes.place[eyes.texels.any(axis=0)]
    assert (place > -1e-6).all()
    assert (place < 1 + 1e-6).all()

    def shown(up_px: float) -> tuple[np.ndarray, np.ndarray]:
        moved = dataclasses.replace(shot.camera, cy_px=shot.camera.cy_px + up_px)
        plain = unwrap(light, shot.mesh, raster, moved)
        filled, where = with_eyes(plain, light, found, eyes)
        np.testing.assert_array_equal(where, eyes.texels.any(axis=0))
        np.testing.assert_array_equal(
            filled.texture[~eyes.texels.any(axis=0)], plain.texture[~eyes.texels.any(axis=0)]
        )
        return plain.texture, filled.texture

    here, beside = shown(0.0), shown(12.0)
    for texels in eyes.texels:
        np.testing.assert_array_equal(here[1][texels], beside[1][texels])
        # 12 px are a third of an eye's width: the plain texel shows the lid.
        assert np.abs(np.log(here[0][texels] / beside[0][texels])).mean() > 0.2


def test_a_camera_beside_the_head_is_told_from_one_in_front() -> None:
    for turn in (-35.0, 0.0, 8.0, 120.0):
        assert aside_deg(camera_at(turn)) == pytest.approx(abs(turn), abs=3.0)


def test_closed_and_hidden_eyes_are_not_filled(
    light: np.ndarray, marks: np.ndarray, shot: Shot, template: Template
) -> None:
    lids = over_eyes(light, marks, skin_of(light, marks), 0.6)
    away = marks.copy()
    away[EYES[0]] = np.nan
    assert np.isnan(openings(lids, marks)).all()
    one = openings(light, away)
    assert np.isnan(one[0]).all()
    assert np.isfinite(one[1]).all()
    raster = rasterise(shot.mesh, 96, 64)
    plain, eyes = unwrap(lids, shot.mesh, raster, shot.camera), eye_texels(template, raster)
    assert eyes is not None
    same, filled = with_eyes(plain, lids, openings(lids, marks), eyes)
    assert not filled.any()
    np.testing.assert_array_equal(same.texture, plain.texture)
    np.testing.assert_array_equal(same.seen, plain.seen)
    without = dataclasses.replace(
        template, regions={k: v for k, v in template.regions.items() if k != "eyes"}
    )
    assert eye_texels(without, raster) is None


@settings(max_examples=30, deadline=None)
@given(
    values=st.lists(
        st.floats(-1, 1e6, width=32) | st.just(float("nan")) | st.just(float("inf")),
        min_size=12,
        max_size=12,
    ),
    scale=st.sampled_from([1e-6, 1.0, 1e6]),
    seed=st.integers(0, 99),
)
def test_openings_are_finite_or_missing_on_any_picture(
    values: list[float], scale: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    picture = np.resize(np.array(values, np.float32), (40, 60, 3))
    marks = rng.uniform(-50, 110, (68, 2)) * scale
    with np.errstate(over="ignore", invalid="ignore"):
        found = openings(picture, marks)
    each = np.isfinite(found).all(axis=(1, 2))
    assert np.isnan(found[~each]).all()
