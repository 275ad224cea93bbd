"""Files that `lightstage-sim dataset` writes beside the folders of the people that it makes."""

from __future__ import annotations

from pathlib import Path

from lightstage.errors import FormatError
from lightstage.formats.files import read_json

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
