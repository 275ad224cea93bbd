"""A person is taken out of all folders, nobody else is touched, and what is left is told."""

from __future__ import annotations

import functools
import json
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from lightstage.errors import FormatError, LightstageError
from lightstage.formats.files import write_json
from lightstage.formats.lock import being_filled, locked
from lightstage.formats.people import people_counts
from processing.dataset import PublishConfig, build_store, forget, open_store, verify_store
from processing.dataset.named import names_subject
from processing.records import RUN_LOCK
from tests.processing import lit_ball
from tests.processing.lit_ball import Ball
from tests.processing.releases import publish

WHO = "person-1"


@pytest.fixture(scope="module")
def lab_made(tmp_path_factory: pytest.TempPathFactory, make_processed: Callable[..., Path]) -> Path:
    """Sessions, processed folders, a store, a release and two checkpoints of three people."""
    lab = tmp_path_factory.mktemp("made") / "lab"
    people = []
    for i in range(3):
        who = f"person-{i}"
        ball = Ball(albedo=(0.5, 0.3, 0.1 + 0.1 * i))
        session = lit_ball.write_session(ball, lit_ball.small_rig(1, 0.015), lab / "S" / f"s{i}")
        value = json.loads((session / "session.json").read_text())
        write_json(session / "session.json", {**value, "subject": who, "id": f"s{i}"})
        people.append(make_processed(lab / "P" / f"p{i}", subject=who, seed=i, rows=48, columns=32))
    store = build_store(people, lab / "store")
    fingerprint = open_store(store).fingerprint
    publish(open_store(store), lab / "published", config=PublishConfig(patch_px=4))
    for name, held in (("run", fingerprint), ("other run", "f" * 64)):
        (lab / name).mkdir()
        write_json(lab / name / "checkpoint.json", {"data_fingerprint": held})
    return lab


@pytest.fixture
def lab(lab_made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(lab_made, tmp_path / "lab"))


@pytest.fixture
def command(run_command: Callable[..., Any]) -> Callable[..., Any]:
    return functools.partial(run_command, "processing", "dataset", "forget")


