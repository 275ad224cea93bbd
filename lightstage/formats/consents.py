"""The lab's registry of consents: what each person's photographs may be used for, and until when.

    schema = "lightstage.consents/1"

    [[consent]]
    id = "C-2026-0041"
    purposes = ["capture", "research", "training"]
    until = "2031-01-31"
    withdrawn = "2026-05-01"

One TOML or JSON file, kept apart from sessions: they hold the id alone.
"""

from __future__ import annotations

import dataclasses
import datetime
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, get_args

from lightstage.errors import ConfigError, LightstageError, one_error
from lightstage.formats.files import check_schema, read_json
from lightstage.formats.names import consent_problem
from lightstage.formats.values import read_toml_value

SCHEMA = "lightstage.consents/1"
KEYS = ("id", "purposes", "until", "withdrawn")
Purpose = Literal["capture", "research", "training", "publication", "commercial"]
NAMED = 8
"""People that one message names."""


@dataclasses.dataclass(frozen=True)
class Consent:
    """What one person agreed to.

    Attributes:
        id: that sessions carry.
        purposes: that are agreed to.
        until: the last day; None without an end.
        withdrawn: the first day on which it holds no more; None where it was not withdrawn.
    """

    id: str
    purposes: frozenset[str]
    until: datetime.date | None = None
    withdrawn: datetime.date | None = None

    def problem(self, purpose: Purpose, day: datetime.date) -> str:
        """Why it does not cover a purpose on a day; empty where it does."""
        if self.withdrawn is not None and day >= self.withdrawn:
            return f"was withdrawn on {self.withdrawn}"
        if self.until is not None and day > self.until:
            return f"ended on {self.until}"
        if purpose not in self.purposes:
            covers = ", ".join(p for p in get_args(Purpose) if p in self.purposes)
            return f"covers {covers or 'nothing'}"
        return ""


@dataclasses.dataclass(frozen=True)
class Consents:
    """A registry that was read.

    Attributes:
        path: the file.
        by_id: the consents.
    """

    path: Path
    by_id: Mapping[str, Consent]

    def require(
        self,
        purpose: Purpose,
        whose: Mapping[str, str | None],
        day: datetime.date | None = None,
    ) -> None:
        """Refuse people who did not agree to a purpose.

        Args:
            purpose: what is to be done.
            whose: by what a message calls a person or a session, the id of the consent.
            day: today where None.

        Raises:
            ConfigError: every id that does not cover the purpose, in one message.
        """
        day = day or datetime.datetime.now(datetime.UTC).date()
        wrong = []
        for who, consent_id in whose.items():
            if consent_id is None:
                wrong.append(f"{who} carries no id of a consent")
                continue
            known = self.by_id.get(consent_id)
            problem = "is not in it" if known is None else known.problem(purpose, day)
            if problem:
                wrong.append(f"{consent_id} ({who}) {problem}")
        if wrong:
            more = f"; and {len(wrong) - NAMED} more" if len(wrong) > NAMED else ""
            raise ConfigError(
                self.path,
                field=f"purpose {purpose}",
                found="; ".join(wrong[:NAMED]) + more,
                expected=f"consents that cover {purpose} on {day}",
                hint="Leave these people out, or ask them and record what they agree to.",
            )


def require_consents(path: Path | None, purpose: Purpose, whose: Mapping[str, str | None]) -> None:
    """`Consents.require`, where a registry is configured."""
    if path is not None:
        read_consents(path).require(purpose, whose)


def read_consents(path: Path) -> Consents:
    """Read a registry, .json or TOML.

    Raises:
        ConfigError, FormatError: no registry, an unknown key or purpose, an id that is none or
            is there twice, a date that is none; all in one message.
    """
    value = read_json(path) if path.suffix.lower() == ".json" else read_toml_value(path)
    check_schema(path, value, SCHEMA)
    listed = value.get("consent", [])
    _require_keys(value, path, "", ("schema", "consent"))
    if not isinstance(listed, list):
        raise ConfigError(path, field="consent", found=ascii(listed)[:80], expected="a list")
    problems: list[LightstageError] = []
    by_id: dict[str, Consent] = {}
    for number, each in enumerate(listed, 1):
        try:
            consent = _consent(each, path, f"consent {number}")
            if consent.id in by_id:
                raise ConfigError(
                    path,
                    field=f"consent {number}",
                    found=f"id {consent.id} twice",
                    expected="each id once",
                    hint="Which of the two holds, only the lab can know: remove the other.",
                )
            by_id[consent.id] = consent
        except LightstageError as error:
            problems.append(error)
    if problems:
        raise one_error(problems)
    return Consents(path, by_id)


def _require_keys(value: Mapping[str, Any], path: Path, field: str, known: Sequence[str]) -> None:
    """Refuse keys that no record has: one that is misspelt would not hold."""
    if unknown := sorted(set(value) - set(known)):
        shown = ", ".join(ascii(key)[:80] for key in unknown[:3])
        raise ConfigError(
            path, field=field, found=f"unknown keys: {shown}", expected=f"of {', '.join(known)}"
        )


def _consent(value: Any, path: Path, field: str) -> Consent:
    if not isinstance(value, dict):
        raise ConfigError(path, field=field, found=ascii(value)[:80], expected=", ".join(KEYS))
    _require_keys(value, path, field, KEYS)
    consent_id = value.get("id")
    wanted = consent_problem(consent_id) if isinstance(consent_id, str) else "an id"
    if not isinstance(consent_id, str) or wanted is not None:
        shown = ascii(consent_id)[:80]
        raise ConfigError(path, field=f"{field}, id", found=shown, expected=wanted or "")
    purposes = value.get("purposes")
    known = get_args(Purpose)
    if not isinstance(purposes, list) or any(p not in known for p in purposes):
        raise ConfigError(
            path,
            field=f"{consent_id}, purposes",
            found=ascii(purposes)[:80],
            expected=f"a list of {', '.join(known)}",
        )
    days = {key: _day(value.get(key), path, f"{consent_id}, {key}") for key in KEYS[2:]}
    return Consent(consent_id, frozenset(purposes), **days)


def _day(value: Any, path: Path, field: str) -> datetime.date | None:
    """A day as text."""
    if value is None:
        return None
    try:
        return datetime.date.fromisoformat(value)
    except (TypeError, ValueError):
        raise ConfigError(
            path, field=field, found=ascii(value)[:80], expected='a day, such as "2031-01-31"'
        ) from None
