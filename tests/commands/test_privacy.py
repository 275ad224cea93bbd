"""Who may read what commands write, on a machine whose umask hides nothing."""

from __future__ import annotations

import os
import stat

import pytest

SHARED = {"patterns", "occlusion", "targets"}
"""Commands whose result shows nobody."""


@pytest.fixture(autouse=True)
def open_umask():
    before = os.umask(0)
    yield
    os.umask(before)


def modes_below(folder):
    return {
        str(path.relative_to(folder)): stat.S_IMODE(path.stat().st_mode)
        for path in folder.rglob("*")
    }


def test_what_shows_a_face_is_its_owners_alone_and_what_shows_nobody_follows_the_umask(
    command, request, tmp_path, run_command, world
):
    name = request.node.callspec.params["command"]
    ended = run_command(*command(tmp_path / "new" / "out"))
    assert ended.code == 0, ended
    found = modes_below(tmp_path / "new")
    assert found
    if name in SHARED:
        assert all(mode in (0o666, 0o777) for mode in found.values()), found
    else:
        # The group has what it has of the folder that was read, other users nothing.
        assert [path for path, mode in found.items() if mode & 0o007] == []
    assert os.umask(0) == 0


def test_the_group_gets_what_it_has_of_the_maps(tmp_path, run_command, world):
    words = ("learning", "bake", "--maps", world["mesh's maps"], "--mesh", world["mesh"])
    words += ("--environment", world["lights"])
    before = stat.S_IMODE(world["mesh's maps"].stat().st_mode)
    try:
        for folder, file in ((0o700, 0o600), (0o750, 0o640), (0o777, 0o660)):
            world["mesh's maps"].chmod(folder)
            out = tmp_path / f"{folder:o}.exr"
            assert run_command(*words, "--out", out).code == 0
            assert stat.S_IMODE(out.stat().st_mode) == file
    finally:
        world["mesh's maps"].chmod(before)


def test_a_command_that_was_refused_leaves_the_umask_as_it_was(run_command, tmp_path):
    assert run_command("learning", "bake", "--maps", tmp_path / "none").code == 2
    assert os.umask(0) == 0
