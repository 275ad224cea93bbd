"""The scans of a store in dataset.json, and what all of them must agree in.

Every entry holds the sums that the store's statistics are made of, so that a scan comes or goes
without another one being read.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.errors import FormatError
from lightstage.formats.files import check_schema, read_json, write_json
from lightstage.formats.paths import check_name
from processing.dataset.scan import CHANNELS, DatasetError, ScanEntry
from processing.dataset.statistics import Statistics
from processing.dataset.store import DATASET, PATCH, SCHEMA, STORE, STRIDE

AVERAGED = ("diffuse_albedo", "specular_albedo")
HISTORY = "history.jsonl"
"""The scans that each fingerprint of the store covers, by their SHA-256, without names."""
RELEASES = "releases.jsonl"
"""What was published of the store, and of which scans; it stays in the lab."""
OLDER = (
    "It was built by an earlier version, which kept neither the sums of its scans nor hashes. "
    "Build it again: lightstage-processing dataset build P/* --out STORE --overwrite."
)


@dataclasses.dataclass(frozen=True)
class Entry:
    """One scan as dataset.json lists it: `ScanEntry`, and what the store knows besides.

    Attributes:
        folder: in the store's `scans`.
        shards_sha256: of its shards.json.
        sums: of `Statistics`.
    """

    scan: ScanEntry
    folder: str
    shards_sha256: str
    sums: dict[str, Any]

    def as_json(self) -> dict[str, Any]:
        """The entry as it is written."""
        own = {"folder": self.folder, "shards_sha256": self.shards_sha256, "sums": self.sums}
        return {**dataclasses.asdict(self.scan), **own}

    @staticmethod
    def of_json(value: Any, where: Path, field: str) -> Entry:
        """The entry that was written; DatasetError where it is none."""
        known = dataclasses.fields(ScanEntry)
        names = {f.name for f in known}
        try:
            rest = {key: each for key, each in value.items() if key not in names}
            folder, shards = rest["folder"], str(rest["shards_sha256"])
            # What has a default came later, and older stores lack it.
            has = {f.name for f in known if f.default is dataclasses.MISSING or f.name in value}
            scan = ScanEntry(**{name: value[name] for name in has})
            Statistics(averaged()).add_sums(rest["sums"])
        except (KeyError, TypeError, ValueError, AttributeError, FormatError) as error:
            raise DatasetError(
                where, field=field, found=f"no usable {error}"[:80], expected="a scan", hint=OLDER
            ) from None
        return Entry(scan, check_name(folder, where, f"{field}.folder"), shards, rest["sums"])


def averaged() -> dict[str, int]:
    """Maps whose mean a store gives, and their channels."""
    return {name: CHANNELS[name] for name in AVERAGED}


def sums_of(maps: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """What a scan's maps, (rows, columns[, c]) each by name, add to the store's statistics."""
    own = Statistics(averaged())
    own.add(maps, maps["confidence"][:, :, 0] > 0)
    return own.sums()


def fingerprint_of(digests: Sequence[str]) -> str:
    """SHA-256 of all scans' SHA-256, in the order of the store."""
    return hashlib.sha256("".join(digests).encode()).hexdigest()


def read_entries(store: Path) -> list[Entry]:
    """The entries of a store.

    Raises:
        FormatError, DatasetError: no store, or one of an earlier version.
    """
    file = store / DATASET
    value = read_json(file)
    check_schema(file, value, SCHEMA)
    if value.get("kind") != STORE or not isinstance(value.get("scans"), list):
        raise DatasetError(
            file, field="kind", found=repr(value.get("kind")), expected=f"{STORE!r} with scans"
        )
    return [
        Entry.of_json(each, file, f"scans[{index}]") for index, each in enumerate(value["scans"])
    ]


