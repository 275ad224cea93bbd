"""The table of people: shares by sex, age, tone and look, and who follows from it."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.formats.config import read_toml
from sim.errors import SimError
from sim.people.traits import AGE_RANGE, LOOKS, SEXES, TONES, Traits

TABLES = Path(__file__).parents[1] / "data" / "people"
ATTRIBUTES = ("sex", "age", "tone", "look")


@dataclasses.dataclass(frozen=True)
class PeopleTable:
    """Shares of the people of a data set; each attribute's shares sum to 1.

    Attributes:
        name: of the table.
        subjects: how many people it represents.
        sex: share of each of `sim.people.traits.SEXES`.
        age: (from, to, share) of years, in order.
        tone: share of each of `sim.people.traits.TONES`.
        look: share of each of `sim.people.traits.LOOKS`.
    """

    name: str
    subjects: int
    sex: Mapping[str, float]
    age: tuple[tuple[float, float, float], ...]
    tone: Mapping[int, float]
    look: Mapping[str, float]


def load_table(name_or_path: str) -> PeopleTable:
    """A table by its name (a file of sim/data/people) or by the path of a TOML file like it.

    Raises:
        SimError: an unknown name, a missing or unknown entry, a share that is no positive number.
        ConfigError: a file that cannot be read.
    """
    path = TABLES / f"{name_or_path}.toml"
    if not path.is_file():
        path = Path(name_or_path)
    if not path.is_file():
        known = sorted(file.stem for file in TABLES.glob("*.toml"))
        raise SimError(
            "--people",
            found=repr(name_or_path),
            expected=f"{', '.join(known)} or a TOML file",
            hint=f"{TABLES / 'balanced.toml'} shows the form.",
        )
    values = read_toml(path)
    unknown = sorted(set(values) - {"subjects", *ATTRIBUTES})
    if unknown:
        raise SimError(
            path, field=unknown[0], found="an unknown key", expected=", ".join(ATTRIBUTES)
        )
    subjects = values.get("subjects")
    if not isinstance(subjects, int) or isinstance(subjects, bool) or subjects < 1:
        raise SimError(path, field="subjects", found=repr(subjects), expected="a count of people")
    return PeopleTable(
        name=path.stem,
        subjects=subjects,
        sex=_shares(path, "sex", values, SEXES),
        age=_ages(path, values),
        tone={int(k): v for k, v in _shares(path, "tone", values, map(str, TONES)).items()},
        look=_shares(path, "look", values, LOOKS),
    )


def people(table: PeopleTable, count: int, seed: int) -> list[Traits]:
    """The people of a data set.

    Each person comes from the kind (sex, age group, tone, look) that lags furthest behind its
    share, alone and together with the others, and chance decides between equals. So every beginning
    of the list has the table's shares, and a larger data set begins with the smaller one.

    Args:
        table: shares.
        count: how many people.
        seed: of the order and of the ages within a group.
    """
    ages = {group: group[2] for group in table.age}
    kinds = list(itertools.product(table.sex, ages, table.tone, table.look))
    shares = [
        np.array([table.sex[kind[0]] for kind in kinds]),
        np.array([ages[kind[1]] for kind in kinds]),
        np.array([table.tone[kind[2]] for kind in kinds]),
        np.array([table.look[kind[3]] for kind in kinds]),
    ]
    together = np.prod(shares, axis=0)
    # same[i][j, k]: kinds j and k have attribute i in common, so a person of one counts for both.
    same = [np.array([[a[i] == b[i] for b in kinds] for a in kinds]) for i in range(len(shares))]
    made = np.zeros(len(kinds))
    rng = np.random.default_rng([seed, 210])
    found = []
    for number in range(1, count + 1):
        lag = number * together - made + 1e-3 * rng.uniform(size=len(kinds))
        for share, alike in zip(shares, same, strict=True):
            lag += number * share - alike @ made
        lag[together == 0] = -np.inf
        chosen = int(np.argmax(lag))
        made[chosen] += 1
        sex, (low, high, _), tone, look = kinds[chosen]
        age = math.floor(10 * rng.uniform(low, high)) / 10
        found.append(Traits(sex=sex, age_years=age, tone=tone, look=look))
    return found


def _shares(
    path: Path, field: str, values: Mapping[str, Any], known: Iterable[str]
) -> dict[str, float]:
    found, names = values.get(field), list(known)
    if not isinstance(found, Mapping) or not found:
        raise SimError(path, field=f"[{field}]", found=repr(found), expected=", ".join(names))
    unknown = sorted(set(found) - set(names))
    if unknown:
        raise SimError(path, field=f"[{field}]", found=unknown[0], expected=", ".join(names))
    numbers = {name: _share(path, f"[{field}] {name}", found[name]) for name in found}
    return _normalised(path, f"[{field}]", numbers)


def _ages(path: Path, values: Mapping[str, Any]) -> tuple[tuple[float, float, float], ...]:
    found = values.get("age")
    if not isinstance(found, list) or not found:
        raise SimError(
            path,
            field="[[age]]",
            found=repr(found),
            expected="groups of from_years, to_years, share",
        )
    groups, before = [], AGE_RANGE[0]
    for index, group in enumerate(found):
        where = f"[[age]] number {index + 1}"
        if not isinstance(group, Mapping) or set(group) != {"from_years", "to_years", "share"}:
            raise SimError(
                path, field=where, found=repr(group), expected="from_years, to_years and share"
            )
        low, high = (_share(path, where, group[key]) for key in ("from_years", "to_years"))
        if not before <= low < high <= AGE_RANGE[1]:
            raise SimError(
                path,
                field=where,
                found=f"{low:g} to {high:g} years",
                expected=f"rising years from {before:g} to {AGE_RANGE[1]:g}",
            )
        groups.append((low, high, _share(path, where, group["share"])))
        before = high
    shares = _normalised(path, "[[age]]", {str(i): g[2] for i, g in enumerate(groups)})
    return tuple(
        (low, high, share) for (low, high, _), share in zip(groups, shares.values(), strict=True)
    )


def _share(path: Path, field: str, value: object) -> float:
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not number or not math.isfinite(float(str(value))) or float(str(value)) < 0:
        raise SimError(path, field=field, found=repr(value), expected="a number, not negative")
    return float(str(value))


def _normalised(path: Path, field: str, shares: dict[str, float]) -> dict[str, float]:
    total = sum(shares.values())
    if not total > 0:
        raise SimError(path, field=field, found="shares that sum to 0", expected="a share above 0")
    return {name: share / total for name, share in shares.items()}
