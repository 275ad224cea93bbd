"""Sockets lie where nobody else gets at them, and dead captures leave none."""

import os
import socket
import stat
import subprocess
import sys

import pytest

from lightstage.errors import CaptureError
from lightstage.operator import runtime as module
from lightstage.operator.runtime import new_socket_path, remove_stale


def bound(path):
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    listener.bind(str(path))
    return listener


def dead_process():
    child = subprocess.Popen([sys.executable, "-c", ""])
    child.wait()
    return child.pid


def test_the_folder_is_this_users_alone(runtime):
    path = new_socket_path()
    assert path.parent == runtime
    assert stat.S_IMODE(os.lstat(runtime).st_mode) == 0o700
    assert path.name.startswith(f"{os.getpid()}-")
    assert new_socket_path() != path


@pytest.mark.parametrize("wrong", ["open to others", "a link", "a file", "a long name"])
def test_a_folder_that_is_not_safe_or_not_short_is_not_used(runtime, wrong, monkeypatch, tmp_path):
    if wrong == "open to others":
        runtime.mkdir()
        runtime.chmod(0o755)
    elif wrong == "a link":
        (tmp_path / "elsewhere").mkdir(mode=0o700)
        runtime.symlink_to(tmp_path / "elsewhere")
    elif wrong == "a file":
        runtime.write_text("")
    else:
        long = tmp_path / ("l" * 90)
        long.mkdir()
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(long))
    path = new_socket_path()
    assert path.parent.name == f"lightstage-{os.getuid()}"
    assert len(os.fsencode(path)) <= 100


def test_without_any_folder_it_is_reported_what_to_set(monkeypatch):
    monkeypatch.setattr(module, "own_folder", lambda _: False)
    with pytest.raises(CaptureError, match="Set XDG_RUNTIME_DIR"):
        new_socket_path()


def test_sockets_of_dead_captures_go_and_all_others_stay(runtime):
    runtime.mkdir(mode=0o700)
    dead = dead_process()
    gone = runtime / f"{dead}-aaaa.sock"
    bound(gone).close()
    living = runtime / f"{os.getpid()}-bbbb.sock"
    bound(living).close()  # its process lives: it may be about to listen
    inherited = runtime / f"{dead}-cccc.sock"
    listener = bound(inherited)  # whoever made it is dead, but somebody answers
    listener.listen()
    other = runtime / "notes.sock"
    other.write_text("")
    assert remove_stale(runtime) == [gone]
    assert sorted(p.name for p in runtime.iterdir()) == sorted(
        p.name for p in (living, inherited, other)
    )
    listener.close()


def test_a_new_capture_cleans_up(runtime):
    runtime.mkdir(mode=0o700)
    gone = runtime / f"{dead_process()}-aaaa.sock"
    bound(gone).close()
    new_socket_path()
    assert not gone.exists()
