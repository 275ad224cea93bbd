"""A session from photographs taken elsewhere: FOLDER/PATTERN/CAMERA.EXT, or FOLDER/CAMERA.EXT."""

from __future__ import annotations

import dataclasses
import os
import re
import secrets
import shutil
import unicodedata
from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np

from lightstage.cameras.camera import CardFile
from lightstage.commands import ProgressCallback, quiet
from lightstage.errors import (
    FormatError,
    LightstageError,
    PatternError,
    alike_as_one,
    one_error,
)
from lightstage.exif import read_exif
from lightstage.findings import Finding
from lightstage.formats.exr import private_attributes, write_exr
from lightstage.formats.files import fsync_path, sha256_file
from lightstage.formats.landmarks import LANDMARKS, read_clicked, write_points_px
from lightstage.imported_light import Exposures, developed_findings
from lightstage.opening import Opened, open_photograph
from lightstage.patterns import SEQUENCES, drive_levels, pattern_levels
from lightstage.rig import Rig
from lightstage.session import (
    Carried,
    SessionPlan,
    SessionWriter,
    check_consent,
    check_pseudonym,
    require_new,
)
from lightstage.session.plan import FILE_NAME

ONE_LIGHT = "full"
"""Pattern of photographs that are in no pattern's folder."""


@dataclasses.dataclass(frozen=True)
class Imported:
    """What became a session: how many photographs, and what the operator should know of them."""

    frames: int
    findings: tuple[Finding, ...]


def find_photographs(
    folder: Path, rig: Rig, cameras: Sequence[str] | None = None, one_light: str | None = None
) -> dict[str, dict[str, Path]]:
    """Photographs of a folder: pattern to camera to file, patterns in a sequence's usual order.

    Args:
        folder: holds PATTERN/CAMERA.EXT, or frames/PATTERN/CAMERA.EXT, or CAMERA.EXT alone.
        rig: whose cameras and lights the names mean.
        cameras: ids, where the rig's cameras are not known yet.
        one_light: pattern of photographs that are in the folder itself; None where they are in
            patterns' folders, or under `ONE_LIGHT` where there is none of these.

    Raises:
        FormatError: a session's folder.
        FormatError, PatternError: every unknown pattern or camera, doubled or missing photograph,
            in one message.
    """
    problems: list[LightstageError] = []
    misnamed: list[LightstageError] = []
    top = _top(folder)
    ids = [camera.id for camera in rig.cameras] if cameras is None else list(cameras)
    found: dict[str, dict[str, Path]] = {}
    for pattern, place in _places(top, one_light).items():
        try:
            pattern_levels(pattern, rig)
        except PatternError as error:
            problems.append(error)
            continue
        here = found.setdefault(pattern, {})
        for file in _files(place):
            name = _camera_name(file)
            if name not in ids:
                misnamed.append(
                    FormatError(file, found="no camera of the rig", expected=", ".join(ids))
                )
            elif name in here:
                misnamed.append(
                    FormatError(file, found="a second photograph", expected="one a camera")
                )
            else:
                here[name] = file
        problems += [
            FormatError(place / camera, found="no photograph", expected="one of each camera")
            for camera in ids
            if camera not in here
        ]
    problems = [*alike_as_one(misnamed, "file"), *problems]
    if not found and not problems:
        problems.append(
            FormatError(
                folder, found="no photographs", expected="such as full/cam0.dng, or cam0.dng"
            )
        )
    if problems:
        raise one_error(problems)
    usual = [name for names in SEQUENCES.values() for name in names]
    order = sorted(
        found, key=lambda name: (name not in usual, usual.index(name) if name in usual else 0, name)
    )
    return {name: found[name] for name in order}


