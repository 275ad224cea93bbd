"""Taking a person out of a lab's folders: what is theirs, what held them, and the proof.

A plan is written before the first file goes, and kept until the last one has: a call that was
interrupted resumes it. What is removed is known by its hash, so that a copy somewhere else is
found too.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import shutil
from collections.abc import Sequence
from pathlib import Path

from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.files import read_json, write_json
from lightstage.formats.lock import locked
from lightstage.formats.people import PEOPLE_LOCK, lists_person, take_off
from processing.dataset.changes import changing, remove_scans
from processing.dataset.contents import now_utc
from processing.dataset.scan import DatasetError
from processing.dataset.search import (
    HALF_BUILT,
    JOURNAL,
    KINDS,
    Found,
    note_releases,
    survey,
    what_is_left,
)
from processing.dataset.store import DATASET
from processing.errors import ProcessingError
from processing.records import RUN_LOCK

SCHEMA, PROOF_SCHEMA = "lightstage.forget/1", "lightstage.forgotten/1"
LOCKS = (("session", JOURNAL, "capture"), ("processed folder", RUN_LOCK, "run"))
"""Kinds of folders, the file that who writes to one holds, and who that is."""


def plan_path(out: Path, subject: str) -> Path:
    """The plan's file of a person while it is carried out."""
    return out / f"forget-{hashlib.sha256(subject.encode()).hexdigest()[:12]}.json"


def search(
    subject: str,
    folders: Sequence[Path],
    out: Path,
    hashed: bool,
    progress: ProgressCallback = quiet,
) -> tuple[str, Found]:
    """What there is of a person, with what an interrupted call has in its plan.

    Args:
        subject: the pseudonym.
        folders: where to search.
        out: folder of the plan.
        hashed: see `survey`.
        progress: called after each of the person's folders.

    Returns:
        When the removal began, and what was found.

    Raises:
        DatasetError: no person of this pseudonym; what `survey` raises.
    """
    plan = plan_path(out, subject)
    if not plan.is_file():
        found = survey(subject, folders, hashed, progress)
        require_somebody(subject, folders, found)
        return now_utc(), found
    value = read_json(plan, SCHEMA)
    begun = Found(**value["found"])
    found = begun.joined(survey(subject, folders, hashed, progress, begun))
    return str(value["begun_utc"]), found


def forget(
    subject: str,
    folders: Sequence[Path],
    out: Path,
    progress: ProgressCallback = quiet,
) -> tuple[Found, dict[str, list[str]], Path]:
    """Remove everything of a person, search what is left, and write the proof.

    Args:
        subject: the pseudonym.
        folders: where to search.
        out: folder for the plan and the proof; it must be in none of the person's folders.
        progress: called after each path that was removed.

    Returns:
        What was found, what is left by how it was found, and the proof.

    Raises:
        DatasetError: no person of this pseudonym; ProcessingError: a folder that is in use.
    """
    plan = plan_path(out, subject)
    begun, found = search(subject, folders, out, True)
    where = out.resolve()
    for path in [p for each in found.removed.values() for p in each] + found.whole:
        if where.is_relative_to(path):
            raise ProcessingError(
                out, field="--out", found=f"a folder in {path}, which goes", expected="another one"
            )
    write_json(
        plan,
        {
            "schema": SCHEMA,
            "subject": subject,
            "begun_utc": begun,
            "found": dataclasses.asdict(found),
        },
    )
    _remove(subject, found, progress)
    left = what_is_left(subject, folders, found, plan)
    proof = plan.with_name(plan.name.replace("forget-", "forgotten-"))
    write_json(
        proof,
        {
            "schema": PROOF_SCHEMA,
            "subject": subject,
            "begun_utc": begun,
            "done_utc": now_utc(),
            "searched": [str(folder.resolve()) for folder in folders],
            **dataclasses.asdict(found),
            "left": left,
        },
    )
    plan.unlink()
    return found, left, proof


def require_somebody(subject: str, folders: Sequence[Path], found: Found) -> None:
    """Refuse a pseudonym of which there is nothing."""
    if found.empty:
        half = [f"; {path} is half-built, of nobody knows whom" for path in _half_built(found)]
        raise DatasetError(
            "dataset forget",
            field="SUBJECT",
            found=f"nothing of {subject!r} in {', '.join(map(str, folders))}{''.join(half)}",
            expected="the pseudonym of somebody who is there",
            hint="Check for a typing error, or name more folders with --in.",
        )


def _half_built(found: Found) -> list[str]:
    return found.removed.get(HALF_BUILT, [])


def _remove(subject: str, found: Found, progress: ProgressCallback) -> None:
    paths = [Path(path) for kind in KINDS for path in found.removed.get(kind, [])]
    paths += [Path(path) for path in found.whole]
    lists = [path for path in map(Path, found.lists) if lists_person(path, subject)]
    total = len(paths) + len(found.scans) + len(lists)
    done = 0
    with contextlib.ExitStack() as stack:
        # All locks before the first file goes: who works on one of the folders is not disturbed.
        for kind, lock, who in LOCKS:
            for path in map(Path, found.removed.get(kind, [])):
                # A session that was imported has no journal.
                if not path.is_dir() or (kind == "session" and not (path / lock).is_file()):
                    continue
                busy = ProcessingError(
                    path,
                    found=f"a folder that a {who} is writing to",
                    expected="one that is at rest",
                    hint=f"Wait until that {who} has ended, and call this again.",
                )
                stack.enter_context(locked(path / lock, busy))
        for path in lists:
            busy = ProcessingError(
                path,
                found="a list of people that `lightstage-sim dataset` is making now",
                expected="one that is at rest",
                hint="Wait until that command has ended, and call this again.",
            )
            stack.enter_context(locked(path.with_name(PEOPLE_LOCK), busy))
        for whole in map(Path, found.whole):
            if (whole / DATASET).is_file():
                stack.enter_context(changing(whole))
                note_releases(whole, found)
        for store, names in found.scans.items():
            if names:
                remove_scans(Path(store), names)
            if (Path(store) / DATASET).is_file():
                # Also those that were recorded since it was searched; no later one has the scans.
                note_releases(Path(store), found)
            done += 1
            progress(done, total)
        for path in lists:
            take_off(path, subject)
            done += 1
            progress(done, total)
        for path in paths:
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink(missing_ok=True)
            done += 1
            progress(done, total)


def found_in_words(found: Found) -> list[str]:
    """What was found, a line each."""
    lines = [f"{kind}: {path}" for kind in KINDS for path in found.removed.get(kind, [])]
    lines += [
        f"store: {', '.join(names)} of {store}" for store, names in found.scans.items() if names
    ]
    lines += [f"entry in the list of simulated people: {path}" for path in found.lists]
    lines += [f"store, which holds nobody else: {path}" for path in found.whole]
    lines += [
        f"stays, and held the person: {each['out']}, published on {each['utc']}"
        for each in found.published
    ]
    lines += [
        f"stays, and was trained on the person: {path}; train anew" for path in found.checkpoints
    ]
    return lines
