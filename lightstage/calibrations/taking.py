"""A pose is a session like any other: the same capture, checked by the quick checks alone."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from lightstage.calibrations.kinds import Kind
from lightstage.capture.config import CaptureConfig
from lightstage.capture.session_run import Order, capture_session, unfinished
from lightstage.capture.stage import Stage
from lightstage.findings import Finding
from lightstage.operator import Operator
from lightstage.patterns import Drive
from lightstage.sequence import plan_shots

SUBJECT = "calibration"


class NoFaceChecks:
    """The checks that capture calls; a target is no face, and is checked when its pose is whole."""

    def photograph(self, pattern: str, camera_id: str, path: Path) -> list[Finding]:
        """Returns no findings: targets are not checked photograph by photograph."""
        del pattern, camera_id, path
        return []

    def shot(self, pattern: str) -> list[Finding]:
        """Returns no findings: targets are not checked shot by shot."""
        del pattern
        return []

    def forget(self, pattern: str, camera_id: str) -> None:
        """Does nothing: no figures of a photograph that is retaken are kept here."""
        del pattern, camera_id

    def facts(self) -> dict[str, Any]:
        """Returns no figures."""
        return {}


class SessionTaker:
    """Takes each pose into its own session folder (run.PoseTaker).

    Args:
        stage: opened.
        kind: what is photographed.
        config: of the capture.
        operator: decides where a photograph fails.
    """

    def __init__(self, stage: Stage, kind: Kind, config: CaptureConfig, operator: Operator) -> None:
        self._stage = stage
        self._kind = kind
        self._config = config
        self._operator = operator

    def __call__(self, root: Path, patterns: Sequence[str], drive: Drive) -> None:
        """Take all patterns into `root`, or resume what is in it; dark afterwards.

        Raises:
            LightstageError: as a capture does; what was taken is kept in `root`.
        """
        if (root / "journal.jsonl").is_file():
            _, order = unfinished(root)
        else:
            shots = plan_shots(patterns, self._stage.rig, drive)
            order = Order(
                root,
                shots,
                subject=SUBJECT,
                expression=self._kind.name,
                facts={"calibration_kind": self._kind.name},
            )
        order = dataclasses.replace(order, alone=False)
        with contextlib.ExitStack() as dark:
            dark.callback(self._stage.lights.dark)
            capture_session(self._stage, order, self._config, self._operator, NoFaceChecks())
