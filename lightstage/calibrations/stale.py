"""Whether a lab's calibration shots still hold for this stage, and what a session records of them.

Shots end to hold when their days are over, and at once when the rig, a camera, one of the settings
that matter for their kind, or (where they show the LEDs' light) the LED firmware is another.
"""

from __future__ import annotations

import dataclasses
import datetime
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from lightstage.calibrations.config import CalibrationConfig, require_kind
from lightstage.calibrations.folder import lab_shots, latest
from lightstage.calibrations.kinds import KINDS, Kind
from lightstage.cameras.camera import Summary
from lightstage.counting import counted
from lightstage.errors import LightstageError, one_error
from lightstage.findings import Finding, Severity
from lightstage.formats.calibration_shots import Shots
from lightstage.leds.controller import Hello
from lightstage.rig import MEASURED_WITH, Rig, rig_sha256

MANY = 3
"""Only the number is reported of more cameras, or values of one setting, than this."""


@dataclasses.dataclass(frozen=True)
class Used:
    """What a session learns of its lab's calibration shots.

    Attributes:
        findings: one for each kind that is missing or no longer holds, with all its reasons:
            `refuse`, or `warn` where that was allowed.
        facts: for the journal's event ``calibration`` and the manifest, by kind: ``id``,
            ``path`` (in the lab's folder), ``sha256`` of calibration.json, ``age_days``,
            ``stale`` (what does not hold and was allowed).
    """

    findings: list[Finding]
    facts: dict[str, dict[str, Any]]


def use_calibrations(
    lab: Path,
    rig: Rig,
    summaries: Mapping[str, Summary],
    leds: Hello,
    allow_stale: Collection[str] = (),
    config: CalibrationConfig | None = None,
    now: datetime.datetime | None = None,
) -> Used:
    """What `lightstage capture --calibration LAB --allow-stale KIND` checks before a light goes on.

    Args:
        lab: the lab's folder.
        rig: the session's.
        summaries: by camera id, as they are now.
        leds: the LED device.
        allow_stale: kinds that may be missing or stale; what is so is a warning then.
        config: which kinds are wanted.
        now: with its zone; the computer's clock by default.

    Raises:
        ConfigError: a name in `allow_stale` that is no kind.
        FormatError: no such folder.
    """
    config = config or CalibrationConfig()
    now = now or datetime.datetime.now(datetime.UTC)
    for name in allow_stale:
        require_kind(name, "--allow-stale")
    findings: list[Finding] = []
    facts: dict[str, dict[str, Any]] = {}
    for name in config.wanted:
        allowed = name in allow_stale
        own = _findings(lab, KINDS[name], rig, summaries, leds, now, config, allowed)
        findings += own
        shots = latest(lab, name)
        if shots is None:
            facts[name] = {"id": None, "stale": [finding.found for finding in own]}
            continue
        facts[name] = {
            "id": shots.file.id,
            "path": shots.root.relative_to(lab).as_posix(),
            "sha256": shots.sha256,
            "age_days": round(shots.file.age_days(now), 3),
            "stale": [finding.found for finding in own],
        }
    return Used(findings, facts)


def stale(
    lab: Path,
    rig: Rig,
    summaries: Mapping[str, Summary],
    leds: Hello,
    now: datetime.datetime,
    config: CalibrationConfig,
) -> list[Finding]:
    """Why each wanted kind of shots does not hold for this stage; empty when all do.

    Arguments as in `use_calibrations`; every finding has severity `refuse`.
    """
    return use_calibrations(lab, rig, summaries, leds, (), config, now).findings


