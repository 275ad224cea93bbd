"""The table of people: shares kept by every beginning of the list."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lightstage.errors import LightstageError
from sim.errors import SimError
from sim.people.table import TABLES, PeopleTable, load_table, people
from sim.people.traits import AGE_RANGE, LOOKS, SEXES, TONES


def shares_off(table: PeopleTable, count: int, seed: int) -> float:
    """How many people the worst group is away from its share."""
    found = people(table, count, seed)
    off = [abs(sum(p.sex == sex for p in found) - count * s) for sex, s in table.sex.items()]
    off += [abs(sum(p.tone == tone for p in found) - count * s) for tone, s in table.tone.items()]
    for low, high, share in table.age:
        off.append(abs(sum(low <= p.age_years < high for p in found) - count * share))
    return max(off)


@pytest.mark.parametrize("count", [12, 40, 210])
def test_every_group_of_the_balanced_table_has_its_share(count: int) -> None:
    table = load_table("balanced")
    assert table.subjects > 200
    assert max(shares_off(table, count, seed) for seed in range(5)) <= 2.0


def test_two_attributes_together_are_balanced_too() -> None:
    found = people(load_table("balanced"), 600, 3)
    count = np.zeros((len(SEXES), len(TONES)))
    for person in found:
        count[SEXES.index(person.sex), TONES.index(person.tone)] += 1
    assert count.min() >= 0.8 * count.mean()
    assert count.max() <= 1.2 * count.mean()


def test_a_larger_data_set_begins_with_the_smaller_one() -> None:
    table = load_table("balanced")
    assert people(table, 1400, 5)[:40] == people(table, 40, 5)
    assert people(table, 40, 6) != people(table, 40, 5)


def test_a_users_table_is_followed(tmp_path: Path) -> None:
    path = tmp_path / "lab.toml"
    path.write_text(
        "subjects = 30\n[sex]\nmale = 3\nfemale = 1\n[tone]\n2 = 1\n5 = 1\n[look]\nfreckled = 2\n"
        "[[age]]\nfrom_years = 20\nto_years = 30\nshare = 1\n"
        "[[age]]\nfrom_years = 60\nto_years = 80\nshare = 0\n"
    )
    table = load_table(str(path))
    assert (table.name, table.subjects) == ("lab", 30)
    found = people(table, 40, 1)
    assert abs(sum(p.sex == "male" for p in found) - 30) <= 2
    assert {p.tone for p in found} == {2, 5}
    assert {p.look for p in found} == {"freckled"}
    assert all(20 <= p.age_years <= 30 for p in found)


GOOD = {
    "subjects": "subjects = 5",
    "sex": "[sex]\nmale = 1",
    "tone": "[tone]\n1 = 1",
    "look": "[look]\nplain = 1",
    "age": "[[age]]\nfrom_years = 20\nto_years = 30\nshare = 1",
}


@pytest.mark.parametrize(
    ("entry", "text", "message"),
    [
        ("subjects", "subjects = 0", "subjects"),
        ("subjects", "subjects = 5\nheight = 3", "height"),
        ("sex", "[sex]\nmale = -1", "not negative"),
        ("sex", "[sex]\nmale = nan", "finite number"),
        ("sex", "[sex]\nmale = 0", "sum to 0"),
        ("tone", "[tone]\n7 = 1", "7"),
        ("look", "[look]\nshiny = 1", "shiny"),
        ("look", "", "look"),
        ("age", "", "age"),
        ("age", "[[age]]\nfrom_years = 30\nto_years = 20\nshare = 1", "rising"),
        ("age", "[[age]]\nfrom_years = 3\nto_years = 20\nshare = 1", "rising"),
        ("age", "[[age]]\nfrom_years = 30\nshare = 1", "to_years"),
    ],
)
def test_a_wrong_table_is_one_message(tmp_path: Path, entry: str, text: str, message: str) -> None:
    path = tmp_path / "table.toml"
    path.write_text("\n".join((GOOD | {entry: text}).values()) + "\n")
    with pytest.raises(LightstageError, match=message):
        load_table(str(path))


def test_an_unknown_table_names_those_there_are() -> None:
    with pytest.raises(SimError, match="balanced"):
        load_table("everyone")


def test_shipped_tables_use_known_groups_only() -> None:
    for path in TABLES.glob("*.toml"):
        table = load_table(path.stem)
        assert set(table.look) <= set(LOOKS)
        assert AGE_RANGE[0] <= table.age[0][0] < table.age[-1][1] <= AGE_RANGE[1]