def named_cameras(folder: Path, one_light: str | None = None) -> list[str]:
    """Cameras that a folder's photographs are named after, in the order of their numbers.

    Raises:
        FormatError: no such folder, or a session's; names that no camera of a session can have.
    """
    places = _places(_top(folder), one_light)
    files = {_camera_name(file): file for place in places.values() for file in _files(place)}
    problems: list[LightstageError] = [
        FormatError(
            file,
            found=f"a camera called {name!r}",
            expected="letters, digits and _ @ + . -",
            hint="Rename its files.",
        )
        for name, file in files.items()
        if not FILE_NAME.fullmatch(name)
    ]
    if problems:
        raise one_error(problems)
    names = set(files)
    return sorted(names, key=lambda name: (re.sub(r"\d+", _padded, name), name))


def brightest_pattern(patterns: Sequence[str], rig: Rig) -> str:
    """The pattern that lights most: that in which cameras are searched for."""
    return max(patterns, key=lambda name: float(pattern_levels(name, rig).sum()))


def _places(top: Path, one_light: str | None) -> dict[str, Path]:
    """Pattern to the folder that holds its photographs."""
    folders = sorted(p for p in top.iterdir() if p.is_dir() and not p.name.startswith("."))
    if one_light is not None or not folders:
        return {one_light or ONE_LIGHT: top} if _files(top) else {}
    return {_composed(place.name): place for place in folders}


def _files(place: Path) -> list[Path]:
    return sorted(p for p in place.iterdir() if p.is_file() and not p.name.startswith("."))


def _camera_name(file: Path) -> str:
    return _composed(file.stem)


def _composed(name: str) -> str:
    """A name with its accents as one character each: disks and programs write both forms."""
    return unicodedata.normalize("NFC", name)


def _padded(digits: re.Match[str]) -> str:
    return digits[0].zfill(12)


def _top(folder: Path) -> Path:
    """The folder that holds the patterns' folders; FormatError where there is none."""
    if (folder / "session.json").is_file() or (folder / "journal.jsonl").is_file():
        raise FormatError(
            folder,
            found="a session",
            expected="a folder of photographs, PATTERN/CAMERA.EXT in it",
            hint="A session needs no import: `lightstage-processing run SESSION --out OUT` takes "
            "it, and `lightstage capture --resume` resumes one that is not finished. To make "
            "another session of its photographs, without its consent, calibration and levels, "
            f"import {folder / 'frames'}.",
        )
    top = folder / "frames" if (folder / "frames").is_dir() else folder
    if not top.is_dir():
        raise FormatError(folder, found="no such folder", expected="PATTERN/CAMERA.EXT in it")
    return top


def import_session(
    folder: Path,
    rig: Rig,
    out: Path,
    subject: str,
    expression: str,
    calibration: Carried | None = None,
    landmarks: Path | None = None,
    progress: ProgressCallback = quiet,
    consent: str | None = None,
    findings: Sequence[Finding] = (),
    one_light: str | None = None,
    emitters: Collection[str] = (),
) -> Imported:
    """Make a session of photographs taken elsewhere; all of it appears at once, or nothing.

    Args:
        folder: see find_photographs.
        rig: where lamps and cameras were.
        out: the session's folder, new.
        subject: pseudonym.
        expression: such as ``neutral``.
        calibration: as read by session.read_calibration.
        landmarks: landmarks.json, to be kept with the session.
        progress: called with photographs kept and wanted.
        consent: id of the record of the person's consent.
        findings: of whoever looked before, for the journal.
        one_light: see find_photographs.
        emitters: colours of the lights that were driven; none named: all. Where some are, the
            session records each lamp's level: 0 or that of the pattern's name.

    Returns:
        How many photographs, and what should be known of them.

    Raises:
        FormatError: every photograph that cannot be opened (`opening`), has not its camera's size,
            or has a field that may name a person or a place, in one message.
        CaptureError: `out` holds something.
        PatternError: a colour of no light, or a single light of another colour.
    """
    check_pseudonym(subject, "subject")
    check_pseudonym(expression, "expression")
    if consent is not None:
        check_consent(consent)
    require_new(out)
    marks = None if landmarks is None else read_clicked(landmarks, rig)
    found = find_photographs(folder, rig, one_light=one_light)
    total = sum(len(files) for files in found.values())
    levels = {p: drive_levels(p, rig, "on-off", emitters=emitters) for p in found if emitters}
    place = out.resolve()  # of a link to an empty folder, the folder
    beside = place.with_name(f".{place.name}.{secrets.token_hex(4)}")
    try:
        plan = SessionPlan(tuple(found), subject, expression, consent=consent)
        own = calibration or Carried()
        writer = SessionWriter.new(
            beside, rig, plan, facts={"imported": True}, colour=own.colour, beside=own.beside
        )
        try:
            for finding in findings:
                writer.finding(finding)
            more = _keep_all(found, levels, rig, writer, total, progress)
            for finding in more:
                writer.finding(finding)
            writer.finish()
            writer.end()
        finally:
            writer.close()
        if marks is not None:
            write_points_px(marks, beside / LANDMARKS)
        os.replace(beside, place)
        fsync_path(place.parent)
    finally:
        shutil.rmtree(beside, ignore_errors=True)
    return Imported(total, tuple(more))


