"""JPEG, PNG and TIFF become linear light, or are refused with what is wrong."""

from __future__ import annotations

import io
import struct
import zlib

import cv2
import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage import opening
from lightstage.checks import check_session
from lightstage.developed import developed_kind, read_developed
from lightstage.errors import FormatError
from lightstage.formats.exr import read_exr
from lightstage.formats.icc import read_profile
from lightstage.formats.session import load_session
from lightstage.importing import find_photographs, import_session, named_cameras
from lightstage.opening import open_photograph
from lightstage.patterns import pattern_levels
from processing.decode.config import DecodeConfig
from processing.decode.stage import decode

ADOBE = ((0.60974, 0.31111, 0.01947), (0.20528, 0.62567, 0.06087), (0.14919, 0.06322, 0.74457))
"""Adobe RGB's colorants under D50, as its profile has them."""
SRGB = ((0.4360747, 0.2225045, 0.0139322), (0.3850649, 0.7168786, 0.0971045))
SRGB += ((0.1430804, 0.0606169, 0.7141733),)


def fixed(*numbers):
    return struct.pack(f">{len(numbers)}i", *(round(n * 65536) for n in numbers))


def icc(colorants=ADOBE, curve=None, space=b"RGB ", leave_out=()):
    """A profile of colorants and one curve, by another hand than the reader's."""
    if curve is None:
        curve = b"curv" + struct.pack(">IIH", 0, 1, round(2.19921875 * 256))
    tags = {b"rXYZ": colorants[0], b"gXYZ": colorants[1], b"bXYZ": colorants[2]}
    parts = {name: b"XYZ \0\0\0\0" + fixed(*value) for name, value in tags.items()}
    parts |= dict.fromkeys((b"rTRC", b"gTRC", b"bTRC"), curve)
    parts[b"desc"] = b"desc\0\0\0\0" + struct.pack(">I", 10) + b"Made here\0"
    parts = {name: part for name, part in parts.items() if name not in leave_out}
    table, data, place = b"", b"", 132 + 12 * len(parts)
    for name, part in parts.items():
        padded = part + bytes(-len(part) % 4)
        table += struct.pack(">4sII", name, place + len(data), len(part))
        data += padded
    head = bytes(16) + space + b"XYZ " + bytes(12) + b"acsp" + bytes(88)
    body = head + struct.pack(">I", len(parts)) + table + data
    return struct.pack(">I", len(body)) + body[4:]


def png(codes, profile=None, **more):
    data = cv2.imencode(".png", np.ascontiguousarray(codes[..., ::-1]))[1].tobytes()
    chunks = dict(more)
    if profile is not None:
        chunks["iCCP"] = b"made\0\0" + zlib.compress(profile)
    for kind, body in chunks.items():
        named = kind.encode() + body
        chunk = struct.pack(">I", len(body)) + named + struct.pack(">I", zlib.crc32(named))
        data = data[:33] + chunk + data[33:]
    return data


def exif(orientation=1, seconds=(1, 60)):
    """An EXIF block: orientation, and an EXIF directory of exposure, ISO and f-number."""
    first = struct.pack("<H", 2) + struct.pack("<HHIHH", 274, 3, 1, orientation, 0)
    first += struct.pack("<HHII", 34665, 4, 1, 38) + struct.pack("<I", 0)
    inner = struct.pack("<H", 3) + struct.pack("<HHII", 33434, 5, 1, 80)
    inner += struct.pack("<HHII", 33437, 5, 1, 88) + struct.pack("<HHIHH", 34855, 3, 1, 100, 0)
    inner += struct.pack("<I", 0)
    return b"II*\0\x08\0\0\0" + first + inner + struct.pack("<4I", *seconds, 8, 1)


