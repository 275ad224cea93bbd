"""Camera folders, photographed by the real driver on libgphoto2's virtual camera."""

from __future__ import annotations

import hashlib
import tomllib

import numpy as np
import pytest

from lightstage.cameras.binding import read_cameras_file
from lightstage.cameras.process import CameraProcess
from sim.devices.camera_device import PORT, CameraFolders
from sim.errors import SimError


def test_each_shot_gives_the_bytes_that_lie_there_at_that_moment(tmp_path):
    rng = np.random.default_rng(1)
    folders = CameraFolders(tmp_path, ["cam0", "cam1"])
    first = {name: rng.bytes(70_000) for name in ("cam0", "cam1")}
    for name, data in first.items():
        folders.put(name, data)
    cameras = [CameraProcess(n, PORT, folders.folder(n), 30.0) for n in ("cam0", "cam1")]
    try:
        for camera in cameras:
            camera.open()
        paths = map(str, range(9))

        def shot(camera):
            path = tmp_path / next(paths)
            got = camera.download(camera.trigger(0.0).files[0].name, path)
            assert got.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
            return path.read_bytes()

        for camera in cameras:
            assert shot(camera) == first[camera.id]
        second = rng.bytes(70_000)
        folders.put("cam0", second)
        assert shot(cameras[0]) == second
        assert shot(cameras[1]) == first["cam1"]
    finally:
        for camera in cameras:
            camera.close()


def test_the_cameras_file_is_what_capture_reads(tmp_path):
    folders = CameraFolders(tmp_path / "with 'quotes'" / "c", ["cam0", "cam1"])
    path = tmp_path / "cameras.toml"
    path.write_text(folders.cameras_file())
    file = read_cameras_file(path)
    assert set(file.cameras) == {"cam0", "cam1"}
    assert file.cameras["cam1"].virtual_folder == folders.folder("cam1")
    assert "serial" in tomllib.loads(path.read_text())["allow_unverifiable"]


def test_a_folder_holds_one_file_whatever_was_put(tmp_path):
    folders = CameraFolders(tmp_path, ["cam0"])
    for data in (b"first", b"other"):
        folders.put("cam0", data)
        there = [p for p in folders.folder("cam0").rglob("*") if p.is_file()]
        assert [p.read_bytes() for p in there] == [data]


def test_a_file_of_another_size_is_refused(tmp_path):
    """The virtual camera would cut it: it keeps the size that it saw when it was opened."""
    folders = CameraFolders(tmp_path, ["cam0"])
    folders.put("cam0", b"12345")
    with pytest.raises(SimError, match="6 bytes, expected 5"):
        folders.put("cam0", b"123456")
