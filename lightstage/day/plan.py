"""The plan of a day: a TOML file with subjects, their consent, their expressions, and the order."""

from __future__ import annotations

import dataclasses
import difflib
import json
import unicodedata
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from lightstage.errors import ConfigError, LightstageError, one_error
from lightstage.formats.files import check_schema, write_text
from lightstage.formats.names import consent_problem, name_problem, pseudonym_problem
from lightstage.formats.values import read_toml_value

SCHEMA = "lightstage.plan/1"
PUBLISHED = (
    *("neutral", "smile", "jaw_open", "brow_raise", "brow_furrow", "pucker", "eyes_closed"),
)
"""The preset ``published``: seven expressions of each person, as RealFaceDB was captured with
[AvatarMe]; the names are those of `lightstage-sim dataset --expressions 7`."""
PRESET = "published"
MOST_SUBJECTS, MOST_EXPRESSIONS, MOST_TAKES = 500, 100, 50
_FIELDS = ("schema", "sequence", "expressions", "sessions", "order", "takes", "subjects")
_SUBJECT_FIELDS = ("subject", "consent", "expressions", "sequence")


@dataclasses.dataclass(frozen=True)
class PlannedSubject:
    """One person of the day.

    Attributes:
        subject: pseudonym.
        consent: id of the record of the person's consent.
        expressions: of this person, in order; none: the plan's.
        sequence: of this person; none: the plan's.
    """

    subject: str
    consent: str
    expressions: tuple[str, ...] | None = None
    sequence: str | None = None


def take_folder(subject: str, expression: str, number: int) -> str:
    """Name of the folder of a person's session of this number, from 1, with an expression.

    No pseudonym holds a plus sign, so two takes never share a folder.
    """
    again = "" if number == 1 else f"+{number}"
    return f"{subject}+{expression}{again}"


@dataclasses.dataclass(frozen=True)
class Take:
    """One session that the plan wants: a person with an expression.

    Attributes:
        subject: pseudonym.
        expression: such as ``neutral``.
        consent: id of the record of the person's consent.
        sequence: of patterns.
        wanted: how many whole sessions of it are wanted: 1, or more where one shall be repeated.
    """

    subject: str
    expression: str
    consent: str
    sequence: str
    wanted: int = 1

    @property
    def name(self) -> str:
        """As the plan's `order` and the command line name it: ``P07/neutral``."""
        return f"{self.subject}/{self.expression}"

    def folder(self, number: int) -> str:
        """Name of the folder of its session of this number, from 1."""
        return take_folder(self.subject, self.expression, number)


@dataclasses.dataclass(frozen=True)
class DayPlan:
    """A day.

    Attributes:
        subjects: in the order in which they were written.
        expressions: of every subject that names none of its own.
        sequence: of patterns, as `lightstage capture --sequence` takes it.
        sessions: folder of the sessions, relative to the plan's own.
        order: names of takes (``P07/neutral``) that come first, in this order; the others follow,
            subject by subject.
        takes: how many whole sessions are wanted of a take, where it is more than one.
    """

    subjects: tuple[PlannedSubject, ...] = ()
    expressions: tuple[str, ...] = PUBLISHED
    sequence: str = "binary"
    sessions: str = "sessions"
    order: tuple[str, ...] = ()
    takes: Mapping[str, int] = dataclasses.field(default_factory=dict)

    def all_takes(self) -> list[Take]:
        """Every session that the plan wants, in the day's order."""
        takes = {}
        for each in self.subjects:
            own = self.expressions if each.expressions is None else each.expressions
            for expression in own:
                name = f"{each.subject}/{expression}"
                takes[name] = Take(
                    each.subject,
                    expression,
                    each.consent,
                    each.sequence or self.sequence,
                    self.takes.get(name, 1),
                )
        first = [takes.pop(name) for name in self.order if name in takes]
        return [*first, *takes.values()]

    def take(self, name: str, where: str | Path = "--take") -> Take:
        """The take of a name; ConfigError where there is none."""
        takes = {take.name: take for take in self.all_takes()}
        if name not in takes:
            raise ConfigError(
                where,
                found=ascii(name[:80]),
                expected="SUBJECT/EXPRESSION of the plan",
                hint=_nearest(name, list(takes)),
            )
        return takes[name]

    def moved(self, name: str, by: int) -> DayPlan:
        """The same day with one take earlier (negative) or later in the order."""
        names = [take.name for take in self.all_takes()]
        place = names.index(self.take(name).name)
        to = max(0, min(len(names) - 1, place + by))
        names.insert(to, names.pop(place))
        return dataclasses.replace(self, order=tuple(names))

    def wanting(self, name: str, wanted: int) -> DayPlan:
        """The same day with so many whole sessions wanted of one take."""
        takes = {**self.takes, self.take(name).name: wanted}
        return dataclasses.replace(self, takes={k: n for k, n in takes.items() if n != 1})

    def with_subject(self, subject: PlannedSubject) -> DayPlan:
        """The same day with one person more, at its end."""
        return dataclasses.replace(self, subjects=(*self.subjects, subject))

    def without_subject(self, name: str) -> DayPlan:
        """The same day without one person; ConfigError where there is none of this name."""
        if name not in [each.subject for each in self.subjects]:
            raise ConfigError("subject", found=ascii(name[:80]), expected="a subject of the plan")
        own = {take.name for take in self.all_takes() if take.subject == name}
        return dataclasses.replace(
            self,
            subjects=tuple(each for each in self.subjects if each.subject != name),
            order=tuple(each for each in self.order if each not in own),
            takes={take: number for take, number in self.takes.items() if take not in own},
        )


