"""What there is of a person in a lab's folders: by names, hashes and the records of stores."""

from __future__ import annotations

import dataclasses
import fnmatch
import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from lightstage.commands import ProgressCallback, quiet
from lightstage.errors import FormatError
from lightstage.formats.files import read_json, sha256_file
from lightstage.formats.lock import abandoned
from lightstage.formats.people import PEOPLE_LIST, lists_person
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.values import read_lines
from processing.dataset.changes import BESIDE, OF_A_SCAN, folder_of
from processing.dataset.contents import RELEASES, scans_of_fingerprint
from processing.dataset.links import require_no_links_out
from processing.dataset.named import names_subject
from processing.dataset.release_files import CHANNELS as RELEASED
from processing.dataset.release_files import TARS
from processing.dataset.scan import DatasetError, scan_digest
from processing.dataset.store import DATASET, PUBLISHED, SCANS, STORE, trace_of

SHARED = "calibration"
"""A session's folder of what it has in common with other sessions."""
NOT_SHOWN = frozenset(
    ["", *(f".{n}" for n in ("json", "jsonl", "toml", "txt", "csv", "tsv", "html", "md", "log"))]
)
"""Suffixes of files that show nobody; all others do, since cameras name photographs in many ways. A
copy of one elsewhere is the person's too."""
LEFT_BESIDE = re.compile(r"\.(?P<stem>.+)\.[0-9a-f]{8}(\..+)?")
JOURNAL = "journal.jsonl"
BATCH_LISTS = ("batch.json", "batch.html")
LEFT, HALF_BUILT = "left by a killed process", "half-built by a killed process"
KINDS = ("session", "processed folder", LEFT, HALF_BUILT, "list of a batch", "copy")
"""What goes. Of a half-built store or release nobody can tell any more whom it shows, so that it
goes with anybody who is to be forgotten."""


@dataclasses.dataclass
class Found:
    """What there is of a person in some folders.

    Attributes:
        removed: paths that go, by what they are (`KINDS`).
        scans: by store, the names of the person's scans; `whole` where the store has no others.
        whole: stores that go as a whole.
        scan_sha256: of the person's scans, as stores and releases know them.
        published: releases that held the person.
        checkpoints: that were trained on a store that held the person.
        hashes: SHA-256 of files that show the person, to their size.
        lists: of simulated people, from which the person is taken.
    """

    removed: dict[str, list[str]] = dataclasses.field(default_factory=dict)
    scans: dict[str, list[str]] = dataclasses.field(default_factory=dict)
    whole: list[str] = dataclasses.field(default_factory=list)
    scan_sha256: list[str] = dataclasses.field(default_factory=list)
    published: list[dict[str, Any]] = dataclasses.field(default_factory=list)
    checkpoints: list[str] = dataclasses.field(default_factory=list)
    hashes: dict[str, int] = dataclasses.field(default_factory=dict)
    lists: list[str] = dataclasses.field(default_factory=list)

    @property
    def empty(self) -> bool:
        """Whether there is nothing of the person."""
        own = any(paths for kind, paths in self.removed.items() if kind != HALF_BUILT)
        return not (own or self.scans or self.whole or self.lists)

    def add(self, kind: str, path: Path) -> None:
        """Note a path that goes."""
        listed = self.removed.setdefault(kind, [])
        if str(path) not in listed:
            listed.append(str(path))

    def joined(self, other: Found) -> Found:
        """What both know: an interrupted call's plan, and what is there now."""
        both = Found(whole=sorted({*self.whole, *other.whole}))
        for kind in KINDS:
            for path in (*self.removed.get(kind, []), *other.removed.get(kind, [])):
                both.add(kind, Path(path))
        for store in {**self.scans, **other.scans}:
            both.scans[store] = other.scans.get(store, [])
        both.scan_sha256 = sorted({*self.scan_sha256, *other.scan_sha256})
        known = {str(each["out"]) + str(each["utc"]): each for each in self.published}
        both.published = list(
            (known | {str(e["out"]) + str(e["utc"]): e for e in other.published}).values()
        )
        both.checkpoints = sorted({*self.checkpoints, *other.checkpoints})
        both.hashes = {**self.hashes, **other.hashes}
        both.lists = sorted({*self.lists, *other.lists})
        return both


