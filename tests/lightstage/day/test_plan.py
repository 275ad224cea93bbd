"""A plan of a day says what is wrong with it, and what is right comes back as it was written."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.day import PUBLISHED, DayPlan, PlannedSubject, read_plan, write_plan
from lightstage.day.plan import parse_plan, plan_values
from lightstage.errors import ConfigError, FormatError
from lightstage.rig import default_rig, save_rig

HEAD = 'schema = "lightstage.plan/1"\n'
P07 = '[[subjects]]\nsubject = "P07"\nconsent = "C-2026-0041"\n'
WORDS = st.from_regex(r"[a-z][a-z0-9_]{0,8}", fullmatch=True).filter(
    lambda word: word not in ("con", "prn", "aux", "nul")
)


def refusal(tmp_path: Path, text: str) -> str:
    path = tmp_path / "plan.toml"
    path.write_text(text)
    with pytest.raises((ConfigError, FormatError)) as raised:
        read_plan(path)
    assert str(path) in str(raised.value)
    return str(raised.value)


def test_a_plan_of_one_person_has_the_published_seven_expressions(tmp_path: Path) -> None:
    path = tmp_path / "plan.toml"
    path.write_text(HEAD + P07)
    takes = read_plan(path).all_takes()
    assert [take.expression for take in takes] == list(PUBLISHED)
    assert {(take.subject, take.consent, take.sequence) for take in takes} == {
        ("P07", "C-2026-0041", "binary")
    }


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        (HEAD + P07 + P07, ["subjects[1].subject", "each subject once"]),
        (HEAD + P07 + P07.replace("P07", "p07"), ["each subject once"]),
        (HEAD + '[[subjects]]\nsubject = "P07"\n', ["no consent", "Nobody is planned without"]),
        (HEAD + P07.replace("C-2026-0041", "Jane Doe"), ["subjects[0].consent"]),
        (HEAD + P07 + 'expressions = ["xyz"]\n', ["expressions[0]", "xyz", "There are"]),
        (HEAD + P07 + 'expressions = ["smlie"]\n', ["Did you mean smile?"]),
        (HEAD + P07 + 'expressions = ["smile", "smile"]\n', ["each expression once"]),
        (HEAD + P07 + "expressions = []\n", ["1 to 100 expressions"]),
        (HEAD + P07.replace("P07", "<b>P07</b>"), ["subjects[0].subject", "letters, digits"]),
        (HEAD + P07.replace("P07", "../../P07"), ["never a name, an address or a path"]),
        (HEAD + P07.replace("P07", "Jane Doe"), ["one word of letters"]),
        (HEAD + 'order = ["P08/neutral"]\n' + P07, ["order[0]", "Did you mean P07/neutral?"]),
        (HEAD + 'order = ["P07/smile", "P07/smile"]\n' + P07, ["each take once"]),
        (HEAD + '[takes]\n"P07/smile" = 0\n' + P07, ["a whole number from 1"]),
        (HEAD + '[takes]\n"P07/smile" = true\n' + P07, ["a whole number from 1"]),
        (HEAD + '[takes]\n"P07/smile" = "2"\n' + P07, ["found '2', expected a whole number"]),
        (HEAD + "subject = 3\n" + P07, ["an unknown field"]),
        (HEAD + P07 + "note = 3\n", ["subjects[0].note", "an unknown field"]),
        (HEAD + "sequence = 3\n" + P07, ["sequence"]),
        (HEAD + 'sessions = ""\n' + P07, ["sessions"]),
        (HEAD + "subjects = 3\n", ["subjects"]),
        ('schema = "lightstage.plan/2"\n', ["newer version"]),
        ('schema = "lightstage.rig/1"\n', ["lightstage.plan/1"]),
        ("", ["schema"]),
        ("subjects = [", ["valid TOML"]),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, text: str, parts: list[str]) -> None:
    stated = refusal(tmp_path, text)
    for part in parts:
        assert part in stated


def test_all_that_is_wrong_is_reported_at_once(tmp_path: Path) -> None:
    text = HEAD + '[[subjects]]\nsubject = "A B"\n[[subjects]]\nsubject = "P2"\nexpressions = 3\n'
    assert "4 problems" in refusal(tmp_path, text)


@given(
    st.lists(st.tuples(WORDS, st.lists(WORDS, min_size=1, max_size=3, unique=True)), max_size=5,
             unique_by=lambda each: each[0]),
    st.randoms(),
)  # fmt: skip
def test_what_is_written_is_read_again(tmp_path_factory, people, random) -> None:
    words = list(dict.fromkeys(word for _, own in people for word in own)) or ["neutral"]
    day = DayPlan(
        tuple(PlannedSubject(f"{name}1", "C-1", tuple(own)) for name, own in people), tuple(words)
    )
    names = [take.name for take in day.all_takes()]
    random.shuffle(names)
    for name in names[:3]:
        day = day.moved(name, random.choice([-2, -1, 1, 9])).wanting(name, random.randint(1, 3))
    path = write_plan(tmp_path_factory.mktemp("plan") / "plan.toml", day)
    again = read_plan(path)
    assert again == day
    assert sorted(take.name for take in again.all_takes()) == sorted(names)


@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.text(max_size=5),
        lambda inner: (
            st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3)
        ),
        max_leaves=8,
    ),
    st.sampled_from(["sequence", "expressions", "sessions", "order", "takes", "subjects"]),
)
def test_whatever_a_field_holds_is_taken_or_refused_in_words(value, field: str) -> None:
    values = {**plan_values(DayPlan((PlannedSubject("P1", "C-1"),))), field: value}
    try:
        parse_plan(values, Path("plan.toml")).all_takes()
    except (ConfigError, FormatError) as error:
        refusal = str(error)
    else:
        refusal = "plan.toml"
    assert "plan.toml" in refusal


def test_a_take_moves_by_one_and_stays_in_the_list(tmp_path: Path) -> None:
    day = DayPlan((PlannedSubject("P1", "C-1"), PlannedSubject("P2", "C-2")), ("a", "b"))
    names = [take.name for take in day.moved("P2/a", -1).all_takes()]
    assert names == ["P1/a", "P2/a", "P1/b", "P2/b"]
    assert next(take.name for take in day.moved("P1/a", -1).all_takes()) == "P1/a"
    with pytest.raises(ConfigError, match="Did you mean"):
        day.moved("P1/aa", 1)


def test_takes_of_different_people_never_share_a_folder() -> None:
    day = DayPlan((PlannedSubject("P1", "C-1"), PlannedSubject("P1.2", "C-2")), ("a", "2", "a.2"))
    folders = [take.folder(n) for take in day.all_takes() for n in (1, 2, 3)]
    assert len(set(folders)) == len(folders)
    assert all("/" not in name and not name.startswith(".") for name in folders)


def test_a_plan_that_could_not_be_read_again_is_not_written(tmp_path: Path) -> None:
    path = write_plan(tmp_path / "plan.toml", DayPlan((PlannedSubject("P1", "C-1"),)))
    before = path.read_bytes()
    for subject in (PlannedSubject("P1", "C-2"), PlannedSubject("a/b", "C-2")):
        with pytest.raises(ConfigError):
            write_plan(path, read_plan(path).with_subject(subject))
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["plan.toml"]


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (["--plan", "PLAN", "--out", "S"], "--plan: the plan has it"),
        (["--plan", "PLAN", "--subject", "P9", "--consent", "C-9"], "2 problems"),
        (["--plan", "PLAN", "--take", "P07/smlie"], "Did you mean P07/smile?"),
        (["--plan", "PLAN"], "the stage's rig.json"),
        (["--take", "P07/smile", "--out", "S"], "--plan beside it"),
        ([], "or --plan with a day's plan"),
        (["--out", "S", "--attended", "--unattended"], "one of the two"),
    ],
)
def test_capture_states_what_does_not_go_with_a_plan(tmp_path, run_command, words, part) -> None:
    plan = tmp_path / "plan.toml"
    plan.write_text(HEAD + P07)
    given = [{"PLAN": str(plan), "S": str(tmp_path / "S")}.get(word, word) for word in words]
    ended = run_command("lightstage", "capture", "--leds", "serial:///dev/none", *given)
    assert ended.code == 2
    assert part in ended.err
    assert [path.name for path in tmp_path.iterdir()] == ["plan.toml"]


def test_a_plans_pattern_that_does_not_exist_is_named_with_the_plan(tmp_path, run_command) -> None:
    plan = tmp_path / "plan.toml"
    plan.write_text(HEAD + 'sequence = "binery"\n' + P07)
    rig = save_rig(default_rig(), tmp_path / "rig.json")
    words = ("capture", "--leds", "serial:///dev/none", "--plan", plan, "--rig", rig)
    ended = run_command("lightstage", *map(str, words))
    assert ended.code == 2
    assert f"{plan}, sequence: pattern 'binery': found an unknown name" in ended.err
