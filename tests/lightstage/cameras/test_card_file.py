"""A card's file on its way to the disk."""

from __future__ import annotations

import errno
import hashlib
import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.cameras import card_file
from lightstage.cameras.card_file import pieces, write_card_file
from lightstage.cameras.process import CameraProcess
from lightstage.errors import CaptureError, DeviceError

HERE = Path(__file__).parent


@given(st.binary(max_size=2000))
def test_pieces_are_the_whole_and_at_least_two(data):
    parts = list(pieces(memoryview(data)))
    assert b"".join(parts) == data
    assert len(parts) >= min(2, len(data))


def test_a_large_file_comes_in_pieces_that_need_no_copy():
    data = memoryview(bytes(3 * card_file.PIECE_BYTES + 5))
    parts = list(pieces(data))
    assert [len(part) for part in parts] == [card_file.PIECE_BYTES] * 3 + [5]
    assert all(part.obj is data.obj for part in parts)


def test_what_is_written_is_hashed_flushed_and_counted(tmp_path, monkeypatch):
    flushed = []
    monkeypatch.setattr(os, "fsync", lambda handle: flushed.append(os.fstat(handle).st_size))
    data = os.urandom(2_500_000)
    got = write_card_file(tmp_path / "x", len(data), pieces(memoryview(data)))
    assert (tmp_path / "x").read_bytes() == data
    assert (got.size, got.sha256) == (len(data), hashlib.sha256(data).hexdigest())
    assert flushed == [len(data)]


def test_writes_that_take_only_a_part_are_gone_on_with(tmp_path, monkeypatch):
    write = os.write
    monkeypatch.setattr(os, "write", lambda handle, data: write(handle, bytes(data)[:7]))
    got = write_card_file(tmp_path / "x", 100, [b"abcdefghij" * 10])
    assert (tmp_path / "x").read_bytes() == b"abcdefghij" * 10
    assert got.size == 100


def test_what_a_camera_gives_too_little_of_is_written_and_reported(tmp_path):
    assert write_card_file(tmp_path / "x", 100, [b"half"]).size == 4


def test_a_camera_that_fails_on_the_way_leaves_no_file(tmp_path):
    def source():
        yield b"half"
        raise DeviceError("camera", found="gone")

    with pytest.raises(DeviceError, match="found gone"):
        write_card_file(tmp_path / "x", 8, source())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("number", "message"),
    [
        (errno.ENOSPC, "No space left on device, expected room .*The disk is full"),
        (errno.EDQUOT, "Your share of the disk is used up"),
        (errno.EROFS, "The disk cannot be written to"),
        (errno.EIO, "The disk fails"),
        (errno.ENODEV, "Is the disk still there"),
    ],
)
@pytest.mark.parametrize("call", ["open", "write", "fsync"])
def test_a_disk_that_fails_is_reported_in_plain_words_and_nothing_is_left(
    tmp_path, monkeypatch, number, message, call
):
    def fail(*_args, **_more):
        raise OSError(number, os.strerror(number))

    with monkeypatch.context() as patch:
        patch.setattr(os, call, fail)
        with pytest.raises(CaptureError, match=f"x, write: found .*{message}"):
            write_card_file(tmp_path / "x", 4, [b"data"])
    assert list(tmp_path.iterdir()) == []


def test_another_file_is_never_written_over_not_even_a_link_to_nowhere(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    with pytest.raises(CaptureError, match=r"File exists.*Nothing is overwritten"):
        write_card_file(tmp_path / "link", 4, [b"data"])
    assert not (tmp_path / "nowhere").exists()


def test_disk_errors_come_from_the_process_as_such_and_the_camera_works_on(
    monkeypatch, tmp_path, processes
):
    """A removed folder, and a real limit on a file's size; the camera is not to blame."""
    monkeypatch.setenv("PYTHONPATH", str(HERE))
    camera = CameraProcess("cam0", "ports", None, 20.0, "camera_drivers:Fine")
    processes.append(camera)
    camera.open()
    (file,) = camera.trigger(0.0).files
    with pytest.raises(CaptureError, match=r"camera cam0 \(.*gone/x\), .*The folder is gone"):
        camera.download(file.name, tmp_path / "gone" / "x")
    resource.prlimit(camera.pid, resource.RLIMIT_FSIZE, (3000, 3000))
    with pytest.raises(CaptureError, match=r"File too large.*take no file of this size"):
        camera.download(file.name, tmp_path / "x")
    assert list(tmp_path.iterdir()) == []
    assert camera.card() == (file,)


def test_the_parent_s_memory_does_not_grow_with_its_photographs(processes, tmp_path):
    """Sixty megabytes of photographs: were they to pass through it, its peak would show them."""
    script = (
        "import resource, sys; from pathlib import Path\n"
        "from lightstage.cameras.process import CameraProcess\n"
        "c = CameraProcess('c', 'x' * 2_000, None, 20.0, 'camera_drivers:Fine'); c.open()\n"
        "def once(n): c.download(c.trigger(0).files[0].name, Path(sys.argv[1]) / str(n))\n"
        "once(0); before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "[once(n) for n in range(1, 31)]; c.close()\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path)],
        env={**os.environ, "PYTHONPATH": str(HERE)},
        capture_output=True,
        text=True,
    )
    assert int(done.stdout) < 2_000, done.stderr  # kilobytes
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) == 31 * 2_000_000
