"""What was done in a processed folder: keys of finished stages, their facts, seconds and memory."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import json
import platform
import resource
import shutil
import time
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

from lightstage.errors import FormatError
from lightstage.formats.files import check_schema, leftovers, read_json, sha256_file, write_json
from lightstage.formats.population import FILE as POPULATION
from lightstage.formats.population import POINTS_FILE as POINTS_OF_POPULATION
from lightstage.formats.processed import TRUTH_SCHEMA
from processing.errors import ProcessingError

SCHEMA = "processing.stages/1"
REPORT_SCHEMA = "processing.report/1"
MADE_FIRST = ("work", "views", "stages.json")
"""What a stage makes before all else: a folder with one of these is a processed folder."""
EVALUATION = "evaluation.json"
"""Errors of a processed folder against truth; they hold until a stage runs again."""
RUN_LOCK = "run.lock"
"""Held while stages run, so that two runs do not share a folder."""
REPORTED = ("numpy", "scipy", "numba", "opencv-contrib-python-headless", "open3d", "pycolmap")
CODE = (
    "processing",
    *(f"lightstage/{name}" for name in ("formats", "rig", "patterns", "faces")),
    *(f"lightstage/{name}.py" for name in ("meshlab", "nearest_point")),
    *(f"lightstage/{name}.py" for name in ("containers", "exif", "photo_file", "tiff")),
)
"""Folders and files whose code results depend on; what a stage reaches of them is in its key."""


@dataclasses.dataclass(frozen=True)
class Record:
    """One finished stage.

    Attributes:
        key: hash of its inputs, configuration and code; another key means it is stale.
        outputs: files it wrote, relative to the processed folder.
        facts: JSON-ready, with seconds and peak_rss_mb.
        parts: what the key was made of, each a hash (`stage_inputs`); empty where an older version
            wrote it.
        config: the resolved configuration that it ran with; empty likewise.
    """

    key: str
    outputs: list[str]
    facts: dict[str, Any]
    parts: dict[str, str] = dataclasses.field(default_factory=dict)
    config: dict[str, Any] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class MadeFrom:
    """The session that a processed folder was made from.

    Attributes:
        session: the session's id; None where only a report names it, and has none.
        subject: the person's pseudonym.
    """

    session: str | None
    subject: str

    def __str__(self) -> str:
        """As messages name it."""
        session = "a session" if self.session is None else f"session {self.session}"
        return f"{session} of subject {self.subject}"


def require_own(out: Path) -> None:
    """Refuse a folder that holds other things than a processed session's.

    Raises:
        ProcessingError: a folder with files in it, none of which the stages make.
    """
    names = sorted(path.name for path in out.iterdir()) if out.is_dir() else []
    # A run that was killed at its start leaves the lock, and half a file beside a name of its own.
    half = {path.name for path in [*leftovers(out, "*"), *leftovers(out, "*.*")]}
    names = [name for name in names if name != RUN_LOCK and name not in half]
    if names and not any(name in names for name in MADE_FIRST):
        raise ProcessingError(
            out,
            field="--out",
            found=f"a folder that holds {names[0]}" + " and more" * (len(names) > 1),
            expected="a new folder, or one that the stages made",
            hint="Name another, so that nothing of yours is mixed with what the stages write.",
        )


def require_same_session(out: Path, given: MadeFrom) -> None:
    """Refuse a folder that was made from another session: one person's maps, another's consent.

    Raises:
        ProcessingError: stages.json, or report.json where that one does not name it, is of another.
        FormatError: a file that cannot be read.
    """
    found = read_made_from(out) or _reported(out)
    if found is None:
        return
    if found.subject != given.subject or found.session not in (None, given.session):
        raise ProcessingError(
            out,
            field="--out",
            found=f"a folder made from {found}",
            expected=f"a new one, or one made from {given}",
            hint="Choose another --out.",
        )


def read_made_from(out: Path) -> MadeFrom | None:
    """Which session stages.json is of; None where there is none or an older version wrote it."""
    path = out / "stages.json"
    value = read_json(path, SCHEMA).get("made_from") if path.exists() else None
    if value is None:
        return None
    names = value if isinstance(value, dict) else {}
    session, subject = names.get("session"), names.get("subject")
    if not (isinstance(session, str) and isinstance(subject, str)):
        raise FormatError(
            path, field="made_from", found=repr(value)[:80], expected="session and subject, as text"
        )
    return MadeFrom(session, subject)


def read_report(path: Path) -> dict[str, Any]:
    """report.json, of the stages or of a simulated person's truth.

    Raises:
        FormatError: no file, no object, or of a newer version or something else.
    """
    value = read_json(path)
    if not isinstance(value, dict):
        raise FormatError(path, found=type(value).__name__, expected="a JSON object")
    if "schema" in value:  # earlier truths have none
        known = REPORT_SCHEMA if of_stages(value) else TRUTH_SCHEMA
        check_schema(path, value, known)
    return value


def of_stages(report: dict[str, Any]) -> bool:
    """Whether a report is of stages, not of a simulated person's truth."""
    return str(report.get("schema")).partition("/")[0] == REPORT_SCHEMA.partition("/")[0]


