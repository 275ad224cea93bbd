"""Commands that work on one store at once, and those of whose processes somebody killed one."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from lightstage.errors import LightstageError
from lightstage.formats.files import abandoned_beside, atomic_folder
from lightstage.formats.lock import being_filled, locked
from processing.dataset import Store, build_store, open_store, remove_scans, verify_store
from processing.dataset.changes import LOCK
from tests.processing.releases import PEOPLE, SMALL, publish, small_store

Make = Callable[..., Path]
HELD = LightstageError("held")


@pytest.fixture
def store(tmp_path: Path, make_processed: Make) -> Store:
    return open_store(small_store(tmp_path, make_processed).path)


def recorded(store: Store) -> list[list[str]]:
    """The scans of each release that a store knows."""
    file = store.path / "releases.jsonl"
    lines = file.read_text().splitlines() if file.is_file() else []
    return [json.loads(line)["scans"] for line in lines]


def test_a_release_is_recorded_under_the_stores_lock(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("processing.dataset.changes.RELEASE_LOCK_S", 0.0, raising=False)
    with (
        locked(store.path / LOCK, HELD),
        pytest.raises(LightstageError, match="another process has been changing for 0 s"),
    ):
        publish(store, tmp_path / "PUB", config=SMALL)
    assert recorded(store) == []
    assert not (tmp_path / "PUB").exists()
    publish(store, tmp_path / "PUB", config=SMALL)
    assert recorded(store) == [[scan.sha256 for scan in store.scans]]


def test_a_release_of_people_who_left_the_store_meanwhile_is_refused(
    store: Store, tmp_path: Path
) -> None:
    def leave(done: int, total: int) -> None:
        if done == total:
            remove_scans(store.path, [store.scans[1].folder])

    with pytest.raises(LightstageError, match="1 scan went while the release was made"):
        publish(store, tmp_path / "PUB", config=SMALL, progress=leave)
    assert recorded(store) == []
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in", "store"]


def test_who_waits_for_a_folder_that_is_replaced_gets_the_lock_of_the_new_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import fcntl

    path, flock = tmp_path / "lock", fcntl.flock
    (tmp_path / "new").touch()

    def replaced_first(*args: int) -> None:
        if (tmp_path / "new").exists():
            (tmp_path / "new").rename(path)
        flock(*args)

    monkeypatch.setattr("lightstage.formats.lock.fcntl.flock", replaced_first)
    with locked(path, HELD), pytest.raises(LightstageError, match="held"), locked(path, HELD):
        raise AssertionError("two have the lock")


def half_filled(path: Path, marker: str) -> Path:
    """What `atomic_folder` leaves at `path` where its process is killed."""
    code = (
        "import os, sys\n"
        "from pathlib import Path\n"
        "from lightstage.formats.files import atomic_folder\n"
        "with atomic_folder(Path(sys.argv[1]), sys.argv[2]) as beside:\n"
        "    (beside / 'half').write_text('half')\n"
        "    os._exit(0)\n"
    )
    subprocess.run([sys.executable, "-c", code, path, marker], check=True)
    (left,) = (each for each in path.parent.iterdir() if each.name.startswith(f".{path.name}."))
    return left


def test_what_a_killed_process_left_of_a_folder_goes_with_the_next_one_of_its_name(
    tmp_path: Path,
) -> None:
    for name in ("out", "out.v2", "out[1]"):
        left = half_filled(tmp_path / name, "mark")
        assert abandoned_beside(tmp_path / name) == [left]
        with atomic_folder(tmp_path / name, "mark") as beside:
            assert not left.exists()
            assert abandoned_beside(tmp_path / name) == []
            with pytest.raises(KeyError, match="another"), atomic_folder(tmp_path / name, "mark"):
                raise KeyError("another")
            assert beside.is_dir()  # since somebody fills it
        assert (tmp_path / name).is_dir()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "out.v2", "out[1]"]


def test_a_folder_that_a_killed_process_had_moved_away_is_put_back(tmp_path: Path) -> None:
    moved = tmp_path / ".out.0123abcd.old"
    moved.mkdir()
    (moved / "mark").write_text("old")
    (tmp_path / ".out.0123abcd").mkdir()
    with pytest.raises(KeyError), atomic_folder(tmp_path / "out", "mark") as beside:
        raise KeyError(beside)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert (tmp_path / "out" / "mark").read_text() == "old"


def test_verify_names_what_killed_processes_left_and_the_next_change_removes_it(
    store: Store, tmp_path: Path, run_command: Callable[..., Any]
) -> None:
    scans = store.path / "scans"
    orphan, adding = scans / ("0" * 16), scans / ".adding-01234567"
    for folder in (orphan, adding, scans / "mine"):
        folder.mkdir()
    half = half_filled(store.path, "dataset.json")
    with being_filled(lambda: scans / ".adding-89abcdef"):
        _, left = verify_store(store.path)
        assert left == [adding.name, orphan.name, "mine", str(half)]
        ended = run_command("processing", "dataset", "verify", store.path)
        assert f"{orphan.name}, mine, {half}: of no scan, left by processes" in ended.out
        remove_scans(store.path, [store.scans[1].folder])
        assert verify_store(store.path)[1] == ["mine", str(half)]
        assert (scans / ".adding-89abcdef").is_dir()
    build_store([tmp_path / "in" / PEOPLE[0]], store.path)
    assert not half.exists()


def test_a_removed_scan_that_cannot_go_from_the_disk_is_reported(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(path: Path, *rest: Any, **more: Any) -> None:
        if not more.get("ignore_errors"):
            raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr("processing.dataset.changes.shutil.rmtree", refused)
    with pytest.raises(PermissionError):
        remove_scans(store.path, [store.scans[1].folder])
