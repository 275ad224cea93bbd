"""OpenEXR maps: exact round trips, and NaN or damage refused."""

import contextlib
import os

import numpy as np
import OpenEXR
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from lightstage.errors import FormatError
from lightstage.formats.exr import read_exr, read_half_exr, require_finite, write_exr


@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 3), (1, 1), (1, 9, 3)])
@pytest.mark.parametrize("half", [True, False])
def test_a_picture_survives_its_file(tmp_path, shape, half):
    image = np.random.default_rng(0).uniform(-2, 900, shape)
    read = read_exr(write_exr(tmp_path / "a.exr", image, half=half))
    assert read.dtype == np.float32
    assert np.array_equal(read, image.astype(np.float16 if half else np.float32))


def test_one_channel_may_come_with_its_axis(tmp_path):
    image = np.arange(6.0).reshape(2, 3, 1)
    assert np.array_equal(read_exr(write_exr(tmp_path / "a.exr", image)), image[:, :, 0])


def test_channels_have_the_names_that_other_programs_expect(tmp_path):
    image = np.random.default_rng(1).uniform(0, 1, (4, 6, 3)).astype(np.float32)
    path = write_exr(tmp_path / "a.exr", image, half=False)
    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = file.channels()
        assert sorted(channels) == ["B", "G", "R"]
        assert np.array_equal(channels["G"].pixels, image[:, :, 1])


@given(arrays(np.float32, (3, 4), elements=st.floats(-1e6, 1e6, width=32)))
def test_float_maps_are_exact_at_every_scale(tmp_path_factory, image):
    path = tmp_path_factory.mktemp("exr") / "a.exr"
    assert np.array_equal(read_exr(write_exr(path, image, half=False)), image)


@pytest.mark.parametrize("shape", [(3,), (2, 2, 2), (2, 2, 4), (0, 3), (1, 2, 3, 4)])
def test_other_shapes_are_refused(tmp_path, shape):
    with pytest.raises(FormatError, match="shape"):
        write_exr(tmp_path / "a.exr", np.ones(shape))
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("value", [65536.0, -1e6, np.inf, np.float16(-np.inf)])
def test_values_beyond_half_are_refused(tmp_path, value):
    with pytest.raises(FormatError, match="65504"):
        write_exr(tmp_path / "a.exr", np.full((2, 2), value))
    assert os.listdir(tmp_path) == []


def test_half_floats_are_written_as_they_are(tmp_path):
    every = np.arange(1 << 16, dtype=np.uint16)
    known = every[(every & 0x7FFF) <= 0x7BFF]
    image = known.view(np.float16).reshape(-1, 31)
    for same in (image, image.astype(np.float32), image[::-1][::-1]):
        path = write_exr(tmp_path / "a.exr", same)
        assert np.array_equal(read_half_exr(path).view(np.uint16).ravel(), known)
    wide = write_exr(tmp_path / "wide.exr", image, half=False)
    assert np.array_equal(read_exr(wide), image.astype(np.float32))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_texture_with_nan_or_infinity_is_refused_and_its_place_named(tmp_path, bad):
    image = np.ones((4, 5, 3), np.float32)
    image[2, 3, 1] = bad
    path = write_exr(tmp_path / "texture.exr", image, half=False)
    with pytest.raises(
        FormatError, match=r"texture.exr, element \(2, 3, 1\): found 1 NaN or infinite value"
    ):
        read_exr(path, finite=True)
    assert read_exr(path).shape == (4, 5, 3)


def test_a_missing_empty_or_foreign_file_is_refused(tmp_path):
    with pytest.raises(FormatError, match="no such file"):
        read_exr(tmp_path / "none.exr")
    for data in (b"", b"\x89PNG\r\n\x1a\n" * 9):
        (tmp_path / "a.exr").write_bytes(data)
        with pytest.raises(FormatError, match="found something else, expected an OpenEXR picture"):
            read_exr(tmp_path / "a.exr")


