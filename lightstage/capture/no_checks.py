"""Stands in until lightstage.checks has ShotChecks; removed then."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from lightstage.checks.config import ChecksConfig
from lightstage.findings import Finding
from lightstage.rig import Rig
from lightstage.sequence import Shot


class ShotChecks:
    """Finds nothing."""

    def __init__(self, rig: Rig, shots: Sequence[Shot], config: ChecksConfig) -> None:
        self.of = (rig, shots, config)

    def photograph(self, pattern: str, camera_id: str, path: Path) -> list[Finding]:
        """Nothing."""
        return [] if (pattern, camera_id, path) else []

    def shot(self, pattern: str) -> list[Finding]:
        """Nothing."""
        return [] if pattern else []

    def forget(self, pattern: str, camera_id: str) -> None:
        """Nothing."""
