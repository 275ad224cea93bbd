"""A camera that does not answer must not keep the person lit until its deadline ends it."""

from __future__ import annotations

import threading
import time
from collections.abc import Collection, Iterable

from lightstage.capture.config import CaptureConfig
from lightstage.capture.pattern_light import PatternLight
from lightstage.preflight.values import exposure_s
from lightstage.session import SessionWriter

TELL_S = 1.0
"""A camera that is later than this is reported to the operator, who then sees the seconds run."""


class ExposureTimes:
    """How long exposures of a session last, from the common trigger until the camera is done.

    A camera is done when its photograph is on its card. Several threads may call.

    Args:
        shutters: the cameras' shutter times, such as ``1/60``; None is unknown.
    """

    def __init__(self, shutters: Iterable[str | None]) -> None:
        exposures = [exposure_s(text) for text in shutters if text is not None]
        self._shutter_s = max((time_s for time_s, _ in filter(None, exposures)), default=None)
        self._longest_s: dict[str, float] = {}
        self._lock = threading.Lock()

    def note(self, camera_id: str, seconds: float) -> None:
        """Note that a camera was done so many seconds after the trigger."""
        with self._lock:
            self._longest_s[camera_id] = max(seconds, self._longest_s.get(camera_id, 0.0))

    def usual_s(self, camera_ids: Collection[str]) -> float | None:
        """Longest that a normal exposure of these cameras takes.

        Of a camera without an exposure so far, it is the longest of all cameras; where no camera
        has exposed yet, the longest shutter time that the cameras are set to. None where no camera
        reports one either.
        """
        with self._lock:
            if not self._longest_s:
                return self._shutter_s
            of_all_s = max(self._longest_s.values())
            each_s = [self._longest_s.get(camera_id, of_all_s) for camera_id in camera_ids]
        return max(self._shutter_s or 0.0, *each_s)


class LateCameras:
    """Watches one shot: puts its light out when the cameras that still need it are too late.

    The light stays for as long as an exposure of these cameras normally takes, at least until the
    last of the others has exposed, and `late_camera_grace_s` longer. The journal's lines
    ``waiting`` name the cameras that are late and how many seconds are left.

    Args:
        pattern: what is lit.
        light: its light.
        times: how long exposures last.
        at_s: time.monotonic() of the common trigger.
        config: the grace, and the deadline at which a camera is ended.
        writer: the session.
    """

    def __init__(
        self,
        pattern: str,
        light: PatternLight,
        times: ExposureTimes,
        at_s: float,
        config: CaptureConfig,
        writer: SessionWriter,
    ) -> None:
        self._pattern = pattern
        self._light = light
        self._times = times
        self._at_s = at_s
        self._grace_s = config.late_camera_grace_s
        self._ended_s = at_s + config.deadlines.trigger_s
        self._writer = writer
        self._told = self._over = False

    def look(self) -> None:
        """Report cameras that are late, and put the light out when they are too late."""
        late = self._light.needed_by
        usual_s = self._times.usual_s(late) if late and not self._over else None
        if usual_s is None:
            return
        exposed_s = max(self._at_s + usual_s, self._light.last_over_s)
        now_s = time.monotonic()
        dark_s = exposed_s + self._grace_s
        if dark_s >= self._ended_s:
            return  # the camera's own deadline comes first
        if now_s >= dark_s:
            self._over = True
            if self._light.put_out():
                self._note(late, now_s, lit=False)
        elif not self._told and now_s >= exposed_s + min(TELL_S, self._grace_s / 2):
            self._told = True
            self._note(late, now_s, lit=True, dark_in_s=round(dark_s - now_s, 3))

    def _note(self, late: Collection[str], now_s: float, **facts: object) -> None:
        self._writer.note(
            "waiting",
            pattern=self._pattern,
            cameras=sorted(late),
            **facts,
            ended_in_s=round(max(0.0, self._ended_s - now_s), 3),
        )