def _keep_all(
    found: dict[str, dict[str, Path]],
    levels: dict[str, np.ndarray],
    rig: Rig,
    writer: SessionWriter,
    total: int,
    progress: ProgressCallback,
) -> list[Finding]:
    problems: list[LightstageError] = []
    done = 0
    exposures = Exposures()
    encodings: dict[str, tuple[str, Path]] = {}
    for pattern, files in found.items():
        for camera, path in files.items():
            try:
                opened = open_photograph(path)
                _require_size(path, opened, rig, camera)
                _require_nameless(path, opened)
                first = encodings.setdefault(camera, (opened.encoding, path))
                if first[0] != opened.encoding:
                    raise FormatError(
                        path,
                        found=f"a {opened.encoding} photograph",
                        expected=f"one that is {first[0]}, as {first[1]} is: their light is on "
                        "scales of their own",
                    )
                incoming = writer.incoming(pattern, camera, 1)
                if opened.developed is None:
                    shutil.copyfile(path, incoming)
                else:
                    factor = exposures.factor(pattern, camera, path, opened.developed)
                    rgb = opened.developed.rgb * factor
                    write_exr(incoming, rgb, half=opened.developed.bits == 8)
                file = CardFile(path.name, incoming.stat().st_size)
                writer.keep(pattern, camera, 1, incoming, file, sha256_file(incoming))
            except FormatError as error:
                problems.append(error)
            done += 1
            progress(done, total)
        if not problems:
            driven = {"levels": levels[pattern].tolist()} if pattern in levels else {}
            writer.shot(pattern, **driven)
    if problems:
        raise one_error(alike_as_one(problems, "photograph"))
    return developed_findings(exposures)


def _require_nameless(path: Path, opened: Opened) -> None:
    """Refuse a photograph that would bring the name of a person or a place into the session.

    Developed pictures are written anew, without any such field.
    """
    if opened.encoding == "raw":
        private = read_exif(path).private
    else:
        private = () if opened.developed is not None else private_attributes(path)
    if private:
        raise FormatError(
            path,
            field="headers",
            found=f"{', '.join(private)}, not empty",
            expected="nothing that may name a person or a place",
            hint="Clear these fields in a copy, as ExifTool does for RAW (exiftool -Artist= "
            "-Copyright= -gps:all= FILE), and import the copy.",
        )


def _require_size(path: Path, opened: Opened, rig: Rig, camera_id: str) -> None:
    """Refuse a photograph of another size than rig.json has for its camera."""
    camera = rig.camera(camera_id)
    width, height = opened.size_px
    if (width, height) == (camera.width_px, camera.height_px):
        return
    turned = (height, width) == (camera.width_px, camera.height_px)
    raise FormatError(
        path,
        found=f"{width} x {height} pixels",
        expected=f"{camera.width_px} x {camera.height_px}, as the rig has its camera",
        hint="It is on its side: keep the camera's own mark of orientation."
        if turned
        else "Neither crop nor scale photographs: the rig's lens and pose hold for whole ones.",
    )