KINDS = ["NO", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "B44", "DWAA", "DWAB"]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("order", ["INCREASING_Y", "DECREASING_Y"])
def test_files_of_other_programs_are_read_whole_and_refused_cut(tmp_path, kind, order, capfd):
    pixels = np.random.default_rng(0).uniform(0, 1, (300, 20, 3)).astype(np.float32)
    header = {
        "compression": getattr(OpenEXR, f"{kind}_COMPRESSION"),
        "type": OpenEXR.scanlineimage,
        "lineOrder": getattr(OpenEXR, order),
        "dataWindow": (np.array([4, -7], np.int32), np.array([23, 292], np.int32)),
    }
    path = tmp_path / "a.exr"
    with OpenEXR.File(header, {"RGB": pixels}) as file:
        file.write(str(path))
    assert np.abs(read_exr(path) - pixels).mean() < 0.02
    data = path.read_bytes()
    for share in (0.0, 0.001, 0.02, 0.3, 0.7, 0.99):
        path.write_bytes(data[: max(4, int(share * len(data)))])
        with pytest.raises(FormatError, match=r"a.exr: found an OpenEXR picture that ends after"):
            read_exr(path)
    path.write_bytes(data[:-1])
    with pytest.raises(FormatError, match="expected all of its lines"):
        read_exr(path)
    assert capfd.readouterr() == ("", "")


def test_a_window_of_a_picture_is_where_the_picture_has_it(tmp_path):
    whole = np.zeros((64, 128, 3), np.float32)
    whole[16:48, 32:96] = np.random.default_rng(0).uniform(0, 1, (32, 64, 3))
    wide = np.pad(whole, ((4, 4), (6, 6), (0, 0)), constant_values=7.0)  # beyond the picture
    display = (np.array([0, 0], np.int32), np.array([127, 63], np.int32))
    for pixels, first in ((whole[16:48, 32:96], (32, 16)), (wide, (-6, -4))):
        last = (first[0] + pixels.shape[1] - 1, first[1] + pixels.shape[0] - 1)
        window = (np.array(first, np.int32), np.array(last, np.int32))
        header = {"type": OpenEXR.scanlineimage, "dataWindow": window, "displayWindow": display}
        path = tmp_path / "window.exr"
        with OpenEXR.File(header, {"RGB": np.ascontiguousarray(pixels)}) as file:
            file.write(str(path))
        np.testing.assert_array_equal(read_exr(path), whole)


def test_luminance_and_chroma_are_refused(tmp_path):
    path = tmp_path / "yc.exr"
    grey = np.ones((8, 8), np.float32)
    with OpenEXR.File({"type": OpenEXR.scanlineimage}, {"Y": grey, "RY": grey, "BY": grey}) as file:
        file.write(str(path))
    with pytest.raises(FormatError, match="luminance and chroma"):
        read_exr(path)


def write_parts(path, *parts):
    """A file of parts, each its name and its pixels by channel."""
    header = {"type": OpenEXR.scanlineimage}
    with OpenEXR.File([OpenEXR.Part(dict(header), dict(c), name) for name, c in parts]) as file:
        file.write(str(path))
    return path


def test_the_part_with_the_colours_is_read_wherever_it_is(tmp_path):
    rgb = np.random.default_rng(0).uniform(0, 1, (4, 6, 3)).astype(np.float32)
    grey = np.ones((4, 6), np.float32)
    beauty, depth, mask = ("beauty", {"RGB": rgb}), ("depth", {"Z": grey}), ("mask", {"Y": grey})
    for parts in ([depth, beauty], [mask, beauty], [beauty, mask]):
        np.testing.assert_array_equal(read_exr(write_parts(tmp_path / "a.exr", *parts)), rgb)
    assert read_exr(write_parts(tmp_path / "a.exr", depth, mask)).shape == (4, 6)


@pytest.mark.parametrize("channel", ["RGB", "Y"])
def test_several_parts_that_may_be_the_picture_are_refused_by_name(tmp_path, channel):
    pixels = {channel: np.ones((4, 6, 3) if channel == "RGB" else (4, 6), np.float32)}
    path = write_parts(tmp_path / "a.exr", ("normal", pixels), ("beauty", pixels))
    with pytest.raises(FormatError, match=r"2 parts that hold .*'normal', 'beauty'"):
        read_exr(path)