def names_in(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


def test_a_dry_run_lists_everything_and_changes_nothing(
    lab: Path, tmp_path: Path, command: Callable[..., Any]
) -> None:
    before = names_in(lab)
    ended = command(WHO, "--in", lab, "--out", tmp_path / "office")
    assert ended.code == 0, ended.err
    scan = next(s.folder for s in open_store(lab / "store").scans if s.subject == WHO)
    for message in (
        f"session: {lab / 'S' / 's1'}",
        f"processed folder: {lab / 'P' / 'p1'}",
        f"store: {scan} of {lab / 'store'}",
        "/published, published on",
        f"trained on the person: {lab / 'run'}",
        "Nothing was removed",
    ):
        assert message in ended.out
    assert "other run" not in ended.out
    assert "s0" not in ended.out
    assert names_in(lab) == before
    assert not (tmp_path / "office").exists()


@pytest.mark.parametrize("what", ["session", "photograph"])
def test_links_that_lead_out_are_refused_and_searched_where_they_lead_is_named(
    lab: Path, tmp_path: Path, command: Callable[..., Any], what: str
) -> None:
    elsewhere = tmp_path / "other disk"
    elsewhere.mkdir()
    inside = lab / "S" / "s1"
    there = inside if what == "session" else next(inside.rglob("*.exr"))
    moved = Path(shutil.move(there, elsewhere / there.name))
    there.symlink_to(moved)
    ended = command(WHO, "--in", lab, "--out", tmp_path / "office", "--yes")
    assert ended.code == 2
    assert f"found a link to {moved}" in ended.err
    assert moved.exists()
    assert (lab / "P" / "p1").exists()
    both = command(WHO, "--in", lab, "--in", elsewhere, "--out", tmp_path / "office")
    assert both.code == 0, both.err


def test_everything_of_a_person_goes_and_nothing_of_another(
    lab: Path, tmp_path: Path, command: Callable[..., Any]
) -> None:
    scans = open_store(lab / "store").scans
    theirs = f"store/scans/{scans[1].folder}"
    expected = {
        name
        for name in names_in(lab)
        if not any(name == own or name.startswith(f"{own}/") for own in ("S/s1", "P/p1", theirs))
    }
    ended = command(WHO, "--in", lab, "--out", tmp_path / "office", "--yes")
    assert ended.code == 0, ended.err
    assert names_in(lab) == expected
    assert [s.subject for s in open_store(lab / "store").scans] == ["person-0", "person-2"]
    proofs = list((tmp_path / "office").iterdir())
    assert len(proofs) == 1
    proof = json.loads(proofs[0].read_text())
    assert proof["schema"] == "lightstage.forgotten/1"
    assert proof["left"] == {"by_hash": [], "by_pseudonym": []}
    assert proof["scan_sha256"] == [scans[1].sha256]
    assert len(proof["published"]) == 1
    assert len(proof["hashes"]) == 8  # seven photographs and an albedo of their own
    again = command(WHO, "--in", lab, "--out", tmp_path / "office", "--yes")
    assert again.code == 2
    assert f"nothing of '{WHO}'" in again.err


def test_a_copy_elsewhere_and_what_killed_processes_left_go_too(
    lab: Path, tmp_path: Path, command: Callable[..., Any]
) -> None:
    card = lab / "card" / "DCIM"
    card.mkdir(parents=True)
    shutil.copy(lab / "S" / "s1" / "frames" / "x+" / "cam0.exr", card / "0001.exr")
    shutil.copy(lab / "S" / "s0" / "frames" / "x+" / "cam0.exr", card / "0002.exr")
    # Of cameras whose makers name their photographs as few do.
    (lab / "S" / "s1" / "frames" / "cam0.take1.rw2").write_bytes(b"a photograph")
    (card / "0003.RW2").write_bytes(b"a photograph")
    half = lab / "P" / ".p1.0123abcd"
    half.mkdir()
    (half / "half.exr").write_bytes(b"half")
    (lab / "store" / "scans" / ".adding-01234567").mkdir()
    ended = command(WHO, "--in", lab, "--out", tmp_path / "office", "--yes")
    assert ended.code == 0, ended.err
    assert [p.name for p in card.iterdir()] == ["0002.exr"]
    assert not half.exists()
    assert not (lab / "store" / "scans" / ".adding-01234567").exists()


def test_scans_that_killed_processes_left_in_no_list_go_too(lab: Path, tmp_path: Path) -> None:
    name = next(s.folder for s in open_store(lab / "store").scans if s.subject == WHO)
    other = build_store([lab / "P" / "p0"], lab / "other store")
    left = [
        other / "scans" / name,  # `dataset add`, before the scan was listed
        other / "scans" / ".adding-01234567",  # earlier
        lab / ".new store.0123abcd" / "scans" / name,  # `dataset build`
    ]
    for folder in left:
        shutil.copytree(lab / "store" / "scans" / name, folder)
    forget.forget(WHO, [lab], tmp_path / "office")
    assert not any(folder.exists() for folder in left)
    assert not left[2].parents[1].exists()
    assert [s.subject for s in open_store(other).scans] == ["person-0"]
    assert verify_store(other)[1] == []


def test_a_call_killed_among_the_scans_goes_on_where_the_store_alone_knew_the_person(
    lab: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for own in ("S/s1", "P/p1"):
        shutil.rmtree(lab / own)
    scan = next(s.folder for s in open_store(lab / "store").scans if s.subject == WHO)

    def killed(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as at:
        at.setattr("processing.dataset.changes._discard", killed)
        with pytest.raises(KeyboardInterrupt):
            forget.forget(WHO, [lab], tmp_path / "office")
    assert (lab / "store" / "scans" / scan).is_dir()
    assert [s.subject for s in open_store(lab / "store").scans] == ["person-0", "person-2"]
    listed = forget.search(WHO, [lab], tmp_path / "office", hashed=False)[1]
    assert listed.removed["left by a killed process"] == [str(lab / "store" / "scans" / scan)]
    forget.forget(WHO, [lab], tmp_path / "office")
    assert not (lab / "store" / "scans" / scan).exists()
    assert verify_store(lab / "store")[1] == []


def test_half_built_stores_and_releases_of_nobody_knows_whom_go_with_anybody(
    lab: Path, tmp_path: Path
) -> None:
    half = [
        lab / ".new store.0123abcd" / "scans" / ("0" * 16),
        lab / ".PUB.0123abcd" / "diffuse_albedo",
        lab / ".TARS.0123abcd",
        lab / "store" / "scans" / ("1" * 16),
    ]
    for folder in half:
        folder.mkdir(parents=True)
    (half[2] / "patches-000000.tar").write_bytes(b"patches")
    shutil.copytree(lab / "published", lab / ".published.0123abcd.old")
    with pytest.raises(LightstageError, match=r"TARS\.0123abcd is half-built, of nobody"):
        forget.forget("person-9", [lab], tmp_path / "office")
    assert all(folder.exists() for folder in half)
    forget.forget(WHO, [lab], tmp_path / "office")
    assert not any(folder.exists() for folder in half)
    assert not list(lab.glob(".*"))
    assert (lab / "published").is_dir()


@pytest.mark.parametrize("place", [".new store.0123abcd", "store/scans/.adding-0123abcd"])
def test_a_store_that_is_being_made_stops_it_before_anything_goes(
    lab: Path, tmp_path: Path, place: str
) -> None:
    with being_filled(lambda: lab / place) as folder:
        (folder / "scans").mkdir()
        before = names_in(lab)
        with pytest.raises(LightstageError, match="that another process is making"):
            forget.forget(WHO, [lab], tmp_path / "office")
        assert names_in(lab) == before


@pytest.mark.parametrize("whole", [False, True])
def test_a_release_that_was_recorded_after_the_search_is_in_the_proof(
    lab: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, whole: bool
) -> None:
    own = build_store([lab / "P" / "p1"], lab / "own store") if whole else lab / "store"
    survey = forget.survey

    def published_after(*args: Any, **more: Any) -> Any:
        found = survey(*args, **more)
        if not (lab / "late").exists():
            publish(open_store(own), lab / "late", config=PublishConfig(patch_px=4))
        return found

    monkeypatch.setattr(forget, "survey", published_after)
    _, _, proof = forget.forget(WHO, [lab], tmp_path / "office")
    published = json.loads(proof.read_text())["published"]
    assert str(lab / "late") in [each["out"] for each in published]
    assert len(published) == 2


@pytest.mark.parametrize("by", ["trace", "sha256"])
def test_networks_that_began_with_weights_of_the_person_are_listed(lab: Path, by: str) -> None:
    """Trained on a store without the person, by their scans; those of an earlier version too."""
    for scan in open_store(lab / "store").scans[:2]:
        (lab / scan.subject).mkdir()
        value = {"data_fingerprint": "e" * 64, "trained_on": ["0" * 64, getattr(scan, by)]}
        write_json(lab / scan.subject / "checkpoint.json", value)
    found = forget.survey(WHO, [lab], hashed=False)
    assert found.checkpoints == [str(lab / WHO), str(lab / "run")]


def test_what_names_the_person_still_is_reported_and_exits_2(
    lab: Path, tmp_path: Path, command: Callable[..., Any]
) -> None:
    (lab / "notes.txt").write_text("person-1 wore glasses; person-10 did not")
    (lab / "others.txt").write_text("person-10, person-1b, my-person-1")
    ended = command(WHO, "--in", lab, "--out", tmp_path / "office", "--yes")
    assert ended.code == 2
    assert f"still there: {lab / 'notes.txt'}" in ended.out
    assert "others.txt" not in ended.out
    assert "1 file that still shows or names" in ended.err


def test_a_pseudonym_is_found_in_texts_of_any_suffix_and_in_tables_of_offices(
    tmp_path: Path,
) -> None:
    (tmp_path / "utf-16.csv").write_text(f"pseudonym;name\n{WHO};Ann\n", encoding="utf-16")
    (tmp_path / "plan.yaml").write_text(f"{WHO}: glasses\n")
    with zipfile.ZipFile(tmp_path / "table.xlsx", "w", zipfile.ZIP_DEFLATED) as table:
        table.writestr("xl/sharedStrings.xml", f"<t>{WHO}</t>" * 9)
    for name in ("utf-16.csv", "plan.yaml", "table.xlsx"):
        assert names_subject(tmp_path / name, WHO)
        assert not names_subject(tmp_path / name, "person-2")
    damaged = tmp_path / "damaged.xlsx"
    damaged.write_bytes((tmp_path / "table.xlsx").read_bytes()[:40])
    assert not names_subject(damaged, WHO)
    (tmp_path / "part").write_bytes(b"\0\0" + WHO.encode())
    assert not names_subject(tmp_path / "part", WHO)  # an array's bytes


@pytest.mark.parametrize("who", ["Żaneta7", "Ωmega-3.b"])
def test_a_pseudonym_beyond_ascii_is_found_as_json_writes_it(lab: Path, who: str) -> None:
    file = lab / "S" / "s1" / "session.json"
    write_json(file, {**json.loads(file.read_text()), "subject": who})
    write_json(lab / "batch.json", {"sessions": [{"subject": who}]})
    write_json(lab / "table.json", {"who": f"{who}, glasses"})
    write_json(lab / "other.json", {"who": f"{who}b, x{who}"})
    found, left, _ = forget.forget(who, [lab], lab.parent / "proof")
    assert found.removed["list of a batch"] == [str(lab / "batch.json")]
    assert str(lab / "table.json") in left["by_pseudonym"]
    assert str(lab / "other.json") not in left["by_pseudonym"]


@pytest.mark.parametrize("name", ["dataset.json", "report.json", "checkpoint.json"])
def test_a_file_of_another_program_with_one_of_our_names_is_passed_over(
    lab: Path, tmp_path: Path, name: str
) -> None:
    (lab / "else").mkdir()
    (lab / "else" / name).write_text("[1, 2]")
    found, left, _ = forget.forget(WHO, [lab], tmp_path / "proof")
    assert not found.empty
    assert not any(left.values())


def test_a_session_whose_file_is_damaged_does_not_stop_the_search_for_what_is_left(
    lab: Path, tmp_path: Path
) -> None:
    (lab / "S" / "s0" / "session.json").write_text("[1, 2]")
    _, left, proof = forget.forget(WHO, [lab], tmp_path / "proof")
    assert proof.is_file()
    assert not any(left.values())


def test_a_processed_folder_whose_person_cannot_be_read_is_named(lab: Path) -> None:
    (lab / "P" / "p0" / "stages.json").write_text("[1, 2]")
    with pytest.raises(FormatError, match=r"p0/stages\.json: found list, expected a JSON object"):
        forget.survey(WHO, [lab], hashed=False)


def test_an_interrupted_call_goes_on(
    lab: Path, tmp_path: Path, command: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    removed = shutil.rmtree
    calls = []

    def interrupted(path: Path, *rest: Any, **more: Any) -> None:
        calls.append(path)
        if len(calls) == 2:
            # The folder's own files that say whose it is are gone already.
            (Path(path) / "report.json").unlink(missing_ok=True)
            raise KeyboardInterrupt
        removed(path, *rest, **more)

    monkeypatch.setattr(forget.shutil, "rmtree", interrupted)
    assert command(WHO, "--in", lab, "--out", tmp_path / "office", "--yes").code == 130
    monkeypatch.setattr(forget.shutil, "rmtree", removed)
    assert [p.name[:7] for p in (tmp_path / "office").iterdir()] == ["forget-"]
    ended = command(WHO, "--in", lab, "--out", tmp_path / "office", "--yes")
    assert ended.code == 0, ended.err
    assert not (lab / "P" / "p1").exists()
    assert not (lab / "S" / "s1").exists()
    assert [p.name[:10] for p in (tmp_path / "office").iterdir()] == ["forgotten-"]


@pytest.mark.parametrize(
    ("lock", "who"), [(f"P/p1/{RUN_LOCK}", "run"), ("S/s1/journal.jsonl", "capture")]
)
def test_a_folder_in_use_stops_it_before_anything_goes(
    lab: Path, tmp_path: Path, lock: str, who: str
) -> None:
    before = names_in(lab)
    with (
        locked(lab / lock, LightstageError("held")),
        pytest.raises(LightstageError, match=f"a {who} is writing to"),
    ):
        forget.forget(WHO, [lab], tmp_path / "office")
    assert names_in(lab) - {lock} == before


def test_somebody_unknown_and_a_folder_that_is_not_there_are_refused(
    lab: Path, tmp_path: Path, command: Callable[..., Any]
) -> None:
    for words, message in (
        (("person-9", "--in", lab), "nothing of 'person-9'"),
        ((WHO, "--in", lab / "none"), "--in: found no such folder"),
    ):
        for more in ((), ("--yes",)):
            ended = command(*words, "--out", tmp_path / "office", *more)
            assert ended.code == 2
            assert message in ended.err
    inside = command(WHO, "--in", lab, "--out", lab / "S" / "s1" / "proofs", "--yes")
    assert inside.code == 2
    assert "which goes" in inside.err
    assert (lab / "S" / "s1" / "session.json").exists()


def test_a_store_of_that_person_alone_goes_as_a_whole(lab: Path, tmp_path: Path) -> None:
    build_store([lab / "P" / "p1"], lab / "own store")
    found, left, _ = forget.forget(WHO, [lab], tmp_path / "office")
    assert found.whole == [str(lab / "own store")]
    assert not (lab / "own store").exists()
    assert left == {"by_hash": [], "by_pseudonym": []}


def people_list(folder: Path) -> Path:
    """The list that `lightstage-sim dataset` writes beside three people."""
    people = [
        {"name": f"person-{i}", "seed": i, "sex": sex, "age_years": age, "tone": 2, "look": "plain"}
        for i, (sex, age) in enumerate([("male", 20.2), ("female", 52.6), ("male", 35.0)])
    ]
    value = {"schema": "lightstage.people/1", "counts": people_counts(people), "people": people}
    return write_json(folder / "people.json", value)


def test_a_simulated_person_is_taken_off_the_list_of_people_and_the_others_stay(
    lab: Path, tmp_path: Path, command: Callable[..., Any]
) -> None:
    path = people_list(lab / "P")
    path.chmod(0o640)
    listed = command(WHO, "--in", lab, "--out", tmp_path / "office")
    assert f"entry in the list of simulated people: {path}" in listed.out
    assert WHO in path.read_text()
    ended = command(WHO, "--in", lab, "--out", tmp_path / "office", "--yes")
    assert ended.code == 0, ended.err
    value = json.loads(path.read_text())
    assert [each["name"] for each in value["people"]] == ["person-0", "person-2"]
    assert value["counts"]["sex"] == {"male": 2}
    assert value["counts"]["age"] == {"20s": 1, "30s": 1}
    assert path.stat().st_mode & 0o777 == 0o640
    (proof,) = (tmp_path / "office").iterdir()
    assert json.loads(proof.read_text())["lists"] == [str(path)]
    assert command(WHO, "--in", lab, "--out", tmp_path / "office", "--yes").code == 2


def test_an_entry_that_an_earlier_call_left_in_the_list_of_people_goes_too(
    lab: Path, tmp_path: Path
) -> None:
    forget.forget(WHO, [lab], tmp_path / "office")
    path = people_list(lab / "P")
    found, left, _ = forget.forget(WHO, [lab], tmp_path / "office")
    assert found.lists == [str(path)]
    assert left == {"by_hash": [], "by_pseudonym": []}
    with pytest.raises(LightstageError, match="nothing of"):
        forget.forget(WHO, [lab], tmp_path / "office")


def test_a_list_of_people_that_is_being_made_stops_it_before_anything_goes(
    lab: Path, tmp_path: Path
) -> None:
    path = people_list(lab / "P")
    with locked(lab / "P" / "people.lock", LightstageError("held")):
        before = names_in(lab)
        with pytest.raises(LightstageError, match="that `lightstage-sim dataset` is making now"):
            forget.forget(WHO, [lab], tmp_path / "office")
    assert names_in(lab) - {f"P/p1/{RUN_LOCK}"} == before
    assert WHO in path.read_text()


@pytest.mark.parametrize("text", ["[1, 2]", '{"people": [{"name": "person-1"}]}', "{"])
def test_a_list_of_people_of_another_program_is_reported_and_left_as_it_is(
    lab: Path, tmp_path: Path, text: str
) -> None:
    path = lab / "P" / "people.json"
    path.write_text(text)
    found, left, _ = forget.forget(WHO, [lab], tmp_path / "office")
    assert found.lists == []
    assert path.read_text() == text
    assert left["by_pseudonym"] == ([str(path)] if WHO in text else [])
