"""Scans come into a store and go out of it, one by one or all at once."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import os
import re
import secrets
import shutil
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import zarr

from lightstage.commands import ProgressCallback, quiet
from lightstage.counting import counted
from lightstage.errors import LightstageError, one_error
from lightstage.formats.consents import require_consents
from lightstage.formats.files import (
    abandoned_beside,
    atomic_folder,
    fsync_path,
    read_json,
    require_replaceable,
    sha256_file,
    write_json,
)
from lightstage.formats.lock import abandoned, being_filled, locked, remove_abandoned
from processing.dataset.arrays import written_whole
from processing.dataset.contents import (
    HISTORY,
    RELEASES,
    Entry,
    append_line,
    now_utc,
    read_entries,
    require_fits,
    sums_of,
    write_entries,
)
from processing.dataset.hashes import differences
from processing.dataset.scan import DatasetError, ScanEntry, read_scan
from processing.dataset.store import CHUNK, DATASET, SCANS, SHARD, STORE, Store, open_store

LOCK = "store.lock"
LOCK_S = 60.0
"""Whoever changes dataset.json holds the lock for milliseconds; who builds the store anew, for all
the time that this takes."""
RELEASE_LOCK_S = 3600.0
"""So long a release, which took as long to make, waits for who builds the store anew."""
SHARDS, SHARDS_SCHEMA = "shards.json", "lightstage.shards/1"
BESIDE = ".adding-"
"""Begins the name of a scan that is being written, in `scans`."""
FOLDER_DIGITS = 16
STORE_FILES = (
    *(DATASET, ".dataset.*.json", LOCK, HISTORY, RELEASES, f"{SCANS}/*/{SHARDS}"),
    *(f"{SCANS}/*/*/{file}" for file in ("zarr.json", "c/*/*/*")),
    *(f"{SCANS}/{BESIDE}*{'/*' * depth}" for depth in range(1, 7)),
)
"""All that a store has, as globs, with what killed processes leave in it."""
OF_A_SCAN = re.compile(f"[0-9a-f]{{{FOLDER_DIGITS}}}")
"""Names of scans; what has another was put there by hand."""


def build_store(
    processed: Sequence[Path],
    out: Path,
    progress: ProgressCallback = quiet,
    consents: Path | None = None,
) -> Path:
    """Gather the atlas maps of processed folders into one store.

    Every folder is read and checked before anything is reported; on an error nothing is left
    behind.

    Args:
        processed: folders with atlas/, head_from_world.json and report.json (subject, expression,
            and the id of the record of the person's consent where there is one).
        out: the store's folder; an older store there is replaced, and no other process can change
            it meanwhile.
        progress: called after each folder.
        consents: the lab's registry, where there is one: everybody must have agreed to research.

    Returns:
        `out`.

    Raises:
        ConfigError: people who did not agree to research, before any map is read.
        FormatError, DatasetError: no folder, something that is no processed folder, a missing map,
            maps or atlases of different size, NaN, a missing or not rigid head_from_world, a folder
            given twice, a scan of the same files, a pseudonym of two people, all in one message; an
            older store that another process is changing.
    """
    if not processed:
        raise DatasetError(
            "dataset build",
            found="no processed folder among what was named",
            expected="at least one",
            hint="Name folders that `lightstage-processing run` made, as P/*.",
        )
    require_consents(consents, "research", _consents_of(processed))
    problems: list[LightstageError] = []
    entries: list[Entry] = []
    known: dict[str, ScanEntry] = {}
    require_replaceable(out, DATASET, STORE, own=STORE_FILES)
    with contextlib.ExitStack() as stack:
        if (out / DATASET).is_file():
            # A scan that is added or removed meanwhile would be lost, or be back, with the new one.
            stack.enter_context(changing(out))
        beside = stack.enter_context(atomic_folder(out, DATASET, STORE, own=STORE_FILES))
        for index, root in enumerate(processed):
            try:
                if root.resolve() in {p.resolve() for p in processed[:index]}:
                    raise DatasetError(root, found="the same folder twice", expected="once")
                entry, maps = read_scan(root)
                require_fits(root, entry, known)
                known[str(root)] = entry
                if not problems:
                    entries.append(_written(beside, entry, maps))
            except LightstageError as error:
                problems.append(error)
            progress(index + 1, len(processed))
        if problems:
            raise one_error(problems)
        # What training and releases were made of is known also after a store was built again.
        for name in (HISTORY, RELEASES):
            if (out / name).is_file():
                shutil.copy(out / name, beside / name)
        write_entries(beside, entries)
    return out


def _consents_of(processed: Sequence[Path]) -> dict[str, str | None]:
    """Ids of consents by person, of captured people; what else is wrong is reported later."""
    found: dict[str, str | None] = {}
    for root in processed:
        try:
            report = read_json(root / "report.json")
        except LightstageError:
            continue
        if isinstance(report, dict) and report.get("synthetic") is not True:
            consent = report.get("consent")
            found[f"{report.get('subject')} in {root}"] = (
                consent if isinstance(consent, str) else None
            )
    return found


def add_scan(store: Path, root: Path, consents: Path | None = None) -> str:
    """Add a processed folder to a store; other processes may read it and add to it meanwhile.

    No other scan is read. The scan is written beside the others, and is in the store as soon as
    dataset.json, which is replaced in one step, lists it.

    Args:
        store: its folder.
        root: the processed folder.
        consents: the lab's registry, where there is one: research must be agreed to.

    Returns:
        The scan's name in the store.

    Raises:
        FormatError, DatasetError: as `build_store`, or a store of an earlier version.
    """
    open_store(store)  # for its messages, where it is none
    entry, maps = read_scan(root)
    if not entry.synthetic:
        require_consents(consents, "research", {f"{entry.subject} in {root}": entry.consent})
    require_fits(root, entry, _named(store, read_entries(store)))
    with being_filled(lambda: _beside(store)) as beside:
        try:
            made = _written(store, entry, maps, beside.name)
            made = dataclasses.replace(made, folder=_folder_of(entry))
            # On the disk before the list names them.
            for path in beside.rglob("*"):
                fsync_path(path)
            with changing(store):
                before = read_entries(store)
                require_fits(root, entry, _named(store, before))
                _clear_of_killed(store, before)
                place = store / SCANS / made.folder
                os.replace(beside, place)
                fsync_path(place.parent)
                write_entries(store, [*before, made], before)
        finally:
            shutil.rmtree(beside, ignore_errors=True)
    return made.folder


def remove_scans(store: Path, names: Sequence[str]) -> list[Entry]:
    """Take scans out of a store: first off the list, then off the disk.

    What processes that were killed left in the store goes too.

    Args:
        store: its folder.
        names: of scans, as `Scan.folder` has them.

    Returns:
        What was removed.

    Raises:
        DatasetError: a name that no scan has, or the last scan.
    """
    open_store(store)  # for its messages, where it is none
    with changing(store):
        before = read_entries(store)
        there = {entry.folder for entry in before}
        unknown = [name for name in dict.fromkeys(names) if name not in there]
        if unknown:
            raise DatasetError(
                store,
                field="scan",
                found=", ".join(map(repr, unknown[:5])),
                expected="names of scans in it",
                hint=f"`lightstage-processing dataset list {store}` shows them.",
            )
        gone = [entry for entry in before if entry.folder in names]
        left = [entry for entry in before if entry.folder not in names]
        if not left:
            raise DatasetError(
                store,
                found="no scan that would be left",
                expected="at least one",
                hint="Remove the store's folder itself.",
            )
        write_entries(store, left, before)
        for entry in gone:
            if (store / SCANS / entry.folder).exists():
                _discard(store / SCANS / entry.folder)
        _clear_of_killed(store, left)
    return gone


def verify_store(store: Path, progress: ProgressCallback = quiet) -> tuple[int, list[str]]:
    """Hold every file of every scan against its hash.

    Args:
        store: its folder.
        progress: called after each scan.

    Returns:
        Files that were compared, and what processes that were killed left: folders in `scans` by
        their names, half-built stores beside this one by their paths.

    Raises:
        DatasetError: all files that are missing, changed or not of the store, in one message.
    """
    entries = read_entries(store)
    problems: list[LightstageError] = []
    files = 0
    for index, entry in enumerate(entries):
        try:
            files += _verify_scan(store / SCANS / entry.folder, entry)
        except LightstageError as error:
            problems.append(error)
        progress(index + 1, len(entries))
    if problems:
        raise one_error(problems)
    left = [path.name for path in left_in(store, {entry.folder for entry in entries})]
    return files, [*left, *map(str, abandoned_beside(store.resolve()))]


def left_in(store: Path, listed: Collection[str]) -> list[Path]:
    """What is in a store's `scans` and in no list, but for what somebody is adding; sorted.

    Args:
        store: its folder.
        listed: names of its scans.
    """
    return sorted(
        path
        for path in (store / SCANS).glob("*")
        if path.name not in listed
        and (not path.name.startswith(BESIDE) or not path.is_dir() or abandoned(path))
    )


def _clear_of_killed(store: Path, entries: Sequence[Entry]) -> None:
    """Remove scans that are in no list, and those that a killed process did not finish.

    Only while the store is locked: a scan that was added is in no list for a moment.
    """
    for path in left_in(store, {entry.folder for entry in entries}):
        with contextlib.suppress(OSError):  # another user's: `verify` names it
            if path.name.startswith(BESIDE):
                remove_abandoned(path)
            elif OF_A_SCAN.fullmatch(path.name):
                _discard(path)


def _beside(store: Path) -> Path:
    return store / SCANS / f"{BESIDE}{secrets.token_hex(4)}"


def folder_of(subject: str, expression: str, sha256: str) -> str:
    """A scan's name in a store: it shows nothing of the person, and is the same in every store."""
    # Two people's scans of the same files are two scans.
    key = "\0".join((subject, expression, sha256))
    return hashlib.sha256(key.encode()).hexdigest()[:FOLDER_DIGITS]


def _folder_of(entry: ScanEntry) -> str:
    return folder_of(entry.subject, entry.expression, entry.sha256)


def _named(store: Path, entries: Sequence[Entry]) -> dict[str, ScanEntry]:
    return {f"scan {entry.folder} of {store}": entry.scan for entry in entries}


def record_release(store: Store, release: dict[str, Any]) -> None:
    """Record in the lab which scans a release was made of: the release itself does not show it.

    Args:
        store: the lab's store, as it was read for the release.
        release: where it is going to be, and its hash.

    Raises:
        DatasetError: scans that were removed since, whose release would be one of people who are
            to be forgotten; a store that another process is changing.
    """
    open_store(store.path)  # for its messages, where there is none any more
    with changing(store.path, RELEASE_LOCK_S):
        left = {scan.sha256 for scan in open_store(store.path).scans}
        gone = [scan for scan in store.scans if scan.sha256 not in left]
        if gone:
            raise DatasetError(
                store.path,
                found=f"a store from which {counted(len(gone), 'scan')} went while the release was "
                "made of it",
                expected="all scans of the release still in it",
                hint="Publish again: the release is made of the scans that are left.",
            )
        line = {"utc": now_utc(), **release, "fingerprint": store.fingerprint}
        append_line(store.path / RELEASES, {**line, "scans": [scan.sha256 for scan in store.scans]})


@contextlib.contextmanager
def changing(store: Path, wait_s: float | None = None) -> Iterator[None]:
    """Be the only one who changes a store.

    Args:
        store: its folder.
        wait_s: so long for whoever changes it now; `LOCK_S` where None.

    Raises:
        DatasetError: another process has been changing it for so long.
    """
    wait_s = LOCK_S if wait_s is None else wait_s
    busy = DatasetError(
        store,
        found=f"a store that another process has been changing for {wait_s:g} s",
        expected="one that is free",
        hint="Wait until that process has ended.",
    )
    with locked(store / LOCK, busy, wait_s=wait_s):
        yield


def _discard(folder: Path) -> None:
    """Remove a scan's folder: in one step it is no scan any more."""
    away = folder.with_name(f"{BESIDE}{secrets.token_hex(4)}")
    os.replace(folder, away)
    shutil.rmtree(away)


def _written(
    store: Path, entry: ScanEntry, maps: dict[str, np.ndarray], name: str | None = None
) -> Entry:
    """Write a scan's arrays and the hashes of their files."""
    folder = store / SCANS / (name or _folder_of(entry))
    for each, image in maps.items():
        _write_map(folder / each, each, image)
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    shards = {str(path.relative_to(folder)): sha256_file(path) for path in files}
    listed = write_json(folder / SHARDS, {"schema": SHARDS_SCHEMA, "files": shards})
    return Entry(entry, folder.name, sha256_file(listed), sums_of(maps))


def _write_map(path: Path, name: str, image: np.ndarray) -> None:
    rows, columns, channels = image.shape
    chunk = (min(CHUNK, rows), min(CHUNK, columns), channels)
    # A shard holds a whole number of chunks; a small map is one shard.
    shard = tuple(
        min(SHARD, -(-size // part) * part)
        for size, part in zip((rows, columns), chunk[:2], strict=True)
    )
    array = zarr.create_array(
        path,
        shape=image.shape,
        dtype="float32" if name == "position" else "float16",
        chunks=chunk,
        shards=(*shard, channels),
        **written_whole(),
    )
    array[:] = image.astype(array.dtype)


def _verify_scan(folder: Path, entry: Entry) -> int:
    """Compare a scan's files; returns how many."""
    listed = folder / SHARDS
    if not listed.is_file() or sha256_file(listed) != entry.shards_sha256:
        found = "another list of hashes" if listed.is_file() else "no list of hashes"
        raise DatasetError(listed, found=found, expected="the one that was written", hint=_LACKING)
    known: dict[str, str] = read_json(listed, SHARDS_SCHEMA)["files"]
    if wrong := differences(folder, known, SHARDS, "the store"):
        raise DatasetError(
            folder,
            field=f"{entry.scan.subject}, {entry.scan.expression}",
            found=wrong,
            expected="the files that were written",
            hint=_LACKING,
        )
    return len(known)


_LACKING = "Remove this scan and add it again, or copy the store again from where it is whole."
