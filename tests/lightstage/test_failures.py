"""What the system and libraries raise: one clear error each, and nothing half-written."""

import contextlib
import errno
import itertools
import os
import re

import cv2
import numpy as np
import pytest

from lightstage.errors import DiskError, DiskFullError, FormatError, MemoryLimitError
from lightstage.failures import explain
from lightstage.formats.exr import read_exr, write_exr
from lightstage.formats.files import atomic_folder, atomic_path, write_bytes
from lightstage.formats.mesh import Mesh, write_ply
from lightstage.formats.png import write_png


def noise(rows):
    return np.random.default_rng(0).random((rows, 256, 3)).astype(np.float32)


def save_tensors(path):
    from safetensors.numpy import save_file

    with atomic_path(path) as beside:
        save_file({"a": np.zeros(100_000)}, str(beside))


def save_arrays(path):
    with atomic_path(path) as beside, beside.open("wb") as file:
        np.savez(file, a=noise(256))


def save_mesh(path):
    corners = np.random.default_rng(0).random((3000, 3))
    write_ply(Mesh(corners, np.arange(3000).reshape(-1, 3)), path)


WRITERS = {
    "ply": save_mesh,
    "exr": lambda path: write_exr(path, noise(256)),
    "png": lambda path: write_png(path, (255 * noise(256)).astype(np.uint8)),
    "safetensors": save_tensors,
    "npz": save_arrays,
    "bytes": lambda path: write_bytes(path, bytes(100_000)),
}


@pytest.mark.parametrize("kind", WRITERS)
def test_a_full_disk_is_one_error_whatever_writes_and_the_old_file_stays(small_disk, kind):
    path = small_disk / f"a.{kind}"
    path.write_bytes(b"old")
    with pytest.raises(DiskFullError, match="found a full disk, 6") as raised:
        WRITERS[kind](path)
    assert raised.value.where == str(path)
    assert "Nothing was left half-written" in str(raised.value)
    assert os.listdir(small_disk) == [path.name]
    assert path.read_bytes() == b"old"


def test_a_full_disk_states_how_much_is_missing_where_that_is_known(small_disk):
    with pytest.raises(DiskFullError) as raised:
        write_bytes(small_disk / "a.bin", bytes(100_000))
    # 64 KiB are 65.5 kB.
    assert raised.value.found == "a full disk, 65.5 kB free"
    assert raised.value.expected == "100.0 kB: 34.5 kB more"


@pytest.mark.parametrize("rows", [1, 4, 8, 16, 24])
def test_a_small_picture_that_the_disk_has_no_room_for_is_never_left_cut(small_disk, rows):
    (small_disk / "filler").write_bytes(bytes(65536 - 4096))
    path = small_disk / "a.exr"
    try:
        write_exr(path, noise(rows))
    except DiskFullError:
        assert os.listdir(small_disk) == ["filler"]
    else:
        assert read_exr(path).shape == (rows, 256, 3)


def test_a_folder_that_fills_the_disk_leaves_the_old_one(small_disk):
    folder = small_disk / "out"
    with atomic_folder(folder, "marker") as beside:
        write_bytes(beside / "marker", b"old")

    def fill():
        with atomic_folder(folder, "marker") as beside:
            write_bytes(beside / "first", bytes(30_000))
            write_bytes(beside / "second", bytes(50_000))

    with pytest.raises(DiskFullError) as raised:
        fill()
    assert raised.value.where == str(folder)
    # The part of the second file that the disk took counts, too.
    written = re.fullmatch("more than the (.*) kB that had .* full", raised.value.expected)
    assert written is not None
    assert 50 < float(written[1]) < 65.6
    assert sorted(p.name for p in small_disk.rglob("*")) == ["marker", "out"]


def test_memory_that_nobody_has_is_reported_as_such():
    torch = pytest.importorskip("torch")
    for allocate in (lambda: np.zeros(10**14), lambda: torch.empty(10**14)):
        with pytest.raises((MemoryError, RuntimeError)) as raised:
            allocate()
        assert isinstance(explain(raised.value), MemoryLimitError)


def test_memory_that_opencv_lacks_is_no_unreadable_file():
    with pytest.raises(cv2.error) as raised:
        cv2.resize(np.zeros((2, 2), np.float32), (2 * 10**7, 2 * 10**7))
    assert isinstance(explain(raised.value), MemoryLimitError)


def test_each_system_error_names_its_file_and_what_to_expect(tmp_path):
    (tmp_path / "file").write_text("x")
    os.symlink(tmp_path / "b", tmp_path / "a")
    os.symlink(tmp_path / "a", tmp_path / "b")
    for path, found in (
        (tmp_path / "none" / "x", "nothing of this name"),
        (tmp_path / "file" / "x", "a file where a folder is needed"),
        (tmp_path, "a folder"),
        (tmp_path / "a", "links that lead in a circle"),
        (tmp_path / ("n" * 300), "a name that is too long for this disk"),
    ):
        with pytest.raises(OSError, match="Errno") as raised:
            path.open("wb").close()
        stated = explain(raised.value)
        assert isinstance(stated, DiskError)
        assert (stated.where, stated.found) == (str(path), found)


@pytest.mark.parametrize("number", sorted(errno.errorcode))
def test_every_error_number_of_the_system_is_explained(number):
    stated = explain(OSError(number, os.strerror(number), "/x"))
    assert stated is not None
    assert stated.found


def test_errors_of_codecs_are_explained(tmp_path):
    from safetensors import SafetensorError, safe_open

    path = tmp_path / "x.safetensors"
    path.write_bytes(b"nothing of the kind")
    with pytest.raises(SafetensorError) as raised, safe_open(str(path), "np"):
        pass
    assert explain(raised.value) is not None
    with pytest.raises(cv2.error) as raised:
        cv2.imdecode(np.zeros(0, np.uint8), cv2.IMREAD_COLOR)
    assert explain(raised.value) is not None


def test_a_defect_is_not_explained_away():
    for error in (ZeroDivisionError(), KeyError("a"), TypeError("b"), RuntimeError("a bug")):
        assert explain(error) is None
    with pytest.raises(cv2.error) as raised:
        cv2.GaussianBlur(np.zeros((4, 4), np.float32), (0, 0), 0)
    assert explain(raised.value) is None


def test_a_png_is_read_back_as_it_was_written(tmp_path):
    rng = np.random.default_rng(0)
    shapes = ((5, 7), (5, 7, 3), (5, 7, 4))
    for shape, kind in itertools.product(shapes, (np.uint8, np.uint16)):
        pixels = rng.integers(0, np.iinfo(kind).max, shape, dtype=kind)
        back = cv2.imread(str(write_png(tmp_path / "a.png", pixels)), cv2.IMREAD_UNCHANGED)
        order = [2, 1, 0, 3][: shape[2]] if len(shape) == 3 else slice(None)
        np.testing.assert_array_equal(back[..., order] if len(shape) == 3 else back, pixels)


def test_pixels_that_no_png_holds_are_refused_and_nothing_is_written(tmp_path):
    for pixels in (
        np.zeros((4, 4), np.float32),
        np.zeros((4, 4, 2), np.uint8),
        np.zeros((0, 4, 3), np.uint8),
        np.zeros(4, np.uint8),
    ):
        with contextlib.suppress(FormatError):
            write_png(tmp_path / "a.png", pixels)
            raise AssertionError(f"{pixels.dtype} {pixels.shape} was taken")
    assert os.listdir(tmp_path) == []
