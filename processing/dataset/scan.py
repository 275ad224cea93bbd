"""One scan of a store: a processed folder's atlas maps in the head frame, and whose they are."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.errors import FormatError
from lightstage.formats.fields import array_of
from lightstage.formats.files import check_schema, read_json, sha256_file
from lightstage.formats.names import require_pseudonym
from lightstage.formats.people import is_people_file
from lightstage.formats.processed import HEAD_SCHEMA, ProcessedFolder
from processing.errors import ProcessingError
from processing.records import MadeFrom, of_stages, read_made_from, read_records, read_report

CHANNELS: dict[str, int] = {
    "diffuse_albedo": 3,
    "specular_albedo": 1,
    "diffuse_normal": 3,
    "specular_normal": 3,
    "position": 3,
    "confidence": 1,
}
"""Maps of a store and their channels; normals and position (mm) are in the head frame."""
NORMALS = ("diffuse_normal", "specular_normal")
SKIN = "skin"
SEXES = ("female", "male", "other")
AGE_BANDS = {"under 18": 18.0, "18 to 29": 30.0, "30 to 44": 45.0, "45 to 59": 60.0}
"""Name of a band, and the age in years at which the next begins; the last has no end."""
OLDEST, OLDEST_YEARS = "60 and over", 130


class DatasetError(ProcessingError):
    """A dataset that cannot be built, read or published."""


@dataclasses.dataclass(frozen=True)
class ScanEntry:
    """A store's entry for one scan in its dataset.json.

    Attributes:
        subject: the person's pseudonym.
        expression: such as ``neutral``.
        rows: of the maps.
        columns: of the maps.
        sha256: of all files that went in.
        consent: id of the record of the person's consent; None where there is none.
        synthetic: a simulated person, who needs none.
        sex: one of `SEXES`; None where the processed folder does not state it.
        age: a band of `AGE_BANDS`, likewise; the years themselves are not kept.
    """

    subject: str
    expression: str
    rows: int
    columns: int
    sha256: str
    consent: str | None
    synthetic: bool
    sex: str | None = None
    age: str | None = None


def without_people_files(paths: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """Separate folders from the files that `lightstage-sim dataset` writes beside its people.

    A shell's ``P/*`` names them all.

    Returns:
        What a store is to be made of, and the files to pass over.
    """
    passed = [path for path in paths if is_people_file(path)]
    return [path for path in paths if path not in passed], passed


def read_scan(root: Path) -> tuple[ScanEntry, dict[str, np.ndarray]]:
    """Read a processed folder.

    Confidence is 0 where the template has eyes, the opening of the mouth or hair (map `skin`), as a
    simulated person's is: nothing that reads a store takes these for skin.

    Args:
        root: a folder with atlas/, head_from_world.json and report.json.

    Returns:
        Its entry, and its maps by name, (rows, columns, c) float32, in the head frame.

    Raises:
        FormatError, DatasetError: something else than a processed folder, such as the truth of a
            simulated session, an atlas older than the stages before it, a report of another
            session than the atlas or of a newer version, a map that is missing, damaged or of
            another size, no subject, a pose that is not rigid.
    """
    _require_processed(root)
    folder = ProcessedFolder(root)
    report = read_report(root / "report.json")
    subject, expression = (
        require_pseudonym(report.get(key), root / "report.json", key)
        for key in ("subject", "expression")
    )
    _require_current_atlas(root, report)
    consent = report.get("consent")
    if consent is not None and not (isinstance(consent, str) and consent):
        raise FormatError(
            root / "report.json",
            field="consent",
            found=repr(consent)[:80],
            expected="the id of a consent record, or null",
        )
    head_from_world = read_head_pose(folder.head_pose)
    if not folder.atlas_path(SKIN).is_file():
        raise FormatError(
            folder.atlas_path(SKIN),
            found="no such file",
            expected="the map of what is skin, which keeps eyes and teeth out",
            hint="Run `lightstage-processing atlas` again; `lightstage-sim dataset` into a new "
            "folder where the person is simulated.",
        )
    maps = {name: folder.read_atlas(name) for name in (*CHANNELS, SKIN)}
    sizes = {name: image.shape[:2] for name, image in maps.items()}
    if len(set(sizes.values())) > 1:
        sizes_in_words = ", ".join(f"{name} {h} x {w}" for name, (h, w) in sizes.items())
        raise DatasetError(
            root / "atlas",
            found=f"maps of different size: {sizes_in_words}",
            expected="one size",
            hint="Make the atlas again with one --atlas-rows.",
        )
    skin = maps.pop(SKIN) > 0.5
    maps["confidence"] = np.where(skin, maps["confidence"], 0)
    maps = {name: image.reshape(*image.shape[:2], -1) for name, image in maps.items()}
    # Single precision: coordinates are under a metre, so this rounds by less than 1e-4 mm.
    pose = head_from_world.astype(np.float32)
    rotation, translation = pose[:, :3], pose[:, 3]
    surface = (maps["position"] != 0).any(axis=2, keepdims=True)
    maps["position"] = np.where(surface, maps["position"] @ rotation.T + translation, 0)
    for name in NORMALS:
        maps[name] = maps[name] @ rotation.T
    rows, columns = maps["confidence"].shape[:2]
    entry = ScanEntry(
        subject=subject,
        expression=expression,
        rows=rows,
        columns=columns,
        sha256=scan_digest(folder),
        consent=consent,
        synthetic=report.get("synthetic") is True,
        sex=_sex(report.get("sex"), root / "report.json"),
        age=_age(report.get("age_years"), root / "report.json"),
    )
    return entry, maps


def age_band(years: float) -> str:
    """The band of an age."""
    return next((name for name, end in AGE_BANDS.items() if years < end), OLDEST)


def _sex(value: Any, where: Path) -> str | None:
    """A person's sex by a report; None where it does not state it."""
    if value is not None and value not in SEXES:
        raise FormatError(
            where,
            field="sex",
            found=ascii(value)[:80],
            expected=f"one of {', '.join(SEXES)}, or null",
        )
    return value


