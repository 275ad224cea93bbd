"""What a line of a journal must hold, event by event, before anything is done by it.

A journal may have been changed by hand or come from elsewhere: its paths and names are checked
before a file is moved or read by them. Events that are not listed, and fields that no rule names,
are for people; who shows them copes with whatever is there.
"""

from __future__ import annotations

import datetime
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from lightstage.errors import FormatError
from lightstage.formats.names import require_pseudonym
from lightstage.formats.paths import check_name, relative_path

Line = dict[str, Any]


class Rule(NamedTuple):
    """What a field must be: in words, and as a test."""

    expected: str
    holds: Callable[[Any], bool]


SOME = 1_000_000
"""No take, and no count of lines of a screen, is larger."""


def check_lines(lines: Sequence[Line], path: Path) -> None:
    """Refuse lines whose fields are not those of their events.

    Args:
        lines: with their events and ids; the first is ``begin``.
        path: of the journal, for the error.

    Raises:
        FormatError: a field that is missing or is something else, or a camera that ``begin`` does
            not name.
    """
    for line in lines:
        _check_line(line, path)
        wanted, _ = _EVENTS.get(line["event"], ({}, {}))
        if "camera" in wanted and line["camera"] not in lines[0]["cameras"]:
            raise FormatError(
                path,
                field=f"line {line['id']} ({line['event']}), camera",
                found=repr(line["camera"]),
                expected=f"one of {', '.join(lines[0]['cameras'])}",
                hint=_HINT,
            )


def _check_line(line: Line, path: Path) -> None:
    wanted, optional = _EVENTS.get(line["event"], ({}, {}))
    where = f"line {line['id']} ({line['event']})"
    for name, rule in (*wanted.items(), *optional.items()):
        if name not in line and name in wanted:
            raise FormatError(
                path, field=f"{where}, {name}", found="no such field", expected="it", hint=_HINT
            )
        value = line.get(name)
        if name in wanted or value is not None:
            _check_field(value, rule, path, f"{where}, {name}")


_HINT = "The journal was changed by hand or by the disk; restore it from a copy."


def _check_field(value: Any, rule: str | Rule, path: Path, field: str) -> None:
    if rule == "name":
        check_name(value, path, field)
    elif rule == "pseudonym":
        require_pseudonym(value, path, field)
    elif rule == "names":
        _check_field(value, _LIST, path, field)
        for index, each in enumerate(value):
            check_name(each, path, f"{field}[{index}]")
    elif rule == "path":
        relative_path(value, path, field)
    elif isinstance(rule, Rule) and not rule.holds(value):
        shown = ascii(value)
        raise FormatError(
            path,
            field=field,
            found=shown if len(shown) <= 80 else f"{shown[:80]}..",
            expected=rule.expected,
            hint=_HINT,
        )


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_hash(value: Any) -> bool:
    return isinstance(value, str) and value.isascii()


def _is_encoding(value: Any) -> bool:
    return value in ("raw", "linear")


def _is_take(value: Any) -> bool:
    return type(value) is int and 1 <= value <= SOME


def _is_time(value: Any) -> bool:
    try:
        return datetime.datetime.fromisoformat(value).tzinfo is not None
    except (TypeError, ValueError):
        return False


def _is_file(value: Any) -> bool:
    if not isinstance(value, list) or len(value) != 2:
        return False
    return isinstance(value[0], str) and type(value[1]) is int and value[1] >= 0


def _are_files(value: Any) -> bool:
    return isinstance(value, list) and all(map(_is_file, value))


def _are_cards(value: Any) -> bool:
    return isinstance(value, dict) and all(map(_are_files, value.values()))


def _are_keys(value: Any) -> bool:
    return isinstance(value, list) and all(map(_is_key, value))


def _is_key(value: Any) -> bool:
    if not isinstance(value, list) or len(value) != 3:
        return False
    return _is_text(value[0]) and _is_text(value[1]) and _is_take(value[2])


def _are_takes(value: Any) -> bool:
    return isinstance(value, dict) and all(map(_is_take, value.values()))


def _is_number(value: Any) -> bool:
    return type(value) in (int, float)


def _are_levels(value: Any) -> bool:
    return isinstance(value, list) and all(_is_number(each) and 0 <= each <= 1 for each in value)


def _are_all_levels(value: Any) -> bool:
    return isinstance(value, dict) and all(map(_are_levels, value.values()))


def _are_serials(value: Any) -> bool:
    return isinstance(value, dict) and all(
        each is None or isinstance(each, str) for each in value.values()
    )