def read_plan(path: Path) -> DayPlan:
    """Read and check a plan.

    Raises:
        ConfigError: no such file, no TOML, or everything that is wrong in it, in one message.
        FormatError: another schema.
    """
    return parse_plan(read_toml_value(path), path)


def parse_plan(values: Mapping[str, Any], path: Path) -> DayPlan:
    """A plan from the values of its file; errors as `read_plan`."""
    check_schema(path, dict(values), SCHEMA)
    found = _Problems(path)
    found.unknown(values, _FIELDS, "")
    expressions = found.expressions(values.get("expressions", PRESET), "expressions", None)
    known = tuple(dict.fromkeys((*expressions, *PUBLISHED)))
    subjects = found.subjects(values.get("subjects", []), known)
    plan = DayPlan(
        tuple(subjects),
        expressions or PUBLISHED,
        found.text(values, "sequence", "binary"),
        found.folder(values.get("sessions", "sessions")),
    )
    names = [take.name for take in plan.all_takes()]
    order = found.order(values.get("order", []), names)
    takes = found.takes(values.get("takes", {}), names)
    if found.problems:
        raise one_error(found.problems)
    return dataclasses.replace(plan, order=order, takes=takes)


def write_plan(path: Path, plan: DayPlan) -> Path:
    """Write a plan, whole or not at all; comments of an older file are not kept.

    Raises:
        ConfigError: a plan that could not be read again.
        DiskFullError: no room for it; the older file is left as it was.
    """
    values = plan_values(plan)
    parse_plan(values, path)
    return write_text(path, _toml(values))


def plan_values(plan: DayPlan) -> dict[str, Any]:
    """What a plan's file holds."""
    preset = plan.expressions == PUBLISHED
    return {
        "schema": SCHEMA,
        "sequence": plan.sequence,
        "expressions": PRESET if preset else list(plan.expressions),
        "sessions": plan.sessions,
        "order": list(plan.order),
        "takes": dict(plan.takes),
        "subjects": [
            {
                key: list(value) if isinstance(value, tuple) else value
                for key, value in dataclasses.asdict(each).items()
                if value is not None
            }
            for each in plan.subjects
        ],
    }


def _toml(values: Mapping[str, Any]) -> str:
    """Texts, lists of texts, one table of numbers and one list of tables, as TOML."""
    # JSON's quoted texts and lists are TOML's too.
    plain = {k: v for k, v in values.items() if k not in ("takes", "subjects")}
    lines = [f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in plain.items()]
    lines += ["", "[takes]"] if values["takes"] else []
    lines += [f"{json.dumps(k, ensure_ascii=False)} = {n}" for k, n in values["takes"].items()]
    for each in values["subjects"]:
        lines += ["", "[[subjects]]"]
        lines += [f"{key} = {json.dumps(v, ensure_ascii=False)}" for key, v in each.items()]
    return "\n".join(lines) + "\n"


def _nearest(name: str, known: Sequence[str]) -> str:
    near = difflib.get_close_matches(name, known, n=1)
    shown = ", ".join(known[:12]) + (", .." if len(known) > 12 else "")
    return f"Did you mean {near[0]}?" if near else f"There are: {shown or 'none yet'}."