def _age(value: Any, where: Path) -> str | None:
    """The band of the age in a report; None where it has none."""
    if value is None:
        return None
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not number or not 0 <= value <= OLDEST_YEARS:
        raise FormatError(
            where,
            field="age_years",
            found=ascii(value)[:80],
            expected=f"years from 0 to {OLDEST_YEARS}, or null",
        )
    return age_band(value)


def scan_digest(folder: ProcessedFolder) -> str:
    """SHA-256 of the files that a scan is made of; FileNotFoundError where one is missing."""
    files = [folder.head_pose, *(folder.atlas_path(name) for name in (*CHANNELS, SKIN))]
    return hashlib.sha256("".join(map(sha256_file, files)).encode()).hexdigest()


def _require_processed(root: Path) -> None:
    """Name what is there instead of a processed folder with an atlas."""
    found, hint = "", ""
    if not root.exists():
        found = "no such folder"
    elif not root.is_dir():
        found = "a file"
    elif ProcessedFolder(root).true_landmarks.is_file():
        found = "the truth of a simulated session, which no photograph shows"
        hint = (
            "Run `lightstage-processing run SESSION --out OUT` on the session itself, and name "
            "OUT. Simulated people to train on are made by `lightstage-sim dataset --maps-only`."
        )
    elif (root / "atlas").is_dir():
        return
    elif (root / "session.json").is_file() or (root / "journal.jsonl").is_file():
        found = "a session, photographs alone"
        hint = "Run `lightstage-processing run SESSION --out OUT` first, and name OUT."
    elif (root / "dataset.json").is_file():
        found = "a dataset"
        hint = "Name the processed folders that it was made of."
    elif (root / "report.json").is_file():
        found = "a processed folder without an atlas"
        hint = "Run `lightstage-processing atlas SESSION --out OUT` first."
    elif holds_scans(root):
        found = "a folder of processed folders"
        hint = f"Name those in it: {root}/*"
    else:
        found = "a folder of something else"
    raise DatasetError(root, found=found, expected="a processed folder with atlas/", hint=hint)


def _require_current_atlas(root: Path, report: dict[str, Any]) -> None:
    """Refuse a folder whose report may be of another person than its atlas shows.

    A folder that no stage wrote, such as a simulated person's, has neither a record of the stages
    nor their report.
    """
    if not of_stages(report) and not (root / "stages.json").exists():
        return
    session = report.get("session")
    reported = MadeFrom(session if isinstance(session, str) else None, str(report.get("subject")))
    made_from = read_made_from(root)
    again = "Run `lightstage-processing run SESSION --out OUT` with the session it is of."
    if made_from is None or reported.session is None:
        raise DatasetError(
            root,
            found="no record of the session that its maps were made from",
            expected="one in stages.json and report.json",
            hint=again,
        )
    if made_from != reported:
        raise DatasetError(
            root / "report.json",
            found=str(reported),
            expected=f"{made_from}, as stages.json has it",
            hint=again,
        )
    if "atlas" not in read_records(root):
        raise DatasetError(
            root / "atlas",
            found="an atlas that is older than the stages before it",
            expected="one made after them",
            hint="Run `lightstage-processing run SESSION --out OUT` with the same --config: it "
            "makes again what is out of date.",
        )


def holds_scans(folder: Path) -> bool:
    """True where a folder's own folders are processed ones, as `lightstage-sim dataset` leaves."""
    return any(folder.glob("*/atlas"))


def read_head_pose(path: Path) -> np.ndarray:
    """head_from_world.json as (3, 4) float64.

    Raises:
        FormatError: missing, of a newer version, or not rigid.
    """
    value = read_json(path)
    if isinstance(value, dict) and "schema" in value:  # earlier truths have none
        check_schema(path, value, HEAD_SCHEMA)
    found = value.get("head_from_world") if isinstance(value, dict) else None
    try:
        pose = array_of(found, 3, 4)
        turn = np.where(np.abs(pose[:, :3]) <= 1.001, pose[:, :3], 0.0)  # else no rotation
        rigid = np.allclose(turn @ turn.T, np.eye(3), atol=1e-4)
        rigid = bool(rigid and np.linalg.det(turn) > 0)
    except ValueError:
        rigid = False
    if not rigid:
        raise FormatError(
            path, field="head_from_world", found=repr(found)[:80], expected="a rigid 3 x 4"
        )
    return pose