def test_deep_pixels_and_channels_of_unlike_types_are_refused(tmp_path):
    deep = np.empty((2, 2), object)
    for place in np.ndindex(2, 2):
        deep[place] = np.ones(2, np.float32)
    header = {"type": OpenEXR.deepscanline, "compression": OpenEXR.ZIPS_COMPRESSION}
    path = tmp_path / "a.exr"
    with OpenEXR.File(header, dict.fromkeys("RGB", deep)) as file:
        file.write(str(path))
    with pytest.raises(FormatError, match="deep pixels"):
        read_exr(path)
    wide, half = np.ones((4, 6), np.float32), np.ones((4, 6), np.float16)
    write_parts(path, ("", {"R": wide, "G": wide, "B": half}))
    with pytest.raises(FormatError, match="all of them in half floats"):
        read_exr(path)


@given(st.integers(0, 400), st.integers(0, 255))
def test_a_damaged_header_is_read_or_refused(tmp_path_factory, place, byte):
    path = write_exr(tmp_path_factory.mktemp("exr") / "a.exr", np.ones((40, 6, 3)))
    data = bytearray(path.read_bytes())
    data[min(place, len(data) - 1)] = byte
    path.write_bytes(data)
    with contextlib.suppress(FormatError):
        read_exr(path)


def test_other_channels_are_refused(tmp_path):
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {"Z": np.ones((2, 2), np.float32)}) as file:
        file.write(str(tmp_path / "a.exr"))
    with pytest.raises(FormatError, match=r"channels Z, expected R G B or Y"):
        read_exr(tmp_path / "a.exr")


@pytest.mark.parametrize(
    ("names", "found"),
    [
        ("XYZ", "channels X Y Z, expected"),  # it was read as Y alone
        ("rgb", "channels b g r, expected R G B or Y, by these names. Rename"),
        (("beauty.R", "beauty.G", "beauty.B"), "channels beauty.B beauty.G beauty.R, expected"),
    ],
)
def test_channels_of_other_names_are_refused_by_the_names_that_the_file_has(tmp_path, names, found):
    grey = np.ones((4, 6), np.float32)
    path = write_parts(tmp_path / "a.exr", ("", dict.fromkeys(names, grey)))
    with pytest.raises(FormatError, match=found):
        read_exr(path)


def test_finite_arrays_pass():
    require_finite(np.zeros((2, 2)), "x")


def test_half_floats_are_read_as_they_are_stored_and_wider_numbers_rounded(tmp_path):
    image = np.random.default_rng(0).normal(size=(20, 31, 3)).astype(np.float32)
    for half in (True, False):
        path = write_exr(tmp_path / f"{half}.exr", image, half=half)
        found = read_half_exr(path)
        assert found.dtype == np.float16
        assert found.flags.c_contiguous
        assert np.array_equal(found, image.astype(np.float16))
    flat = write_exr(tmp_path / "flat.exr", image[..., 0])
    assert read_half_exr(flat).shape == (20, 31)


@pytest.mark.parametrize("wrong", [np.nan, np.inf, 1e6])
def test_half_floats_that_are_not_finite_are_refused(tmp_path, wrong):
    image = np.ones((4, 5), np.float32)
    image[2, 3] = wrong
    path = write_exr(tmp_path / "wide.exr", image, half=False)
    with pytest.raises(FormatError, match=r"wide\.exr"):
        read_half_exr(path)
    if wrong != 1e6:
        # Written by another program: ours writes no half picture with infinities.
        stored = {"Y": image.astype(np.float16)}
        with OpenEXR.File({"type": OpenEXR.scanlineimage}, stored) as file:
            file.write(str(tmp_path / "half.exr"))
        with pytest.raises(FormatError, match=r"element \(2, 3\)"):
            read_half_exr(tmp_path / "half.exr")