def survey(
    subject: str,
    folders: Sequence[Path],
    hashed: bool,
    progress: ProgressCallback = quiet,
    begun: Found | None = None,
) -> Found:
    """Find everything of a person, and change nothing.

    Args:
        subject: the pseudonym.
        folders: where to search, with all that is in them.
        hashed: hash every file that shows the person; otherwise only those that a file of the same
            size elsewhere may be a copy of.
        progress: called after each of the person's folders.
        begun: what a call that was interrupted was removing.

    Raises:
        DatasetError: a folder that is not there, links that lead out of them, or a store or release
            that is being made.
        FormatError: a file of ours that cannot be read, so that its person is not known.
    """
    for folder in folders:
        if not folder.is_dir():
            raise DatasetError(folder, field="--in", found="no such folder", expected="a folder")
    require_no_links_out(folders)
    found = Found()
    others: list[Path] = []
    processed: list[Path] = []
    stores: list[Path] = []
    half_built: list[Path] = []
    checkpoints: list[tuple[Path, Any]] = []
    for path, names in _walked(folders):
        kind = _kind(path, names)
        if kind in ("session", "processed folder"):
            whose = _subject(path, names)
            if whose == subject:
                found.add(kind, path)
            elif kind == "processed folder":
                processed.append(path)
        elif kind == STORE:
            stores.append(path)
        elif kind == "checkpoint":
            checkpoints.append((path, read_json(path / "checkpoint.json")))
        if BATCH_LISTS[0] in names and names_subject(path / BATCH_LISTS[0], subject):
            for name in BATCH_LISTS:
                if (path / name).exists():
                    found.add("list of a batch", path / name)
        if lists_person(path / PEOPLE_LIST, subject):
            found.lists.append(str(path / PEOPLE_LIST))
        if LEFT_BESIDE.fullmatch(path.name) and (kind == PUBLISHED or _holds_maps(path, names)):
            half_built.append(path)
        if kind is None:
            others += [path / name for name in names]
    own = [Path(p) for kind in KINDS[:2] for p in found.removed.get(kind, [])]
    for path in own:
        for beside in path.parent.glob(".*"):
            match = LEFT_BESIDE.fullmatch(beside.name)
            if match and match["stem"] == path.name:
                found.add(LEFT, beside)
    known = {name for names in begun.scans.values() for name in names} if begun else set()
    _of_stores(subject, stores, half_built, own, known, found)
    _holders(stores, checkpoints, found)
    _hash_own(own, others, found, hashed, progress)
    _leave_common(processed, found)
    _copies(others, found)
    return found


def _walked(folders: Sequence[Path]) -> Iterator[tuple[Path, list[str]]]:
    """Every folder with the names of its files; what is in one of ours belongs to it."""
    seen: set[Path] = set()
    for folder in folders:
        for root, below, names in os.walk(folder.resolve()):
            path = Path(root)
            if path in seen:
                below[:] = []
                continue
            seen.add(path)
            below.sort()
            yield path, sorted(names)
            if _kind(path, names) in ("session", "processed folder", STORE, PUBLISHED):
                below[:] = []


def _kind(path: Path, names: Sequence[str]) -> str | None:
    """What a folder is by the files in it; None for what is none of ours."""
    if "session.json" in names or JOURNAL in names:
        return "session"
    if DATASET in names:
        kind = _text(read_json(path / DATASET), "kind")
        return kind if kind in (STORE, PUBLISHED) else None
    if "stages.json" in names or "report.json" in names:
        return "processed folder"
    return "checkpoint" if "checkpoint.json" in names else None


def _holds_maps(path: Path, names: Sequence[str]) -> bool:
    """Whether a folder without dataset.json holds maps of a store or of a release."""
    if DATASET in names:
        return False
    arrays = any((path / name).is_dir() for name in (SCANS, *RELEASED))
    return arrays or any(fnmatch.fnmatch(name, TARS) for name in names)


