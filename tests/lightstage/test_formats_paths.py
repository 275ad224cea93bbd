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
    "said",
    [
        *("", "..", "../outside.txt", "frames/../../outside.txt", "frames/..", "/etc/passwd"),
        *("//etc", "a\0b", "a\nb", "\x1b[31m", "frames\\cam0.dng", "C:\\x", "\ud800", "\u202ea"),
        *("link-out", "link-out/outside.txt", "loop", "loop/x", None, 3, ["frames"], {"a": 1}),
    ],
)
def test_a_path_that_leaves_its_folder_is_refused(folder, said):
    with pytest.raises(FormatError) as told:
        path_inside(folder, said, "session.json", "frames[0].path")
    assert str(told.value).startswith("session.json, frames[0].path: found ")
    assert str(told.value).isprintable()


@pytest.mark.parametrize(
    "said", ["frames/cam0.dng", "frames/not there.dng", "link-in/cam0.dng", "a..b", "ä/😀.dng", "."]
)
def test_a_path_inside_the_folder_is_taken_as_it_is(folder, said):
    assert path_inside(folder, said, "session.json") == folder / said
    assert path_inside(folder.relative_to(folder.parent), said, "s") is not None


def test_a_path_of_any_length_ends_in_an_answer(folder):
    for said in ("x" * 5000, "x/" * 4000 + "x"):
        assert path_inside(folder, said, "s") == folder / said


def test_a_folder_that_is_a_link_itself_keeps_its_files(folder, tmp_path):
    os.symlink(folder, tmp_path / "short")
    assert path_inside(tmp_path / "short", "frames/cam0.dng", "s").read_bytes() == b"1"


@pytest.mark.parametrize(
    "said", ["cam0", "x+", "lin-x+", "olat-000", "full@cross", "Kamera_ä", "7"]
)
def test_a_plain_name_is_taken(said):
    assert check_name(said, "rig.json", "cameras[0].id") == said


@pytest.mark.parametrize(
    "said", ["", ".", "..", "../X", "a/b", ".hidden", "-x", "a b", "a\0", "a\n", "x" * 101, 3, None]
)
def test_an_id_that_names_no_file_is_refused(said):
    with pytest.raises(ConfigError, match=r"rig\.json, cameras\[0\]\.id: found .*becomes the name"):
        check_name(said, "rig.json", "cameras[0].id", ConfigError)
