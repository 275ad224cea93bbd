"""The files of a release: one zarr group or tars, with checksums, that tell nothing beside."""

from __future__ import annotations

import dataclasses
import io
import json
import shutil
import struct
import tarfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
import zarr

from lightstage.errors import ConfigError
from lightstage.formats.files import sha256_file
from processing.dataset import PublishConfig, Store, build_store
from processing.dataset.release_files import CHANNELS as PUBLISHED
from processing.dataset.release_files import FILE_TIME_S
from tests.processing.releases import (
    ABOUT_FILE,
    PEOPLE,
    SEED,
    SIZE,
    SMALL,
    Make,
    publish,
    read,
    small_store,
)


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory, make_processed: Make) -> Store:
    return small_store(tmp_path_factory.mktemp("small"), make_processed)


def test_the_whole_set_opens_as_one_zarr_group(tmp_path: Path, store: Store) -> None:
    out = publish(store, tmp_path / "out", SEED, SMALL)
    group = zarr.open_group(out, mode="r")
    facts = json.loads((out / "dataset.json").read_text())
    assert dict(group.arrays()).keys() == facts["channels"].keys()
    for name, channels in facts["channels"].items():
        assert group[name].shape == (facts["counts"]["patches"], SIZE, SIZE, channels)
    assert sorted(p.name for p in out.iterdir()) == sorted(
        [
            "DATASHEET.md",
            "checksums.json",
            "croissant.json",
            "dataset.json",
            "zarr.json",
            *facts["channels"],
        ]
    )


def patches_in(out: Path) -> list[dict[str, np.ndarray]]:
    """The samples of tars in webdataset's naming, by the standard library alone."""
    samples: dict[str, dict[str, np.ndarray]] = {}
    for path in sorted(out.glob("*.tar")):
        with tarfile.open(path) as tar:
            for member in tar:
                key, _, name = member.name.partition(".")
                file = tar.extractfile(member)
                assert file is not None
                data = io.BytesIO(file.read())
                samples.setdefault(key, {})[name.removesuffix(".npy")] = np.load(data)
    return list(samples.values())


