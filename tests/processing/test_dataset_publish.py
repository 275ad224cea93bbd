"""Published patches hold the face's maps and nothing that says whose, where or in what order."""

from __future__ import annotations

import dataclasses
import functools
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from lightstage.errors import ConfigError, LightstageError
from lightstage.formats.processed import ProcessedFolder
from processing.__main__ import app
from processing.dataset import PublishConfig, Store, build_store, open_store
from processing.dataset.places import CLEAR, clear_skin, places_of
from processing.dataset.protection import CANNOT_PROTECT
from processing.dataset.publish import published_places, read_patch
from tests.processing.releases import (
    ABOUT_FILE,
    GAP,
    PEOPLE,
    SEED,
    SIZE,
    SMALL,
    Make,
    open_in_memory,
    publish,
    read,
    small_store,
)

Found = tuple[int, int, int]


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory, make_processed: Make) -> Store:
    return small_store(tmp_path_factory.mktemp("small"), make_processed)


@pytest.fixture(scope="module")
def released(store: Store, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return publish(store, tmp_path_factory.mktemp("release") / "out", SEED, SMALL)


def unturned(picture: np.ndarray) -> list[np.ndarray]:
    """A patch in all eight ways that it may have lain."""
    return [np.rot90(p, k) for p in (picture, picture[:, ::-1]) for k in range(4)]


@functools.cache
def texel_places(store: Store, out: Path) -> list[Found]:
    """Where each published patch lay, found by comparing it with every place of every scan."""
    whole = [
        store.read(scan.index, "diffuse_albedo", slice(None), slice(None))
        * (store.read(scan.index, "confidence", slice(None), slice(None)) > 0)
        for scan in store.scans
    ]
    return [find(patch, whole) for patch in read(out, "diffuse_albedo").astype(np.float32)]


def find(patch: np.ndarray, whole: list[np.ndarray]) -> Found:
    found = set()
    for way in unturned(patch):
        brightest = np.unravel_index(int(way.sum(axis=2).argmax()), way.shape[:2])
        for scan, image in enumerate(whole):
            for row, column in np.argwhere((image == way[brightest]).all(axis=2)) - brightest:
                part = image[max(0, row) : row + SIZE, max(0, column) : column + SIZE]
                if part.shape == way.shape and (part == way).all():
                    found.add((scan, int(row), int(column)))
    assert len(found) == 1
    return found.pop()


def test_patches_lie_apart_by_the_gap_and_hold_enough_face(store: Store, released: Path) -> None:
    places = texel_places(store, released)
    facts = json.loads((released / "dataset.json").read_text())
    assert len(places) == len(set(places)) == facts["counts"]["patches"] > 30
    assert (facts["patch"], facts["gap"]) == (SIZE, GAP)
    for scan, row, column in places:
        rows, columns = slice(row, row + SIZE), slice(column, column + SIZE)
        assert (store.read(scan, "confidence", rows, columns) > 0).mean() >= 0.3
        for other, its_row, its_column in places:
            if other == scan and (row, column) != (its_row, its_column):
                assert max(abs(row - its_row), abs(column - its_column)) >= SIZE + GAP


def test_patches_lie_on_no_common_grid(store: Store) -> None:
    places = published_places(store, SMALL.layout(store), 1.0)
    assert len({place.row % (SIZE + GAP) for place in places}) > 5
    assert len({place.column % (SIZE + GAP) for place in places}) > 5


def test_patches_lie_where_they_lay_in_every_release(tmp_path: Path, make_processed: Make) -> None:
    """Patches of two releases that overlapped would stitch together what the gap keeps apart."""
    roots = [make_processed(tmp_path / f"{i}", 192, 128, subject=f"p{i}", seed=i) for i in range(3)]
    first = open_in_memory(build_store(roots, tmp_path / "one"))
    second = open_in_memory(build_store(roots[1:], tmp_path / "two"))
    layout = SMALL.layout(first)
    for scan in second.scans:
        before, after = (
            places_of(first, scan.index + 1, layout),
            places_of(second, scan.index, layout),
        )
        assert [(p.row, p.column, p.quarter_turns, p.mirrored) for p in before] == [
            (p.row, p.column, p.quarter_turns, p.mirrored) for p in after
        ]
        assert all((p.axes == q.axes).all() for p, q in zip(before, after, strict=True))


def test_all_expressions_of_a_person_have_the_same_places(
    tmp_path: Path, make_processed: Make
) -> None:
    """Two expressions show the same skin: patches of both that overlapped would join up, too."""
    names = ("brow_raise", "neutral", "smile")
    roots = [
        make_processed(tmp_path / name, 192, 128, expression=name, seed=index)
        for index, name in enumerate(names)
    ]
    roots.append(make_processed(tmp_path / "other", 192, 128, subject="other", seed=3))
    store = open_in_memory(build_store(roots, tmp_path / "all"))
    fewer = open_in_memory(build_store(roots[1:], tmp_path / "fewer"))
    layout = SMALL.layout(store)
    corners = [[(p.row, p.column) for p in places_of(store, i, layout)] for i in range(4)]
    assert corners[0] == corners[1] == corners[2] != corners[3]
    assert [(p.row, p.column) for p in places_of(fewer, 0, layout)] == corners[0]


def test_a_release_leaves_out_a_share_of_everybody_drawn_anew(
    tmp_path: Path, make_processed: Make
) -> None:
    roots = [make_processed(tmp_path / f"{i}", 192, 128, subject=f"p{i}", seed=i) for i in range(3)]
    everyone = open_in_memory(build_store(roots, tmp_path / "one"))
    fewer = open_in_memory(build_store(roots[:2], tmp_path / "two"))

    def patches(store: Store, name: str, seed: int | None, drop: float) -> set[bytes]:
        out = publish(store, tmp_path / name, seed, dataclasses.replace(SMALL, drop=drop))
        return {patch.tobytes() for patch in read(out, "diffuse_albedo")}

    whole, whole_fewer = patches(everyone, "w", SEED, 0.0), patches(fewer, "f", SEED, 0.0)
    assert whole_fewer < whole
    before = patches(everyone, "a", SEED, 0.4)
    again = patches(everyone, "b", None, 0.4)
    # The same seed, but another store: what is left out is not what was left out before.
    after = patches(fewer, "c", SEED, 0.4)
    assert 0.4 * len(whole) < len(before) < 0.8 * len(whole)
    assert before < whole
    assert before - again
    assert again - before
    gone = before - after
    assert 0.2 * len(gone) < len(gone & whole_fewer)
    assert after - before


def test_directions_and_shape_are_turned_and_mirrored_with_the_picture(
    store: Store, released: Path
) -> None:
    shape, normal = (
        read(released, "shape").astype(float),
        read(released, "specular_normal").astype(float),
    )
    along = [shape[:, 1:-1, 2:] - shape[:, 1:-1, :-2], shape[:, 2:, 1:-1] - shape[:, :-2, 1:-1]]
    own = np.cross(along[1], along[0])
    seen = normal.any(axis=3)
    inner = seen[:, 1:-1, 1:-1] & seen[:, :-2, 1:-1] & seen[:, 2:, 1:-1]
    inner &= seen[:, 1:-1, :-2] & seen[:, 1:-1, 2:]
    own /= np.maximum(np.linalg.norm(own, axis=3, keepdims=True), 1e-9)
    cosine = (own * normal[:, 1:-1, 1:-1]).sum(axis=3)[inner]
    # Outward on every patch: the frame's handedness is mirrored where the picture is.
    assert cosine.min() > 0.999
    means = np.stack([n[s].mean(axis=0) for n, s in zip(normal, seen, strict=True)])
    means /= np.linalg.norm(means, axis=1, keepdims=True)
    # In the head frame all normals of the half cylinder have z > 0 and y = 0.
    assert (means[:, 2] < 0).any()
    assert abs(means[:, 1]).max() > 0.5


def right_neighbours_found(store: Store, config: PublishConfig) -> float:
    """Share of the right neighbours that have the border most like a patch's own."""
    layout = config.layout(store)
    places = published_places(store, layout, 1.0)
    patches = np.stack([read_patch(store, p, SIZE)[0]["diffuse_albedo"] for p in places])
    found = []
    for index, place in enumerate(places):
        beside = [
            other
            for other, its in enumerate(places)
            if its.scan == place.scan
            and abs(its.row - place.row) <= layout.wander
            and SIZE <= its.column - place.column <= SIZE + layout.gap + 2 * layout.wander
        ]
        if beside:
            differences = abs(patches[:, :, 0] - patches[index, :, -1]).sum(axis=(1, 2))
            found.append(int(differences.argmin()) in beside)
    assert len(found) > 8
    return float(np.mean(found))


def test_neighbours_are_not_found_by_their_borders(tmp_path: Path, make_processed: Make) -> None:
    """The whole attack is benchmarks/dataset_privacy.py; this is its plainest part."""
    rng = np.random.default_rng(2)
    roots = []
    for name in PEOPLE:
        roots.append(make_processed(tmp_path / name, 384, 256, subject=name))
        blotches = cv2.GaussianBlur(rng.normal(0.4, 1.0, (384, 256, 3)), (0, 0), 2.0)
        ProcessedFolder(roots[-1]).write_atlas("diffuse_albedo", blotches)
    store = open_in_memory(build_store(roots, tmp_path / "store"))
    touching = dataclasses.replace(SMALL, gap=0.0, wander=0.0, turned=False, min_coverage=0.9)
    assert right_neighbours_found(store, touching) > 0.9
    defaults = PublishConfig(patch_px=SIZE)
    apart = dataclasses.replace(touching, gap=defaults.gap, wander=defaults.wander, turned=True)
    assert right_neighbours_found(store, apart) < 0.2


def test_a_patch_that_shows_too_much_of_a_face_is_refused_with_the_size_that_would_do(
    tmp_path: Path, store: Store
) -> None:
    config = PublishConfig(patch_px=64)
    with pytest.raises(LightstageError, match=r"64 texels.*2\.5%.*Try --patch 16\.") as caught:
        publish(store, tmp_path / "out", SEED, config)
    assert str(store.path) in str(caught.value)
    assert not (tmp_path / "out").exists()
    named = dataclasses.replace(config, patch_px=16)
    out = publish(store, tmp_path / "out", SEED, named)
    assert json.loads((out / "dataset.json").read_text())["most_of_a_face"] == 1 / 40
    for scan, row, column in texel_places(store, out):
        seen = store.read(scan, "confidence", slice(None), slice(None)) > 0
        # The half cylinder's texels have one size: shares of texels are shares of its area.
        assert seen[row : row + 16, column : column + 16].sum() / seen.sum() <= 1 / 40 * 1.05


def test_the_default_patch_is_as_large_a_part_of_every_atlas(store: Store) -> None:
    assert PublishConfig().layout(store).size == 192 * 512 // 6144


def test_people_without_a_consent_record_are_refused_by_name(
    tmp_path: Path, make_processed: Make
) -> None:
    roots = [
        make_processed(tmp_path / "a", 192, 128, subject="asked"),
        make_processed(tmp_path / "b", 192, 128, subject="unasked", consent=None),
        make_processed(tmp_path / "c", 192, 128, subject="simulated", consent=None),
    ]
    report = roots[2] / "report.json"
    report.write_text(json.dumps({**json.loads(report.read_text()), "synthetic": True}))
    store = open_in_memory(build_store(roots, tmp_path / "store"))
    with pytest.raises(LightstageError, match=r"unasked.*--consent.*--without-consent") as caught:
        publish(store, tmp_path / "out", SEED, SMALL)
    assert "simulated" not in str(caught.value)
    assert not (tmp_path / "out").exists()
    config = dataclasses.replace(SMALL, without_consent=True)
    out = publish(store, tmp_path / "out", SEED, config)
    assert json.loads((out / "dataset.json").read_text())["consent"] == {
        "subjects_on_record": 1,
        "subjects_simulated": 1,
        "subjects_without": 1,
        "published_without_consent": True,
    }


@pytest.mark.parametrize("wrong", [{"gap": -0.1}, {"wander": float("nan")}, {"drop": 1.0}])
def test_shares_that_are_none_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match="expected a share"):
        PublishConfig(**wrong)


