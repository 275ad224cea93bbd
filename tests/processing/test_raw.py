"""RAW files of all kinds to linear values, upright, on one scale."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from lightstage.calibrations.picture import read_picture
from lightstage.checks.photo_measures import measure_photo
from lightstage.errors import FormatError
from lightstage.formats.flats import FlatField
from lightstage.formats.orientation import OF_TIFF
from lightstage.poses_from_photos.pictures import _read_mosaic
from lightstage.tiff import Directory
from processing.calibration.picture import read_mosaic
from processing.colour import ColourCorrection
from processing.frames.drafts import NOT_A_NUMBER
from processing.frames.window import Window, whole
from processing.raw.develop import Settings, develop, lying, store
from processing.raw.plain_dng import _strips, map_plain_dng
from processing.raw.raw_file import RawFile, open_raw, read_exposure, unpack_raw
from processing.raw.region import preview
from sim.camera.tiff import BYTE, LONG, RATIONAL, SHORT
from tests.processing.made_raw import (
    BLACK,
    RGGB,
    WHITE,
    X_TRANS,
    counts_of,
    gradient,
    write_dng,
)

PLAIN = Settings(ColourCorrection(np.eye(3)), 1.0, 0.99)


def read(
    path: Path, settings: Settings = PLAIN, window: Window | None = None
) -> tuple[np.ndarray, np.ndarray]:
    raw = open_raw(path)
    window = window or whole(raw.shape)
    out, clipped = np.zeros((*window.shape, 3), np.float16), np.zeros(window.shape, np.uint8)
    develop(raw, window, settings, None, out, clipped)
    raw.close()
    return out.astype(np.float32), clipped


def inner(picture: np.ndarray) -> np.ndarray:
    return picture[8:-8, 8:-8]


def test_a_dng_of_known_colours_is_decoded_to_them(tmp_path: Path) -> None:
    rgb = gradient()
    path = write_dng(tmp_path / "a.dng", counts_of(rgb))
    found, clipped = read(path)
    np.testing.assert_allclose(inner(found), inner(rgb), atol=3e-4)
    assert not clipped.any()
    raw = open_raw(path)
    np.testing.assert_allclose(raw.neutral, [2.0, 1.0, 1.5], rtol=1e-3)
    raw.close()
    assert read_exposure(path) == pytest.approx(100 / 60 / 64, rel=1e-4)


@pytest.mark.parametrize("mosaic", [X_TRANS, None], ids=["X-Trans", "linear DNG"])
def test_other_sensors_come_on_the_same_scale(tmp_path: Path, mosaic: np.ndarray | None) -> None:
    rgb = gradient(600, 640)
    rgb[300:320, 300:320, 0] = 1.2
    path = write_dng(tmp_path / "a.dng", counts_of(rgb, mosaic), mosaic)
    found, clipped = read(path)
    far = np.ones(rgb.shape[:2], bool)
    far[285:335, 285:335] = False
    np.testing.assert_allclose(inner(found)[inner(far)], inner(rgb)[inner(far)], atol=5e-4)
    assert (clipped[300:320, 300:320] & 1).all()
    assert not clipped[far].any()
    window = Window(101, 50, 200, 301)
    part, marks = read(path, PLAIN, window)
    np.testing.assert_array_equal(part, found[window.slices])
    np.testing.assert_array_equal(marks, clipped[window.slices])


STANDING = {
    1: lambda p: p,
    2: lambda p: p[:, ::-1],
    3: lambda p: p[::-1, ::-1],
    4: lambda p: p[::-1],
    5: lambda p: np.swapaxes(p, 0, 1),
    6: lambda p: np.swapaxes(p, 0, 1)[:, ::-1],
    7: lambda p: np.swapaxes(p, 0, 1)[::-1, ::-1],
    8: lambda p: np.swapaxes(p, 0, 1)[::-1],
}
"""Where row 0 and column 0 go by the tag Orientation: [TIFF1992]'s table, by another hand."""


