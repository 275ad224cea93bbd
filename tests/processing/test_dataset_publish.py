"""Published patches hold the face's maps and nothing that says whose, where or in what order."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import zarr

from lightstage.errors import LightstageError
from lightstage.formats.processed import ProcessedFolder
from processing.dataset import PublishConfig, Store, build_store, open_store, publish

Make = Callable[..., Path]
SMALL = PublishConfig(patch_px=16, min_coverage=0.3, shard_patches=4)
SEED = 8675309886753098867
PEOPLE = ("anna-kowalska-77", "bo-larsson-12", "chidi-okoro-31")


@pytest.fixture
def store(tmp_path: Path, make_processed: Make) -> Store:
    roots = [
        make_processed(tmp_path / "in" / name, subject=name, expression="grin-wide", seed=index)
        for index, name in enumerate(PEOPLE)
    ]
    return open_store(build_store(roots, tmp_path / "store"))


def read(out: Path, name: str) -> np.ndarray:
    return np.asarray(zarr.open_array(out / "patches" / name, mode="r")[:])


def texel_places(store: Store, out: Path) -> list[tuple[int, int, int]]:
    """Where each published patch lay, found by comparing it with every place of every scan."""
    places = []
    for patch in read(out, "diffuse_albedo").astype(np.float32):
        found = []
        for scan in store.scans:
            whole = store.read(scan.index, "diffuse_albedo", slice(None), slice(None))
            windows = np.lib.stride_tricks.sliding_window_view(whole, (16, 16), axis=(0, 1))
            same = (windows == patch.transpose(2, 0, 1)).all(axis=(2, 3, 4))
            found += [(scan.index, int(r), int(c)) for r, c in np.argwhere(same)]
        assert len(found) == 1
        places += found
    return places


def test_no_two_patches_share_a_texel_and_all_hold_enough_face(
    tmp_path: Path, store: Store
) -> None:
    out = publish(store, tmp_path / "out", SEED, SMALL)
    places = texel_places(store, out)
    assert len(places) == json.loads((out / "dataset.json").read_text())["counts"]["patches"] > 20
    for scan in store.scans:
        used = np.zeros((scan.rows, scan.columns), int)
        for index, row, column in places:
            if index == scan.index:
                used[row : row + 16, column : column + 16] += 1
                seen = store.read(index, "confidence", slice(row, row + 16), slice(None))
                assert (seen[:, column : column + 16] > 0).mean() >= 0.3
        assert used.max() == 1


def test_the_order_is_shuffled_by_the_seed(tmp_path: Path, store: Store) -> None:
    first = texel_places(store, publish(store, tmp_path / "one", SEED, SMALL))
    again = texel_places(store, publish(store, tmp_path / "two", SEED, SMALL))
    other = texel_places(store, publish(store, tmp_path / "three", SEED + 1, SMALL))
    unknown = texel_places(store, publish(store, tmp_path / "four", None, SMALL))
    assert first == again
    assert sorted(first) == sorted(other) == sorted(unknown)
    assert len({tuple(order) for order in (first, other, unknown, sorted(first))}) == 4


def test_nothing_in_the_folder_names_a_person_a_place_or_the_seed(
    tmp_path: Path, store: Store
) -> None:
    out = publish(store, tmp_path / "out", SEED, SMALL)
    words = [*PEOPLE, "grin-wide", str(SEED), f"{SEED:x}", store.fingerprint, str(tmp_path)]
    words += ['subject"', "expression", "seed", "scan", "session"]
    binary = [SEED.to_bytes(8, "little"), SEED.to_bytes(8, "big")]
    files = [path for path in out.rglob("*") if path.is_file()]
    assert len(files) > 5
    for path in files:
        name = str(path.relative_to(out))
        data = path.read_bytes()
        assert not any(word in name for word in words)
        if path.suffix == ".json":
            assert not [word for word in words if word.encode() in data]
        assert not any(secret in data for secret in (*binary, *(p.encode() for p in PEOPLE)))


def test_shape_is_the_positions_with_the_patch_mean_removed(tmp_path: Path, store: Store) -> None:
    out = publish(store, tmp_path / "out", SEED, SMALL)
    shapes = read(out, "shape")
    for (scan, row, column), shape in zip(texel_places(store, out), shapes, strict=True):
        rows, columns = slice(row, row + 16), slice(column, column + 16)
        seen = store.read(scan, "confidence", rows, columns)[:, :, 0] > 0
        position = store.read(scan, "position", rows, columns)[seen].astype(float)
        np.testing.assert_allclose(shape[seen], position - position.mean(axis=0), atol=1e-4)
        assert not shape[~seen].any()
        assert abs(shape[seen].mean(axis=0)).max() < 1e-4


def test_statistics_need_enough_people(tmp_path: Path, make_processed: Make) -> None:
    roots = [make_processed(tmp_path / str(i), subject=f"p{i}", seed=i) for i in range(3)]

    def statistics(count: int) -> dict:
        store = open_store(build_store(roots[:count], tmp_path / "store"))
        out = publish(store, tmp_path / "out", SEED, SMALL)
        return json.loads((out / "dataset.json").read_text())["statistics"]

    assert statistics(2) == {}
    shown = statistics(3)
    albedo = read(tmp_path / "out", "diffuse_albedo").astype(float)
    seen = read(tmp_path / "out", "diffuse_normal").any(axis=3)
    np.testing.assert_allclose(shown["diffuse_albedo_mean"], albedo[seen].mean(axis=0), rtol=1e-6)
    np.testing.assert_allclose(shown["shape_mean"], 0, atol=1e-4)


def test_what_it_cannot_protect_is_said_in_the_folder(tmp_path: Path, store: Store) -> None:
    out = publish(store, tmp_path / "out", SEED, SMALL)
    said = json.loads((out / "dataset.json").read_text())["cannot_protect"]
    for word in ("moles", "join", "consent"):
        assert word in said


def test_maps_smaller_than_a_patch_are_refused(tmp_path: Path, store: Store) -> None:
    with pytest.raises(LightstageError, match="smaller one"):
        publish(store, tmp_path / "out" / "published", SEED)
    assert not (tmp_path / "out").exists() or not list((tmp_path / "out").iterdir())


def test_publishing_into_the_store_is_refused(store: Store) -> None:
    with pytest.raises(LightstageError, match="outside"):
        publish(store, store.path / "public", SEED, SMALL)


def test_an_interrupt_leaves_nothing(tmp_path: Path, store: Store) -> None:
    def interrupt(done: int, total: int) -> None:
        if done > 6:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        publish(store, tmp_path / "out" / "published", SEED, SMALL, interrupt)
    assert list((tmp_path / "out").iterdir()) == []


def test_a_published_set_is_not_opened_as_a_store(tmp_path: Path, store: Store) -> None:
    with pytest.raises(LightstageError, match="published"):
        open_store(publish(store, tmp_path / "out", SEED, SMALL))


def test_unmeasured_texels_publish_nothing(tmp_path: Path, make_processed: Make) -> None:
    root = make_processed(tmp_path / "a")
    folder = ProcessedFolder(root)
    folder.write_atlas("diffuse_albedo", np.full((96, 64, 3), 0.75))
    out = publish(open_store(build_store([root], tmp_path / "s")), tmp_path / "out", SEED, SMALL)
    seen = read(out, "diffuse_normal").any(axis=3)
    albedo = read(out, "diffuse_albedo")
    assert (albedo[seen] == 0.75).all()
    assert not albedo[~seen].any()
    assert not seen.all()