def test_the_order_is_shuffled_by_the_seed(tmp_path: Path, store: Store, released: Path) -> None:
    def order(name: str, seed: int | None) -> tuple[bytes, ...]:
        out = publish(store, tmp_path / name, seed, SMALL)
        return tuple(patch.tobytes() for patch in read(out, "diffuse_albedo"))

    first, again = order("one", SEED), tuple(p.tobytes() for p in read(released, "diffuse_albedo"))
    other, unknown = order("three", SEED + 1), order("four", None)
    assert first == again
    assert sorted(first) == sorted(other) == sorted(unknown)
    assert len({first, other, unknown, tuple(sorted(first))}) == 4


def test_nothing_in_the_folder_names_a_person_a_place_or_the_seed(
    store: Store, released: Path
) -> None:
    words = [
        *PEOPLE,
        "grin-wide",
        str(SEED),
        f"{SEED:x}",
        store.fingerprint,
        str(store.path.parent),
    ]
    words += ['subject"', "expression", "seed", "scan", "session", "C-0", "C-1"]
    binary = [SEED.to_bytes(8, "little"), SEED.to_bytes(8, "big")]
    files = [path for path in released.rglob("*") if path.is_file()]
    assert len(files) > 5
    for path in files:
        name = str(path.relative_to(released))
        data = path.read_bytes()
        assert not any(word in name for word in words)
        if path.suffix in (".json", ".md"):
            assert not [word for word in words if word.encode() in data]
        assert not any(secret in data for secret in (*binary, *(p.encode() for p in PEOPLE)))