def write_entries(store: Path, entries: Sequence[Entry], before: Sequence[Entry] = ()) -> None:
    """Write dataset.json, after a line of the history that lists the scans it covers.

    Args:
        store: its folder.
        entries: all that it is to hold.
        before: what it held.
    """
    statistics = Statistics(averaged())
    for entry in entries:
        statistics.add_sums(entry.sums)
    digests, old = ([e.scan.sha256 for e in each] for each in (entries, before))
    fingerprint = fingerprint_of(digests)
    append_line(
        store / HISTORY,
        {
            "utc": now_utc(),
            "fingerprint": fingerprint,
            "before": fingerprint_of(old) if old else None,
            "added": sorted(set(digests) - set(old)),
            "removed": sorted(set(old) - set(digests)),
        },
    )
    write_json(
        store / DATASET,
        {
            "schema": SCHEMA,
            "kind": STORE,
            "patch": PATCH,
            "stride": STRIDE,
            "channels": CHANNELS,
            "frame": "head",
            "counts": {
                "subjects": len({entry.scan.subject for entry in entries}),
                "scans": len(entries),
            },
            "statistics": statistics.facts(),
            "fingerprint": fingerprint,
            "scans": [entry.as_json() for entry in entries],
        },
    )


def now_utc() -> str:
    """This second."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def append_line(path: Path, value: dict[str, Any]) -> None:
    """Add a line to a file of JSON lines, and bring it to the disk."""
    data = (json.dumps(value) + "\n").encode()
    with path.open("ab") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def require_fits(root: Path, entry: ScanEntry, others: Mapping[str, ScanEntry]) -> None:
    """Refuse a scan that may not be in one store with others.

    Args:
        root: where it comes from.
        entry: what it is.
        others: by what an error calls them.

    Raises:
        DatasetError: an atlas of another size, a pseudonym of two people, a scan of the same files,
            two draws of one simulated pseudonym.
    """
    for name, other in others.items():
        if (entry.rows, entry.columns) != (other.rows, other.columns):
            # Its texels would be other places and its pores larger.
            raise DatasetError(
                root / "atlas",
                found=f"{entry.rows} x {entry.columns} texels",
                expected=f"{other.rows} x {other.columns}, as {name} has",
                hint="Make all atlases of a store again with one --atlas-rows.",
            )
        if entry.subject != other.subject:
            continue
        if entry.synthetic != other.synthetic:
            # One would be trained on while the other is held out.
            whose = {True: "a simulated person's", False: "a captured person's"}
            raise DatasetError(
                root,
                field="subject",
                found=f"{entry.subject!r}, {whose[entry.synthetic]}",
                expected=f"a pseudonym of its own: in {name} it is {whose[other.synthetic]}",
                hint="Leave one of them out, or make one under another pseudonym. What was "
                "photographed on the simulated stage and processed counts as captured.",
            )
        if entry.expression == other.expression and entry.sha256 == other.sha256:
            # It would count twice, and might be tested on what was trained on.
            raise DatasetError(
                root,
                found=f"the same files as {name}",
                expected="a scan of its own",
                hint="Leave one of the two out.",
            )
        if entry.synthetic and entry.expression == other.expression:
            raise DatasetError(
                root,
                field="subject",
                found=f"{entry.subject!r}, {entry.expression}, which {name} is already",
                expected="a pseudonym of its own",
                hint="Two calls of `lightstage-sim dataset` give their people the same names. Make "
                "all of them in one call, with more --subjects.",
            )


def scans_of_fingerprint(store: Path) -> dict[str, set[str]]:
    """SHA-256 of the scans that each fingerprint in a store's history covered."""
    from lightstage.formats.values import read_lines

    known: dict[str, set[str]] = {}
    path = store / HISTORY
    for line in read_lines(path) if path.is_file() else []:
        if not isinstance(line, dict):
            continue
        before = known.get(str(line.get("before")), set())
        added, removed = ({str(each) for each in line.get(key, [])} for key in ("added", "removed"))
        known[str(line.get("fingerprint"))] = (before | added) - removed
    return known
