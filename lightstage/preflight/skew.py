"""How far apart the cameras of one shot were triggered."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from lightstage.findings import Finding

Triggers = Mapping[str, float]
"""Camera id to time.monotonic() just before its trigger, of one shot."""


class SkewReport:
    """Collects the triggers of a session's shots."""

    def __init__(self) -> None:
        self._offsets: dict[str, list[float]] = {}

    def add(self, shot: Triggers) -> None:
        """Count a shot; each camera's trigger counts from the earliest of it.

        Args:
            shot: who was triggered when; a camera may be missing from some shots. A time that is
                not finite is passed over.
        """
        times = {camera: time for camera, time in shot.items() if math.isfinite(time)}
        first = min(times.values(), default=0.0)
        for camera, time in times.items():
            self._offsets.setdefault(camera, []).append(time - first)

    def facts(self) -> dict[str, dict[str, float]]:
        """Camera id to its figures, in the order in which cameras appeared.

        Returns:
            ``shots``, and of its offsets ``median_s``, ``p95_s`` (95th percentile) and ``max_s``,
            to the microsecond.
        """
        return {
            camera: {
                "shots": len(each),
                "median_s": round(float(np.median(each)), 6),
                "p95_s": round(float(np.percentile(each, 95)), 6),
                "max_s": round(max(each), 6),
            }
            for camera, each in self._offsets.items()
        }


def shot_skew_s(shot: Triggers) -> float:
    """Seconds from the first trigger of a shot to its last; 0 with fewer than two cameras."""
    times = [time for time in shot.values() if math.isfinite(time)]
    return max(times) - min(times) if times else 0.0


def skew_findings(pattern: str, shot: Triggers, max_skew_s: float) -> list[Finding]:
    """A warning where the cameras of a shot were triggered further apart than the limit."""
    span_s = shot_skew_s(shot)
    if span_s <= max_skew_s:
        return []
    last = max(shot, key=lambda camera: (math.isfinite(shot[camera]), shot[camera]))
    return [
        Finding(
            "warn",
            "trigger-skew",
            f"pattern {pattern}, triggers",
            f"{1e3 * span_s:.1f} ms from the first camera to {last}",
            f"at most {1e3 * max_skew_s:g} ms (max_trigger_skew_s)",
            "Is this computer busy with something else?",
            pattern=pattern,
        )
    ]
