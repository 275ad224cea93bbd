"""Whether a photograph is by the camera, and under the settings, that it is taken for."""

from __future__ import annotations

import datetime
from pathlib import Path

from lightstage.cameras.camera import Summary
from lightstage.exif import Exif, read_exif
from lightstage.findings import Finding, Severity
from lightstage.preflight.values import (
    aperture_number,
    exposure_s,
    iso_number,
    same_aperture,
    same_exposure,
)
from lightstage.rig import Camera
from lightstage.session.disk import disk_errors

SAME_NUMBER = ("nikon", "canon")
"""Makers whose files have the body's own number; Fujifilm's have another one."""
CLOCK_GRAIN_S = 2.0
"""A file has whole seconds, and some cameras the moment before the shutter."""
ZONE_S = 900.0
"""Zones differ by quarters of an hour."""


def photograph_findings(
    path: Path,
    camera: Camera,
    summary: Summary,
    exposed_utc: datetime.datetime | None = None,
    max_clock_offset_s: float = 60.0,
) -> list[Finding]:
    """Compare a photograph's headers with the rig and with the camera's summary.

    What the file does not have, and what the camera did not report, is skipped: headers of CR3 and
    RAF files have the same as those of TIFF-like ones, OpenEXR pictures have none.

    Args:
        path: of the photograph.
        camera: of the rig, whose photograph it is taken for.
        summary: the camera's settings.
        exposed_utc: when it was exposed by this computer's clock; without it the time in the file
            is not checked.
        max_clock_offset_s: by which the time in the file may be off; whole quarters of an hour are
            a zone where the file has none.

    Returns:
        ``refuse`` where another camera took it or a person or place is in it; ``retake`` where a
        setting drifted; ``warn`` where its time is off, or where the number in it is another one
        but the body reported the right one and the maker is none of SAME_NUMBER.

    Raises:
        CaptureError: the disk does not give the file.
    """
    with disk_errors(path):
        found = read_exif(path)
    findings: list[Finding] = []

    def finding(
        severity: Severity, code: str, name: str, text: str, wanted: str, hint: str
    ) -> None:
        findings.append(
            Finding(
                severity,
                code,
                f"{path.name} by {camera.id}, {name}",
                text,
                wanted,
                hint,
                camera=camera.id,
            )
        )

    if found.serial is not None and not _same_serial(found.serial, camera.serial):
        # The body itself reported the right number, and its maker may write another one into files.
        doubtful = summary.serial is not None and not _writes_serial(found.make)
        finding(
            "warn" if doubtful else "refuse",
            "wrong-camera",
            "serial in the file",
            found.serial,
            f"{camera.serial} (rig.json)",
            "Compare a few of its files: does this maker write another number than the body has?"
            if doubtful
            else "Another camera took it: check which cable goes to which camera.",
        )
    for name, text, wanted in _drifted(found, summary):
        finding(
            "retake",
            "drift",
            f"{name} in the file",
            text,
            f"{wanted}, as the camera reported",
            "Set it back on the camera and take this photograph again.",
        )
    if found.private:
        finding(
            "refuse",
            "privacy",
            "headers",
            f"{', '.join(found.private)}, not empty",
            "nothing that may name a person or a place",
            "Clear these fields in the camera's menu; a RAW is never rewritten, so take it again.",
        )
    if exposed_utc is not None and found.taken is not None:
        off_s = _clock_off_s(found.taken, exposed_utc)
        if abs(off_s) > max_clock_offset_s + CLOCK_GRAIN_S:
            finding(
                "warn",
                "clock",
                "time in the file",
                f"{found.taken.isoformat()}, {abs(off_s):.0f} s off",
                f"{exposed_utc.isoformat(timespec='seconds')}",
                "Is it an old picture? If not, set the camera's clock.",
            )
    return findings


def _drifted(found: Exif, summary: Summary) -> list[tuple[str, str, str]]:
    """Name, the file's value and the camera's, of each setting that differs."""
    differ = []
    iso = None if summary.iso is None else iso_number(summary.iso)
    if found.iso is not None and iso is not None and found.iso != _written(iso, found.iso):
        differ.append(("ISO", str(found.iso), str(summary.iso)))
    time = None if summary.shutter is None else exposure_s(summary.shutter)
    if (
        found.exposure_s is not None
        and time is not None
        and not same_exposure(found.exposure_s, *time)
    ):
        differ.append(("shutter", f"{found.exposure_s:.6g} s", str(summary.shutter)))
    stop = None if summary.aperture is None else aperture_number(summary.aperture)
    if found.f_number is not None and stop is not None and not same_aperture(found.f_number, stop):
        differ.append(("aperture", f"f/{found.f_number:g}", str(summary.aperture)))
    return differ


def _writes_serial(make: str | None) -> bool:
    """Whether a maker's files have the number that its bodies report through the cable."""
    return make is not None and make.casefold().startswith(SAME_NUMBER)


def _written(iso: float, found: int) -> float:
    """The number that a file has for an ISO: 65535 may stand for whatever is above it."""
    return min(iso, 65535) if found == 65535 else iso


def _same_serial(one: str, other: str) -> bool:
    """Some files fill the number with zeros in front."""
    return one == other or (one.lstrip("0") == other.lstrip("0") != "")


def _clock_off_s(taken: datetime.datetime, exposed_utc: datetime.datetime) -> float:
    if taken.tzinfo is not None:
        return (taken - exposed_utc).total_seconds()
    off_s = (taken - exposed_utc.astimezone(datetime.UTC).replace(tzinfo=None)).total_seconds()
    if abs(off_s) > 15 * 3600:
        return off_s  # no zone is so far away
    return off_s - round(off_s / ZONE_S) * ZONE_S