def _subject(path: Path, names: Sequence[str]) -> str | None:
    """Whose session or processed folder it is; None where it does not state it."""
    if "session.json" in names:
        return _text(read_json(path / "session.json"), "subject")
    if JOURNAL in names:
        lines = read_lines(path / JOURNAL)
        return next((_text(line, "subject") for line in lines if _text(line, "subject")), None)
    subject = None
    if "stages.json" in names:
        value = read_json(path / "stages.json")
        if not isinstance(value, dict):
            raise FormatError(
                path / "stages.json",
                found=type(value).__name__,
                expected="a JSON object that names whose the folder is",
                hint="If the folder is nobody's, remove the file.",
            )
        subject = _text(value.get("made_from"), "subject")
    if subject is None and "report.json" in names:
        subject = _text(read_json(path / "report.json"), "subject")
    return subject


def _text(value: Any, key: str) -> str | None:
    text = value.get(key) if isinstance(value, dict) else None
    return text if isinstance(text, str) else None


def _of_stores(
    subject: str,
    stores: list[Path],
    half_built: list[Path],
    own: list[Path],
    known: set[str],
    found: Found,
) -> None:
    scans = [(_expression(path), _scan_sha256(path)) for path in own]
    listed: dict[Path, set[str]] = {}
    for store in stores:
        entries = read_json(store / DATASET).get("scans", [])
        theirs = [entry for entry in entries if _text(entry, "subject") == subject]
        scans += [(_text(entry, "expression"), _text(entry, "sha256")) for entry in theirs]
        if theirs and len(theirs) == len(entries):
            found.whole.append(str(store))
        elif theirs:
            found.scans[str(store)] = [str(entry.get("folder", "")) for entry in theirs]
        listed[store] = {str(entry.get("folder", "")) for entry in entries}
    found.scan_sha256 = sorted({digest for _, digest in scans if digest})
    # A scan has the same name in every store. One that was being written has none yet.
    names = known | {folder_of(subject, kind or "", digest) for kind, digest in scans if digest}
    for store in stores:
        for path in sorted((store / SCANS).glob("*")):
            being_added = path.name.startswith(BESIDE) and path.is_dir()
            if path.name in listed[store] or not (being_added or OF_A_SCAN.fullmatch(path.name)):
                continue
            if being_added:
                _require_abandoned(path)
            found.add(LEFT if path.name in names else HALF_BUILT, path)
    for folder in half_built:
        _require_abandoned(folder)
        theirs_too = any(path.name in names for path in (folder / SCANS).glob("*"))
        found.add(LEFT if theirs_too else HALF_BUILT, folder)


def _require_abandoned(folder: Path) -> None:
    if not abandoned(folder):
        raise DatasetError(
            folder,
            found="a scan, store or release that another process is making",
            expected="folders that are at rest",
            hint="Wait until that process has ended, and call this again.",
        )


def _scan_sha256(processed: Path) -> str | None:
    """SHA-256 of the scan that a store has of a folder; None where it has no atlas."""
    try:
        return scan_digest(ProcessedFolder(processed))
    except OSError:
        return None


def _expression(processed: Path) -> str | None:
    path = processed / "report.json"
    return _text(read_json(path), "expression") if path.is_file() else None


def _holders(stores: list[Path], checkpoints: list[tuple[Path, Any]], found: Found) -> None:
    """Releases and checkpoints that held the person, by the stores' records."""
    theirs = set(found.scan_sha256)
    held: set[str] = set()
    for store in stores:
        for fingerprint, scans in scans_of_fingerprint(store).items():
            if scans & theirs:
                held.add(fingerprint)
        value = read_json(store / DATASET)
        if any(_text(scan, "sha256") in theirs for scan in value.get("scans", [])):
            held.add(str(value.get("fingerprint")))
        note_releases(store, found)
    traces = theirs | {trace_of(digest) for digest in theirs}
    for path, value in checkpoints:
        # Also of a run that began with another's weights, in a store without the person.
        known = value.get("trained_on") if isinstance(value, dict) else None
        trained = isinstance(known, list) and traces & set(map(str, known))
        if trained or _text(value, "data_fingerprint") in held:
            found.checkpoints.append(str(path))
    found.checkpoints.sort()