def jpeg(codes, orientation=1, seconds=(1, 60), profile=None):
    wanted = [cv2.IMWRITE_JPEG_QUALITY, 100, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, 0x111111]
    data = cv2.imencode(".jpg", np.ascontiguousarray(codes[..., ::-1]), wanted)[1].tobytes()
    body = b"Exif\0\0" + exif(orientation, seconds)
    data = data[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + data[2:]
    if profile is not None:
        body = b"ICC_PROFILE\0\x01\x01" + profile
        data = data[:2] + b"\xff\xe2" + struct.pack(">H", len(body) + 2) + body + data[2:]
    return data


def tiff(codes, profile=None, orientation=1, **more):
    file = io.BytesIO()
    tags = [(274, 3, 1, orientation, True)]
    if profile is not None:
        tags.append((34675, 7, len(profile), profile, True))
    how = {"photometric": "rgb"} | more
    tifffile.imwrite(file, codes, metadata=None, extratags=tags, **how)
    return file.getvalue()


def read(tmp_path, data, name="a.jpg"):
    (tmp_path / name).write_bytes(data)
    return read_developed(tmp_path / name)


def ramp(dtype=np.uint8, height=16, width=24):
    most = np.iinfo(dtype).max
    x, y = np.meshgrid(np.linspace(0.1, 0.9, width), np.linspace(0.2, 0.8, height))
    return np.rint(np.stack([x, y, 0.5 + 0 * x], axis=-1) * most).astype(dtype)


def plain_srgb(value):
    """[IEC61966] in float64, number by number."""
    return np.vectorize(lambda v: v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4)(
        value
    )


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("write", [png, tiff])
def test_without_a_profile_values_are_srgb_in_all_their_bits(tmp_path, dtype, write):
    codes = ramp(dtype)
    found = read(tmp_path, write(codes))
    assert (found.bits, found.has_profile, found.profile) == (8 * codes.itemsize, False, "sRGB")
    expected = plain_srgb(codes / np.iinfo(dtype).max)
    np.testing.assert_allclose(found.rgb, expected, atol=1e-6)
    assert found.clipped == 0


@pytest.mark.parametrize("kind", ["png", "tiff", "jpeg"])
def test_a_profile_states_what_values_mean(tmp_path, kind):
    codes = ramp()
    write = {"png": png, "tiff": tiff, "jpeg": jpeg}[kind]
    found = read(tmp_path, write(codes, profile=icc()))
    assert (found.has_profile, found.profile) == (True, "Made here")
    light = (codes / 255.0) ** 2.19921875
    expected = light @ np.array(ADOBE) @ np.linalg.inv(np.array(SRGB))
    np.testing.assert_allclose(found.rgb, expected, atol=0.03 if kind == "jpeg" else 1e-3)
    assert np.abs(found.rgb - plain_srgb(codes / 255.0)).max() > 0.05


def test_what_cameras_keep_beside_a_jpegs_profile_is_no_part_of_it(tmp_path):
    codes, profile = ramp(), icc()
    plain, described = jpeg(codes), jpeg(codes, profile=profile)

    def with_parts(*parts):
        body = b"".join(b"\xff\xe2" + struct.pack(">H", len(part) + 2) + part for part in parts)
        return plain[:2] + body + plain[2:]

    more = b"MPF\0II*\0" + bytes(80)
    first, second = (
        b"ICC_PROFILE\0" + bytes([number, 2]) + half
        for number, half in ((1, profile[:100]), (2, profile[100:]))
    )
    assert not read(tmp_path, with_parts(more)).has_profile
    expected = read(tmp_path, described).rgb
    found = read(tmp_path, with_parts(more, second, first, more)).rgb
    np.testing.assert_array_equal(found, expected)


def test_curves_of_all_kinds_are_read():
    x = np.linspace(0, 1, 65536)
    srgb = plain_srgb(x)
    table = np.rint(plain_srgb(np.linspace(0, 1, 1024)) * 65535).astype(">u2").tobytes()
    numbers = fixed(2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)
    curves = {
        b"curv" + struct.pack(">II", 0, 0): x,
        b"curv" + struct.pack(">II", 0, 1024) + table: srgb,
        b"para" + struct.pack(">IHH", 0, 3, 0) + numbers: srgb,
        b"para" + struct.pack(">IHH", 0, 4, 0) + numbers + fixed(0, 0): srgb,
        b"para" + struct.pack(">IHH", 0, 0, 0) + fixed(1.8): x**1.8,
    }
    for curve, expected in curves.items():
        profile = read_profile(icc(SRGB, curve), "x")
        np.testing.assert_allclose(profile.curves[0], expected, atol=2e-5)
        np.testing.assert_array_equal(profile.matrix, np.eye(3))


@pytest.mark.parametrize(
    ("profile", "message"),
    [
        (icc(space=b"CMYK"), "one of CMYK colours"),
        (icc(leave_out=(b"rTRC",)), "without curves and a matrix"),
        (icc()[:-40], "damaged"),
        (b"\0" * 200, "damaged"),
        (icc(colorants=((0, 0, 0),) * 3), "cannot be"),
    ],
)
def test_a_profile_that_cannot_be_used_is_one_message(tmp_path, profile, message):
    with pytest.raises(FormatError, match=f"ICC profile: found .*{message}"):
        read(tmp_path, tiff(ramp(), profile))


@pytest.mark.parametrize("kind", ["png", "tiff", "jpeg"])
@pytest.mark.parametrize(
    ("profile", "message"),
    [(b"abc", "damaged"), (icc()[:120], "damaged"), (icc(leave_out=(b"rTRC",)), "without curves")],
)
def test_a_profile_that_a_decoder_leaves_out_is_not_taken_for_srgb(
    tmp_path, capfd, kind, profile, message
):
    write = {"png": png, "tiff": tiff, "jpeg": jpeg}[kind]
    with pytest.raises(FormatError, match=f"ICC profile: found .*{message}"):
        read(tmp_path, write(ramp(), profile=profile))
    assert capfd.readouterr() == ("", "")  # libpng prints by itself


def test_a_pngs_profile_that_is_damaged_when_unpacked_is_refused(tmp_path):
    body = b"made\0\0" + zlib.compress(icc())[:-30]
    packed = b"made\0\0" + b"no zlib"
    for chunk, found in ((body, "damaged"), (packed, "damaged one of 0 bytes")):
        with pytest.raises(FormatError, match=f"ICC profile: found a {found}"):
            read(tmp_path, png(ramp(), iCCP=chunk))


@given(place=st.integers(128, 480), byte=st.integers(0, 255))
@settings(max_examples=150, deadline=None)
def test_a_damaged_profile_is_refused_or_finite(place, byte):
    data = bytearray(icc())
    data[min(place, len(data) - 1)] = byte
    try:
        found = read_profile(bytes(data), "x")
    except FormatError:
        return
    assert np.isfinite(found.linear(ramp())).all()


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("write", [jpeg, tiff])
def test_pictures_stand_upright(tmp_path, orientation, write):
    codes = np.zeros((16, 24, 3), np.uint8)
    codes[2:6, 3:11] = 200
    found = read(tmp_path, write(codes, orientation=orientation)).rgb[..., 1] > 0.3
    mark = codes[..., 1] > 0
    if orientation > 4:
        mark = mark.T
    rows = orientation in (3, 4, 7, 8)
    columns = orientation in (2, 3, 6, 7)
    mark = mark[::-1] if rows else mark
    mark = mark[:, ::-1] if columns else mark
    np.testing.assert_array_equal(found, mark)


def cmyk_jpeg():
    data = bytearray(jpeg(ramp()))
    data[data.index(b"\xff\xc0") + 9] = 4
    return bytes(data)


def with_alpha(codes, alpha):
    return np.dstack([codes, np.full(codes.shape[:2], alpha, codes.dtype)])


def rgba_png(codes, alpha):
    return cv2.imencode(".png", with_alpha(codes, alpha))[1].tobytes()


BAD = {
    "transparent PNG": (rgba_png(ramp(), 254), "transparent in 1e.02 %|transparent in 100 %"),
    "transparent TIFF": (
        tiff(with_alpha(ramp(np.uint16), 9), extrasamples=["unassalpha"]),
        "transparent in",
    ),
    "CMYK JPEG": (cmyk_jpeg(), "a JPEG in CMYK"),
    "CMYK TIFF": (tiff(with_alpha(ramp(), 3), photometric="separated"), "a TIFF in CMYK"),
    "grey JPEG": (cv2.imencode(".jpg", ramp()[..., 0])[1].tobytes(), "a grey JPEG"),
    "grey PNG": (cv2.imencode(".png", ramp()[..., 0])[1].tobytes(), "a grey PNG"),
    "palette": (
        tiff(ramp()[..., 0], photometric="palette", colormap=np.zeros((3, 256), np.uint16)),
        "of a palette.*Export it as RGB",
    ),
    "white at 0": (tiff(ramp()[..., 0], photometric="miniswhite"), "grey, with white at 0"),
    "grey TIFF": (tiff(ramp()[..., 0], photometric="minisblack"), "a TIFF that is grey"),
    "floats": (tiff(ramp().astype(np.float32)), "32 bit floats.*OpenEXR"),
    "1 x 1 px": (png(ramp()[:1, :1]), "1 x 1 pixels"),
    "cut JPEG": (jpeg(ramp())[:-100], "damaged|whole"),
    "cut PNG": (png(ramp())[:-60], "damaged"),
    "cut TIFF": (tiff(ramp())[:-60], "truncated|damaged"),
    "head alone": (b"\xff\xd8\xff\xe0", "damaged"),
    "linear PNG": (png(ramp(), gAMA=struct.pack(">I", 100000)), "gamma 1 without an ICC"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_does_not_tell_light_is_one_message(tmp_path, name):
    data, message = BAD[name]
    (tmp_path / "a.jpg").write_bytes(data)
    with pytest.raises(FormatError, match=rf"a\.jpg: .*({message})"):
        open_photograph(tmp_path / "a.jpg")


def test_an_opaque_alpha_channel_is_left_out(tmp_path):
    codes = ramp()
    found = read(tmp_path, tiff(with_alpha(codes, 255), extrasamples=["unassalpha"]))
    np.testing.assert_allclose(found.rgb, plain_srgb(codes / 255.0), atol=1e-6)
    found = read(tmp_path, rgba_png(codes[..., ::-1], 255))
    np.testing.assert_allclose(found.rgb, plain_srgb(codes / 255.0), atol=1e-6)


def face(level, small_rig, most=255, dtype=np.uint8):
    """A bright disc, encoded."""
    camera = small_rig.cameras[0]
    y, x = np.mgrid[: camera.height_px, : camera.width_px]
    disc = np.hypot(x - 16, y - 24) < 12
    linear = np.where(disc, level, 0.001)[..., None] * [0.9, 0.7, 0.5]
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.rint(encoded * most).astype(dtype)


@pytest.fixture
def folder(tmp_path, small_rig):
    for pattern in ("full", "x+", "x-"):
        level = 0.8 * pattern_levels(pattern, small_rig).mean()
        for index, camera in enumerate(small_rig.cameras):
            path = tmp_path / "in" / pattern / f"{camera.id}"
            path.parent.mkdir(parents=True, exist_ok=True)
            suffix, data = [
                (".JPG", jpeg(face(level, small_rig))),
                (".png", png(face(level, small_rig, 65535, np.uint16))),
                (".tif", tiff(face(level, small_rig))),
            ][index]
            path.with_suffix(suffix).write_bytes(data)
    return tmp_path / "in"


def test_developed_pictures_become_a_session_that_is_checked_and_decoded(
    folder, tmp_path, small_rig
):
    found = import_session(folder, small_rig, tmp_path / "S", "p1", "neutral")
    assert found.frames == 9
    stated = " ".join(map(str, found.findings))
    assert "3 JPEG of 8 bits, no profile, taken for sRGB" in stated
    assert "3 PNG of 16 bits" in stated
    assert "tone curve" in stated
    session = load_session(tmp_path / "S")
    assert {frame.encoding for frame in session.file.frames} == {"linear"}
    assert {frame.path[-4:] for frame in session.file.frames} == {".exr"}
    full = read_exr(session.frame_path(session.frame("full", "cam1")))
    np.testing.assert_allclose(full[24, 16], 0.8 * np.array([0.9, 0.7, 0.5]), rtol=1e-4)
    assert check_session(tmp_path / "S").sums == 3
    facts = decode(session, tmp_path / "OUT", DecodeConfig())
    assert facts["frames"] == 9


def test_photographs_of_one_light_need_no_patterns_folder(folder, tmp_path, small_rig):
    found = import_session(folder / "full", small_rig, tmp_path / "S", "p1", "neutral")
    assert found.frames == 3
    session = load_session(tmp_path / "S")
    assert session.file.sequence == ["full"]
    assert check_session(tmp_path / "S").frames == 3
    assert decode(session, tmp_path / "OUT", DecodeConfig())["frames"] == 3
    import_session(folder / "x+", small_rig, tmp_path / "T", "p1", "neutral", one_light="olat-003")
    assert load_session(tmp_path / "T").file.sequence == ["olat-003"]
    assert named_cameras(folder / "full") == ["cam0", "cam1", "cam2"]


def test_two_sizes_of_one_camera_are_one_message(folder, tmp_path, small_rig):
    (folder / "x+" / "cam1.png").write_bytes(png(ramp(np.uint8, 24, 16)))
    with pytest.raises(FormatError, match=r"x\+/cam1\.png: found 16 x 24 pixels, expected 32 x 48"):
        import_session(folder, small_rig, tmp_path / "S", "p1", "neutral")
    assert not (tmp_path / "S").exists()


def test_unlike_exposures_are_brought_to_one_and_reported(folder, tmp_path, small_rig):
    level = 0.8 * pattern_levels("x+", small_rig).mean()
    (folder / "x+" / "cam0.JPG").write_bytes(jpeg(face(level / 2, small_rig), seconds=(1, 120)))
    found = import_session(folder, small_rig, tmp_path / "S", "p1", "neutral")
    assert any("x+/cam0 times 2" in str(finding) for finding in found.findings)
    session = load_session(tmp_path / "S")
    lit = read_exr(session.frame_path(session.frame("x+", "cam0")))[24, 16]
    np.testing.assert_allclose(lit, level * np.array([0.9, 0.7, 0.5]), rtol=0.05)
    (folder / "x+" / "cam0.JPG").write_bytes(jpeg(face(level, small_rig), seconds=(1, 12000)))
    with pytest.raises(FormatError, match="exposure: found 200 times less"):
        import_session(folder, small_rig, tmp_path / "T", "p1", "neutral")


def test_raw_and_developed_pictures_of_one_camera_are_not_mixed(folder, tmp_path, small_rig, dng):
    (folder / "x+" / "cam1.png").write_bytes(dng(1000))
    with pytest.raises(FormatError, match="a raw photograph, expected one that is developed"):
        import_session(folder, small_rig, tmp_path / "S", "p1", "neutral")


def test_names_are_right_or_told(folder, tmp_path, small_rig):
    decomposed, composed = "cama\u0308", "cam\u00e4"
    (folder / "full" / "cam0.JPG").rename(folder / "full" / f"{decomposed}.JPG")
    assert composed in named_cameras(folder / "full")
    found = find_photographs(folder / "full", small_rig, named_cameras(folder / "full"))
    assert set(found["full"]) == {composed, "cam1", "cam2"}
    (folder / "full" / f"{decomposed}.JPG").rename(folder / "full" / "my cam\n2.JPG")
    with pytest.raises(FormatError, match=r"found a camera called.*Rename") as caught:
        named_cameras(folder / "full")
    assert "\n" not in str(caught.value)
    with pytest.raises(FormatError, match=r"2 problems[^!]*found no camera of the rig"):
        import_session(folder / "full", small_rig, tmp_path / "S", "p1", "neutral")
    (folder / "my lights\u00fc").mkdir()
    with pytest.raises(Exception, match="my lights\u00fc"):
        import_session(folder, small_rig, tmp_path / "S", "p1", "neutral")


def test_raw_files_are_opened_before_they_are_taken(tmp_path, small_rig, dng):
    for camera in small_rig.cameras:
        path = tmp_path / "in" / f"{camera.id}.dng"
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(dng(1000))
    gpr = bytearray(dng(1000))
    entry = struct.pack("<HHIH", 259, 3, 1, 1)
    assert gpr.count(entry) == 1
    at = gpr.index(entry)
    gpr[at + 8 : at + 10] = struct.pack("<H", 9)
    (tmp_path / "in" / "cam1.dng").write_bytes(gpr)
    with pytest.raises(FormatError, match=r"cam1\.dng: found a DNG of a format .* Convert it"):
        import_session(tmp_path / "in", small_rig, tmp_path / "S", "p1", "neutral")
    (tmp_path / "in" / "cam1.dng").write_bytes(b"Dear diary")
    with pytest.raises(FormatError, match=r"cam1\.dng.*no photograph"):
        import_session(tmp_path / "in", small_rig, tmp_path / "S", "p1", "neutral")
    assert developed_kind(tmp_path / "in" / "cam0.dng") is None


def cut_rw2(size):
    """Directories of a Panasonic camera's RAW without the counts they tell of."""
    words = {2: 3724, 3: 2754, 4: 0, 5: 0, 6: 2752, 7: 3664}
    rows = [struct.pack("<HHIHH", tag, 3, 1, value, 0) for tag, value in words.items()]
    place = 8 + 2 + 12 * (len(rows) + 2) + 4
    rows += [struct.pack("<HHII", 271, 2, 10, place), struct.pack("<HHII", 272, 2, 8, place + 10)]
    body = b"Panasonic\0DMC-LX3\0"
    data = b"IIU\0\x08\0\0\0" + struct.pack("<H", len(rows)) + b"".join(rows) + bytes(4) + body
    return data.ljust(size, b"\0")


def test_a_raw_that_holds_hardly_more_than_its_header_is_cut(tmp_path, dng, monkeypatch):
    (tmp_path / "a.rw2").write_bytes(cut_rw2(12_000))
    with pytest.raises(FormatError, match=r"a\.rw2: found a RW2 of 12000 bytes, .*Copy it"):
        open_photograph(tmp_path / "a.rw2")
    (tmp_path / "b.dng").write_bytes(dng(1000))
    open_photograph(tmp_path / "b.dng")
    # LibRaw gives zeros for what some files lack: as if this one needed more bits.
    monkeypatch.setattr(opening, "LEAST_BITS_PER_PX", 1000.0)
    with pytest.raises(FormatError, match=r"b\.dng: found \d+ bytes for \d+ x \d+ pixels"):
        open_photograph(tmp_path / "b.dng")
