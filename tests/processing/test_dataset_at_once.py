"""Commands that work on one store at once, and those of whose processes somebody killed one."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from lightstage.errors import LightstageError
from lightstage.formats.lock import locked
from processing.dataset import Store, open_store, remove_scans
from processing.dataset.changes import LOCK
from tests.processing.releases import SMALL, publish, small_store

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
