"""What a release says of itself: true, whole, valid, and never of fewer than five people."""

from __future__ import annotations

import dataclasses
import itertools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import mlcroissant
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.errors import ConfigError, LightstageError
from lightstage.formats.files import sha256_file
from processing.dataset import About, Answers, PublishConfig, Store, build_store, statements
from processing.dataset.about import NEEDED, read_about
from processing.dataset.groups import FEWEST, published_counts
from processing.dataset.scan import AGE_BANDS, OLDEST, SEXES, age_band
from tests.processing.releases import (
    ABOUT,
    ABOUT_FILE,
    SMALL,
    Make,
    open_in_memory,
    publish,
    small_store,
)

TINY = PublishConfig(patch_px=8, gap=0.25, wander=0.25, most_face=0.2, min_coverage=0.3)


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory, make_processed: Make) -> Store:
    return small_store(tmp_path_factory.mktemp("cards"), make_processed)


@pytest.mark.parametrize("form", ["zarr", "webdataset"])
def test_mlcroissant_takes_the_croissant_file_without_a_warning(
    tmp_path: Path, store: Store, form: Literal["zarr", "webdataset"]
) -> None:
    answers = Answers(impact="Nobody looked.", representation="Nobody else.")
    about = dataclasses.replace(ABOUT, answers=answers, citation="@misc{us}")
    out = publish(
        store, tmp_path / "out", config=dataclasses.replace(SMALL, form=form), about=about
    )
    metadata = mlcroissant.Dataset(jsonld=str(out / "croissant.json")).metadata
    assert (metadata.ctx.issues.errors, metadata.ctx.issues.warnings) == (set(), set())
    assert metadata.ctx.conforms_to.value.endswith("croissant/1.0")
    assert (metadata.license, metadata.cite_as) == ([ABOUT.license], "@misc{us}")
    assert [each.name for each in metadata.creators] == list(ABOUT.creators)
    # The fields of responsible AI are read as such, by their names in the vocabulary.
    for field in (
        "data_collection",
        "data_collection_type",
        "data_collection_missing_data",
        "data_preprocessing_protocol",
        "data_use_cases",
        "data_release_maintenance_plan",
    ):
        assert getattr(metadata, field), field
    assert metadata.data_social_impact == "Nobody looked."
    assert metadata.data_biases[-1] == "Nobody else."
    assert "C-" not in " ".join(metadata.personal_sensitive_information)
    facts = json.loads((out / "dataset.json").read_text())["cannot_protect"]
    assert facts in metadata.data_limitations
    for file in metadata.file_objects:
        assert file.sha256 == sha256_file(out / file.content_url)
    sets = {each.id: each for each in metadata.distribution if each.id in SETS}
    assert set(sets) == SETS
    if form == "webdataset":
        tars = sorted(path.name for path in out.glob("*.tar"))
        assert all(sorted(each.contained_in) == tars for each in sets.values())
    else:
        assert all(list(out.glob(each.includes[0])) for each in sets.values())


SETS = {"diffuse_albedo", "specular_albedo", "diffuse_normal", "specular_normal", "shape"}


def test_mlcroissant_refuses_the_file_where_its_vocabulary_is_broken(
    tmp_path: Path, store: Store
) -> None:
    """What this test file relies on to find an error does find one."""
    out = publish(store, tmp_path / "out", config=SMALL)
    value = json.loads((out / "croissant.json").read_text())
    del value["distribution"][0]["contentUrl"]
    (out / "croissant.json").write_text(json.dumps(value))
    with pytest.raises(mlcroissant.ValidationError, match="contentUrl"):
        mlcroissant.Dataset(jsonld=str(out / "croissant.json"))


def test_the_datasheet_gives_the_labs_answers_and_asks_for_the_others(
    tmp_path: Path, store: Store
) -> None:
    about = dataclasses.replace(ABOUT, answers=Answers(funding="By the Hermit Fund."))
    out = publish(store, tmp_path / "out", config=SMALL, about=about)
    text = (out / "DATASHEET.md").read_text()
    for message in ("By the Hermit Fund.", ABOUT.license, ABOUT.terms, *ABOUT.creators, ABOUT.url):
        assert message in text
    assert text.count("**Not answered.**") == len(about.unanswered) == 11
    assert "funding" not in text.split("Not answered by the lab: ")[1].split("\n")[0]
    answers = Answers(**{field.name: "Said." for field in dataclasses.fields(Answers)})
    whole = publish(
        store, tmp_path / "whole", config=SMALL, about=dataclasses.replace(ABOUT, answers=answers)
    )
    text = (whole / "DATASHEET.md").read_text()
    assert "ot answered" not in text
    assert text.count("\nSaid.\n") == 12
    assert "# Patches of a test\n" in text