def test_shape_is_the_positions_about_the_patch_mean_to_scale(store: Store, released: Path) -> None:
    shapes = read(released, "shape").astype(float)
    for (scan, row, column), shape in zip(texel_places(store, released), shapes, strict=True):
        rows, columns = slice(row, row + SIZE), slice(column, column + SIZE)
        seen = store.read(scan, "confidence", rows, columns)[:, :, 0] > 0
        position = store.read(scan, "position", rows, columns)[seen].astype(float)
        ours = shape[shape.any(axis=2)]
        assert abs(ours.mean(axis=0)).max() < 1e-4
        from_middle = np.linalg.norm(position - position.mean(axis=0), axis=1)
        np.testing.assert_allclose(
            np.sort(np.linalg.norm(ours, axis=1)), np.sort(from_middle), atol=1e-4
        )


def test_what_it_cannot_protect_is_reported_in_the_folder(store: Store, released: Path) -> None:
    facts = json.loads((released / "dataset.json").read_text())["cannot_protect"]
    for word in ("moles", "join", "consent"):
        assert word in facts


@pytest.mark.parametrize(("words", "warned"), [(["--gap", "0"], True), ([], False)])
def test_a_gap_of_nothing_is_warned_of_with_the_figures_of_the_docs(
    tmp_path: Path, store: Store, words: list[str], warned: bool
) -> None:
    out = tmp_path / "published"
    asked = ["dataset", "publish", str(store.path), "--out", str(out), "--patch", "16", *words]
    asked += ["--about", str(ABOUT_FILE)]
    done = CliRunner().invoke(app, [*asked, "--json"])
    assert done.exit_code == 0, done.output
    facts = json.loads(done.stdout)
    text = [line for line in done.stderr.splitlines() if line.startswith("warning: ")]
    assert text == [f"warning: {each}" for each in facts["warnings"]]
    # The store has published sets of this version for other tests, too.
    text = [line for line in text if "another `version`" not in line]
    stated = json.loads((out / "dataset.json").read_text())["cannot_protect"]
    assert ("Of this set" in stated) == warned == bool(text)
    table = (Path(__file__).parents[2] / "docs" / "dataset.md").read_text().splitlines()
    rows = {gap: next(row for row in table if row.startswith(f"| {gap} | 0.5 | yes |"))
            for gap in ("0", "0.5")}  # fmt: skip
    for row in rows.values() if warned else ():
        _, _, _, _, _, right, _, _, same, _ = (cell.strip() for cell in row.split("|"))
        count, share = right.split(" of ")[0], float(right.split(", ")[1].removesuffix(" %"))
        assert count in text[0]
        assert f"{share:.0f} %" in text[0]
        assert f"{float(same.removesuffix(' %')):.0f} %" in text[0]


