"""Pictures of light from everywhere: one reader for the stage, the renderer and the simulator."""

import cv2
import numpy as np
import pytest

from learning.relight import read_light
from lightstage.errors import ConfigError, FormatError
from lightstage.formats.exr import write_exr
from lightstage.formats.panorama import read_panorama


@pytest.fixture
def light():
    return np.random.default_rng(0).uniform(0.1, 4.0, (8, 16, 3)).astype(np.float32)


def test_a_radiance_picture_is_the_same_light_as_an_exr(tmp_path, light):
    write_exr(tmp_path / "a.exr", light, half=False)
    cv2.imwrite(str(tmp_path / "a.hdr"), light[:, :, ::-1])
    exr, hdr = read_panorama(tmp_path / "a.exr"), read_panorama(tmp_path / "a.hdr")
    assert exr.dtype == hdr.dtype == np.float64
    np.testing.assert_allclose(exr, light)
    # RGBE holds eight bits beside a pixel's largest channel.
    np.testing.assert_allclose(hdr, light, atol=light.max() / 128)


def test_an_exposure_in_the_header_is_undone_and_a_wrong_one_refused(tmp_path, light):
    path = tmp_path / "room.hdr"
    cv2.imwrite(str(path), np.ascontiguousarray(light[..., ::-1]))
    plain, data = read_panorama(path), path.read_bytes()

    def with_line(line: bytes) -> np.ndarray:
        first, _, rest = data.partition(b"\n")
        path.write_bytes(first + b"\n" + line + b"\n" + rest)
        return read_panorama(path)

    np.testing.assert_allclose(with_line(b"EXPOSURE=8.0"), plain / 8, rtol=1e-6)
    np.testing.assert_allclose(with_line(b"EXPOSURE= 2\nEXPOSURE=4"), plain / 8, rtol=1e-6)
    corrected = with_line(b"COLORCORR= 1 2 4")
    np.testing.assert_allclose(corrected, plain / np.array([1, 2, 4]), rtol=1e-6)
    for wrong in (b"EXPOSURE=0", b"EXPOSURE=bright", b"COLORCORR=1 2"):
        with pytest.raises(FormatError, match="EXPOSURE, COLORCORR"):
            with_line(wrong)


def test_a_head_is_lit_by_either_alike(tmp_path, light):
    write_exr(tmp_path / "a.exr", light, half=False)
    cv2.imwrite(str(tmp_path / "a.hdr"), light[:, :, ::-1])
    exr, hdr = read_light(tmp_path / "a.exr", 8), read_light(tmp_path / "a.hdr", 8)
    np.testing.assert_allclose(exr.rgb.sum(axis=0), hdr.rgb.sum(axis=0), rtol=0.01)


@pytest.mark.parametrize("angle_deg", [np.nan, np.inf, -np.inf])
def test_a_turn_that_is_no_angle_is_refused(tmp_path, light, angle_deg):
    write_exr(tmp_path / "a.exr", light)
    with pytest.raises(ConfigError, match="--rotate"):
        read_light(tmp_path / "a.exr", 8, angle_deg)


@pytest.mark.parametrize("suffix", [".exr", ".hdr"])
def test_broken_and_missing_pictures_are_refused_in_one_message(tmp_path, suffix, capfd):
    path = tmp_path / f"a{suffix}"
    with pytest.raises(FormatError, match="no such file"):
        read_panorama(path)
    cut = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 32 +X 64\n"
    for damaged in (b"#?RADIANCE\nbroken", cut):
        path.write_bytes(damaged)
        with pytest.raises(FormatError, match=str(path)):
            read_panorama(path)
    # Nothing is printed beside the error, by OpenCV either.
    assert capfd.readouterr() == ("", "")


def test_a_value_that_is_no_light_is_named_with_its_place(tmp_path, light):
    for value, found in (
        (np.nan, "NaN or infinite"),
        (np.inf, "NaN or infinite"),
        (-1, "negative"),
    ):
        light[2, 5, 2] = value
        write_exr(tmp_path / "a.exr", light, half=False)
        with pytest.raises(FormatError, match=f"row 2, column 5, B: found 1 {found} value"):
            read_panorama(tmp_path / "a.exr")