def note_releases(store: Path, found: Found) -> None:
    """Note the releases of a store that held the person, by its record, each once."""
    for line in read_lines(store / RELEASES) if (store / RELEASES).is_file() else []:
        if isinstance(line, dict) and set(found.scan_sha256) & set(line.get("scans", [])):
            release = {k: v for k, v in line.items() if k != "scans"}
            if release not in found.published:
                found.published.append(release)


def _hash_own(
    own: list[Path],
    others: list[Path],
    found: Found,
    hashed: bool,
    progress: ProgressCallback,
) -> None:
    """Hash what shows the person; without `hashed` only what may have a copy elsewhere."""
    sizes = {path.stat().st_size for path in others if path.is_file()}
    for index, folder in enumerate(own):
        for path in personal_files(folder):
            size = path.stat().st_size
            if size and (hashed or size in sizes):
                found.hashes[sha256_file(path)] = size
        progress(index + 1, len(own))


def _leave_common(processed: list[Path], found: Found) -> None:
    """Forget hashes of files that other people's processed folders have too: they show nobody."""
    sizes = set(found.hashes.values())
    for folder in processed:
        for path in personal_files(folder):
            if path.stat().st_size in sizes:
                found.hashes.pop(sha256_file(path), None)


def _copies(others: list[Path], found: Found) -> None:
    """Find the same bytes in folders that are none of ours: what a card left, a copy."""
    gone = {Path(p) for paths in found.removed.values() for p in paths}
    sizes = set(found.hashes.values())
    for path in others:
        if path.suffix.lower() in NOT_SHOWN or gone & {path, *path.parents}:
            continue
        if path.is_file() and path.stat().st_size in sizes and sha256_file(path) in found.hashes:
            found.add("copy", path)


def personal_files(folder: Path) -> list[Path]:
    """Files of a session or processed folder that show its person."""
    return sorted(
        path
        for path in folder.rglob("*")
        if path.suffix.lower() not in NOT_SHOWN
        and path.is_file()
        and SHARED not in path.relative_to(folder).parts
    )


def what_is_left(
    subject: str, folders: Sequence[Path], found: Found, plan: Path
) -> dict[str, list[str]]:
    """Files that show the person, by their hash, or name the person, by the pseudonym.

    Args:
        subject: the pseudonym, searched for as a word in names of files and in text.
        folders: where to search.
        found: what was removed.
        plan: skipped: it names who is to be forgotten.

    Returns:
        `by_hash` and `by_pseudonym`: paths.
    """
    sizes = set(found.hashes.values())
    left: dict[str, list[str]] = {"by_hash": [], "by_pseudonym": []}
    seen: set[Path] = set()
    recorded: dict[Path, str] = {}
    for folder in folders:
        for path in sorted(folder.resolve().rglob("*")):
            if path in seen or path == plan.resolve() or path.name.startswith("forgotten-"):
                continue
            seen.add(path)
            if names_subject(path, subject):
                left["by_pseudonym"].append(str(path))
            if path.is_dir() and (path / "session.json").is_file():
                recorded |= _recorded(path)
            plain = path.is_file() and not path.is_symlink()
            if not (plain and path.stat().st_size in sizes):
                continue
            if (recorded.get(path) or sha256_file(path)) in found.hashes:
                left["by_hash"].append(str(path))
    return left


def _recorded(session: Path) -> dict[Path, str]:
    """Hashes of a session's photographs as it has them: RAW files of all people are of one size."""
    value = read_json(session / "session.json")
    frames = value.get("frames") if isinstance(value, dict) else None
    named = [(_text(f, "path"), _text(f, "sha256")) for f in frames or []]
    return {session / path: digest for path, digest in named if path and digest}
