"""Everything that is made sure before a light goes on, in one message."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from lightstage.cameras.binding import CamerasFile
from lightstage.cameras.camera import Summary
from lightstage.errors import DeviceError, LightstageError, one_error
from lightstage.findings import Finding
from lightstage.leds.controller import LedController
from lightstage.leds.opening import channels_needed
from lightstage.preflight.clock import computer_clock_findings
from lightstage.preflight.config import Plan, PreflightConfig
from lightstage.preflight.disk import card_findings, disk_findings
from lightstage.preflight.privacy import privacy_findings
from lightstage.preflight.pulses import pulse_findings
from lightstage.preflight.settings import settings_findings
from lightstage.rig import Rig


def preflight(
    rig: Rig,
    summaries: Mapping[str, Summary],
    file: CamerasFile,
    leds: LedController,
    out: Path,
    plan: Plan,
    config: PreflightConfig,
) -> list[Finding]:
    """Check lights, cameras, disk and clocks; nothing is changed but for a trial file.

    Args:
        rig: lights and cameras wanted.
        summaries: by camera id, as they are now.
        file: what is expected of the cameras, and what may stay unverified.
        leds: open.
        out: the session's folder, new or to be resumed.
        plan: what is about to be taken.
        config: limits.

    Returns:
        All that was found; `require` raises on what forbids a capture.
    """
    shutters = {camera_id: summary.shutter for camera_id, summary in summaries.items()}
    return [
        *device_findings(rig, summaries, file, leds, config),
        *pulse_findings(shutters, leds.pulse_hz, plan.lowest_level, config),
        *card_findings(rig, summaries, plan, config),
        *disk_findings(rig, out, plan, config),
        *computer_clock_findings(out, config),
    ]


def device_findings(
    rig: Rig,
    summaries: Mapping[str, Summary],
    file: CamerasFile,
    leds: LedController,
    config: PreflightConfig,
) -> list[Finding]:
    """Checks of the devices themselves, whatever is to be taken (arguments as `preflight`'s)."""
    return [
        *_led_findings(rig, leds),
        *settings_findings(summaries, file, config),
        *privacy_findings(summaries),
    ]


def refusals(findings: Sequence[Finding]) -> list[LightstageError]:
    """What forbids a capture, as errors."""
    return [
        DeviceError(f.where, found=f.found, expected=f.expected, hint=f.hint)
        for f in findings
        if f.severity == "refuse"
    ]


def require(findings: Sequence[Finding]) -> None:
    """DeviceError with everything that forbids a capture, in one message."""
    problems = refusals(findings)
    if problems:
        raise one_error(problems)


def _led_findings(rig: Rig, leds: LedController) -> list[Finding]:
    findings = []
    count, needed = leds.hello.light_count, sum(channels_needed(rig).values())
    # A rig that gives addresses leaves channels free on purpose.
    if count < needed or (count > needed and not rig.addressed):
        findings.append(
            Finding(
                "refuse",
                "light-count",
                "LED device, lamp count",
                str(count),
                f"at least {needed} (addresses in rig.json)"
                if rig.addressed
                else f"{needed} (rig.json)",
                "Is this the rig file of this stage?",
            )
        )
    if not leds.acknowledged:
        findings.append(
            Finding(
                "warn",
                "unacknowledged",
                "LED device",
                "a device that does not acknowledge",
                "one that reports what is lit",
                "Every photograph is recorded as taken under unacknowledged light.",
            )
        )
    return findings
