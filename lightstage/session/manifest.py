"""The manifest: what a session was made with and of, so that it can be checked years later.

It holds versions, devices, hashes and settings, and of the person a pseudonym and the id of the
consent record alone. No host, no user and no absolute path get into it.
"""

from __future__ import annotations

import collections
import dataclasses
import hashlib
import itertools
import json
import math
import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.counting import counted
from lightstage.errors import FormatError, LightstageError
from lightstage.formats.files import read_json, sha256_file, write_json
from lightstage.formats.paths import path_inside
from lightstage.formats.values import open_regular
from lightstage.rig import Rig, load_rig, rig_to_json
from lightstage.session.events import Line
from lightstage.session.reading import read_journal
from lightstage.session.state import SessionState
from lightstage.session.versions import software_versions, system_facts

SCHEMA = "lightstage.manifest/1"
MANIFEST = "manifest.json"
JOURNAL = "journal.jsonl"
MAX_BYTES = 1 << 40
"""Largest number of bytes that a journal states; a larger one is damage."""
OF_SESSION = ("created_utc", "subject", "expression", "consent")
OF_CAMERA = (
    *("serial", "model", "firmware", "mode", "iso", "shutter", "aperture"),
    *("white_balance", "image_format", "focus"),
)
"""What is written of each camera: never its owner, artist, copyright or place."""
_ABSOLUTE = re.compile(r"(?<![\w.+@)-])(?:file:)?(?:/+|~/|[A-Za-z]:[\\/]|\\\\)[\w.~@+-][^\s'\",;]*")
_PATH = "(path)"


def write_manifest(root: Path, facts: Mapping[str, Any] | None = None) -> Path:
    """Write manifest.json of a session whose session.json is there; atomically, also a second time.

    Photographs' hashes are those of the journal, which were read back from the disk; the hashes of
    the small files are taken anew.

    Args:
        root: the session's folder.
        facts: what else the manifest shall hold under ``facts``, such as figures of safety and
            calibration shots. Absolute paths in it are replaced by ``(path)``.

    Raises:
        FormatError: no journal or session, or damaged ones.
    """
    path = root / JOURNAL
    data = path.read_bytes() if path.is_file() else b""
    lines = read_journal(path)
    whole = data[: data.rfind(b"\n") + 1]
    state = SessionState(lines)
    session = read_json(root / "session.json", "lightstage.session/1")
    rig = load_rig(root / "rig.json")
    files, lost = _files(root, state)
    begins = [line for line in lines if line["event"] in ("begin", "resume")]
    begun = {key: value for line in begins for key, value in line.items()}
    manifest = {
        "schema": SCHEMA,
        "session": session["id"],
        "created_utc": session["created_utc"],
        "subject": session["subject"],
        "expression": session["expression"],
        "consent": session.get("consent"),
        "software": software_versions(),
        "began_with": lines[0].get("version"),
        "system": system_facts(),
        "leds": begun.get("led_device"),
        "cameras": _cameras(begun.get("told") or {}),
        "not_verifiable": begun.get("not_verifiable") or {},
        "unacknowledged": [
            pattern for pattern in state.patterns if state.acknowledged(pattern) is False
        ],
        "configuration": begun.get("config") or {},
        "calibration": {
            kind: file for kind, file in session.get("calibration", {}).items() if file is not None
        },
        "light": _light_figures(lines),
        "warnings": collections.Counter(
            line.get("code", "")
            for line in lines
            if line["event"] == "finding" and line.get("severity") == "warn"
        ),
        "accepted": session.get("accepted", {}),
        "resumed": len(begins) - 1,
        "light_map_sha256": light_map_hash(rig),
        "files": dict(sorted(files.items())),
        "lost": dict(sorted(lost.items())),
        "journal": {
            "path": JOURNAL,
            "last_id": lines[-1]["id"],
            "bytes": len(whole),
            "sha256": hashlib.sha256(whole).hexdigest(),
        },
        "facts": dict(facts or {}),
    }
    return write_json(root / MANIFEST, _plain(manifest))


def check_manifest(root: Path, known: Mapping[str, str] | None = None) -> list[LightstageError]:
    """Compare a session's folder with its manifest.

    Args:
        root: the session's folder.
        known: hashes that were taken just now, by path in the session; these files are not read
            again.

    Returns:
        One error for each file that is missing, changed or not in the manifest, and for a journal
        whose part up to the manifest's line was changed. None where there is no manifest because
        the photographs were imported.
    """
    path = root / MANIFEST
    if not os.path.lexists(path):
        return [] if _needs_none(root) else [_wrong(path, "no such file", "the manifest", "")]
    try:
        manifest = read_json(path, SCHEMA)
        files, journal = dict(manifest["files"]), dict(manifest["journal"])
        limit, line = min(max(0, int(journal["bytes"])), MAX_BYTES), int(journal["last_id"])
        light_map, whole = str(manifest["light_map_sha256"]), str(journal["sha256"])
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        return [_wrong(path, f"no readable {error}", "the fields of a manifest", "Restore it.")]
    except LightstageError as problem:
        return [problem]
    problems = _other_session(root, manifest)
    problems += [
        _wrong(path, f"no hash of {name}", "one", "")
        for name in ("session.json", "rig.json")
        if name not in files
    ]
    for name, sha256 in files.items():
        problems += _file_problems(root, str(name), str(sha256), known or {})
    for name in _photographs_on_disk(root):
        if name not in files:
            problems.append(
                _wrong(root / name, "a file", "none that the manifest does not list", "")
            )
    expected = f"its lines up to {line} as written"
    try:
        with open(open_regular(root / JOURNAL), "rb") as file:
            data = file.read(min(limit, os.fstat(file.fileno()).st_size))
    except (OSError, FormatError):
        problems.append(_wrong(root / JOURNAL, "no journal", expected, "Restore it."))
    else:
        if len(data) < limit:
            size = f"{counted(len(data), 'byte')}, cut"
            problems.append(_wrong(root / JOURNAL, size, f"at least {limit}", "Restore it."))
        elif hashlib.sha256(data).hexdigest() != whole:
            problems.append(_wrong(root / JOURNAL, "another beginning", expected, "Restore it."))
    if files.get("rig.json") == _hash_of(root / "rig.json"):
        try:
            same = light_map_hash(load_rig(root / "rig.json")) == light_map
        except LightstageError as problem:
            problems.append(problem)
        else:
            if not same:
                problems.append(_wrong(path, "another light map", "that of rig.json", ""))
    return problems