def test_tars_hold_the_patches_of_the_zarr_group_in_its_order(
    tmp_path: Path, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("processing.dataset.release_files.TAR_PATCHES", 5)
    arrays = publish(store, tmp_path / "zarr", SEED, SMALL)
    tars = publish(store, tmp_path / "tars", SEED, dataclasses.replace(SMALL, form="webdataset"))
    samples = patches_in(tars)
    assert len(samples) == len(read(arrays, "shape")) > 5
    for name in ("diffuse_albedo", "specular_albedo", "specular_normal", "shape"):
        np.testing.assert_array_equal(np.stack([s[name] for s in samples]), read(arrays, name))
    assert len(list(tars.glob("*.tar"))) == -(-len(samples) // 5)
    two = [json.loads((each / "dataset.json").read_text()) for each in (arrays, tars)]
    assert two[0] == two[1]


def test_files_in_a_tar_show_no_time_no_owner_and_no_patch_by_their_size(
    tmp_path: Path, store: Store
) -> None:
    out = publish(store, tmp_path / "out", SEED, dataclasses.replace(SMALL, form="webdataset"))
    with tarfile.open(next(out.glob("*.tar"))) as tar:
        members = tar.getmembers()
    assert {(m.mtime, m.uid, m.gid, m.uname, m.gname) for m in members} == {(0, 0, 0, "", "")}
    sizes: dict[str, set[int]] = {}
    for member in members:
        sizes.setdefault(member.name.partition(".")[2], set()).add(member.size)
    assert all(len(each) == 1 for each in sizes.values())
    # What webdataset takes for one sample stands together.
    keys = [member.name.partition(".")[0] for member in members]
    assert keys == sorted(keys)


@pytest.mark.parametrize("form", ["zarr", "webdataset"])
def test_every_file_of_a_release_has_a_checksum(
    tmp_path: Path, store: Store, form: Literal["zarr", "webdataset"]
) -> None:
    out = publish(store, tmp_path / "out", SEED, dataclasses.replace(SMALL, form=form))
    sums = json.loads((out / "checksums.json").read_text())["files"]
    there = {str(p.relative_to(out)) for p in out.rglob("*") if p.is_file()} - {"checksums.json"}
    assert sums == {name: sha256_file(out / name) for name in there}


@pytest.mark.parametrize("form", ["zarr", "webdataset"])
def test_files_of_a_release_show_no_time_and_parts_of_a_map_have_one_size(
    tmp_path: Path, store: Store, form: Literal["zarr", "webdataset"]
) -> None:
    out = publish(store, tmp_path / "out", SEED, dataclasses.replace(SMALL, form=form))
    assert {path.stat().st_mtime for path in (out, *out.rglob("*"))} == {FILE_TIME_S}
    if form == "zarr":
        for name in PUBLISHED:
            array = zarr.open_array(out / name, mode="r")
            whole = array.shape[0] // array.shards[0]
            sizes = [(out / name / f"c/{i}/0/0/0").stat().st_size for i in range(whole)]
            assert whole > 5
            assert len(set(sizes)) == 1
            # An index of offsets and sizes ends each file.
            parts = struct.unpack(
                f"<{2 * array.shards[0]}Q",
                (out / name / "c/0/0/0/0").read_bytes()[-16 * array.shards[0] - 4 : -4],
            )
            assert len(set(parts[1::2])) == 1


def test_a_set_that_is_there_is_replaced_as_a_whole_and_only_when_told(
    tmp_path: Path, store: Store, run_command: Callable[..., Any]
) -> None:
    out = tmp_path / "out"
    words = ("dataset", "publish", store.path, "--about", ABOUT_FILE, "--out", out, "--patch", 16)
    assert run_command("processing", *words).code == 0
    first = contents(out)
    again = run_command("processing", *words)
    assert again.code == 2
    assert "pass --overwrite" in again.err
    assert contents(out) == first
    (out / "LICENSE").write_text("ours")
    refused = run_command("processing", *words, "--overwrite")
    assert refused.code == 2
    assert f"{out}: found LICENSE, which the command did not make" in refused.err
    (out / "LICENSE").unlink()
    assert contents(out) == first
    tars = run_command("processing", *words, "--format", "webdataset", "--overwrite")
    assert tars.code == 0, tars.err
    assert {path.suffix for path in out.iterdir()} == {".tar", ".json", ".md"}
    assert sorted(tmp_path.glob(".*")) == []
    assert run_command("processing", *words, "--overwrite").code == 0
    # The lab knows of all: those of the shared store that went to this place.
    lines = (store.path / "releases.jsonl").read_text().splitlines()
    assert [json.loads(line)["out"] for line in lines].count(str(out)) == 3


def test_of_two_that_publish_to_one_place_at_once_one_is_there_whole(
    tmp_path: Path, store: Store
) -> None:
    out, between = tmp_path / "out", []

    def other(done: int, total: int) -> None:
        if done == total and not between:
            between.append(contents(publish(store, out, SEED + 1, SMALL)))

    publish(store, out, SEED, SMALL, other)
    sums = json.loads((out / "checksums.json").read_text())["files"]
    assert sums == {name: sha256_file(out / name) for name in sums}
    assert contents(out) != between[0]
    assert sorted(tmp_path.glob(".*")) == []


def contents(folder: Path) -> dict[str, bytes]:
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


@pytest.mark.parametrize("form", ["zarr", "webdataset"])
def test_verify_names_what_is_missing_changed_and_foreign_in_a_release(
    tmp_path: Path,
    store: Store,
    run_command: Callable[..., Any],
    form: Literal["zarr", "webdataset"],
) -> None:
    out = publish(store, tmp_path / "out", SEED, dataclasses.replace(SMALL, form=form))
    whole = run_command("processing", "dataset", "verify", out)
    assert whole.code == 0, whole.err
    listed = json.loads((out / "checksums.json").read_text())["files"]
    assert f"a release, {len(listed)} files as they were published" in whole.out
    changed = next(name for name in listed if name.endswith(("/c/0/0/0/0", ".tar")))
    data = bytearray((out / changed).read_bytes())
    data[len(data) // 2] ^= 1
    (out / changed).write_bytes(data)
    (out / "DATASHEET.md").unlink()
    (out / "notes.txt").write_text("mine")
    ended = run_command("processing", "dataset", "verify", out)
    assert ended.code == 2
    assert (
        f"{out}: found DATASHEET.md is missing; notes.txt is not of the release; {changed} has "
        "changed, expected the files that were published. Copy the release again"
    ) in " ".join(ended.err.split())
    (out / "checksums.json").write_text('{"schema": "lightstage.checksums/1", "files": [1]}')
    ended = run_command("processing", "dataset", "verify", out)
    assert ended.code == 2
    assert "checksums.json, files: found list, expected an object" in ended.err


def test_a_command_of_scans_does_not_speak_of_training_where_it_is_given_a_release(
    tmp_path: Path, store: Store, run_command: Callable[..., Any]
) -> None:
    out = publish(store, tmp_path / "out", SEED, SMALL)
    for words in (("list", out), ("remove", "--subject", "bo", "--store", out)):
        ended = run_command("processing", "dataset", *words)
        assert ended.code == 2
        assert "found 'published', expected 'store'" in ended.err
        assert "dataset verify" in ended.err
        assert "training" not in ended.err


def test_a_form_that_there_is_none_of_is_refused() -> None:
    with pytest.raises(ConfigError, match="format: found 'csv', expected zarr or webdataset"):
        PublishConfig(form="csv")  # type: ignore[arg-type]


def test_another_release_of_the_same_name_and_version_is_warned_of(
    tmp_path: Path, make_processed: Make, run_command: Callable[..., Any]
) -> None:
    store = small_store(tmp_path / "lab", make_processed).path
    words = ("dataset", "publish", store, "--patch", 16, "--json", "--about")

    def warnings(about: Path, out: Path, *more: str) -> list[str]:
        ended = run_command("processing", *words, about, "--out", out, *more)
        assert ended.code == 0, ended.err
        found: list[str] = json.loads(ended.out.splitlines()[-1])["warnings"]
        assert all(f"warning: {each}" in ended.err for each in found)
        return found

    first, second = tmp_path / "1" / "PUB", tmp_path / "2" / "PUB"
    later = tmp_path / "later.toml"
    later.write_text(ABOUT_FILE.read_text().replace('"1.0.0"', '"2.0.0"'))
    assert warnings(ABOUT_FILE, first) == []
    (warning,) = warnings(ABOUT_FILE, second)
    name = "Skin patches of simulated people"
    assert warning.startswith(f"version 1.0.0 of {name!r} is that of {first} too")
    assert 'such as "2.0.0"' in warning
    assert warnings(later, second, "--overwrite") == []
    # Of another store, in a place and beside it; and what was moved away since it was recorded.
    other = build_store([tmp_path / "lab" / "in" / PEOPLE[0]], tmp_path / "other")
    words = ("dataset", "publish", other, *words[3:])
    (warning,) = warnings(later, tmp_path / "2" / "OTHER")
    assert f"is that of {second} too" in warning
    (warning,) = warnings(ABOUT_FILE, first, "--overwrite")
    assert f"is that of {first} too" in warning
    shutil.rmtree(tmp_path / "2")
    (warning,) = warnings(later, tmp_path / "3" / "PUB")
    assert f"is that of {tmp_path / '2' / 'OTHER'} too" in warning