def test_nothing_is_published_without_licence_and_terms(
    tmp_path: Path, store: Store, run_command: Callable[..., Any]
) -> None:
    out, file = tmp_path / "out", tmp_path / "about.toml"
    words = ("dataset", "publish", store.path, "--out", out, "--patch", 16)
    done = run_command("processing", *words)
    assert (done.code, out.exists()) == (2, False)
    assert f"--about: found none, expected a TOML file with {', '.join(NEEDED)}" in done.err
    file.write_text('name = "x"\nterms = " "\nlicense = "CC-BY-4.0"\n')
    done = run_command("processing", *words, "--about", file)
    assert (done.code, out.exists()) == (2, False)
    assert f"{file}: " in done.err
    assert "found no terms, no creators, no contact, no url" in done.err
    done = run_command("processing", *words, "--about", ABOUT_FILE)
    assert done.code == 0, done.err
    assert "10 questions of its DATASHEET.md not answered: funding, recruitment" in done.out


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("url", "our page"),
        ("version", "first"),
        ("version", "1.0"),
        ("license", "two\nlines"),
        ("name", "x" * 501),
        ("contact", "\x1b[2J"),
        ("terms", "y" * 10_001),
        ("creators", ("Lab", "La\x00b")),
    ],
)
def test_texts_that_are_none_are_refused_by_field(field: str, value: Any) -> None:
    with pytest.raises(ConfigError, match=field):
        dataclasses.replace(ABOUT, **{field: value})


def test_an_unknown_key_is_refused_and_texts_of_lines_are_taken(tmp_path: Path) -> None:
    file = tmp_path / "about.toml"
    text = ABOUT_FILE.read_text()
    file.write_text(text + 'age = "no question"\n')
    with pytest.raises(ConfigError, match=r"about\.toml, answers\.age: found an unknown key"):
        read_about(file)
    file.write_text(text + 'ethics_review = """One.\nTwo."""\n')
    assert read_about(file).answers.ethics_review == "One.\nTwo."
    assert isinstance(read_about(file), About)


@pytest.mark.parametrize(("groups", "most"), [(2, 40), (3, 24), (4, 16)])
def test_no_group_of_fewer_than_five_follows_from_what_is_published(groups: int, most: int) -> None:
    """By whoever knows the rule and the total, from all tables that there may be."""
    alike: dict[Any, list[tuple[int, ...]]] = {}
    for counts in itertools.product(range(most + 1), repeat=groups):
        if not FEWEST <= sum(counts) <= most:
            continue  # Of fewer than five people the total tells it.
        shown = published_counts(dict(zip("abcd", counts, strict=False)))
        assert all(count % FEWEST == 0 < count for count in shown.values())
        alike.setdefault((sum(counts), tuple(sorted(shown.items()))), []).append(counts)
    for (total, shown), tables in alike.items():
        for group in range(groups):
            found = {table[group] for table in tables}
            small = found & set(range(1, FEWEST))
            assert not small or len(found) > 1, (total, shown, tables)


@given(st.lists(st.integers(0, 1000), max_size=8))
def test_groups_that_are_published_hold_everybody_and_five_or_more(counts: list[int]) -> None:
    shown = published_counts({f"g{index}": count for index, count in enumerate(counts)})
    groups = [name.replace(" or ", ", ").split(", ") for name in shown]
    everyone = [name for names in groups for name in names]
    assert not shown or everyone == [f"g{index}" for index in range(len(counts))]
    for names, count in zip(groups, shown.values(), strict=True):
        people = sum(counts[int(name[1:])] for name in names)
        assert FEWEST <= count <= people < count + FEWEST
    # Large groups are not put together with each other.
    if all(count >= FEWEST for count in counts) and len(counts) > 1:
        assert len(shown) == len(counts)


