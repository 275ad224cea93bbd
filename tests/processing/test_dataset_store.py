"""The store gives back what the atlas holds, in the head frame, or says what is wrong."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from lightstage.errors import LightstageError
from lightstage.formats.exr import write_exr
from lightstage.formats.processed import ProcessedFolder
from processing.dataset import (
    CHANNELS,
    PublishConfig,
    add_scan,
    build_store,
    open_store,
    without_people_files,
)
from tests.processing.releases import publish

Make = Callable[..., Path]
ALL = slice(None)


def some_pose() -> np.ndarray:
    c, s = np.cos(0.4), np.sin(0.4)
    return np.array([[c, 0, s, 5.0], [0, 1, 0, -20.0], [-s, 0, c, 60.0]])


def test_maps_come_back_in_the_head_frame(tmp_path: Path, make_processed: Make) -> None:
    pose = some_pose()
    root = make_processed(tmp_path / "a", rows=300, columns=200, head_from_world=pose)
    store = open_store(build_store([root], tmp_path / "store"))
    atlas = ProcessedFolder(root)
    seen = atlas.read_atlas("confidence") > 0
    for name, channels in CHANNELS.items():
        found = store.read(0, name, ALL, ALL)
        assert found.dtype == np.float32
        assert found.shape == (300, 200, channels)
        expected = atlas.read_atlas(name).reshape(300, 200, -1).astype(float)
        if name == "position":
            # The plain twin: one point at a time.
            row, column = 150, 77
            point = pose[:, :3] @ expected[row, column] + pose[:, 3]
            np.testing.assert_allclose(found[row, column], point, atol=1e-4)
            expected = np.where(seen[..., None], expected @ pose[:, :3].T + pose[:, 3], 0)
        elif name.endswith("normal"):
            expected = expected @ pose[:, :3].T
        np.testing.assert_allclose(found, expected, atol=1e-3)
        assert not found[~seen].any()


def test_a_part_is_the_part_of_the_whole_across_chunks(
    tmp_path: Path, make_processed: Make
) -> None:
    root = make_processed(tmp_path / "a", rows=600, columns=300)
    store = open_store(build_store([root], tmp_path / "store"))
    whole = store.read(0, "position", ALL, ALL)
    part = store.read(0, "position", slice(200, 570), slice(250, 290))
    np.testing.assert_array_equal(part, whole[200:570, 250:290])


def test_patch_origins_are_those_that_counting_gives(tmp_path: Path, make_processed: Make) -> None:
    root = make_processed(tmp_path / "a", rows=96, columns=64)
    store = open_store(build_store([root], tmp_path / "store"))
    seen = ProcessedFolder(root).read_atlas("confidence") > 0
    expected = [
        (row, column)
        for row in range(0, 96, 8)
        for column in range(0, 64, 8)
        if row + 24 <= 96
        and column + 24 <= 64
        and seen[row : row + 24, column : column + 24].mean() >= 0.6
    ]
    assert store.patch_origins(0, 24, 8, 0.6) == expected
    assert 0 < len(expected) < len(store.patch_origins(0, 24, 8, 0.0))
    assert store.patch_origins(0, 97, 8, 0.0) == []


def test_statistics_are_of_all_covered_texels(tmp_path: Path, make_processed: Make) -> None:
    roots = [make_processed(tmp_path / f"{i}", subject=f"person-{i}", seed=i) for i in range(3)]
    value = json.loads((build_store(roots, tmp_path / "store") / "dataset.json").read_text())
    albedo = []
    for root in roots:
        folder = ProcessedFolder(root)
        albedo.append(folder.read_atlas("diffuse_albedo")[folder.read_atlas("confidence") > 0])
    pooled = np.concatenate(albedo)
    np.testing.assert_allclose(
        value["statistics"]["diffuse_albedo_mean"], pooled.mean(axis=0), rtol=1e-4
    )
    np.testing.assert_allclose(
        value["statistics"]["diffuse_albedo_deviation"], pooled.std(axis=0), rtol=1e-3
    )
    assert value["counts"] == {"subjects": 3, "scans": 3}


def test_fingerprint_changes_with_a_map(tmp_path: Path, make_processed: Make) -> None:
    root = make_processed(tmp_path / "a")
    first = open_store(build_store([root], tmp_path / "one")).fingerprint
    again = open_store(build_store([root], tmp_path / "two")).fingerprint
    folder = ProcessedFolder(root)
    folder.write_atlas("specular_albedo", folder.read_atlas("specular_albedo") * 1.5)
    other = open_store(build_store([root], tmp_path / "two")).fingerprint
    assert first == again != other


def wrong_size(root: Path) -> None:
    ProcessedFolder(root).write_atlas("specular_albedo", np.ones((48, 64)))


def with_nan(root: Path) -> None:
    image = ProcessedFolder(root).read_atlas("diffuse_albedo")
    image[40, 30] = np.nan
    write_exr(ProcessedFolder(root).atlas_path("diffuse_albedo"), image)


def without_pose(root: Path) -> None:
    ProcessedFolder(root).head_pose.unlink()


def bent_pose(root: Path) -> None:
    value = {"head_from_world": [[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]}
    ProcessedFolder(root).head_pose.write_text(json.dumps(value))


def without_map(root: Path) -> None:
    ProcessedFolder(root).atlas_path("specular_normal").unlink()


def without_subject(root: Path) -> None:
    (root / "report.json").write_text("{}")


def with_a_path_for_a_subject(root: Path) -> None:
    value = json.loads((root / "report.json").read_text())
    (root / "report.json").write_text(json.dumps({**value, "subject": "../other"}))


def with_report_of(schema: str) -> Callable[[Path], None]:
    def damage(root: Path) -> None:
        value = json.loads((root / "report.json").read_text())
        (root / "report.json").write_text(json.dumps({**value, "schema": schema}))

    return damage


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (with_report_of("lightstage.truth/2"), "schema: .*newer version"),
        (with_report_of("processing.report/2"), "schema: .*newer version"),
        (with_report_of("lightstage.rig/1"), r"schema: found 'lightstage\.rig/1'"),
        (with_a_path_for_a_subject, r"subject: found '\.\./other', expected letters"),
        (wrong_size, "different size"),
        (with_nan, "NaN"),
        (without_pose, "head_from_world.json"),
        (bent_pose, "rigid"),
        (without_map, "specular_normal.exr"),
        (without_subject, "subject"),
    ],
)
def test_bad_input_is_one_clear_message_and_leaves_nothing(
    tmp_path: Path, make_processed: Make, damage: Callable[[Path], None], message: str
) -> None:
    good = make_processed(tmp_path / "in" / "good")
    bad = make_processed(tmp_path / "in" / "bad")
    damage(bad)
    with pytest.raises(LightstageError, match=message) as caught:
        build_store([good, bad], tmp_path / "out" / "store")
    assert str(bad) in str(caught.value)
    assert list((tmp_path / "out").iterdir()) == []


def test_all_bad_folders_are_named_and_an_older_store_is_kept(
    tmp_path: Path, make_processed: Make
) -> None:
    roots = [make_processed(tmp_path / f"in{i}", seed=i) for i in range(3)]
    out = build_store(roots, tmp_path / "out" / "store")
    with_nan(roots[0])
    without_pose(roots[2])
    with pytest.raises(LightstageError) as caught:
        build_store(roots, out)
    assert str(roots[0]) in str(caught.value)
    assert str(roots[2]) in str(caught.value)
    assert [p.name for p in out.parent.iterdir()] == ["store"]
    assert len(open_store(out).scans) == 3


def test_an_interrupt_leaves_nothing(tmp_path: Path, make_processed: Make) -> None:
    roots = [make_processed(tmp_path / f"in{i}") for i in range(2)]

    def interrupt(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        build_store(roots, tmp_path / "out" / "store", interrupt)
    assert list((tmp_path / "out").iterdir()) == []


def test_a_folder_of_something_else_is_not_replaced(tmp_path: Path, make_processed: Make) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("dear")
    with pytest.raises(LightstageError, match="another output folder"):
        build_store([make_processed(tmp_path / "a")], tmp_path / "mine")
    assert (tmp_path / "mine" / "letter.txt").read_text() == "dear"


def test_a_store_with_files_of_others_is_not_replaced_and_what_a_killed_call_left_goes(
    tmp_path: Path, make_processed: Make
) -> None:
    store = build_store([make_processed(tmp_path / "a")], tmp_path / "store")
    scan = next((store / "scans").iterdir())
    half = store / "scans" / ".adding-01234567" / "position" / "c" / "0" / "0"
    half.mkdir(parents=True)
    (half / "0.partial").write_text("half")
    for mine in (store / "letter.txt", scan / "letter.txt", store / "scans" / "letter.txt"):
        mine.write_text("dear")
        with pytest.raises(LightstageError, match=r"letter\.txt, which the command did not make"):
            build_store([tmp_path / "a"], store)
        mine.unlink()
    add_scan(store, make_processed(tmp_path / "b", subject="b", seed=2))
    build_store([tmp_path / "a"], store)
    assert not half.exists()
    assert len(open_store(store).scans) == 1


def test_a_store_of_a_newer_version_is_refused(tmp_path: Path, make_processed: Make) -> None:
    out = build_store([make_processed(tmp_path / "a")], tmp_path / "store")
    text = (out / "dataset.json").read_text().replace("realfacedb/2", "realfacedb/3")
    (out / "dataset.json").write_text(text)
    with pytest.raises(LightstageError, match="newer"):
        open_store(out)


def test_atlases_of_two_sizes_are_refused_with_both_scans_and_sizes(
    tmp_path: Path, make_processed: Make
) -> None:
    small = make_processed(tmp_path / "in" / "small", rows=96, columns=64)
    large = make_processed(tmp_path / "in" / "large", rows=192, columns=128)
    with pytest.raises(LightstageError) as caught:
        build_store([small, large], tmp_path / "out" / "store")
    for message in (str(small), str(large), "96 x 64", "192 x 128", "--atlas-rows"):
        assert message in str(caught.value)
    assert list((tmp_path / "out").iterdir()) == []


def test_the_list_and_lock_of_simulated_people_are_passed_over_and_nothing_else(
    tmp_path: Path, make_processed: Make
) -> None:
    folder = make_processed(tmp_path / "p" / "person-0000-neutral")
    people = folder.with_name("people.json")
    lock = folder.with_name("people.lock")
    people.write_text('{"schema": "lightstage.people/1", "people": []}')
    lock.write_text("")
    (tmp_path / "q").mkdir()
    other = tmp_path / "q" / "people.json"
    other.write_text('{"people": ["somebody else"]}')
    folders, passed = without_people_files([folder, people, lock, other])
    assert passed == [people, lock]
    assert folders == [folder, other]
    with pytest.raises(LightstageError, match=f"{other}: found a file"):
        build_store(folders, tmp_path / "out" / "store")


@pytest.mark.parametrize(
    ("marker", "message"),
    [
        ("session.json", "a session.*lightstage-processing run"),
        ("dataset.json", "a dataset"),
        ("report.json", "without an atlas.*lightstage-processing atlas"),
        ("letter.txt", "something else"),
        (None, "no such folder"),
    ],
)
def test_what_is_no_processed_folder_is_refused_by_name(
    tmp_path: Path, make_processed: Make, marker: str | None, message: str
) -> None:
    root = tmp_path / "in" / "given"
    if marker:
        root.mkdir(parents=True)
        (root / marker).write_text("{}")
    good = make_processed(tmp_path / "in" / "good")
    with pytest.raises(LightstageError, match=f"{root}: found .*{message}"):
        build_store([good, root], tmp_path / "out" / "store")


def test_the_truth_of_a_simulated_session_is_refused_and_simulated_people_are_not(
    tmp_path: Path, make_processed: Make
) -> None:
    people = make_processed(tmp_path / "P" / "person-0000-neutral", consent=None)
    truth = make_processed(tmp_path / "S.truth", subject="P07", consent=None)
    ProcessedFolder(truth).true_landmarks.write_text("{}")
    with pytest.raises(
        LightstageError,
        match=r"S\.truth: found the truth of a simulated .* name OUT\..*--maps-only",
    ):
        build_store([people, truth], tmp_path / "out" / "store")
    assert list((tmp_path / "out").iterdir()) == []
    assert len(open_store(build_store([people], tmp_path / "out" / "store")).scans) == 1


@pytest.mark.parametrize("first", ["captured", "simulated"])
def test_one_pseudonym_of_a_simulated_and_a_captured_person_is_refused(
    tmp_path: Path, make_processed: Make, first: str
) -> None:
    captured = make_processed(tmp_path / "in" / "captured", subject="P07")
    simulated = make_processed(tmp_path / "in" / "simulated", subject="P07", consent=None)
    smile = make_processed(tmp_path / "in" / "smile", subject="P07", expression="smile")
    report = json.loads((simulated / "report.json").read_text())
    (simulated / "report.json").write_text(json.dumps({**report, "synthetic": True}))
    roots = [captured, smile, simulated] if first == "captured" else [simulated, captured]
    with pytest.raises(LightstageError, match=r"subject: found 'P07', a .* person's") as caught:
        build_store(roots, tmp_path / "out" / "store")
    for message in (str(captured), str(simulated), "another pseudonym"):
        assert message in str(caught.value)
    assert list((tmp_path / "out").iterdir()) == []
    assert len(open_store(build_store([captured, smile], tmp_path / "out" / "store")).scans) == 2


def test_a_store_that_lost_or_changed_a_part_is_reported_and_not_read_as_zeros(
    tmp_path: Path, make_processed: Make
) -> None:
    roots = [make_processed(tmp_path / name, subject=name, seed=k) for k, name in enumerate("abc")]
    whole = build_store(roots, tmp_path / "store")
    part = (
        Path("scans") / open_store(whole).scans[1].folder / "diffuse_albedo" / "c" / "0" / "0" / "0"
    )
    data = (whole / part).read_bytes()
    for changed, message in (
        (None, r"diffuse_albedo: found 0 of its 1 parts"),
        (data[:90] + bytes([data[90] ^ 1]) + data[91:], "bytes that are not those that were"),
        (data[: len(data) // 2], "bytes that are not those that were written"),
    ):
        shutil.rmtree(tmp_path / "broken", ignore_errors=True)
        broken = shutil.copytree(whole, tmp_path / "broken")
        (broken / part).unlink()
        if changed is not None:
            (broken / part).write_bytes(changed)
        store = open_store(broken)
        assert store.read(0, "diffuse_albedo", slice(None), slice(None)).any()
        with pytest.raises(LightstageError, match=message):
            store.read(1, "diffuse_albedo", slice(None), slice(None))
        with pytest.raises(LightstageError, match=message):
            publish(store, tmp_path / "published", 0, PublishConfig(patch_px=8, drop=0.0))
        assert not (tmp_path / "published").exists()
    empty = np.zeros((96, 64), np.float32)
    black = ProcessedFolder(roots[0]).write_atlas("specular_albedo", empty)
    assert black.is_file()
    store = open_store(build_store(roots, tmp_path / "black"))
    assert not store.read(0, "specular_albedo", slice(None), slice(None)).any()


def test_a_copy_of_a_scan_and_two_draws_of_one_pseudonym_are_refused(
    tmp_path: Path, make_processed: Make
) -> None:
    first = make_processed(tmp_path / "P" / "person-0000-neutral", seed=1)
    copy = make_processed(tmp_path / "copy", seed=1)
    with pytest.raises(LightstageError, match=r"copy: found the same files as .*P/person-0000"):
        build_store([first, copy], tmp_path / "store")
    other = make_processed(tmp_path / "Q" / "person-0000-neutral", seed=2)
    # A captured person may have been photographed twice.
    assert len(open_store(build_store([first, other], tmp_path / "twice")).scans) == 2
    for root in (first, other):
        report = json.loads((root / "report.json").read_text())
        (root / "report.json").write_text(json.dumps({**report, "synthetic": True}))
    with pytest.raises(LightstageError, match=r"Q/person-0000.*of its own.*--subjects"):
        build_store([first, other], tmp_path / "store")
    assert not (tmp_path / "store").exists()


def test_a_folder_of_processed_folders_is_reported_with_what_to_name(
    tmp_path: Path, make_processed: Make
) -> None:
    people = tmp_path / "my people"
    make_processed(people / "one")
    with pytest.raises(LightstageError, match=r"a folder of processed folders.*my people/\*"):
        build_store([people], tmp_path / "store")
    with pytest.raises(LightstageError, match=r"expected a store.* build '.*my people'/\* --out"):
        open_store(people)


def test_a_folder_without_the_map_of_skin_is_refused(tmp_path: Path, make_processed: Make) -> None:
    root = make_processed(tmp_path / "a")
    ProcessedFolder(root).atlas_path("skin").unlink()
    with pytest.raises(LightstageError, match=r"skin\.exr.*atlas` again"):
        build_store([root], tmp_path / "store")


def test_the_store_states_who_consented_and_who_is_simulated(
    tmp_path: Path, make_processed: Make
) -> None:
    asked = make_processed(tmp_path / "asked", consent="C-17")
    unasked = make_processed(tmp_path / "unasked", subject="p2", consent=None)
    simulated = make_processed(tmp_path / "simulated", subject="p3", consent=None)
    report = json.loads((simulated / "report.json").read_text())
    (simulated / "report.json").write_text(json.dumps({**report, "synthetic": True}))
    store = open_store(build_store([asked, unasked, simulated], tmp_path / "store"))
    assert [(s.consent, s.synthetic) for s in store.scans] == [
        ("C-17", False),
        (None, False),
        (None, True),
    ]
