"""A check of all devices without a capture: what each reports, and what would keep lights off."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from lightstage.cameras.binding import (
    CamerasFile,
    Moved,
    close_cameras,
    connect_problems,
    find_cameras,
)
from lightstage.cameras.camera import Summary
from lightstage.cameras.process import CameraProcess, detect_ports
from lightstage.capture.config import CaptureConfig
from lightstage.capture.stage import moved_finding
from lightstage.errors import LightstageError
from lightstage.findings import Finding
from lightstage.leds.controller import Hello
from lightstage.leds.opening import open_rig_leds, require_controllers
from lightstage.operator.plain import plain
from lightstage.preflight import Plan, device_findings, settings_findings
from lightstage.preflight.clock import computer_clock_findings
from lightstage.preflight.disk import card_findings, disk_findings, photograph_bytes
from lightstage.preflight.privacy import privacy_findings
from lightstage.preflight.pulses import pulse_findings
from lightstage.rig import Rig

SHOWN = ("iso", "shutter", "aperture", "white_balance", "image_format", "mode", "focus", "firmware")
"""Settings that are reported of each camera."""


@dataclasses.dataclass(frozen=True)
class CameraLook:
    """One camera of the rig.

    Attributes:
        id: the rig's name for it.
        serial: that it reports, else the rig's.
        answers: whether it does.
        port: where it is.
        model: maker and name.
        lens: what is mounted, where it reports it.
        battery_percent: charge.
        free_shots: photographs that still fit on its card, by the rig's pixels.
        settings: by name.
        differing: names of settings that are not as expected or not as the other cameras'.
    """

    id: str
    serial: str
    answers: bool
    port: str = ""
    model: str = ""
    lens: str = ""
    battery_percent: float | None = None
    free_shots: int | None = None
    settings: dict[str, str] = dataclasses.field(default_factory=dict)
    differing: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class Look:
    """All devices.

    Attributes:
        lights: what the LED device reported; None where it does not answer.
        acknowledged: whether it reports what is lit.
        cameras: in the rig's order.
        findings: as a capture's preflight has them; devices that do not answer are ``refuse``.
    """

    lights: Hello | None
    acknowledged: bool
    cameras: tuple[CameraLook, ...]
    findings: tuple[Finding, ...]

    @property
    def ready(self) -> bool:
        """Whether a capture could begin."""
        return not any(each.severity == "refuse" for each in self.findings)

    def facts(self) -> dict[str, Any]:
        """As JSON has it."""
        return {**dataclasses.asdict(self), "ready": self.ready}


def look_at_devices(
    rig: Rig, leds: str, file: CamerasFile, config: CaptureConfig, out: Path, plan: Plan
) -> Look:
    """Open lights and cameras, ask what they are, and let them go; nothing is lit or changed.

    Args:
        rig: what must be there.
        leds: the LED device's URL.
        file: where cameras are, and what is expected of them.
        config: deadlines and limits.
        out: a session's folder, for the disk and the clock.
        plan: what a capture would take.

    Raises:
        ConfigError: a malformed URL.
        RigError: URLs of other controllers than the rig's.
    """
    require_controllers(leds, rig)
    findings: list[Finding] = []
    cameras, summaries, found = _look_at_cameras(rig, file, config)
    findings += found
    hello, acknowledged, pulse_hz = None, False, None
    try:
        with open_rig_leds(leds, rig) as device:
            hello, acknowledged = device.hello, device.acknowledged
            pulse_hz = device.pulse_hz
            findings += device_findings(rig, summaries, file, device, config.preflight)
    except LightstageError as error:
        findings.append(_silent(error, "LED device"))
        # What the cameras' settings lack is reported all the same: one walk to the stage.
        findings += settings_findings(summaries, file, config.preflight)
        findings += privacy_findings(summaries)
    shutters = {camera_id: summary.shutter for camera_id, summary in summaries.items()}
    if hello is not None:
        findings += pulse_findings(shutters, pulse_hz, plan.lowest_level, config.preflight)
    findings += card_findings(rig, summaries, plan, config.preflight)
    findings += disk_findings(rig, out, plan, config.preflight)
    findings += computer_clock_findings(out, config.preflight)
    looks = [_camera(rig, each, summaries.get(each.id), plan, findings) for each in cameras]
    seen = {look.id for look in looks}
    looks += [CameraLook(c.id, c.serial, False) for c in rig.cameras if c.id not in seen]
    order = [camera.id for camera in rig.cameras]
    looks.sort(key=lambda look: order.index(look.id))
    return Look(hello, acknowledged, tuple(looks), tuple(findings))


def _look_at_cameras(
    rig: Rig, file: CamerasFile, config: CaptureConfig
) -> tuple[Sequence[CameraProcess], dict[str, Summary], list[Finding]]:
    try:
        cameras = find_cameras(rig, file, config.deadlines, detect_ports)
    except LightstageError as error:
        return [], {}, [_silent(error, "cameras")]
    moved: list[Moved] = []
    try:
        wanted = [rig.camera(camera.id) for camera in cameras]
        summaries, problems = connect_problems(wanted, cameras, file.allow_unverifiable, moved)
    finally:
        close_cameras(cameras)
    findings = [_silent(each, "") for each in problems]
    return cameras, summaries, [*findings, *map(moved_finding, moved)]


def _silent(error: LightstageError, where: str) -> Finding:
    """A device that does not answer, as a finding; an error of several is reported whole."""
    several = not error.found
    return Finding(
        "refuse",
        "no-answer",
        where or error.where if several else error.where,
        plain(str(error) if several else error.found),
        error.expected or "all of them",
        error.hint or "Inspect its cable, power and battery.",
    )


def _camera(
    rig: Rig,
    device: CameraProcess,
    summary: Summary | None,
    plan: Plan,
    findings: Sequence[Finding],
) -> CameraLook:
    camera = rig.camera(device.id)
    if summary is None:
        return CameraLook(device.id, camera.serial, False, device.port)
    free = summary.card_free_bytes
    settings = {name: value for name in SHOWN if (value := getattr(summary, name)) is not None}
    wrong = [f.where.rpartition(", ")[2] for f in findings if f.camera == device.id]
    return CameraLook(
        device.id,
        summary.serial or camera.serial,
        True,
        device.port,
        summary.model or "",
        summary.lens or "",
        summary.battery_percent,
        None if free is None else free // max(1, photograph_bytes(camera, plan)),
        settings,
        tuple(name for name in dict.fromkeys(wrong) if name in SHOWN),
    )
