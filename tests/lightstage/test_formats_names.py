"""What may stand for a person, and for a consent record."""

import unicodedata

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.errors import ConfigError
from lightstage.formats.names import RESERVED, consent_problem, pseudonym_problem
from lightstage.session.pseudonym import check_consent, check_pseudonym


@pytest.mark.parametrize(
    "text",
    ["P1", "subject-1", "P07", "person_3.b", "Ω7", "Ж12", "é1", "被験者3", "x" * 64, "7", "lps"],
)
def test_pseudonyms_are_taken(text):
    assert check_pseudonym(text, "subject") == text


@pytest.mark.parametrize(
    "text",
    [
        "",
        ".",
        "..",
        "../P1",
        "P1/..",
        "..\\P1",
        "P1..x",
        "/P1",
        "C:P1",
        "~P1",
        "P1.",
        "P1 ",
        " P1",
        "P1\n",
        "P1\0",
        "P\t1",
        "-P1",
        "ann@home.org",
        "P\u2215\u00311",  # division slash
        "P\u20441",  # fraction slash
        "P\u29f81",  # big solidus
        "P\uff0f1",  # full-width slash
        "P\ufe681",  # small reverse solidus
        "\uff30\uff11",  # full-width P1
        "\U0001d40f1",  # mathematical bold P
        "\u2460",  # 1 in a circle
        "P\u00b2",  # superscript 2
        "\ufb01x",  # fi as one letter
        "P\u202e1",  # right-to-left override
        "P\u2066x\u2069",  # isolates
        "P\u200b1",  # zero-width space
        "P\u200d1",  # zero-width joiner
        "P\ufeff1",
        "P\u00ad1",  # soft hyphen
        "P\u2024\u20241",  # one-dot leaders
        "P\u00a01",  # no-break space
        "\u0430nn",  # Cyrillic a, Latin n
        "\u039fk",  # Greek capital O, Latin k
        "x" * 65,
        "CON",
        "nul.txt",
        "Lpt1 .x",
        "\U0001f600",
        "\ud800",
    ],
)
def test_paths_addresses_tricks_and_reserved_names_are_refused(text):
    with pytest.raises(ConfigError, match="--subject") as caught:
        check_pseudonym(text, "subject")
    assert str(caught.value).isascii()  # the trick is shown, not played


def test_one_accent_written_two_ways_is_one_pseudonym():
    assert check_pseudonym("e\u03011", "subject") == check_pseudonym("\u00e91", "subject")


@pytest.mark.parametrize(
    "text",
    ["Ann Person", "ann person 2", "Ann-Maria", "Ann_Person", "ann.person", "Jürgen", "Müller",
     "P 07", "佐藤", "Иван"],
)  # fmt: skip
def test_what_may_be_a_persons_name_is_no_pseudonym(text):
    with pytest.raises(ConfigError, match="such as P07 or subject-12"):
        check_pseudonym(text, "subject")


def test_an_expression_may_have_two_words():
    assert check_pseudonym("mouth open", "expression") == "mouth open"


@given(st.text(max_size=70))
def test_what_is_taken_is_its_own_spelling_and_safe_as_a_file_name(text):
    composed = unicodedata.normalize("NFC", text)
    if pseudonym_problem(composed) is not None:
        return
    assert unicodedata.normalize("NFKC", composed) == composed
    assert composed.isprintable()
    assert composed.strip(" .") == composed
    assert not set(composed) & set("/\\:@~<>|?*\"'\0")
    assert composed.split(".")[0].strip().casefold() not in RESERVED


@given(st.text(alphabet="abcLPTCONaux01. -_", max_size=8))
def test_short_names_are_judged_alike_whatever_their_capitals(text):
    upper, lower = pseudonym_problem(text.upper()), pseudonym_problem(text.lower())
    assert (upper is None) == (lower is None)


@pytest.mark.parametrize("text", ["C-2026-0041", "17", "A1", "ICL.23_EX-004", "0" * 64])
def test_consent_records_ids_are_taken(text):
    assert check_consent(text) == text


@pytest.mark.parametrize(
    "text",
    ["", "1", "ann", "Ann Person 1", "C/17", "../17", "C..17", "-17", "17.", "C-１７", "ann@x1",
     "x1" * 33, "17\n", "17\u202e", "é1"],
)  # fmt: skip
def test_what_may_be_a_name_or_path_is_no_consent_id(text):
    with pytest.raises(ConfigError, match="--consent"):
        check_consent(text)


@given(st.text(max_size=70))
def test_any_text_gets_an_answer(text):
    for problem in (pseudonym_problem(text), consent_problem(text)):
        assert problem is None or problem