@pytest.mark.parametrize("orientation", STANDING)
def test_pictures_stand_upright_however_the_camera_was_held(
    tmp_path: Path, orientation: int
) -> None:
    stand = STANDING[orientation]
    rgb = gradient()
    rgb[10, 12] = 1.1
    path = write_dng(tmp_path / "a.dng", counts_of(rgb), more={274: (SHORT, orientation)})
    found, clipped = read(path)
    raw = open_raw(path)
    assert raw.shape == stand(rgb).shape[:2]
    raw.close()
    lying_down, marks = read(write_dng(tmp_path / "b.dng", counts_of(rgb)))
    np.testing.assert_array_equal(found, stand(lying_down))
    np.testing.assert_array_equal(clipped, stand(marks))
    window = Window(7, 5, 30, 21)
    part, _ = read(path, PLAIN, window)
    np.testing.assert_array_equal(part, found[window.slices])
    unpacked = unpack_raw(path)
    assert unpacked.orientation == raw.orientation
    unpacked.close()
    ambient = np.ascontiguousarray(found[window.slices], np.float32)
    out, clipped = np.zeros((*window.shape, 3), np.float16), np.zeros(window.shape, np.uint8)
    develop(open_raw(path), window, PLAIN, ambient, out, clipped)
    assert np.abs(out).max() < 2e-3
    look, _ = preview(open_raw(path))
    few, _ = preview(open_raw(tmp_path / "b.dng"))
    np.testing.assert_array_equal(look, stand(few))
    upright_grey, lying_grey = _read_mosaic(path)[0], _read_mosaic(tmp_path / "b.dng")[0]
    np.testing.assert_array_equal(upright_grey, stand(lying_grey))
    assert measure_photo(path).size_px == raw.shape[::-1]
    mosaic, flat = read_mosaic(path), read_mosaic(tmp_path / "b.dng")
    np.testing.assert_array_equal(mosaic.level, stand(flat.level))
    np.testing.assert_array_equal(mosaic.as_read().level, flat.level)


@pytest.mark.parametrize("orientation", STANDING)
def test_a_lying_window_and_place_show_the_same_pixels(orientation: int) -> None:
    picture = np.arange(11 * 17).reshape(11, 17)
    how = OF_TIFF[orientation]
    upright = STANDING[orientation](picture)
    np.testing.assert_array_equal(how.upright(picture), upright)
    window = Window(2, 3, 5, 7)
    part = picture[lying(window, picture.shape, how).slices]
    np.testing.assert_array_equal(how.upright(part), upright[window.slices])
    height, width = upright.shape
    x, y = how.place_as_read(4.5, 2.5, width, height)
    assert picture[int(y), int(x)] == upright[2, 4]


def test_unequal_blacks_change_no_colour(tmp_path: Path) -> None:
    """A count above black is as much light in each place, whatever its black is."""
    rgb = gradient()
    offsets = np.array([[0, 40], [80, 120]])
    counts = counts_of(rgb).astype(int) + np.tile(offsets, (24, 32))
    tags = {50713: (SHORT, (2, 2)), 50714: (SHORT, tuple((BLACK + offsets).ravel()))}
    found, _ = read(write_dng(tmp_path / "a.dng", counts.astype(np.uint16), more=tags))
    even, _ = read(write_dng(tmp_path / "b.dng", counts_of(rgb)))
    ratio = inner(found) / inner(even)
    scale = (WHITE - BLACK) / (WHITE - BLACK - offsets.max())
    np.testing.assert_allclose(ratio, scale, rtol=1.5e-3)  # halves
    np.testing.assert_allclose(ratio.mean(axis=(0, 1)), scale, rtol=5e-4)
    picture, plain = read_picture(tmp_path / "a.dng"), read_picture(tmp_path / "b.dng")
    np.testing.assert_allclose(picture.rgb, plain.rgb * scale, rtol=1e-5)
    level, flat = read_mosaic(tmp_path / "a.dng").level, read_mosaic(tmp_path / "b.dng").level
    np.testing.assert_allclose(level, flat * scale, rtol=1e-5)
    look, plain_look = preview(open_raw(tmp_path / "a.dng")), preview(open_raw(tmp_path / "b.dng"))
    np.testing.assert_allclose(look[0], plain_look[0] * scale, rtol=1e-5)


def test_black_levels_of_four_places_and_margins_are_the_files_own(tmp_path: Path) -> None:
    counts = counts_of(gradient(60, 80)).astype(int)
    offsets = np.array([[0, 7], [40, 90]])
    counts += np.tile(offsets, (30, 40))
    tags = {
        50713: (SHORT, (2, 2)),
        50714: (SHORT, tuple((BLACK + offsets).ravel())),
        50829: (LONG, (4, 6, 56, 78)),
    }
    raw = open_raw(write_dng(tmp_path / "a.dng", counts.astype(np.uint16), more=tags))
    assert raw.origin == (4, 6)
    assert raw.size == (52, 72)
    np.testing.assert_array_equal(raw.black, BLACK + offsets)
    raw.close()
    found, _ = read(tmp_path / "a.dng")
    exact = gradient(60, 80)[4:56, 6:78]
    share = (WHITE - BLACK) / (WHITE - BLACK - offsets.max())
    np.testing.assert_allclose(inner(found), inner(exact) * share, atol=3e-4)