def changes(
    shots: Shots, rig: Rig, summaries: Mapping[str, Summary], leds: Hello
) -> list[tuple[str, str, str]]:
    """What of the stage is another than when the shots were taken: code, found, expected."""
    kind = KINDS[shots.file.kind]
    out: list[tuple[str, str, str]] = []
    # A rig whose cameras were measured from such shots is the stage that they were taken with.
    if shots.file.rig_sha256 not in (rig_sha256(rig), rig.more.get(MEASURED_WITH)):
        out.append(("rig-changed", "another rig.json", "the one with which they were taken"))
    cameras = shots.file.devices.cameras
    new = [camera_id for camera_id in summaries if camera_id not in cameras]
    if new:
        out.append(("camera-new", f"no photographs of {', '.join(new)}", "some of every camera"))
    for name in kind.settings:
        other: dict[tuple[str | None, str | None], list[str]] = {}
        for camera_id, summary in summaries.items():
            values = getattr(summary, name), cameras.get(camera_id, {}).get(name)
            if camera_id in cameras and values[0] != values[1]:
                other.setdefault(values, []).append(camera_id)
        code = "camera-changed" if name in ("serial", "model") else "setting-changed"
        if len(other) > MANY:
            own = [camera_id for each in other.values() for camera_id in each]
            found = f"{_named(own, summaries)} with another {name.replace('_', ' ')}"
            out.append((code, found, "those of then"))
            continue
        out += [
            (code, f"{_named(own, summaries)} with {_value(name, now)}", _value(name, was))
            for (now, was), own in other.items()
        ]
    firmware = shots.file.devices.leds.get("firmware")
    if kind.lit and firmware != leds.firmware:
        out.append(
            ("firmware-changed", f"LED firmware {leds.firmware!r}", f"{firmware!r}, as then")
        )
    return out


def _findings(
    lab: Path,
    kind: Kind,
    rig: Rig,
    summaries: Mapping[str, Summary],
    leds: Hello,
    now: datetime.datetime,
    config: CalibrationConfig,
    allowed: bool,
) -> list[Finding]:
    severity: Severity = "warn" if allowed else "refuse"
    again = f"Take them again (lightstage calibrate {kind.name})"
    hint = (
        f"Allowed; {kind.gives} may be wrong in this session."
        if allowed
        else f"{again}, or continue without {kind.gives} (--allow-stale {kind.name})."
    )

    def finding(code: str, found: str, expected: str) -> Finding:
        return Finding(severity, code, f"calibration {kind.name}", found, expected, hint)

    shots = latest(lab, kind.name)
    if shots is None:
        _, damaged = lab_shots(lab)
        reason = f" ({one_error(damaged)})" if damaged else ""
        return [finding("calibration-missing", f"no finished shots in {lab}{reason}", "some")]
    where = shots.root.name
    age = shots.file.age_days(now)
    if age < -config.clock_slack_s / 86400:
        # Their true age is not known: neither they nor the clock can be trusted.
        return [
            finding(
                "clock-backward",
                f"{where}, made {duration(-age)} after now",
                "shots made before now; is the computer's clock right?",
            )
        ]
    reasons: list[tuple[str, str, str]] = []
    if now >= shots.file.expires:
        held = (shots.file.expires - shots.file.created).total_seconds() / 86400
        reasons.append(
            ("calibration-expired", f"{where}, {duration(age)} old", f"at most {duration(held)}")
        )
    changed = changes(shots, rig, summaries, leds)
    if changed:
        codes, found, expected = zip(*changed, strict=True)
        code = codes[0] if len(set(codes)) == 1 else "stage-changed"
        reason = f"{'; '.join(found)}, since {where}"
        reasons.append((code, reason, "; ".join(dict.fromkeys(expected))))
    problems: list[LightstageError] = shots.changed()
    if problems:
        reasons.append(("calibration-damaged", str(one_error(problems)), f"{where} unchanged"))
    if not reasons:
        return []
    codes, found, expected = zip(*reasons, strict=True)
    code = codes[0] if len(codes) == 1 else "calibration-stale"
    return [finding(code, "; ".join(found), "; ".join(expected))]


def duration(days: float) -> str:
    """Days in plain words."""
    if days >= 2:
        return f"{days:.0f} days"
    hours = days * 24
    return f"{hours:.0f} hours" if hours >= 2 else counted(round(hours * 60), "minute")


def _named(own: Collection[str], summaries: Collection[str]) -> str:
    """Cameras by their ids, or by their number where they are more than three."""
    if len(own) <= MANY:
        return ", ".join(own)
    return f"all {len(own)} cameras" if len(own) == len(summaries) else f"{len(own)} cameras"


def _value(name: str, value: str | None) -> str:
    return f"{name.replace('_', ' ')} {value if value is not None else 'not known'}"
