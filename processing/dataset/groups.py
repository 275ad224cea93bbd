"""How many people of each age, sex and tone a release shows, so that no small group is revealed.

No group of fewer than five is published: groups are put together with the next until there are
five (table redesign [Hundepool2012]). All groups are in what is published, empty ones too, so that
the total reveals nothing of a part: to leave small groups out would not do, since 13 people of whom
5 are in one of three groups reveal that the others have 4 each. Counts are rounded down to fives:
of two releases between which one person was removed, most counts are the same.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from lightstage.counting import counted
from processing.dataset.contents import Entry
from processing.dataset.scan import AGE_BANDS, OLDEST, SEXES
from processing.tones import ITA_NAMES, ita_deg, tone_of

FEWEST = 5
"""People of the smallest group that is published, and what counts are rounded down to."""
UNKNOWN = "not known"


@dataclasses.dataclass(frozen=True)
class Table:
    """People by one property, as a release publishes it.

    Attributes:
        what: the property.
        at_least: people by groups put together, rounded down to fives.
        sentence: the same in words, or why nothing is published.
    """

    what: str
    at_least: dict[str, int]
    sentence: str


def published_counts(counts: Mapping[str, int]) -> dict[str, int]:
    """Groups put together so that each has enough people, and how many these are at least.

    Args:
        counts: people by group, in an order in which neighbours may be put together.

    Returns:
        By names joined, people rounded down to fives; nothing where only all together are enough.
        Whoever knows this rule and the total cannot find out how many are in a group of fewer.
    """
    found: list[tuple[list[str], int]] = []
    names: list[str] = []
    people = 0
    for name, count in counts.items():
        names, people = [*names, name], people + count
        if people >= FEWEST:
            found.append((names, people))
            names, people = [], 0
    if len(found) < 2:
        return {}
    last, its_people = found[-1]
    found[-1] = ([*last, *names], its_people + people)
    return {_joined(names): people // FEWEST * FEWEST for names, people in found}


def _joined(names: Sequence[str]) -> str:
    return " or ".join(filter(None, (", ".join(names[:-1]), names[-1])))


def people_tables(entries: Sequence[Entry], subjects: Iterable[str]) -> list[Table]:
    """People of a store by age, sex and tone of skin, as far as the store knows them.

    Args:
        entries: the scans; empty where an earlier version built the store and knew none of it.
        subjects: everybody who is shown.
    """
    everybody = sorted(set(subjects))
    known: dict[str, dict[str, str]] = {"age": {}, "sex": {}, "skin tone": {}}
    for entry in entries:
        for what, value in (("age", entry.scan.age), ("sex", entry.scan.sex)):
            if value is not None:
                known[what].setdefault(entry.scan.subject, value)
    known["skin tone"] = _tones(entries)
    groups = {"age": (*AGE_BANDS, OLDEST), "sex": SEXES, "skin tone": ITA_NAMES}
    return [_table(what, groups[what], known[what], everybody) for what in known]


def _table(
    what: str, groups: Sequence[str], known: Mapping[str, str], everybody: Sequence[str]
) -> Table:
    if not known:
        return Table(what, {}, f"The lab's store knows nobody's {what}.")
    found = Counter(known.get(who, UNKNOWN) for who in everybody)
    at_least = published_counts({name: found[name] for name in (*groups, UNKNOWN)})
    parts = "; ".join(f"{name}: {count} or more" for name, count in at_least.items())
    counts_in_words = parts or f"not published, since a group would have fewer than {FEWEST}"
    return Table(
        what,
        at_least,
        f"{counted(len(everybody), 'person', 'people')} by {what}: {counts_in_words}.",
    )


def _tones(entries: Sequence[Entry]) -> dict[str, str]:
    """Each person's tone, from the mean colour of all skin that was measured."""
    sums: dict[str, np.ndarray] = {}
    for entry in entries:
        own = np.array([*entry.sums["sum"]["diffuse_albedo"], entry.sums["measured"]], float)
        sums[entry.scan.subject] = sums.get(entry.scan.subject, np.zeros(4)) + own
    return {
        who: tone_of(ita_deg(total[:3] / total[3])) for who, total in sums.items() if total[3] > 0
    }
