"""An output that cannot be used is refused before any work, by every command there is."""

import json
import os
import subprocess

import pytest

from lightstage.commands.outputs import try_file, try_folder
from lightstage.errors import ConfigError, DiskError, DiskFullError

WITHOUT_OUTPUT = {
    "lightstage watch",  # but for --picture
    "lightstage calibrations",
    "lightstage console",  # writes the plan that it is given, and sessions beside it
    "lightstage devices",
    "lightstage sessions",
    "lightstage retake",  # writes into the session that it is given
    "lightstage check",
    "sim stage",
    "processing template check",  # but for --picture
    "processing template population",  # writes into the template that it is given
    "processing evaluate",  # writes into the folder that it reads
    "processing dataset add",  # writes into the store that it is given
    "processing dataset remove",
    "processing dataset list",
    "processing dataset verify",
}
"""Commands that name no output: a new command is listed here, or has one."""


def test_every_command_names_what_it_writes_or_writes_nothing(each_command):
    names_one = "--out" in each_command.outputs
    assert names_one != (str(each_command) in WITHOUT_OUTPUT)


def unusable(kind, folder, suffix):
    """A path that nothing can be written to; None where this machine has none of the kind."""
    name = f"out{suffix}"
    if kind == "behind a file":
        (folder / "file").write_text("x")
        return folder / "file" / name
    if kind == "of the other kind":
        path = folder / name
        path.mkdir() if suffix else path.write_text("x")
        return path
    if kind == "forbidden":
        return f"/sys/{name}"
    if kind == "a circle of links":
        os.symlink(folder / "b", folder / "a")
        os.symlink(folder / "a", folder / "b")
        return folder / "a" / name
    if kind == "too long a name":
        return folder / ("n" * 300 + suffix)
    raise AssertionError(kind)


KINDS = ("behind a file", "of the other kind", "forbidden", "a circle of links", "too long a name")


@pytest.mark.parametrize("kind", KINDS)
def test_an_unusable_output_is_one_clear_message_before_any_work(
    each_output, kind, tmp_path, run_command
):
    command, option = each_output
    suffix = command.suffix(option)
    folder = tmp_path / "a folder of Jörg's"
    folder.mkdir()
    path = unusable(kind, folder, suffix)
    before = sorted(folder.rglob("*"))
    ended = run_command(command.program, *command.words_with(option, path), *json_flag(command))
    assert ended.code == 2, ended
    assert "Traceback" not in ended.err
    assert ended.err.count("\n") == 1
    assert f"{path}, {option}: found " in ended.err
    assert "expected " in ended.err
    assert sorted(folder.rglob("*")) == before
    if json_flag(command):
        error = json.loads(ended.out.splitlines()[-1])["error"]
        assert (error["where"], error["field"]) == (str(path), option)
        assert error["message"] in ended.err


def test_a_full_disk_is_reported_before_any_work(each_output, small_disk, run_command):
    command, option = each_output
    (small_disk / "filler").write_bytes(bytes(65536))
    path = small_disk / f"out{command.suffix(option)}"
    ended = run_command(command.program, *command.words_with(option, path))
    assert ended.code == 2, ended
    assert f"DiskFullError: {path}, {option}: found a full disk" in ended.err
    assert os.listdir(small_disk) == ["filler"]


def test_a_read_only_disk_is_reported(small_disk):
    subprocess.run(["mount", "-o", "remount,ro", str(small_disk)], check=True)
    for attempt in (try_folder, try_file):
        with pytest.raises(DiskError, match="--out: found a read-only disk"):
            attempt("--out", small_disk / "out")


def test_a_usable_output_is_taken_and_nothing_is_left(tmp_path):
    try_folder("--out", tmp_path / "new" / "folder")
    try_folder("--out", tmp_path)
    try_file("--out", tmp_path / "new" / "a.png", [".png"])
    try_file("--out", tmp_path / "A.PNG", [".png"])
    assert os.listdir(tmp_path) == []


def test_another_suffix_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"--out: found suffix '.jpg', expected .png or .exr"):
        try_file("--out", tmp_path / "a.jpg", [".png", ".exr"])
    with pytest.raises(ConfigError, match=r"found no suffix, expected \.npz"):
        try_file("--out", tmp_path / "a", [".npz"])


def test_a_full_disk_is_an_error_of_its_own(small_disk):
    (small_disk / "filler").write_bytes(bytes(65536))
    with pytest.raises(DiskFullError, match="found a full disk, 0 bytes free"):
        try_folder("--out", small_disk / "new")


def json_flag(command):
    return ["--json"] if any("--json" in p.opts for p in command.parser.params) else []
