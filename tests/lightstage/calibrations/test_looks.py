"""Quick checks tell a target from another, and what is amiss with it."""

import dataclasses
import itertools

import numpy as np
import pytest

from lightstage.calibrations.config import KIND_NAMES, CalibrationConfig, LookConfig
from lightstage.calibrations.kinds import KINDS
from lightstage.calibrations.looks import LOOKS
from lightstage.calibrations.picture import Picture, read_picture
from lightstage.errors import FormatError
from sim.camera.flaws import PRESETS
from sim.devices.target_photographer import TargetPhotographer

CONFIG = CalibrationConfig()
LIT = {kind: 0.0 if kind == "dark" else 1.0 for kind in (*KIND_NAMES, "nothing")}


@pytest.fixture(scope="module")
def pictures(small_stage, tmp_path_factory):
    """Each target, and an empty stage, as the first camera's file shows it."""
    out = {}
    for kind, level in LIT.items():
        photographer = TargetPhotographer(small_stage, kind, 1, PRESETS["lab"])
        path = tmp_path_factory.mktemp("look") / f"{kind}.dng"
        levels = np.full(len(small_stage.lights), level)
        path.write_bytes(photographer.photograph(small_stage.cameras[0], levels))
        out[kind] = read_picture(path)
    return out


@pytest.mark.parametrize("kind", KIND_NAMES)
def test_a_target_is_found_and_none_is_taken_for_another(pictures, kind):
    for shown, picture in pictures.items():
        _, amiss = LOOKS[kind](picture, CONFIG)
        # An empty stage without a light is dark.
        does = shown == kind or (kind, shown) == ("dark", "nothing")
        assert (amiss == []) == does, (kind, shown, amiss)


def test_what_is_counted_is_what_is_there(pictures):
    figures, _ = LOOKS["charuco"](pictures["charuco"], CONFIG)
    assert 50 < figures["corners"] <= 70
    figures, _ = LOOKS["chart"](pictures["chart"], CONFIG)
    assert figures["patches"] == 24
    figures, _ = LOOKS["mirror"](pictures["mirror"], CONFIG)
    # 168 lights, less those behind the ball and those that run together toward its rim.
    assert 100 < figures["highlights"] <= 168
    ball, _ = LOOKS["grey"](pictures["grey"], CONFIG)
    assert abs(figures["diameter_px"] / ball["diameter_px"] - 1) < 0.1


@pytest.mark.parametrize("kind", ["charuco", "grey", "chart", "flat"])
def test_a_target_at_the_white_level_is_reported_with_its_share(pictures, kind):
    picture = pictures[kind]
    bright = dataclasses.replace(picture, clipped=picture.rgb[..., 1] > 0.2)
    figures, amiss = LOOKS[kind](bright, CONFIG)
    assert [each.code for each in amiss] == ["clipped"]
    assert figures["clipped"] > 0.05
    assert "white level" in amiss[0].found
    assert "Lower the ISO" in amiss[0].hint


def test_highlights_that_all_clip_are_reported_and_few_are_not(pictures):
    picture = pictures["mirror"]
    _, amiss = LOOKS["mirror"](
        dataclasses.replace(picture, clipped=picture.rgb[..., 1] > 0), CONFIG
    )
    assert [each.code for each in amiss] == ["clipped"]
    one = np.zeros_like(picture.clipped)
    one[np.unravel_index(picture.rgb[..., 1].argmax(), one.shape)] = True
    assert LOOKS["mirror"](dataclasses.replace(picture, clipped=one), CONFIG)[1] == []


def moved(picture: Picture, rows: int) -> Picture:
    """The same picture shifted down, black coming in."""
    parts = {}
    for name, step in (("rgb", 1), ("green", 2), ("clipped", 1)):
        old = getattr(picture, name)
        new = np.zeros_like(old)
        new[step * rows :] = old[: old.shape[0] - step * rows]
        parts[name] = new
    return Picture(**parts)


@pytest.mark.parametrize("kind", ["mirror", "grey"])
def test_a_ball_that_leaves_the_picture_is_reported(pictures, kind):
    picture = pictures[kind]
    height = picture.clipped.shape[0]
    codes = [each.code for each in LOOKS[kind](moved(picture, height // 2 - 10), CONFIG)[1]]
    assert "ball-cut" in codes


def test_a_ball_that_is_too_small_to_measure_is_reported(pictures):
    config = CalibrationConfig(look=LookConfig(min_ball_px=5000.0))
    for kind in ("mirror", "grey"):
        assert [each.code for each in LOOKS[kind](pictures[kind], config)[1]] == ["ball-small"]


def test_a_lit_room_is_not_dark_and_a_shadow_is_not_flat(pictures):
    dark, flat = pictures["dark"], pictures["flat"]
    lit = dataclasses.replace(dark, rgb=dark.rgb + np.float32(0.01))
    assert [each.code for each in LOOKS["dark"](lit, CONFIG)[1]] == ["not-dark"]
    spots = dark.rgb.copy()
    spots[:10, :10] = 0.5
    display = dataclasses.replace(dark, rgb=spots)
    assert [each.code for each in LOOKS["dark"](display, CONFIG)[1]] == ["not-dark"]
    shadow = flat.rgb.copy()
    shadow[:, : shadow.shape[1] // 4] *= 0.2
    uneven = dataclasses.replace(flat, rgb=shadow)
    assert [each.code for each in LOOKS["flat"](uneven, CONFIG)[1]] == ["flat-uneven"]


def test_pictures_without_any_meaning_are_refused_and_never_crash():
    rng = np.random.default_rng(5)
    size = (96, 64)
    for level, noise in itertools.product((-1.0, 0.0, 1e-6, 0.5, 1e6), (0.0, 1e-3, 1.0)):
        rgb = (level + noise * rng.standard_normal((*size, 3))).astype(np.float32)
        green = (level + noise * rng.standard_normal((192, 128))).astype(np.float32)
        picture = Picture(rgb, green, rgb.max(axis=2) >= 1)
        for kind in ("charuco", "mirror", "grey", "chart"):
            _, amiss = LOOKS[kind](picture, CONFIG)
            assert amiss, (kind, level, noise)


def test_a_file_that_is_no_raw_is_refused_with_its_name(tmp_path):
    path = tmp_path / "cam0.dng"
    cases = {
        b"": "0 bytes.*no photograph",
        b"II*\0 and nothing more": "is truncated",
        b"\xff\xd8\xff\xe0 a JPEG": "a JPEG",
    }
    for data, message in cases.items():
        path.write_bytes(data)
        with pytest.raises(FormatError, match=rf"cam0\.dng: found .*{message}"):
            read_picture(path)


def test_a_raw_is_read_black_off_and_colours_apart(small_stage, tmp_path):
    photographer = TargetPhotographer(small_stage, "flat", 1)
    path = tmp_path / "flat.dng"
    levels = np.ones(len(small_stage.lights))
    path.write_bytes(photographer.photograph(small_stage.cameras[0], levels))
    picture = read_picture(path)
    red, green, blue = picture.rgb.mean(axis=(0, 1))
    # Sensitivities 0.52, 1, 0.68 of the simulated sensor to the LEDs' white, a few per cent apart.
    assert abs(red / green - 0.52) < 0.05
    assert abs(blue / green - 0.68) < 0.05
    assert abs(green - picture.green.mean()) < 1e-3
    assert not picture.clipped.any()


def test_every_kind_has_a_look_and_its_words():
    assert tuple(KINDS) == KIND_NAMES == tuple(LOOKS)
    for kind in KINDS.values():
        assert kind.put.endswith(".")
        assert ("{camera}" in kind.put) == kind.faces