def _is_object(value: Any) -> bool:
    return isinstance(value, dict)


def _are_findings(value: Any) -> bool:
    return isinstance(value, list) and all(
        isinstance(each, dict)
        and isinstance(each.get("code"), str)
        and all(isinstance(each.get(name) or "", str) for name in ("pattern", "camera"))
        for each in value
    )


def _are_paths(value: Any) -> bool:
    if not isinstance(value, dict):
        return False
    try:
        for each in value.values():
            if each is not None:
                relative_path(each, "journal")
    except FormatError:
        return False
    return True


_TEXT = Rule("a text", _is_text)
_HASH = Rule("a hash in hexadecimal", _is_hash)
_ENCODING = Rule("raw or linear", _is_encoding)
_TAKE = Rule("a take's number, from 1", _is_take)
_TIME = Rule("a time with its zone (ISO 8601)", _is_time)
_FILE = Rule("a file on a card: its name and its size in bytes", _is_file)
_FILES = Rule("a list of files on a card, each a name and a size in bytes", _are_files)
_CARDS = Rule("for each camera a list of files, each a name and a size in bytes", _are_cards)
_TAKES = Rule("for each camera the number of its take", _are_takes)
_NUMBER = Rule("a finite number", _is_number)
_LEVELS = Rule("a list of numbers from 0 to 1", _are_levels)
_ALL_LEVELS = Rule("for each pattern a list of numbers from 0 to 1", _are_all_levels)
_SERIALS = Rule("for each camera its serial number or null", _are_serials)
_OBJECT = Rule("an object", _is_object)
_LIST = Rule("a list", lambda value: isinstance(value, list))
_TOLD = Rule(
    "for each camera an object",
    lambda value: _is_object(value) and all(map(_is_object, value.values())),
)
_PATHS = Rule(
    "for each kind of calibration a relative path that stays in the session, or null", _are_paths
)

_FINDINGS = Rule("a list of findings, each with a code", _are_findings)

Rules = Mapping[str, str | Rule]
_OF_PHOTOGRAPH: Rules = {"pattern": "name", "camera": "name", "take": _TAKE}
_EVENTS: Mapping[str, tuple[Rules, Rules]] = {
    "begin": (
        {
            "session": "name",
            "created_utc": _TEXT,
            "subject": "pseudonym",
            "expression": "pseudonym",
            "sequence": "names",
            "cameras": "names",
        },
        {
            "cards": _CARDS,
            "serials": _SERIALS,
            "calibration": _PATHS,
            "levels": _ALL_LEVELS,
            "config": _OBJECT,
            "facts": _OBJECT,
            "told": _TOLD,
            "not_verifiable": _OBJECT,
            "consent": _TEXT,
            "rig_sha256": _TEXT,
        },
    ),
    "resume": ({}, {"cards": _CARDS, "told": _TOLD, "config": _OBJECT}),
    "lit": ({"pattern": "name"}, {"levels": _LEVELS, "elapsed_s": _NUMBER}),
    "trigger": ({"pattern": "name", "takes": _TAKES}, {}),
    "exposed": (
        {**_OF_PHOTOGRAPH, "file": _FILE, "time_utc": _TIME},
        {"beside": _FILES, "exposure_s": _NUMBER, "clock_offset_s": _NUMBER},
    ),
    "frame": (
        {**_OF_PHOTOGRAPH, "path": "path", "sha256": _HASH},
        {"file": _TEXT, "size": _NUMBER, "encoding": _ENCODING},
    ),
    "rejected": (_OF_PHOTOGRAPH, {}),
    "retake": ({"takes": Rule("a list of pattern, camera and take", _are_keys)}, {}),
    "recovered": ({"camera": "name", "path": "path", "sha256": _HASH}, {"file": _FILE}),
    "deleting": ({"pattern": "name", "camera": "name", "file": _FILE}, {}),
    "deleted": ({"camera": "name", "file": _FILE}, {}),
    "shot": ({"pattern": "name"}, {"levels": _LEVELS}),
    "calibration": (
        {},
        dict.fromkeys(("colour", "cameras", "lights", "flats"), "path"),
    ),
    "accepted": ({"pattern": "name", "findings": _FINDINGS}, {}),
    "note": ({}, {"cards": _CARDS, "file": _FILE}),
    "finding": ({}, {"code": _TEXT}),
}
"""For each event from which a state follows: the fields that it must have, and others that it may.
"""