def _reported(out: Path) -> MadeFrom | None:
    """Which session report.json is of; None where there is none, or no subject in it."""
    path = out / "report.json"
    value = read_json(path) if path.exists() else None
    if not isinstance(value, dict) or not isinstance(value.get("subject"), str):
        return None
    session = value.get("session")
    return MadeFrom(session if isinstance(session, str) else None, value["subject"])


def read_records(out: Path) -> dict[str, Record]:
    """Finished stages by name, in the order they ran; empty where there is no stages.json.

    Also empty where it does not name the session of its stages: they may be of two.
    """
    path = out / "stages.json"
    if not path.exists():
        return {}
    try:
        stages = read_json(path, SCHEMA)["stages"]
        records = {name: Record(**value) for name, value in stages.items()}
    except (KeyError, TypeError, AttributeError) as error:
        raise FormatError(
            path,
            found=f"no usable {error}",
            expected="key, outputs and facts of each stage",
            hint="Remove it, and every stage runs again.",
        ) from None
    return records if read_made_from(out) else {}


def write_records(out: Path, made_from: MadeFrom, records: dict[str, Record]) -> Path:
    """Write stages.json atomically; returns its path."""
    stages = {name: dataclasses.asdict(record) for name, record in records.items()}
    of = dataclasses.asdict(made_from)
    return write_json(out / "stages.json", {"schema": SCHEMA, "made_from": of, "stages": stages})


def hash_of(*values: Any) -> str:
    """SHA-256 of JSON-ready values, in hexadecimal."""
    return hashlib.sha256(json.dumps(values, sort_keys=True, default=str).encode()).hexdigest()


def hash_template(folder: Path) -> str:
    """SHA-256 of the files of a template that stages read, names and bytes: not its population."""
    files = sorted(
        path
        for path in folder.rglob("*")
        if path.is_file() and path.name not in (POPULATION, POINTS_OF_POPULATION)
    )
    return hash_of([(str(path.relative_to(folder)), sha256_file(path)) for path in files])


@functools.cache
def code_version() -> str:
    """SHA-256 of the source files that processing's results depend on."""
    root = Path(__file__).parents[1]
    files: list[Path] = []
    for name in CODE:
        place = root / name
        files += sorted(place.rglob("*.py")) if place.is_dir() else [place]
    return hash_of([(str(path.relative_to(root)), sha256_file(path)) for path in files])


def versions() -> dict[str, str]:
    """Versions of this project, its code's hash, Python and the libraries that shape results."""
    found = {name: _installed(name) for name in REPORTED}
    own = {"lightstage": metadata.version("lightstage"), "code": code_version()[:12]}
    return {**own, "python": platform.python_version(), **found}


def _installed(name: str) -> str:
    """Version of a library, under its own name or that of its build without CUDA."""
    try:
        return metadata.version(f"{name}-cpu")
    except metadata.PackageNotFoundError:
        return metadata.version(name)


def remove_leftovers(out: Path) -> None:
    """Remove what a killed run left beside the files that it wrote; only for the lock's holder."""
    folders = [out, *(path for path in out.rglob("*") if path.is_dir())]
    for folder in folders:
        for path in [*leftovers(folder, "*"), *leftovers(folder, "*.*")]:
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)


def files_in(out: Path) -> dict[str, tuple[int, int]]:
    """Every file below a folder: relative name to size and time of change."""
    found = {}
    for path in out.rglob("*"):
        if path.is_file():
            stat = path.stat()
            found[str(path.relative_to(out))] = (stat.st_size, stat.st_mtime_ns)
    return found


@contextlib.contextmanager
def measured(facts: dict[str, Any]) -> Iterator[None]:
    """Add `seconds` and `peak_rss_mb` of a block to its facts."""
    # Linux resets a process's memory peak on request; elsewhere it is the peak since its start.
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
    start = time.perf_counter()
    yield
    facts["seconds"] = round(time.perf_counter() - start, 2)
    facts["peak_rss_mb"] = round(_peak_rss_mb(), 1)


def _peak_rss_mb() -> float:
    with contextlib.suppress(OSError):
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
