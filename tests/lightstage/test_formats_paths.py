"""Paths and names that files give: none leads out of the folder that it belongs to."""

import os

import pytest

from lightstage.errors import ConfigError, FormatError
from lightstage.formats.paths import check_name, path_inside


@pytest.fixture
def folder(tmp_path):
    root = tmp_path / "session"
    (root / "frames").mkdir(parents=True)
    (root / "frames" / "cam0.dng").write_bytes(b"1")
    (tmp_path / "outside.txt").write_bytes(b"2")
    (root / "link-out").symlink_to(tmp_path)
    (root / "link-in").symlink_to("frames")
    (root / "loop").symlink_to("loop")
    return root


@pytest.mark.parametrize(
    "message",
    [
        *("", "..", "../outside.txt", "frames/../../outside.txt", "frames/..", "/etc/passwd"),
        *("//etc", "a\0b", "a\nb", "\x1b[31m", "frames\\cam0.dng", "C:\\x", "\ud800", "\u202ea"),
        *("link-out", "link-out/outside.txt", "loop", "loop/x", None, 3, ["frames"], {"a": 1}),
    ],
)
def test_a_path_that_leaves_its_folder_is_refused(folder, message):
    with pytest.raises(FormatError) as caught:
        path_inside(folder, message, "session.json", "frames[0].path")
    assert str(caught.value).startswith("session.json, frames[0].path: found ")
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    "message",
    ["frames/cam0.dng", "frames/not there.dng", "link-in/cam0.dng", "a..b", "ä/😀.dng", "."],
)
def test_a_path_inside_the_folder_is_taken_as_it_is(folder, message):
    assert path_inside(folder, message, "session.json") == folder / message
    assert path_inside(folder.relative_to(folder.parent), message, "s") is not None


def test_a_path_of_any_length_ends_in_an_answer(folder):
    for message in ("x" * 5000, "x/" * 4000 + "x"):
        assert path_inside(folder, message, "s") == folder / message


def test_a_folder_that_is_a_link_itself_keeps_its_files(folder, tmp_path):
    os.symlink(folder, tmp_path / "short")
    assert path_inside(tmp_path / "short", "frames/cam0.dng", "s").read_bytes() == b"1"


@pytest.mark.parametrize(
    "message", ["cam0", "x+", "lin-x+", "olat-000", "full@cross", "Kamera_ä", "7"]
)
def test_a_plain_name_is_taken(message):
    assert check_name(message, "rig.json", "cameras[0].id") == message


@pytest.mark.parametrize(
    "message",
    ["", ".", "..", "../X", "a/b", ".hidden", "-x", "a b", "a\0", "a\n", "x" * 101, 3, None],
)
def test_an_id_that_names_no_file_is_refused(message):
    with pytest.raises(ConfigError, match=r"rig\.json, cameras\[0\]\.id: found .*becomes the name"):
        check_name(message, "rig.json", "cameras[0].id", ConfigError)
