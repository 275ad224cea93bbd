"""Whether cameras are set as they must be: alike, by hand, and as the cameras file expects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from lightstage.cameras.binding import CamerasFile
from lightstage.cameras.camera import VERIFIABLE, Summary
from lightstage.cameras.identity import IDENTITY
from lightstage.findings import Finding
from lightstage.preflight.config import PreflightConfig
from lightstage.preflight.values import (
    exposure_s,
    format_kinds,
    is_auto_balance,
    is_manual,
    is_manual_focus,
    iso_number,
    same_value,
)

EXPECTABLE = (
    *("mode", "iso", "shutter", "aperture", "white_balance", "image_format", "focus", "firmware"),
)
"""What ``[expect]`` in a cameras file may hold."""
ALIKE = ("iso", "shutter", "aperture", "white_balance")
"""What must be equal over all cameras unless the cameras file expects something."""
FILE = "the cameras file"


def settings_findings(
    summaries: Mapping[str, Summary], file: CamerasFile, config: PreflightConfig
) -> list[Finding]:
    """Everything about the cameras that keeps lights off, camera by camera.

    Args:
        summaries: by camera id.
        file: what is expected, and what may stay unverified.
        config: limits.
    """
    findings = _unknown_expectations(file)
    for camera_id, summary in summaries.items():
        expected = expected_of(file, camera_id)
        findings += _not_readable(camera_id, summary, file.allow_unverifiable)
        findings += _as_expected(camera_id, summary, expected)
        findings += _by_hand(camera_id, summary, expected)
        findings += _power_and_clock(camera_id, summary, config)
    for name in ALIKE:
        findings += _alike(name, summaries, file)
    return findings


def expected_of(file: CamerasFile, camera_id: str) -> dict[str, str]:
    """What a camera must report: its own table over that of all cameras."""
    entry = file.cameras.get(camera_id)
    return {**file.expect, **(entry.expect if entry is not None else {})}


def _unknown_expectations(file: CamerasFile) -> list[Finding]:
    tables = {"[expect]": file.expect}
    tables |= {f"[cameras.{camera_id}.expect]": e.expect for camera_id, e in file.cameras.items()}
    return [
        Finding(
            "refuse",
            "expect",
            f"{FILE}, {where}",
            repr(name),
            f"one of {', '.join(EXPECTABLE)}",
        )
        for where, table in tables.items()
        for name in table
        if name not in EXPECTABLE
    ]


def _not_readable(camera_id: str, summary: Summary, allowed: Sequence[str]) -> list[Finding]:
    names = [
        name
        for name in VERIFIABLE
        if name not in (*IDENTITY, *allowed) and getattr(summary, name) is None
    ]
    if not names:
        return []
    return [
        Finding(
            "refuse",
            "untold",
            f"camera {camera_id}, {', '.join(names)}",
            "not verifiable: the camera cannot report it",
            "a camera that reports it, or the names in allow_unverifiable",
            f"Allow them in {FILE} if you made sure by eye.",
            camera=camera_id,
        )
    ]


def _as_expected(camera_id: str, summary: Summary, expected: Mapping[str, str]) -> list[Finding]:
    findings = []
    for name, wanted in expected.items():
        found = getattr(summary, name, None) if name in EXPECTABLE else None
        if found is None or same_value(name, found, wanted):
            continue
        if name == "image_format" and {"raw"} <= format_kinds(wanted) <= format_kinds(found):
            continue  # a picture more, of which `_by_hand` warns
        findings.append(
            _finding(camera_id, name, found, f"{wanted} ({FILE})", "Set it on the camera.")
        )
    return findings


def _by_hand(camera_id: str, summary: Summary, expected: Mapping[str, str]) -> list[Finding]:
    """What must hold for every capture, where nothing else is expected."""
    findings = []

    def refuse(name: str, wanted: str, hint: str) -> None:
        if name not in expected:
            found = str(getattr(summary, name))
            findings.append(_finding(camera_id, name, found, wanted, hint))

    if summary.mode is not None and not is_manual(summary.mode):
        refuse("mode", "Manual", "Turn its mode dial to M.")
    if summary.focus is not None and not is_manual_focus(summary.focus):
        refuse("focus", "Manual", "Switch the lens or body to manual focus.")
    if summary.white_balance is not None and is_auto_balance(summary.white_balance):
        refuse("white_balance", "a fixed one", "Set one preset on all cameras.")
    if summary.iso is not None and iso_number(summary.iso) is None:
        refuse("iso", "a number", "Switch automatic ISO off.")
    if summary.shutter is not None and exposure_s(summary.shutter) is None:
        refuse("shutter", "a time", "Set a time on the camera.")
    if summary.image_format is not None:
        kinds = format_kinds(summary.image_format)
        if "raw" not in kinds:
            hint = "Set the picture quality to RAW" + (
                " of full size." if "small raw" in kinds else "."
            )
            refuse("image_format", "RAW", hint)
        elif len(kinds) > 1:
            findings.append(
                Finding(
                    "warn",
                    "two-files",
                    f"camera {camera_id}, image_format",
                    summary.image_format,
                    "RAW alone",
                    "Only the RAW is kept; the other file costs time and card space.",
                    camera=camera_id,
                )
            )
    return findings


def _power_and_clock(camera_id: str, summary: Summary, config: PreflightConfig) -> list[Finding]:
    findings = []
    battery, offset_s = summary.battery_percent, summary.clock_offset_s
    if battery is not None and not battery >= config.min_battery_percent:
        findings.append(
            _finding(
                camera_id,
                "battery",
                f"{battery:g} %",
                f"at least {config.min_battery_percent:g} % (min_battery_percent)",
                "Change its battery, or use a mains adapter.",
            )
        )
    if offset_s is not None and not abs(offset_s) <= config.max_clock_offset_s:
        side = "ahead of" if offset_s > 0 else "behind"
        findings.append(
            _finding(
                camera_id,
                "clock",
                f"{abs(offset_s):.0f} s {side} this computer's",
                f"at most {config.max_clock_offset_s:g} s (max_clock_offset_s)",
                "Set the camera's date and time (in UTC or as this computer shows it).",
            )
        )
    return findings


def _alike(name: str, summaries: Mapping[str, Summary], file: CamerasFile) -> list[Finding]:
    """One finding where cameras of which nothing is expected differ."""
    groups: list[tuple[str, list[str]]] = []
    for camera_id, summary in summaries.items():
        found = getattr(summary, name)
        if found is None or name in expected_of(file, camera_id):
            continue
        for text, ids in groups:
            if same_value(name, text, found):
                ids.append(camera_id)
                break
        else:
            groups.append((found, [camera_id]))
    if len(groups) < 2:
        return []
    groups.sort(key=lambda group: -len(group[1]))
    return [
        Finding(
            "refuse",
            "unlike",
            f"cameras, {name}",
            "; ".join(f"{text} ({', '.join(ids)})" for text, ids in groups),
            "the same on all of them",
            f"Set it alike, or state what each shall have in {FILE} ([cameras.ID.expect]).",
        )
    ]


def _finding(camera_id: str, name: str, found: str, expected: str, hint: str) -> Finding:
    where = f"camera {camera_id}, {name}"
    return Finding("refuse", name, where, found, expected, hint, camera=camera_id)
