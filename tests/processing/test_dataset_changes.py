"""Scans come and go one by one, beside others who do the same and who read; hashes tell damage."""

from __future__ import annotations

import functools
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lightstage.errors import LightstageError
from lightstage.formats.files import write_json
from lightstage.formats.processed import ProcessedFolder
from processing.dataset import add_scan, build_store, open_store, remove_scans, verify_store
from processing.dataset.contents import HISTORY, scans_of_fingerprint

Make = Callable[..., Path]
ALL = slice(None)


@pytest.fixture
def people(tmp_path: Path, make_processed: Make) -> list[Path]:
    return [
        make_processed(tmp_path / f"p{i}", subject=f"person-{i}", seed=i, rows=48, columns=32)
        for i in range(4)
    ]


@pytest.fixture
def command(run_command: Callable[..., Any]) -> Callable[..., Any]:
    return functools.partial(run_command, "processing", "dataset")


def files_of(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def about(store: Path) -> dict[str, Any]:
    return dict(json.loads((store / "dataset.json").read_text()))


def test_scans_added_one_by_one_make_the_store_that_build_makes(
    people: list[Path], tmp_path: Path
) -> None:
    whole = build_store(people, tmp_path / "whole")
    grown = build_store(people[:1], tmp_path / "grown")
    for root in people[1:]:
        add_scan(grown, root)
    own = {name: data for name, data in files_of(whole).items() if name != HISTORY}
    other = files_of(grown)
    assert {name: other[name] for name in own} == own
    assert set(other) - set(own) == {HISTORY, "store.lock"}


def test_a_scan_less_is_the_store_without_it(people: list[Path], tmp_path: Path) -> None:
    store = build_store(people, tmp_path / "store")
    gone = open_store(store).scans[1]
    remove_scans(store, [gone.folder])
    left = build_store([people[0], *people[2:]], tmp_path / "left")
    assert about(store) == about(left)
    assert not (store / "scans" / gone.folder).exists()
    np.testing.assert_array_equal(
        open_store(store).read(1, "position", ALL, ALL),
        open_store(left).read(1, "position", ALL, ALL),
    )
    assert verify_store(store)[1] == []


def test_who_reads_a_store_goes_on_while_a_scan_is_added(
    people: list[Path], tmp_path: Path
) -> None:
    store = build_store(people[:2], tmp_path / "store")
    opened = open_store(store)
    before = opened.read(0, "diffuse_albedo", ALL, ALL)
    add_scan(store, people[2])
    np.testing.assert_array_equal(opened.read(0, "diffuse_albedo", ALL, ALL), before)
    assert opened.read(1, "confidence", ALL, ALL).any()
    assert len(opened.scans) == 2
    assert len(open_store(store).scans) == 3


def test_adding_reads_no_other_scan(people: list[Path], tmp_path: Path) -> None:
    store = build_store(people[:2], tmp_path / "store")
    for scan in open_store(store).scans:
        shutil.rmtree(store / "scans" / scan.folder)
    add_scan(store, people[2])
    assert [s.subject for s in open_store(store).scans] == ["person-0", "person-1", "person-2"]


def test_processes_that_add_at_once_lose_no_scan(people: list[Path], tmp_path: Path) -> None:
    store = build_store(people[:1], tmp_path / "store")
    code = "import sys; from pathlib import Path; from processing.dataset import add_scan; "
    code += "add_scan(Path(sys.argv[1]), Path(sys.argv[2]))"
    adding = [subprocess.Popen([sys.executable, "-c", code, store, root]) for root in people[1:3]]
    assert [each.wait() for each in adding] == [0, 0]
    assert {s.subject for s in open_store(store).scans} == {f"person-{i}" for i in range(3)}
    assert verify_store(store)[1] == []


def test_a_store_that_is_built_anew_takes_and_loses_no_scan_meanwhile(
    people: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("processing.dataset.changes.LOCK_S", 0.0)
    store = build_store(people[:2], tmp_path / "store")
    refused = []

    def others(done: int, total: int) -> None:
        del total
        first = open_store(store).scans[0].folder
        for change in (lambda: add_scan(store, people[2]), lambda: remove_scans(store, [first])):
            with pytest.raises(LightstageError, match="another process has been changing") as error:
                change()
            refused.append((done, error.value))

    build_store(people[:2], store, others)
    assert [done for done, _ in refused] == [1, 1, 2, 2]
    assert len(open_store(store).scans) == 2
    add_scan(store, people[2])
    assert verify_store(store)[1] == []


def test_what_a_killed_process_left_is_no_scan_and_stops_nothing(
    people: list[Path], tmp_path: Path
) -> None:
    whole = build_store(people[:2], tmp_path / "whole")
    store = build_store(people[:1], tmp_path / "store")
    orphan = open_store(whole).scans[1].folder
    (store / "scans" / orphan / "position").mkdir(parents=True)
    (store / "scans" / ".adding-01234567").mkdir()
    assert len(open_store(store).scans) == 1
    assert verify_store(store)[1] == [".adding-01234567", orphan]
    assert add_scan(store, people[1]) == orphan
    assert verify_store(store)[1] == []


def test_a_changed_a_missing_and_a_foreign_file_are_named(
    people: list[Path], tmp_path: Path, command: Callable[..., Any]
) -> None:
    store = build_store(people, tmp_path / "store")
    ended = command("verify", store)
    assert ended.code == 0
    assert "4 scans" in ended.out
    folders = [store / "scans" / scan.folder for scan in open_store(store).scans]
    shard = folders[0] / "position" / "c" / "0" / "0" / "0"
    data = bytearray(shard.read_bytes())
    data[len(data) // 2] ^= 1
    shard.write_bytes(data)
    (folders[1] / "confidence" / "zarr.json").unlink()
    (folders[2] / "notes.txt").write_text("mine")
    listed = folders[3] / "shards.json"
    listed.write_text(listed.read_text().replace("position", "attitude"))
    ended = command("verify", store)
    assert ended.code == 2
    for message in (
        "4 problems",
        "person-0, neutral: found position/c/0/0/0 has changed",
        "found confidence/zarr.json is missing",
        "found notes.txt is not of the store",
        "shards.json: found another list of hashes",
    ):
        assert message in ended.err


def test_what_does_not_fit_is_refused_and_the_store_is_as_it_was(
    people: list[Path], tmp_path: Path, make_processed: Make
) -> None:
    store = build_store(people[:2], tmp_path / "store")
    before = files_of(store)
    other_size = make_processed(tmp_path / "large", subject="person-9", rows=96, columns=64)
    for root, message in (
        (people[0], "the same files as scan"),
        (other_size, "96 x 64 texels, expected 48 x 32"),
        (tmp_path / "none", "no such folder"),
    ):
        with pytest.raises(LightstageError, match=message):
            add_scan(store, root)
    for names, message in ((["nobody"], "names of scans in it"), (["x", "y"], "'x', 'y'")):
        with pytest.raises(LightstageError, match=message):
            remove_scans(store, names)
    with pytest.raises(LightstageError, match="no scan that would be left"):
        remove_scans(store, [scan.folder for scan in open_store(store).scans])
    after = files_of(store)
    after.pop("store.lock", None)
    assert after == before


def test_a_store_of_an_earlier_version_is_read_and_not_added_to(
    people: list[Path], tmp_path: Path
) -> None:
    store = build_store(people[:2], tmp_path / "store")
    value = about(store)
    value["schema"] = "lightstage.realfacedb/1"
    for index, scan in enumerate(value["scans"]):
        os.rename(store / "scans" / scan["folder"], store / "scans" / f"{index:04d}")
        for key in ("folder", "shards_sha256", "sums"):
            del scan[key]
    write_json(store / "dataset.json", value)
    assert open_store(store).read(1, "confidence", ALL, ALL).any()
    with pytest.raises(LightstageError, match="Build it again"):
        add_scan(store, people[2])
    with pytest.raises(LightstageError, match="Build it again"):
        verify_store(store)


def test_the_history_names_which_scans_a_fingerprint_stood_for(
    people: list[Path], tmp_path: Path
) -> None:
    store = build_store(people[:2], tmp_path / "store")
    stood = {}
    for change in (
        lambda: None,
        lambda: add_scan(store, people[2]),
        lambda: remove_scans(store, [open_store(store).scans[0].folder]),
        lambda: build_store(people[2:], store),
    ):
        change()
        opened = open_store(store)
        stood[opened.fingerprint] = {scan.sha256 for scan in opened.scans}
    assert scans_of_fingerprint(store) == stood
    assert "person" not in (store / HISTORY).read_text()


def test_the_commands_add_list_and_remove_by_scan_and_by_subject(
    people: list[Path], tmp_path: Path, command: Callable[..., Any]
) -> None:
    store = build_store(people[:2], tmp_path / "store")
    ended = command("add", people[2], people[3], "--store", store)
    assert ended.code == 0, ended.err
    assert "2 scans added, 4 scans of 4 subjects" in ended.out
    listed = command("list", store)
    first = open_store(store).scans[0]
    assert listed.code == 0
    assert f"{first.folder}  person-0  neutral  48 x 32  C-0001" in listed.out
    ended = command("remove", first.folder, "--subject", "person-3", "--store", store)
    assert ended.code == 0, ended.err
    assert [s.subject for s in open_store(store).scans] == ["person-1", "person-2"]
    ended = command("remove", "--subject", "person-3", "--store", store)
    assert ended.code == 2
    assert "person-3" in ended.err
    ended = command("remove", "--store", store)
    assert ended.code == 2


def test_a_store_of_1400_scans_is_listed_in_a_small_file_of_plain_json(
    people: list[Path], tmp_path: Path
) -> None:
    store = build_store(people[:1], tmp_path / "store")
    value = about(store)
    only = value["scans"][0]
    value["scans"] = [
        {**only, "subject": f"person-{i // 7}", "folder": f"{i:016x}", "sha256": f"{i:064x}"}
        for i in range(1400)
    ]
    write_json(store / "dataset.json", value)
    assert (store / "dataset.json").stat().st_size < 4e6
    assert len(open_store(store).scans) == 1400
    folder = add_scan(store, people[1])
    opened = open_store(store)
    assert opened.scans[-1].folder == folder
    stored = opened.read(1400, "specular_albedo", ALL, ALL)[..., 0]
    atlas = ProcessedFolder(people[1]).read_atlas("specular_albedo")
    np.testing.assert_allclose(stored, atlas, atol=1e-4)
