"""What changed between two checks of a camera: its settings must not; its battery does."""

from __future__ import annotations

import dataclasses

from lightstage.cameras.camera import CameraDevice, Summary
from lightstage.errors import LightstageError
from lightstage.findings import Finding
from lightstage.preflight.privacy import EMPTY, FIELDS, is_empty
from lightstage.preflight.values import same_value

FIXED = (
    *("serial", "model", "firmware", "mode", "iso", "shutter", "aperture"),
    *("white_balance", "image_format", "focus"),
)
"""What decides how a photograph comes out; a change blocks."""
BY_THEMSELVES = ("battery_percent", "card_free_bytes", "clock_offset_s")
"""What changes while a camera works; preflight has limits for them."""


def drift(before: Summary, now: Summary, camera_id: str = "") -> list[Finding]:
    """What is not as it was: before and after a shot, or when a capture is resumed.

    Values compare by meaning. A field that can no longer be read blocks like one that changed; one
    that can be read only now is noted. Battery, card space and clock change by themselves. Owner,
    artist, copyright and place block when they are no longer empty, and their text is not shown.

    Args:
        before: the camera's earlier summary.
        now: its present one.
        camera_id: for the message.
    """
    where = f"camera {camera_id}" if camera_id else "camera"
    findings = []
    for name in FIXED:
        old, new = getattr(before, name), getattr(now, name)
        if old is None and new is None:
            continue
        place, camera = f"{where}, {name}", camera_id or None
        if old is None:
            found = f"{new}, which it did not report before"
            findings.append(Finding("note", "told-now", place, found, "as before", camera=camera))
        elif new is None or not same_value(name, old, new):
            found = "that it no longer reports" if new is None else new
            was = f"{old}, as before"
            findings.append(
                Finding("refuse", "drift", place, found, was, _hint(name, old), camera=camera)
            )
    for name in FIELDS:
        old, new = getattr(before, name), getattr(now, name)
        if new is not None and not is_empty(name, new) and (old is None or is_empty(name, old)):
            findings.append(
                Finding(
                    "refuse",
                    "drift",
                    f"{where}, {name}",
                    "no longer empty",
                    "empty, as before",
                    "Clear it in the camera's menu.",
                    camera=camera_id or None,
                )
            )
    return findings


OF_THE_BODY = ("serial", "model", "firmware")
"""What no command can set: where it changed, another body or other firmware is there."""


def set_back(camera: CameraDevice, before: Summary) -> tuple[list[Finding], list[str]]:
    """Give a camera the settings that it had, where they drifted.

    Nothing is changed on another body than that of `before`.

    Args:
        camera: opened.
        before: its earlier summary.

    Returns:
        One finding ``set-back`` for each setting that was set, and what could not be set, in words.

    Raises:
        DeviceError: the camera cannot report its settings now.
    """
    drifted = {
        finding.where.rpartition(", ")[2]: finding
        for finding in drift(before, camera.summary(), camera.id)
        if finding.code == "drift"
    }
    done, failed = [], []
    for name, finding in drifted.items():
        if drifted.keys() & set(OF_THE_BODY):
            break
        # A field that names somebody was empty, or not known, before.
        try:
            camera.change(name, getattr(before, name) or EMPTY.get(name, ""))
        except LightstageError as error:
            failed.append(str(error))
            continue
        hint = "Somebody or something changed it; it was set back."
        done.append(dataclasses.replace(finding, severity="warn", code="set-back", hint=hint))
    return done, failed


def _hint(name: str, old: str) -> str:
    if name in ("serial", "model"):
        return "Another camera is connected: connect the one that was there."
    if name == "firmware":
        return "Its firmware was changed: begin a new session."
    return f"Set it back to {old}; photographs since then do not compare with those before."
