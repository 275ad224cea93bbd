"""The locks of LED devices' addresses: where they are, whom they exclude, and unsafe folders."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from lightstage.errors import DeviceError
from lightstage.leds import connection
from lightstage.leds.connection import lock_address

HOLDER = (
    "import os, sys\n"
    "from lightstage.leds.connection import lock_address\n"
    "lock = lock_address(sys.argv[1])\n"
    "print('held', flush=True)\n"
    "sys.stdin.read()\n"
)


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The system's temporary folder, empty."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setattr(connection, "BUSY_WAIT_S", 0.0)
    return folder


@pytest.fixture
def holder(temporary: Path) -> Iterator[subprocess.Popen[str]]:
    """Another process that has the address "tcp a:1"."""
    words = [sys.executable, "-c", HOLDER, "tcp a:1"]
    with subprocess.Popen(
        words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        yield process
        process.kill()


def test_locks_are_in_one_folder_that_is_this_users_alone(temporary: Path) -> None:
    with lock_address("tcp a:1"), lock_address("udp a:1"):
        (folder,) = temporary.iterdir()
        assert folder.name == f"lightstage-{os.getuid()}"
        assert stat.S_IMODE(folder.lstat().st_mode) == 0o700
        assert len(list(folder.glob("*.lock"))) == 2


def test_an_address_that_another_process_has_is_refused_until_it_ends(
    holder: subprocess.Popen[str],
) -> None:
    with lock_address("tcp b:1"):
        pass
    with pytest.raises(DeviceError, match="tcp a:1: found another program that is using it"):
        lock_address("tcp a:1")
    holder.kill()
    holder.wait()
    lock_address("tcp a:1").close()


def test_a_lock_file_of_long_ago_is_used_again_and_looks_new_to_cleaners(temporary: Path) -> None:
    lock_address("tcp a:1").close()
    (path,) = temporary.rglob("*.lock")
    os.utime(path, (0, 0))
    with lock_address("tcp a:1"):
        assert [*temporary.rglob("*.lock")] == [path]
        assert path.stat().st_mtime > 1e9


@pytest.mark.parametrize("wrong", ["open to others", "a link", "a file", "another user's"])
def test_a_folder_that_others_can_reach_is_refused_by_name(
    temporary: Path, tmp_path: Path, wrong: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if wrong == "another user's":
        own = os.getuid()
        monkeypatch.setattr(os, "getuid", lambda: own + 1)
    folder = temporary / f"lightstage-{os.getuid()}"
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir(mode=0o700)
    if wrong == "a link":
        folder.symlink_to(elsewhere)
    elif wrong == "a file":
        folder.touch()
    else:
        folder.mkdir(mode=0o700)
    if wrong == "open to others":
        folder.chmod(0o755)
    with pytest.raises(DeviceError, match=r"TMPDIR") as refused:
        lock_address("tcp a:1")
    assert str(folder) in str(refused.value)
    assert not list(elsewhere.iterdir())
    assert not list(temporary.rglob("*.lock"))
