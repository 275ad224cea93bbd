"""How a capture runs: one dataclass with the parts' own."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

from lightstage.calibrations.config import CalibrationConfig
from lightstage.cameras.process import Deadlines
from lightstage.checks.config import ChecksConfig
from lightstage.errors import ConfigError
from lightstage.formats.config import make_config, read_toml
from lightstage.formats.values import TOML, require_plain
from lightstage.operator import OperatorConfig
from lightstage.patterns import Drive
from lightstage.preflight import PreflightConfig
from lightstage.safety import SafetyConfig
from lightstage.session.config import SessionConfig

GRACE_S = (0.5, 60.0)
"""Bounds of `late_camera_grace_s`: cameras differ in how long they write to their card."""


@dataclasses.dataclass(frozen=True)
class CaptureConfig:
    """How a capture runs.

    Attributes:
        trigger_lead_s: time between asking all cameras and the moment at which all trigger.
        dark_after_s: how long a pattern stays lit while its photographs, all exposed, are still
            being downloaded; then the stage is dark until the next one.
        late_camera_grace_s: a camera that does not answer keeps the pattern lit for so long after
            the other cameras have exposed and its own exposure should be over; then the stage is
            dark, and the camera takes the pattern again alone.
        downloads: how often one file is asked for before its photograph counts as failed.
        delete_from_cameras: delete a photograph on the camera once it is in the journal.
        drive: levels weighted by the solid angle that a lamp represents, or plain on and off.
        emitters: colours of the lights that are driven, where rig.json names colours; none: all.
        deadlines: after which a camera that has not answered is ended.
        safety: limits for person and lights.
        preflight: what must hold before a light goes on.
        checks: what a photograph must show.
        operator: what is decided where nobody is asked.
        calibration: which calibration shots a session wants, and how long they hold.
        session: consent, and who may read what is captured.
    """

    trigger_lead_s: float = 0.02
    dark_after_s: float = 2.0
    late_camera_grace_s: float = 3.0
    downloads: int = 2
    delete_from_cameras: bool = False
    drive: Drive = "solid-angle"
    emitters: tuple[str, ...] = ()
    deadlines: Deadlines = dataclasses.field(default_factory=Deadlines)
    safety: SafetyConfig = dataclasses.field(default_factory=SafetyConfig)
    preflight: PreflightConfig = dataclasses.field(default_factory=PreflightConfig)
    checks: ChecksConfig = dataclasses.field(default_factory=ChecksConfig)
    operator: OperatorConfig = dataclasses.field(default_factory=OperatorConfig)
    calibration: CalibrationConfig = dataclasses.field(default_factory=CalibrationConfig)
    session: SessionConfig = dataclasses.field(default_factory=SessionConfig)

    def __post_init__(self) -> None:
        """ConfigError on values with which nothing could be taken."""
        if not 1 <= self.downloads <= 100:
            raise ConfigError(
                "config", field="downloads", found=str(self.downloads), expected="from 1 to 100"
            )
        for name in ("trigger_lead_s", "dark_after_s"):
            value = getattr(self, name)
            if not 0 <= value < float("inf"):
                raise ConfigError(
                    "config", field=name, found=repr(value), expected="seconds from 0"
                )
        low_s, high_s = GRACE_S
        if not low_s <= self.late_camera_grace_s <= high_s:
            raise ConfigError(
                "config",
                field="late_camera_grace_s",
                found=repr(self.late_camera_grace_s),
                expected=f"seconds from {low_s:g} to {high_s:g}",
                hint="A grace that is shorter than the cameras differ voids good photographs.",
            )

    def worst_shot_s(self, acknowledge_s: float) -> float:
        """Longest that a shot can keep its lights on, every deadline used up.

        Args:
            acknowledge_s: after which a silent LED device counts as failed.
        """
        return acknowledge_s + self.trigger_lead_s + self.deadlines.trigger_s + self.dark_after_s


def read_config(
    path: Path | None,
    config: CaptureConfig | None = None,
    *,
    ignore_clock: bool = False,
    **given: Any,
) -> CaptureConfig:
    """The configuration of a file, else `config`, and what the command line sets in it.

    `ignore_clock` is the flag of that name; the other arguments are fields of CaptureConfig.
    """
    config = config or CaptureConfig()
    if path is not None:
        config = make_config(CaptureConfig, read_toml(path), path)
        if config.session.pseudonyms is not None:  # so that a session is resumed from anywhere
            table = str(path.absolute().parent / config.session.pseudonyms)
            # Only what `make_config` reads back from the journal can be resumed.
            require_plain({"session.pseudonyms": table}, path, TOML, ConfigError)
            session = dataclasses.replace(config.session, pseudonyms=table)
            config = dataclasses.replace(config, session=session)
    if ignore_clock:
        preflight = dataclasses.replace(config.preflight, ignore_clock=True)
        config = dataclasses.replace(config, preflight=preflight)
    return dataclasses.replace(config, **{k: v for k, v in given.items() if v is not None})