def people(tmp_path: Path, make: Make, said: list[tuple[str | None, float | None]]) -> Store:
    roots = []
    for index, (sex, age) in enumerate(said):
        root = make(tmp_path / f"p{index}", 96, 64, subject=f"p{index}", seed=index)
        report = json.loads((root / "report.json").read_text())
        (root / "report.json").write_text(json.dumps({**report, "sex": sex, "age_years": age}))
        roots.append(root)
    return open_in_memory(build_store(roots, tmp_path / "store"))


def test_people_are_counted_by_what_the_store_knows(tmp_path: Path, make_processed: Make) -> None:
    lines: list[tuple[str | None, float | None]] = [("female", 20 + i) for i in range(6)]
    lines += [("male", 50), ("male", 51), (None, None), ("female", 29.9)]
    lines += [("male", 31.0)] * 3
    store = people(tmp_path, make_processed, lines)
    out = publish(store, tmp_path / "out", config=TINY)
    tables = {t["what"]: t for t in json.loads((out / "dataset.json").read_text())["people_by"]}
    assert tables["sex"]["groups"] == ["female", "male, other or not known"]
    assert tables["age"]["groups"] == [
        "under 18 or 18 to 29",
        "30 to 44, 45 to 59, 60 and over or not known",
    ]
    assert tables["sex"]["at_least"] == tables["age"]["at_least"] == [5, 5]
    assert tables["skin tone"]["said"].startswith("13 people by skin tone: ")
    texts = [(out / name).read_text() for name in ("DATASHEET.md", "croissant.json")]
    for text in texts:
        assert all(table["said"] in text for table in tables.values())


def test_what_the_store_does_not_know_is_reported(tmp_path: Path, store: Store) -> None:
    out = publish(store, tmp_path / "out", config=SMALL)
    for text in ((out / name).read_text() for name in ("DATASHEET.md", "croissant.json")):
        assert "The lab's store knows nobody's age." in text
        assert "The lab's store knows nobody's sex." in text


def test_a_store_of_before_is_published_without_knowing_whom_it_shows(
    tmp_path: Path, make_processed: Make
) -> None:
    built = small_store(tmp_path, make_processed)
    file = built.path / "dataset.json"
    value = json.loads(file.read_text())
    for scan in value["scans"]:
        for name in ("sums", "shards_sha256", "sex", "age"):
            del scan[name]
    file.write_text(json.dumps(value))
    out = publish(open_in_memory(built.path), tmp_path / "out", config=SMALL)
    assert "knows nobody's skin tone" in (out / "DATASHEET.md").read_text()


@pytest.mark.parametrize(
    ("field", "value"),
    [("sex", "f"), ("sex", 1), ("age_years", "old"), ("age_years", -1), ("age_years", True)],
)
def test_an_age_or_sex_that_is_none_is_refused(
    tmp_path: Path, make_processed: Make, field: str, value: Any
) -> None:
    root = make_processed(tmp_path / "p")
    report = root / "report.json"
    report.write_text(json.dumps({**json.loads(report.read_text()), field: value}))
    with pytest.raises(LightstageError, match=rf"report\.json, {field}: found"):
        build_store([root], tmp_path / "store")
    assert not (tmp_path / "store").exists()


def test_every_age_has_one_band() -> None:
    bands = [age_band(years / 4) for years in range(520)]
    assert list(dict.fromkeys(bands)) == [*AGE_BANDS, OLDEST]
    assert (age_band(17.99), age_band(18)) == ("under 18", "18 to 29")
    assert len(set(SEXES)) == 3


@pytest.mark.parametrize("simulated", [2, 3])
def test_photographs_are_spoken_of_only_where_somebody_was_photographed(simulated: int) -> None:
    facts = {"counts": {"subjects": 3}, "consent": {"subjects_simulated": simulated}}
    told = (
        statements.preprocessing(facts),
        statements.raw_data(facts),
        statements.errors(facts),
    )
    nobody = simulated == 3
    assert [("Noise of the cameras" in told[2]), told[0].startswith("Of the photographs")] == [
        not nobody
    ] * 2
    assert told[0].startswith("There were no photographs") == nobody
    assert told[1].startswith("There are no photographs") == nobody
