"""A photograph's way to its name: verified as the disk holds it, never in the memory whole."""

import os
import subprocess
import sys
import threading

import pytest

from lightstage.session import durable_rename as module
from lightstage.session.disk import make_folder, rename_new
from lightstage.session.durable_rename import Arrival, is_whole, settle, sha256_on_disk

STEPS = ["sized", "parsed", "hashed", "flushed", "named", "folder-flushed"]


@pytest.fixture
def arrival(tmp_path, dng):
    path = tmp_path / ".cam0.take1.partial"
    path.write_bytes(dng(1000))
    size = path.stat().st_size
    return Arrival(path, "cam0", size, sha256_on_disk(path), "x+ by cam0", "x+", "cam0")


def test_each_step_is_reported_when_it_is_done_and_what_it_promises_is_on_the_disk(
    arrival, monkeypatch
):
    lines = []

    def step(name, pattern, camera):
        named, partial = arrival.path.with_name("cam0.dng").exists(), arrival.path.exists()
        lines.append(name)
        assert (pattern, camera) == ("x+", "cam0")
        assert (named, partial) == (("named" in lines), ("named" not in lines))

    monkeypatch.setattr(module, "step", step)
    path, kind = settle(arrival)
    assert lines == STEPS
    assert (path.name, kind.encoding) == ("cam0.dng", "raw")


def test_the_file_is_flushed_before_it_is_read_back_and_the_folder_after_it_has_its_name(
    arrival, monkeypatch
):
    calls = []
    for name in ("fsync", "pread", "link", "posix_fadvise"):
        real = getattr(os, name)

        def call(*args, real=real, name=name):
            calls.append(name)
            return real(*args)

        monkeypatch.setattr(os, name, call)
    settle(arrival)
    assert calls[:2] == ["fsync", "posix_fadvise"]
    assert calls.index("pread") > calls.index("posix_fadvise")
    last_read = len(calls) - calls[::-1].index("pread")
    assert calls[last_read:] == ["fsync", "link", "fsync"]


MEMORY = """
import hashlib, resource, struct, sys, threading
from pathlib import Path
from lightstage.session.durable_rename import Arrival, settle
folder, size = Path(sys.argv[1]), int(sys.argv[2])
head = b"II*\\0\\x08\\0\\0\\0" + struct.pack("<HHHI4sI", 1, 50706, 1, 4, b"\\x01\\x04\\0\\0", 0)
block = bytes(range(256)) * 4096
arrivals = []
for number in range(9):
    path, digest, left = folder / f".cam{number}.partial", hashlib.sha256(head), size - len(head)
    with path.open("wb") as file:
        file.write(head)
        while left:
            part = block[:left]
            file.write(part)
            digest.update(part)
            left -= len(part)
    name = f"cam{number}"
    arrivals.append(Arrival(path, name, size, digest.hexdigest(), name, "x+", name))
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
threads = [threading.Thread(target=settle, args=(each,)) for each in arrivals]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
assert len(list(folder.glob("cam*.dng"))) == 9
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


def test_nine_large_photographs_at_once_need_a_small_part_of_their_size(tmp_path):
    size = 12_000_000
    done = subprocess.run(
        [sys.executable, "-c", MEMORY, str(tmp_path), str(size)],
        capture_output=True, text=True, check=True, timeout=120,
    )  # fmt: skip
    assert int(done.stdout) * 1024 < size  # 9 chunks of 256 KiB and nine threads


@pytest.mark.parametrize("cut", [1, 100, 2000])
def test_a_file_is_whole_only_with_its_size_and_all_that_its_header_says(tmp_path, dng, cut):
    data = dng(1000)
    path = tmp_path / "a"
    path.write_bytes(data)
    assert is_whole(path, len(data))
    assert not is_whole(path, len(data) + 1)
    path.write_bytes(data[:-cut])
    assert not is_whole(path, len(data) - cut)
    path.write_bytes(bytes(len(data)))
    assert not is_whole(path, len(data))
    assert not is_whole(tmp_path / "none", 0)


def test_a_name_that_is_taken_keeps_its_file_also_where_two_want_it_at_once(tmp_path):
    for number in range(20):
        target = tmp_path / f"target{number}"
        sources = [tmp_path / f"source{number}.{n}" for n in range(4)]
        for source in sources:
            source.write_text(source.name)
        outcome = []

        def name(source, target=target, outcome=outcome):
            try:
                rename_new(source, target)
                outcome.append(source.name)
            except FileExistsError:
                pass

        threads = [threading.Thread(target=name, args=(source,)) for source in sources]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert outcome == [target.read_text()]
        assert sum(source.exists() for source in sources) == 3


def test_a_folder_that_was_removed_is_not_made_again_beside_the_session(tmp_path):
    with pytest.raises(OSError, match="No such file"):
        make_folder(tmp_path / "gone" / "frames" / "x+", tmp_path / "gone")
    make_folder(tmp_path / "frames" / "x+", tmp_path)
    make_folder(tmp_path / "frames" / "x+", tmp_path)
    assert (tmp_path / "frames" / "x+").is_dir()
