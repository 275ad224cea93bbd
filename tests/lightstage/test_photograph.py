"""Telling photographs by their bytes."""

import io
import os
import struct

import numpy as np
import pytest
import tifffile
from hypothesis import given
from hypothesis import strategies as st

from lightstage.errors import FormatError
from lightstage.formats.exr import write_exr
from lightstage.photo_file import identify, identify_file
from lightstage.tiff import MAX_DIRECTORIES


def tiff(order, make, **extra):
    file = io.BytesIO()
    tags = [(271, 2, 0, make, True)] if make else []
    tifffile.imwrite(
        file, np.zeros((4, 4), np.uint16), byteorder=order, metadata=None, extratags=tags, **extra
    )
    return file.getvalue()


def test_a_dng_is_recognised_by_its_version_tag(dng):
    kind = identify(dng(1000), "x")
    assert (kind.suffix, kind.encoding) == (".dng", "raw")


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(
    ("make", "suffix"),
    [("NIKON CORPORATION", ".nef"), ("Canon", ".cr2"), ("SONY", ".arw"), ("PENTAX", ".pef")],
)
def test_makers_raw_files_are_recognised_by_their_maker(order, make, suffix):
    assert identify(tiff(order, make), "x").suffix == suffix


def box(kind, content=b"", size=None):
    return struct.pack(">I4s", len(content) + 8 if size is None else size, kind) + content


CR3 = box(b"ftyp", b"crx \0\0\0\1crx isom") + box(b"moov", bytes(40)) + box(b"mdat", bytes(300))
RAF = b"FUJIFILMCCD-RAW 0201".ljust(84, b"\0")
RAF += struct.pack(">6I", 160, 40, 200, 60, 260, 240) + bytes(392)


def test_other_containers_are_recognised_by_their_first_bytes():
    assert identify(CR3, "x").suffix == ".cr3"
    assert identify(CR3[:-308] + box(b"mdat", bytes(9), 0), "x").suffix == ".cr3"
    assert identify(CR3[:-308] + struct.pack(">I4sQ", 1, b"mdat", 16), "x").suffix == ".cr3"
    assert identify(RAF, "x").suffix == ".raf"
    assert identify(b"II\x1a\0\0\0HEAPCCDR" + bytes(50), "x").suffix == ".crw"
    assert identify(b"IIU\0" + bytes(50), "x").suffix == ".rw2"
    assert identify(b"IIRO" + bytes(50), "x").suffix == ".orf"
    assert identify(tiff("<", "EASTMAN KODAK COMPANY"), "x").suffix == ".kdc"


@pytest.mark.parametrize("data", [CR3, RAF], ids=["CR3", "RAF"])
def test_every_truncation_of_a_cr3_or_raf_is_refused(data):
    for size in range(16, len(data)):
        with pytest.raises(FormatError, match="truncated"):
            identify(data[:size], "x")


def test_a_developed_tiff_is_no_raw_whoever_made_the_scanner():
    file = io.BytesIO()
    tags = [(271, 2, 0, "NIKON CORPORATION", True)]
    picture = np.zeros((4, 4, 3), np.uint16)
    tifffile.imwrite(file, picture, photometric="rgb", metadata=None, extratags=tags)
    with pytest.raises(FormatError, match=r"developed colours.*`lightstage import` takes it"):
        identify(file.getvalue(), "x")


def test_an_exr_is_linear(tmp_path):
    data = write_exr(tmp_path / "a.exr", np.ones((2, 2, 3))).read_bytes()
    kind = identify(data, "x")
    assert (kind.suffix, kind.encoding) == (".exr", "linear")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "0 bytes, beginning with none"),
        (b"\xff\xd8\xff\xe1 Exif", "a JPEG"),
        (b"\x89PNG\r\n\x1a\n", "89504e47"),
        (tiff("<", ""), "a TIFF without DNGVersion"),
        (tiff("<", "Scanner"), "of no known maker"),
    ],
)
def test_what_holds_no_raw_light_is_refused(data, message):
    with pytest.raises(FormatError, match=message):
        identify(data, "x")


def test_every_truncation_of_a_dng_is_refused(dng):
    data = dng(1000)
    for size in range(len(data)):
        with pytest.raises(FormatError):
            identify(data[:size], "x")


@given(st.binary(max_size=200), st.sampled_from([b"", b"II*\0", b"MM\0*", b"II*\0\x08\0\0\0"]))
def test_noise_is_refused_not_crashed_on(noise, head):
    try:
        identify(head + noise, "x")
    except FormatError:
        return
    data = head + noise
    starts = (b"II*\0", b"MM\0*", b"\x76\x2f\x31\x01", b"FUJIFILMCCD-RAW")
    starts += (b"IIRO", b"IIRS", b"MMOR", b"IIU\0", b"\0MRM", b"FOVb")
    assert data.startswith(starts) or data[4:11] == b"ftypcrx" or data[6:14] == b"HEAPCCDR"


@pytest.mark.parametrize("count", [MAX_DIRECTORIES + 1, 1 << 20])
def test_no_more_sub_directories_of_one_are_read_than_the_limit(count):
    made = struct.pack("<HHI4s", 271, 2, 4, b"SONY")
    head = b"II*\0" + struct.pack("<IH", 8, 2) + made + struct.pack("<HHII", 330, 4, count, 38)
    nowhere, beyond_the_end = bytes(4 * (count - 1)), struct.pack("<I", 1 << 31)
    assert identify(head + bytes(4) + nowhere + beyond_the_end, "x").suffix == ".arw"


def test_directories_in_a_ring_end():
    ring = b"II*\0" + struct.pack("<IHI", 8, 0, 8)
    with pytest.raises(FormatError, match="without DNGVersion"):
        identify(ring, "x")


@given(st.binary(max_size=200), st.sampled_from([b"", b"II*\0", b"MM\0*", b"II*\0\x08\0\0\0"]))
def test_a_file_is_recognised_by_its_bytes(tmp_path_factory, noise, head):
    path = tmp_path_factory.getbasetemp() / "noise"
    path.write_bytes(head + noise)

    def refusal(call):
        try:
            return call()
        except FormatError as error:
            return str(error)

    assert refusal(lambda: identify_file(path, "x")) == refusal(lambda: identify(head + noise, "x"))


@pytest.mark.parametrize("cut", [0, 1, 500, 3000])
def test_of_a_large_file_only_the_header_is_read(tmp_path, dng, monkeypatch, cut):
    data = dng(1000, width=1000, height=1000)
    path = tmp_path / "a"
    path.write_bytes(data[: len(data) - cut])
    read = []
    real = os.pread

    def pread(handle, size, offset):
        read.append(size)
        return real(handle, size, offset)

    monkeypatch.setattr(os, "pread", pread)
    if cut:
        with pytest.raises(FormatError, match="truncated"):
            identify_file(path)
    else:
        assert identify_file(path).suffix == ".dng"
    assert sum(read) < len(data) / 100