def _other_session(root: Path, manifest: Mapping[str, Any]) -> list[LightstageError]:
    """Where a manifest differs from session.json."""
    try:
        session = read_json(root / "session.json", "lightstage.session/1")
    except LightstageError:
        return []  # reported with the file's hash
    stated = {**{name: session.get(name) for name in OF_SESSION}, "session": session.get("id")}
    stated["accepted"] = session.get("accepted", {})
    return [
        FormatError(
            root / MANIFEST,
            field=name,
            found=repr(manifest[name]),
            expected=f"{value!r} (session.json)",
            hint="It is another session's manifest, or one of the two files was changed.",
        )
        for name, value in stated.items()
        if name in manifest and manifest[name] != value
    ]


def light_map_hash(rig: Rig) -> str:
    """SHA-256 of where the lights are, in which bank, and how strong, in the rig's order."""
    text = json.dumps(rig_to_json(rig)["lights"], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _cameras(summaries: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    return {
        camera: {name: summary.get(name) for name in OF_CAMERA}
        for camera, summary in summaries.items()
    }


def _light_figures(lines: list[Line]) -> dict[str, Any]:
    """How often the light was changed, as it was journaled: the limits are in ``configuration``."""
    moments: list[list[float]] = []
    for line in lines:
        if line["event"] in ("begin", "resume"):
            moments.append([])  # each process has a clock of its own
        elif line["event"] == "lit" and "elapsed_s" in line:
            moments[-1].append(float(line["elapsed_s"]))
    gaps = [b - a for each in moments for a, b in itertools.pairwise(each)]
    most = [sum(a <= b < a + 1.0 for b in each) for each in moments for a in each]
    return {
        "lit": sum(map(len, moments)),
        "shortest_interval_s": min(gaps, default=None),
        "most_in_one_second": max(most, default=0),
    }


def _files(root: Path, state: SessionState) -> tuple[dict[str, str], dict[str, str]]:
    """Path in the session and hash of everything that stays as it is, and of what was lost.

    Lost are photographs that do not count and are no longer on the disk: the others must be there.
    """
    files = {kept.path: kept.sha256 for kept in state.frames()}
    others = {kept.path: kept.sha256 for kept in state.all_frames() if kept.path not in files}
    others |= {aside.path: aside.sha256 for aside in state.recovered().values()}
    lost = {path: sha256 for path, sha256 in others.items() if not (root / path).is_file()}
    files |= {path: sha256 for path, sha256 in others.items() if path not in lost}
    for path in (root / "session.json", root / "rig.json", *sorted(root.glob("calibration/**/*"))):
        if path.is_file():
            files[path.relative_to(root).as_posix()] = sha256_file(path)
    return files, lost


def _photographs_on_disk(root: Path) -> Iterator[str]:
    for folder in ("frames", "recovered"):
        for path in sorted((root / folder).rglob("*")):
            # What a capture was writing when it was ended (.cam0.take1.partial) is no photograph.
            if path.is_file() and not path.name.startswith("."):
                yield path.relative_to(root).as_posix()


def _file_problems(
    root: Path, name: str, sha256: str, known: Mapping[str, str]
) -> list[LightstageError]:
    try:
        path_inside(root, name, root / MANIFEST, "files")
    except FormatError as problem:
        return [problem]
    found = known.get(name) or _hash_of(root / name)
    if found == sha256:
        return []
    if not (root / name).is_file():
        hint = "Copy it back from the camera or from a copy of the session."
        return [_wrong(root / name, "no such file", "the one in the manifest", hint)]
    hint = "The file changed or was cut since the capture; restore it."
    return [_wrong(root / name, f"sha256 {found[:12]}..", f"{sha256[:12]}..", hint)]


def _hash_of(path: Path) -> str:
    try:
        return sha256_file(path)
    except OSError:
        return ""


def _needs_none(root: Path) -> bool:
    """Whether a session has no manifest because it was not captured here, or not to its end."""
    try:
        lines = read_journal(root / JOURNAL)
    except LightstageError:
        return True  # photographs from elsewhere; the journal is another check's
    return "led_device" not in lines[0] or lines[-1]["event"] != "end" or _is_older(lines[0])


def _is_older(begin: Line) -> bool:
    return begin.get("schema") == "lightstage.journal/1"


def _plain(value: Any) -> Any:
    """The same as JSON can hold it, with every absolute path replaced, whoever put it there.

    At the end of a capture no fact may be the reason that there is no manifest: what is not finite
    becomes null, and what JSON does not know becomes text.
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = dataclasses.asdict(value)
    if isinstance(value, Mapping):
        return {_plain(str(key)): _plain(each) for key, each in value.items()}
    if isinstance(value, (list, tuple, set, frozenset, np.ndarray)):
        return [_plain(each) for each in value]
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, (bool, int)):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return _ABSOLUTE.sub(_PATH, str(value))


def _wrong(path: Path, found: str, expected: str, hint: str) -> FormatError:
    return FormatError(path, found=found, expected=expected, hint=hint)
