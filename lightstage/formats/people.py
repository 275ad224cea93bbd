"""Files that `lightstage-sim dataset` writes beside the folders of the people that it makes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from lightstage.errors import FormatError
from lightstage.formats.files import read_json, write_json

PEOPLE_SCHEMA = "lightstage.people/1"
PEOPLE_LIST = "people.json"
"""Everyone, and how many there are of each kind."""
PEOPLE_LOCK = "people.lock"
"""Held while people are made, so that two runs do not share a folder."""


def is_people_file(path: Path) -> bool:
    """Whether a file is the list of simulated people, or the lock beside such a list."""
    if path.name not in (PEOPLE_LIST, PEOPLE_LOCK) or not path.is_file():
        return False
    try:
        read_json(path.with_name(PEOPLE_LIST), PEOPLE_SCHEMA)
    except FormatError:
        return False
    return True


def people_counts(people: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, int]]:
    """How many people there are of each kind: `counts` of people.json.

    Args:
        people: its `people`, each with `sex`, `age_years`, `tone` and `look`.
    """
    counts = {
        "sex": Counter(str(each["sex"]) for each in people),
        "age": Counter(f"{int(each['age_years']) // 10 * 10}s" for each in people),
        "tone": Counter(str(each["tone"]) for each in people),
        "look": Counter(str(each["look"]) for each in people),
    }
    return {name: dict(sorted(count.items())) for name, count in counts.items()}


def lists_person(path: Path, name: str) -> bool:
    """Whether a file is the list of simulated people, with somebody of that name in it."""
    return is_people_file(path) and any(_is(each, name) for each in _people(read_json(path)))


def take_off(path: Path, name: str) -> None:
    """Take somebody off the list of simulated people, and out of its counts.

    Call this while `PEOPLE_LOCK` beside it is held. Who may read the file stays as it is.
    """
    value = read_json(path, PEOPLE_SCHEMA)
    value["people"] = [each for each in _people(value) if not _is(each, name)]
    try:
        value["counts"] = people_counts(value["people"])
    except (KeyError, TypeError, ValueError):  # of a list that somebody changed
        value.pop("counts", None)
    mode = path.stat().st_mode & 0o777
    write_json(path, value)
    path.chmod(mode)


def _people(value: Mapping[str, Any]) -> list[Any]:
    people = value.get("people")
    return people if isinstance(people, list) else []


def _is(entry: Any, name: str) -> bool:
    return isinstance(entry, dict) and entry.get("name") == name
