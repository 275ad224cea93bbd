"""Who may read what shows a face."""

import os
import stat
import subprocess
import sys

import pytest

from lightstage.formats.access import close_folder, group_of, limited_access
from lightstage.formats.files import atomic_folder, write_json


def mode(path):
    return stat.S_IMODE(path.stat().st_mode)


@pytest.fixture(autouse=True)
def open_umask():
    before = os.umask(0)
    yield
    os.umask(before)


@pytest.mark.parametrize(
    ("group", "folder", "file"),
    [("nothing", 0o700, 0o600), ("read", 0o750, 0o640), ("write", 0o770, 0o660)],
)
def test_temporary_files_and_folders_that_are_renamed_are_private_too(
    tmp_path, group, folder, file
):
    with limited_access(group):
        write_json(tmp_path / "a" / "one.json", {})
        with atomic_folder(tmp_path / "b", "two.json") as beside:
            assert mode(beside) == folder
            (beside / "two.json").write_bytes(b"{}")
            assert mode(beside / "two.json") == file
        write = "import pathlib, sys; pathlib.Path(sys.argv[1]).write_bytes(b'')"
        subprocess.run([sys.executable, "-c", write, str(tmp_path / "child")], check=True)
    assert {mode(tmp_path / name) for name in ("a", "b")} == {folder}
    for name in ("a/one.json", "b/two.json", "child"):
        assert mode(tmp_path / name) == file
    write_json(tmp_path / "after.json", {})
    assert mode(tmp_path / "after.json") == 0o666


def test_a_folder_that_was_open_before_is_closed(tmp_path):
    with limited_access():
        close_folder(tmp_path)
    assert mode(tmp_path) == 0o700


@pytest.mark.parametrize(
    ("modes", "group"),
    [
        ([0o700], "nothing"), ([0o755], "read"), ([0o770], "write"), ([0o777], "write"),
        ([0o770, 0o750], "read"), ([0o770, 0o700], "nothing"), ([0o710], "nothing"),
        ([0o707], "nothing"), ([], "nothing"),
    ],
)  # fmt: skip
def test_what_is_made_of_sessions_is_as_open_as_the_most_private_of_them(tmp_path, modes, group):
    folders = []
    for number, each in enumerate(modes):
        folder = tmp_path / str(number)
        folder.mkdir()
        folder.chmod(each)
        folders.append(folder)
    assert group_of([*folders, tmp_path / "missing"]) == group