def test_the_figures_of_forty_people_are_those_of_the_docs() -> None:
    table = (Path(__file__).parents[2] / "docs" / "dataset.md").read_text().splitlines()
    row = next(row for row in table if row.startswith("| the most alike, by tone |"))
    right, chance = row.split("|")[3].split("% (")
    assert f"for {float(right):.0f} % ({float(chance.strip(' %)')):.0f} % by chance)" in (
        CANNOT_PROTECT
    )


def test_maps_smaller_than_a_patch_are_refused(tmp_path: Path, store: Store) -> None:
    with pytest.raises(LightstageError, match=r"no place has that much skin.*Try --patch 16"):
        publish(store, tmp_path / "out" / "published", SEED, PublishConfig(patch_px=512))
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


def test_a_published_set_is_not_opened_as_a_store(released: Path) -> None:
    with pytest.raises(LightstageError, match=r"published.*whole texture.*place.*person"):
        open_store(released)


def test_unmeasured_texels_publish_nothing(tmp_path: Path, make_processed: Make) -> None:
    root = make_processed(tmp_path / "a", 192, 128)
    folder = ProcessedFolder(root)
    folder.write_atlas("diffuse_albedo", np.full((192, 128, 3), 0.75))
    out = publish(
        open_in_memory(build_store([root], tmp_path / "s")), tmp_path / "out", SEED, SMALL
    )
    seen = read(out, "diffuse_normal").any(axis=3)
    albedo = read(out, "diffuse_albedo")
    assert (albedo[seen] == 0.75).all()
    assert not albedo[~seen].any()
    assert not seen.all()