class _Problems:
    """Reads values of one file and keeps everything that is wrong.

    Args:
        path: the file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.problems: list[LightstageError] = []

    def add(self, field: str, found: object, expected: str, hint: str = "") -> None:
        shown = found if isinstance(found, str) else ascii(found)
        self.problems.append(
            ConfigError(self.path, field=field, found=shown[:80], expected=expected, hint=hint)
        )

    def unknown(self, values: Mapping[str, Any], known: Sequence[str], where: str) -> None:
        for key in values:
            if key not in known:
                self.add(f"{where}{key}", "an unknown field", f"one of {', '.join(known)}")

    def text(self, values: Mapping[str, Any], key: str, default: str) -> str:
        value = values.get(key, default)
        if not isinstance(value, str) or not 0 < len(value) <= 1000:
            self.add(key, value, "a sequence's name, or pattern names with commas")
            return default
        return value

    def folder(self, value: Any) -> str:
        if not isinstance(value, str) or not value or "\\" in value or not value.isprintable():
            self.add("sessions", value, "the folder of the sessions, relative to the plan's own")
            return "sessions"
        return value

    def pseudonym(self, value: Any, field: str, person: bool) -> str:
        composed = unicodedata.normalize("NFC", value) if isinstance(value, str) else ""
        wanted = pseudonym_problem(composed) if composed else "a pseudonym"
        if wanted is None and person:
            wanted = name_problem(composed)
        if wanted is not None:
            self.add(
                field,
                ascii(value),
                wanted,
                "Use a pseudonym such as P07, never a name, an address or a path."
                if person
                else "Use a word such as smile.",
            )
        return composed

    def expressions(self, value: Any, field: str, known: Sequence[str] | None) -> tuple[str, ...]:
        """A preset or a list; all of `known` where that is given."""
        if value == PRESET:
            return PUBLISHED
        if not isinstance(value, list) or not 1 <= len(value) <= MOST_EXPRESSIONS:
            self.add(
                field,
                value,
                f'"{PRESET}", or a list of 1 to {MOST_EXPRESSIONS} expressions',
                f"The preset {PRESET} is {', '.join(PUBLISHED)}.",
            )
            return ()
        names: list[str] = []
        for index, each in enumerate(value):
            where = f"{field}[{index}]"
            name = self.pseudonym(each, where, False)
            if known is not None and name and name not in known:
                hint = f"{_nearest(name, known)} A new one goes into the plan's own `expressions`."
                self.add(where, ascii(name), "an expression of the plan", hint)
            if name.casefold() in map(str.casefold, names):
                self.add(where, ascii(name), "each expression once")
            names.append(name)
        return tuple(names)

    def subjects(self, value: Any, known: Sequence[str]) -> list[PlannedSubject]:
        if not isinstance(value, list) or len(value) > MOST_SUBJECTS:
            self.add("subjects", value, f"at most {MOST_SUBJECTS} tables [[subjects]]")
            return []
        subjects: list[PlannedSubject] = []
        seen: dict[str, str] = {}
        for index, each in enumerate(value):
            where = f"subjects[{index}]"
            if not isinstance(each, dict):
                self.add(where, each, "a table with subject and consent")
                continue
            self.unknown(each, _SUBJECT_FIELDS, f"{where}.")
            name = self.pseudonym(each.get("subject"), f"{where}.subject", True)
            other = seen.setdefault(name.casefold(), where)
            if other != where:
                self.add(
                    f"{where}.subject",
                    f"{name!a}, as {other} has",
                    "each subject once",
                    "Give both lists of expressions to one of the two, or another pseudonym.",
                )
            own = None
            if "expressions" in each:
                own = self.expressions(each["expressions"], f"{where}.expressions", known)
            sequence = self.text(each, "sequence", "binary") if "sequence" in each else None
            subjects.append(PlannedSubject(name, self._consent(each, where), own, sequence))
        return subjects

    def _consent(self, each: Mapping[str, Any], where: str) -> str:
        value = each.get("consent")
        wanted = consent_problem(value) if isinstance(value, str) else "the id of the record"
        if wanted is not None:
            self.add(
                f"{where}.consent",
                "no consent" if value is None else ascii(value),
                wanted,
                "Nobody is planned without consent: give its record's number, such as C-2026-0041.",
            )
            return ""
        return str(value)

    def order(self, value: Any, names: Sequence[str]) -> tuple[str, ...]:
        if not isinstance(value, list) or not all(isinstance(each, str) for each in value):
            self.add("order", value, "a list of names such as P07/neutral")
            return ()
        for index, each in enumerate(value):
            if each not in names:
                hint = _nearest(each, names)
                self.add(f"order[{index}]", ascii(each), "SUBJECT/EXPRESSION of the plan", hint)
            elif each in value[:index]:
                self.add(f"order[{index}]", ascii(each), "each take once")
        return tuple(value)

    def takes(self, value: Any, names: Sequence[str]) -> dict[str, int]:
        if not isinstance(value, dict):
            self.add("takes", value, 'a table such as "P07/neutral" = 2')
            return {}
        for key, number in value.items():
            if key not in names:
                self.add(
                    f"takes.{key}", ascii(key), "SUBJECT/EXPRESSION of the plan",
                    _nearest(key, names),
                )  # fmt: skip
            elif type(number) is not int or not 1 <= number <= MOST_TAKES:
                self.add(f"takes.{key}", ascii(number), f"a whole number from 1 to {MOST_TAKES}")
        return dict(value)
