"""When somebody dies during a capture: every step, every victim."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Literal

from lightstage.steps import STEPS

Who = Literal["capture", "camera", "all"]
"""Who dies: the capture's own process, the camera's, or every process that belongs to it."""
SEQUENCE = ("full", "x+", "x-")
CAMERAS = 3
CAMERA_STEPS = ("triggering", "triggered", "downloading", "downloaded")
"""Steps in a camera's process."""
DELETING = ("deleting", "deleted")
SHOT_STEPS = ("lit", "intended", "shot-done")
"""Steps of a pattern, in the capture's process; all other steps but those of the session are of one
photograph."""
SESSION_STEPS = ("session-written", "manifest-written", "ended")
LINES = ("begin", "lit", "trigger", "exposed", "frame", "shot", "end")
"""Events in the middle of whose lines somebody dies."""


@dataclasses.dataclass(frozen=True)
class Kill:
    """When somebody dies.

    Attributes:
        step: of lightstage.steps.STEPS.
        who: dies.
        pattern: at whose step, ``*`` for the first that comes.
        camera: at whose step, and whose process `who` means; ``*`` for the first that comes.
        event: of the journal's line, where the step is in the middle of a line.
    """

    step: str
    who: Who
    pattern: str = "*"
    camera: str = "*"
    event: str = ""

    def __str__(self) -> str:
        at = [text for text in (self.event, self.pattern, self.camera) if text not in ("", "*")]
        return f"{self.step}({' '.join(at)}) {self.who}"


def matrix(patterns: Sequence[str], whos: Sequence[Who]) -> list[Kill]:
    """Every step of every kind, at these patterns, with these victims where they make sense.

    The camera is another one with each pattern.
    """
    kills = []
    for step in STEPS:
        events = LINES if step == "line-half-written" else ("",)
        for event, who, (number, pattern) in itertools.product(events, whos, enumerate(patterns)):
            of_session = step in SESSION_STEPS or event in ("begin", "end")
            of_shot = step in SHOT_STEPS or event in ("lit", "trigger", "shot")
            if who == "camera" and (of_session or of_shot or event):
                continue  # it is no camera's matter
            camera = "*" if of_session or of_shot else f"cam{(number + 1) % CAMERAS}"
            kill_at = Kill(step, who, "*" if of_session else pattern, camera, event)
            if kill_at not in kills:
                kills.append(kill_at)
    return kills