def test_skin_between_the_hairs_of_a_beard_is_not_published(
    tmp_path: Path, make_processed: Make
) -> None:
    rows, columns = np.mgrid[:192, :128]
    beard = rows >= 96
    hairs = beard & (rows % 3 == 0) & (columns % 3 == 0)
    root = make_processed(tmp_path / "bearded", 192, 128, subject="bearded")
    ProcessedFolder(root).write_atlas("skin", ~hairs)
    bearded = open_in_memory(build_store([root], tmp_path / "one"))
    root = make_processed(tmp_path / "shaven", 192, 128, subject="shaven")
    shaven = open_in_memory(build_store([root], tmp_path / "two"))
    layout = SMALL.layout(bearded)
    left, all_of_it = (published_places(store, layout, 1.0) for store in (bearded, shaven))
    assert 0.3 * len(all_of_it) < len(left) < 0.7 * len(all_of_it)
    for place in left:
        shown = read_patch(bearded, place, SIZE)[1]
        here = slice(place.row, place.row + SIZE), slice(place.column, place.column + SIZE)
        # One row of the beard has no hair before the first: it still belongs to whole squares.
        assert shown.sum() <= (~beard[here]).sum() + SIZE
        assert (clear_skin(shown) == shown).all()


@given(
    seed=st.integers(0, 2**32),
    size=st.sampled_from([1, 8, 16, 41, 64]),
    hair=st.sampled_from([0.0, 0.003, 0.03, 0.3, 1.0]),
)
def test_clear_skin_is_what_whole_squares_of_skin_cover_however_it_is_turned(
    seed: int, size: int, hair: float
) -> None:
    measured = np.random.default_rng(seed).uniform(size=(size, size)) >= hair
    side = int(CLEAR * size) | 1
    covered = np.zeros_like(measured)
    for row in range(size - side + 1):
        for column in range(size - side + 1):
            here = slice(row, row + side), slice(column, column + side)
            covered[here] |= measured[here].all()
    assert (clear_skin(measured) == covered).all()
    for own, right in zip(unturned(measured), unturned(covered), strict=True):
        assert (clear_skin(own) == right).all()


def test_neither_dataset_takes_the_place_of_the_other(
    store: Store, tmp_path: Path, make_processed: Make
) -> None:
    other = build_store([make_processed(tmp_path / "other")], tmp_path / "other_store")
    with pytest.raises(LightstageError, match="of kind 'store', not 'published'"):
        publish(store, other, SEED, SMALL)
    assert len(open_store(other).scans) == 1
    published = publish(store, tmp_path / "published", SEED, SMALL)
    before = len(read(published, "shape"))
    with pytest.raises(LightstageError, match="of kind 'published', not 'store'"):
        build_store([tmp_path / "other"], published)
    assert len(read(published, "shape")) == before
    assert publish(store, published, SEED, SMALL) == published
    overwriting = ["dataset", "publish", str(store.path), "--out", str(other), "--overwrite"]
    overwriting += ["--about", str(ABOUT_FILE)]
    done = CliRunner().invoke(app, overwriting)
    assert isinstance(done.exception, LightstageError)
    assert "of kind 'store', not 'published'" in str(done.exception)


def test_a_published_set_given_to_publish_is_distinguished_from_one_given_to_training(
    released: Path, tmp_path: Path
) -> None:
    again = ["dataset", "publish", str(released), "--out", str(tmp_path / "again")]
    message = str(CliRunner().invoke(app, again).exception)
    assert "Name the store that `dataset build` made" in message
    assert "training" not in message
    with pytest.raises(LightstageError, match="training"):
        open_store(released)