def test_flats_black_offsets_and_hot_pixels_are_undone(tmp_path: Path) -> None:
    field = FlatField(
        (96, 64),
        np.array([48.0, 32.0]),
        float(np.hypot(96, 64) / 2),
        np.array([-0.3, 0.05, 0.0]),
        black_offset=np.array([0.01, 0.0, 0.02, 0.03]),
        hot_pixels=np.array([[20, 31], [20, 33], [18, 31], [22, 31], [0, 0], [63, 95]]),
    )
    rgb = np.full((64, 96, 3), 0.4) / field.gain((64, 96))[..., None]
    counts = counts_of(rgb).astype(float)
    raised = np.tile(field.black_offset.reshape(2, 2), (32, 48))
    counts = np.rint(counts + raised * (WHITE - BLACK)).astype(np.uint16)
    counts[tuple(field.hot_pixels.T)] = 15000
    path = write_dng(tmp_path / "a.dng", counts)
    for window in (whole((64, 96)), Window(11, 23, 40, 50)):
        found, clipped = read(path, Settings(ColourCorrection(np.eye(3)), 1.0, 0.99, field), window)
        np.testing.assert_allclose(found, 0.4, atol=6e-3)  # hot corners: their neighbours' light
        assert not clipped.any()


def test_root_polynomials_are_applied(tmp_path: Path) -> None:
    rgb = gradient()
    bent = np.concatenate([np.eye(3), 0.2 * np.ones((3, 3))], axis=1)
    correction = ColourCorrection(np.eye(3), bent)
    path = write_dng(tmp_path / "a.dng", counts_of(rgb))
    found, _ = read(path, Settings(correction, 2.0, 0.99))
    np.testing.assert_allclose(inner(found), inner(2 * correction.apply(rgb)), atol=3e-3)


@pytest.mark.parametrize("share", [0.2, 0.9, 0.999])
def test_a_truncated_dng_is_refused_with_its_name(tmp_path: Path, share: float) -> None:
    path = write_dng(tmp_path / "cut.dng", counts_of(gradient()))
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    with pytest.raises(FormatError, match=r"cut\.dng"):
        open_raw(path)
    with pytest.raises(FormatError, match=r"gone\.dng"):
        open_raw(tmp_path / "gone.dng")


@pytest.mark.parametrize("compression", [9, 52546], ids=["GPR's", "JPEG XL"])
def test_what_libraw_does_not_know_is_not_called_damaged(tmp_path: Path, compression: int) -> None:
    """GoPro's VC-5 [compression 9] and JPEG XL: a DNG by its header, which LibRaw cannot unpack."""
    tags = {259: (SHORT, compression)}
    path = write_dng(tmp_path / "a.gpr", counts_of(gradient()), more=tags)
    for read_it in (open_raw, measure_photo, _read_mosaic, read_mosaic, read_picture):
        with pytest.raises(FormatError, match=r"a\.gpr.*does not know.*Convert it to DNG"):
            read_it(path)
    (tmp_path / "b.gpr").write_bytes(b"Dear diary, " * 9)
    (tmp_path / "c.gpr").write_bytes(path.read_bytes()[:-400])
    for read_it in (open_raw, measure_photo, _read_mosaic, read_mosaic, read_picture):
        with pytest.raises(FormatError, match=r"b\.gpr.*This is no photograph"):
            read_it(tmp_path / "b.gpr")
        with pytest.raises(FormatError, match=r"c\.gpr.*is truncated"):
            read_it(tmp_path / "c.gpr")


def test_sensors_without_red_green_and_blue_are_refused(tmp_path: Path) -> None:
    grey = write_dng(tmp_path / "grey.dng", counts_of(gradient()), more={262: (SHORT, 34892)})
    with pytest.raises(FormatError, match=r"grey\.dng.*expected"):
        open_raw(grey)
    odd = write_dng(tmp_path / "odd.dng", counts_of(gradient()), more={33422: (BYTE, (0, 1, 0, 2))})
    with pytest.raises(FormatError, match=r"odd\.dng"):
        open_raw(odd)


def test_a_file_that_states_no_exposure_reports_it(tmp_path: Path) -> None:
    path = write_dng(tmp_path / "a.dng", counts_of(gradient()), exposure=None)
    assert read_exposure(path) is None


