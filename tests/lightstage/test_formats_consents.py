"""The registry of consents: what is not agreed to is refused, by id and purpose."""

from __future__ import annotations

import datetime
import json
from pathlib import Path

import pytest

from lightstage.errors import LightstageError
from lightstage.formats.consents import read_consents, require_consents

DAY = datetime.date(2026, 6, 15)
REGISTRY = """
schema = "lightstage.consents/1"
[[consent]]
id = "C-1"
purposes = ["capture", "research", "training"]
[[consent]]
id = "C-2"
purposes = ["research", "publication"]
until = "2026-06-15"
[[consent]]
id = "C-3"
purposes = ["research", "publication"]
withdrawn = "2026-06-15"
[[consent]]
id = "C-4"
purposes = []
"""


@pytest.fixture
def registry(tmp_path: Path) -> Path:
    path = tmp_path / "consents.toml"
    path.write_text(REGISTRY)
    return path


def test_what_is_agreed_to_is_let_through_to_the_last_day(registry: Path) -> None:
    consents = read_consents(registry)
    consents.require("research", {"P1": "C-1", "P2": "C-2"}, DAY)
    consents.require("publication", {"P2": "C-2"}, DAY)
    consents.require("research", {"P3": "C-3"}, DAY - datetime.timedelta(days=1))
    consents.require("training", {}, DAY)


@pytest.mark.parametrize(
    ("purpose", "consent", "day", "message"),
    [
        ("publication", "C-1", DAY, "C-1 (P) covers capture, research, training"),
        ("research", "C-2", DAY + datetime.timedelta(days=1), "C-2 (P) ended on 2026-06-15"),
        ("research", "C-3", DAY, "C-3 (P) was withdrawn on 2026-06-15"),
        ("capture", "C-4", DAY, "C-4 (P) covers nothing"),
        ("capture", "C-5", DAY, "C-5 (P) is not in it"),
        ("capture", None, DAY, "P carries no id of a consent"),
        ("commercial", "C-1", DAY, "purpose commercial: found C-1"),
    ],
)
def test_what_is_not_agreed_to_is_refused_with_id_and_purpose(
    registry: Path, purpose: str, consent: str | None, day: datetime.date, message: str
) -> None:
    with pytest.raises(LightstageError) as error:
        read_consents(registry).require(purpose, {"P": consent}, day)  # type: ignore[arg-type]
    assert message in str(error.value)
    assert str(registry) in str(error.value)


def test_json_says_the_same_as_toml(registry: Path, tmp_path: Path) -> None:
    path = tmp_path / "CONSENTS.JSON"
    value = {
        "schema": "lightstage.consents/1",
        "consent": [{"id": "C-2", "purposes": ["publication", "research"], "until": "2026-06-15"}],
    }
    path.write_text(json.dumps(value))
    assert read_consents(path).by_id["C-2"] == read_consents(registry).by_id["C-2"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[[consent]]\nid = "C-1"\npurposes = []\n' * 2, "found id C-1 twice"),
        ('[[consent]]\nid = "Ann"\npurposes = []\n', "expected an id with a digit"),
        ("[[consent]]\nid = 3\npurposes = []\n", "id: found 3"),
        ('[[consent]]\nid = "C-1"\npurposes = ["all"]\n', "C-1, purposes: found ['all']"),
        ('[[consent]]\nid = "C-1"\npurposes = "research"\n', "C-1, purposes: found 'research'"),
        ('[[consent]]\nid = "C-1"\n', "C-1, purposes: found None"),
        ('[[consent]]\nid = "C-1"\npurposes = []\nuntil = "soon"\n', "C-1, until: found 'soon'"),
        ('[[consent]]\nid = "C-1"\npurposes = []\nuntil = ""\n', "C-1, until: found ''"),
        (
            '[[consent]]\nid = "C-1"\npurposes = []\nname = "Ann"\n',
            "unknown keys: 'name', expected of id, purposes, until",
        ),
        (
            '[[consent]]\nid = "C-1"\nuntill = "2031-01-31"\n',
            "consent 1: found unknown keys: 'untill'",
        ),
        ("people = []\n", "found unknown keys: 'people', expected of schema, consent"),
        ("consent = 3\n", "consent: found 3, expected a list"),
        (
            '[[consent]]\nid = "C-1"\nuntil = 2031-01-31\n',
            "consent[0].until: found a date, expected text, a number, true or false, a list or a "
            'table. A day or a time is a text here: write it in quotes, "2031-01-31".',
        ),
    ],
)
def test_a_registry_that_is_wrong_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "consents.toml"
    path.write_text('schema = "lightstage.consents/1"\n' + text)
    with pytest.raises(LightstageError) as error:
        read_consents(path)
    assert message in str(error.value)


def test_without_a_registry_nobody_is_refused(tmp_path: Path) -> None:
    require_consents(None, "training", {"P": None})
    (tmp_path / "c.toml").write_text("")
    with pytest.raises(LightstageError, match="schema"):
        require_consents(tmp_path / "c.toml", "training", {})
