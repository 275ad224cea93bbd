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
"""Makers whose files have the number that the body tells; Fujifilm's have another one."""
CLOCK_GRAIN_S = 2.0
"""A file tells whole seconds, and some cameras the moment before the shutter."""
ZONE_S = 900.0
"""Zones differ by quarters of an hour."""


def photograph_findings(
    path: Path,
    camera: Camera,
    told: Summary,
    exposed_utc: datetime.datetime | None = None,
    max_clock_offset_s: float = 60.0,
) -> list[Finding]:
    """Compare what a photograph's headers say with the rig and with what the camera told.

    What the file does not say, and what the camera did not tell, is passed over: headers of CR3 and
    RAF files say the same as those of TIFF-like ones, OpenEXR pictures say nothing.

    Args:
        path: of the photograph.
        camera: of the rig, whose photograph it is taken for.
        told: what the camera told of its settings.
        exposed_utc: when it was exposed by this computer's clock; without it the time in the file
            is not looked at.
        max_clock_offset_s: by which the time in the file may be off; whole quarters of an hour are
            a zone where the file tells none.

    Returns:
        ``refuse`` where another camera took it or a person or place is in it; ``retake`` where a
        setting drifted; ``warn`` where its time is off, or where the number in it is another one
        but the body told the right one and the maker is none of SAME_NUMBER.

    Raises:
        CaptureError: the disk does not give the file.
    """
    with disk_errors(path):
        found = read_exif(path)
    findings: list[Finding] = []

    def finding(
        severity: Severity, code: str, name: str, said: str, wanted: str, hint: str
    ) -> None:
        findings.append(
            Finding(
                severity,
                code,
                f"{path.name} by {camera.id}, {name}",
                said,
                wanted,
                hint,
                camera=camera.id,
            )
        )

    if found.serial is not None and not _same_serial(found.serial, camera.serial):
        # The body itself told the right number, and its maker may write another one into files.
        doubtful = told.serial is not None and not _writes_told_serial(found.make)
        finding(
            "warn" if doubtful else "refuse",
            "wrong-camera",
            "serial in the file",
            found.serial,
            f"{camera.serial} (rig.json)",
            "Compare a few of its files: does this maker write another number than the body tells?"
            if doubtful
            else "Another camera took it: check which cable goes to which camera.",
        )
    for name, said, wanted in _drifted(found, told):
        finding(
            "retake",
            "drift",
            f"{name} in the file",
            said,
            f"{wanted}, as the camera told",
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


def _drifted(found: Exif, told: Summary) -> list[tuple[str, str, str]]:
    """Name, what the file says and what the camera told, of each setting that differs."""
    differ = []
    iso = None if told.iso is None else iso_number(told.iso)
    if found.iso is not None and iso is not None and found.iso != _written(iso, found.iso):
        differ.append(("ISO", str(found.iso), str(told.iso)))
    time = None if told.shutter is None else exposure_s(told.shutter)
    if (
        found.exposure_s is not None
        and time is not None
        and not same_exposure(found.exposure_s, *time)
    ):
        differ.append(("shutter", f"{found.exposure_s:.6g} s", str(told.shutter)))
    stop = None if told.aperture is None else aperture_number(told.aperture)
    if found.f_number is not None and stop is not None and not same_aperture(found.f_number, stop):
        differ.append(("aperture", f"f/{found.f_number:g}", str(told.aperture)))
    return differ


def _writes_told_serial(make: str | None) -> bool:
    """Whether a maker's files have the number that its bodies tell through the cable."""
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