@pytest.mark.parametrize("wild", [np.nan, np.inf, -np.inf, 1e6])
def test_what_no_half_float_holds_is_marked_and_zero(wild: float) -> None:
    rgb = np.full((3, 4, 3), 0.5, np.float32)
    rgb[1, 2, 0] = wild
    out, clipped = np.ones((3, 4, 3), np.float16), np.zeros((3, 4), np.uint8)
    store(rgb, None, out, clipped)
    assert np.isfinite(out).all()
    assert out[1, 2, 0] == 0
    assert clipped[1, 2] == NOT_A_NUMBER
    assert clipped.sum() == NOT_A_NUMBER


def test_patterns_of_the_mosaic_follow_the_file(tmp_path: Path) -> None:
    rgb = gradient()
    for turned in (RGGB, RGGB[:, ::-1], RGGB[::-1], RGGB[::-1, ::-1]):
        found, _ = read(write_dng(tmp_path / "a.dng", counts_of(rgb, turned), turned))
        np.testing.assert_allclose(inner(found), inner(rgb), atol=3e-4)


def _same(one: RawFile, other: RawFile) -> None:
    np.testing.assert_array_equal(one.counts, other.counts)
    for name in ("origin", "size", "white", "orientation"):
        assert getattr(one, name) == getattr(other, name), name
    assert one.colours is not None
    assert other.colours is not None
    np.testing.assert_array_equal(one.colours, other.colours)
    np.testing.assert_array_equal(one.black, other.black)
    np.testing.assert_allclose(one.neutral, other.neutral, rtol=1e-5)


PLAIN_TAGS: list[dict[int, tuple[int, object]]] = [
    {},
    {274: (SHORT, 6)},
    {274: (SHORT, 8)},
    {274: (SHORT, 3)},
    {274: (SHORT, 2)},
    {274: (SHORT, 5)},
    {50713: (SHORT, (2, 2)), 50714: (SHORT, (600, 607, 640, 690))},
    {33422: (BYTE, (1, 0, 2, 1))},
    {33422: (BYTE, (2, 1, 1, 0)), 50717: (LONG, 12345)},
]


@pytest.mark.parametrize("more", PLAIN_TAGS)
def test_mapped_files_are_what_libraw_unpacks(
    tmp_path: Path, more: dict[int, tuple[int, object]]
) -> None:
    path = write_dng(tmp_path / "a.dng", counts_of(gradient()), more=more)
    mapped, unpacked = open_raw(path), unpack_raw(path)
    assert isinstance(mapped.counts, np.memmap)
    _same(mapped, unpacked)
    mapped.counts[0, 0] = 7  # a hot pixel that is mended changes no file
    mapped.close()
    unpacked.close()
    again = unpack_raw(path)
    assert again.counts[0, 0] != 7
    again.close()


NOT_PLAIN: list[dict[int, tuple[int, object]]] = [
    {50712: (SHORT, tuple(range(65536)))},  # a curve
    {50829: (LONG, (4, 6, 40, 60))},  # margins
    {258: (SHORT, 12)},
    {50714: (RATIONAL, 600.5)},
    {50715: (RATIONAL, (1.0,) * 64)},  # black that changes along rows
    {51009: (BYTE, (0, 0, 0, 0))},  # corrections to be made
    {50717: (LONG, 100)},
]


@pytest.mark.parametrize("more", NOT_PLAIN)
def test_files_that_say_more_of_their_counts_are_left_to_libraw(
    tmp_path: Path, more: dict[int, tuple[int, object]]
) -> None:
    path = write_dng(tmp_path / "a.dng", counts_of(gradient()), more=more)
    assert map_plain_dng(path) is None


def test_strips_in_a_row_are_one_piece_and_others_are_not(tmp_path: Path) -> None:
    counts = counts_of(gradient())
    path = write_dng(tmp_path / "a.dng", counts)
    whole = map_plain_dng(path)
    assert whole is not None
    begin = path.stat().st_size - counts.nbytes
    half = counts.nbytes // 2
    beside = {273: (begin, begin + half), 279: (half, half)}
    assert _strips(Directory("picture", dict(beside), {}), 2 * half) == begin
    apart = {273: (begin, begin + half + 2), 279: (half, half)}
    assert _strips(Directory("picture", dict(apart), {}), 2 * half) is None


@example(place=197, byte=3)
@given(place=st.integers(8, 400), byte=st.integers(0, 255))
@settings(max_examples=60, deadline=None)
def test_a_damaged_header_is_refused_or_read_as_libraw_reads_it(place: int, byte: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = write_dng(Path(folder) / "a.dng", counts_of(gradient()))
        data = bytearray(path.read_bytes())
        data[place] = byte
        path.write_bytes(data)
        try:
            opened = open_raw(path)
        except FormatError:
            return
        assert opened.counts.ndim in (2, 3)
        opened.close()
