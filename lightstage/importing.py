"""A session from photographs taken elsewhere: FOLDER/PATTERN/CAMERA.EXT."""

from __future__ import annotations

import os
import re
import secrets
import shutil
from collections.abc import Sequence
from pathlib import Path

from lightstage.cameras.camera import CardFile
from lightstage.commands import ProgressCallback, quiet
from lightstage.errors import FormatError, LightstageError, PatternError, one_error
from lightstage.findings import Finding
from lightstage.formats.exr import read_exr
from lightstage.formats.files import fsync_path, sha256_file
from lightstage.formats.landmarks import read_points_px, write_points_px
from lightstage.patterns import SEQUENCES, pattern_levels
from lightstage.photograph import identify_file
from lightstage.rig import Rig
from lightstage.session import (
    Carried,
    SessionPlan,
    SessionWriter,
    check_consent,
    check_pseudonym,
    require_new,
)


def find_photographs(
    folder: Path, rig: Rig, cameras: Sequence[str] | None = None
) -> dict[str, dict[str, Path]]:
    """Photographs of a folder: pattern to camera to file, patterns in a sequence's usual order.

    Args:
        folder: holds PATTERN/CAMERA.EXT, or frames/PATTERN/CAMERA.EXT.
        rig: whose cameras and lights the names mean.
        cameras: ids, where the rig's cameras are not known yet.

    Raises:
        FormatError: a session's folder.
        FormatError, PatternError: every unknown pattern or camera, doubled or missing photograph,
            in one message.
    """
    problems: list[LightstageError] = []
    top = _top(folder)
    ids = [camera.id for camera in rig.cameras] if cameras is None else list(cameras)
    found: dict[str, dict[str, Path]] = {}
    for place in sorted(path for path in top.iterdir() if path.is_dir()):
        try:
            pattern_levels(place.name, rig)
        except PatternError as error:
            problems.append(error)
            continue
        here = found.setdefault(place.name, {})
        for file in sorted(path for path in place.iterdir() if not path.name.startswith(".")):
            if file.stem not in ids:
                problems.append(
                    FormatError(file, found="no camera of the rig", expected=", ".join(ids))
                )
            elif file.stem in here:
                problems.append(
                    FormatError(file, found="a second photograph", expected="one a camera")
                )
            else:
                here[file.stem] = file
        problems += [
            FormatError(place / camera, found="no photograph", expected="one of each camera")
            for camera in ids
            if camera not in here
        ]
    if not found and not problems:
        problems.append(
            FormatError(folder, found="no pattern's folder", expected="such as full/cam0.dng")
        )
    if problems:
        raise one_error(problems)
    usual = [name for names in SEQUENCES.values() for name in names]
    order = sorted(
        found, key=lambda name: (name not in usual, usual.index(name) if name in usual else 0, name)
    )
    return {name: found[name] for name in order}


def named_cameras(folder: Path) -> list[str]:
    """Cameras that a folder's photographs are named after, in the order of their numbers.

    Raises:
        FormatError: no such folder, or a session's.
    """
    names = {
        file.stem
        for place in _top(folder).iterdir()
        if place.is_dir()
        for file in place.iterdir()
        if not file.name.startswith(".")
    }
    return sorted(names, key=lambda name: (re.sub(r"\d+", _padded, name), name))


def brightest_pattern(patterns: Sequence[str], rig: Rig) -> str:
    """The pattern that lights most: that in which cameras are looked for."""
    return max(patterns, key=lambda name: float(pattern_levels(name, rig).sum()))


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
            "it, and `lightstage capture --resume` goes on with one that is not finished. To make "
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
) -> int:
    """Make a session of photographs taken elsewhere; all of it appears at once, or nothing.

    Args:
        folder: see find_photographs.
        rig: where lights and cameras stood.
        out: the session's folder, new.
        subject: pseudonym.
        expression: such as ``neutral``.
        calibration: as read by session.read_calibration.
        landmarks: landmarks.json, to be kept with the session.
        progress: called with photographs kept and wanted.
        consent: id of the record of the person's consent.
        findings: of whoever looked before, for the journal.

    Returns:
        How many photographs.

    Raises:
        FormatError: every photograph that is none, is truncated or has NaN, in one message.
        CaptureError: `out` holds something.
    """
    check_pseudonym(subject, "subject")
    check_pseudonym(expression, "expression")
    if consent is not None:
        check_consent(consent)
    require_new(out)
    marks = None if landmarks is None else read_points_px(landmarks)
    found = find_photographs(folder, rig)
    total = sum(len(files) for files in found.values())
    beside = out.with_name(f".{out.name}.{secrets.token_hex(4)}")
    try:
        plan = SessionPlan(tuple(found), subject, expression, consent=consent)
        own = calibration or Carried()
        writer = SessionWriter.new(
            beside, rig, plan, facts={"imported": True}, colour=own.colour, beside=own.beside
        )
        try:
            for finding in findings:
                writer.finding(finding)
            _keep_all(found, writer, total, progress)
            writer.finish()
            writer.end()
        finally:
            writer.close()
        if marks is not None:
            write_points_px(marks, beside / "landmarks.json")
        os.replace(beside, out)
        fsync_path(out.parent)
    finally:
        shutil.rmtree(beside, ignore_errors=True)
    return total


def _keep_all(
    found: dict[str, dict[str, Path]], writer: SessionWriter, total: int, progress: ProgressCallback
) -> None:
    problems: list[LightstageError] = []
    done = 0
    for pattern, files in found.items():
        for camera, path in files.items():
            try:
                if identify_file(path).encoding == "linear":
                    read_exr(path, finite=True)
                incoming = writer.incoming(pattern, camera, 1)
                shutil.copyfile(path, incoming)
                file = CardFile(path.name, path.stat().st_size)
                writer.keep(pattern, camera, 1, incoming, file, sha256_file(path))
            except FormatError as error:
                problems.append(error)
            done += 1
            progress(done, total)
        if not problems:
            writer.shot(pattern)
    if problems:
        raise one_error(problems)
