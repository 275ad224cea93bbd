"""A pattern's light, as long as cameras need it, and whether it lasted through each exposure."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Collection

import numpy as np

from lightstage.errors import DeviceError
from lightstage.leds.controller import LightLostError
from lightstage.safety import SafeLights


class LateCameraError(DeviceError):
    """A camera had not exposed when the light was put out, so as not to keep a person lit."""


class PatternLight:
    """Lights a pattern; turns it off when all cameras have exposed and downloads take long.

    Args:
        lights: the stage's.
        levels: (n,) in 0..1.
        cameras: ids of those that need it.
        after_s: how long it stays lit after the last exposure.

    Attributes:
        driven: (n,) levels that are really driven.
        lit_s: from asking for the light until it was acknowledged.
        last_over_s: time.monotonic() at which a camera needed it no more; -inf before the first.

    Raises:
        LightLostError: it is not lit.
    """

    def __init__(
        self, lights: SafeLights, levels: np.ndarray, cameras: Collection[str], after_s: float
    ) -> None:
        begun_s = time.monotonic()
        self._lights = lights
        self.driven = lights.light(levels)
        self._state = lights.lit_state  # dark may have been asked for since
        self.lit_s = time.monotonic() - begun_s
        self._needed_by = set(cameras)
        self._after_s = after_s
        self._due_s = math.inf
        self._given_up = False
        self._lock = threading.Lock()
        self.last_over_s = -math.inf

    @property
    def needed_by(self) -> frozenset[str]:
        """Cameras that have not exposed yet."""
        with self._lock:
            return frozenset(self._needed_by)

    def over(self, camera_id: str) -> DeviceError | None:
        """One camera needs the light no more; the reason why it may not have lasted until now.

        A light that was put out in between did not last, though the device confirms the darkness
        that it was given since.
        """
        lost: DeviceError | None = None
        try:
            self._lights.confirm()
            if self._lights.state != self._state:
                lost = LightLostError("lights", found="put out meanwhile", expected="still lit")
        except DeviceError as error:
            lost = error
        finally:
            with self._lock:
                self._needed_by.discard(camera_id)
                self.last_over_s = time.monotonic()
                if not self._needed_by and not self._given_up:
                    self._due_s = self.last_over_s + self._after_s
        if lost is None or not self._given_up:
            return lost
        return LateCameraError(
            f"camera {camera_id}",
            found="no picture when the light was put out so as to spare the person",
            expected="one as soon as the other cameras'",
        )

    def put_out(self) -> bool:
        """Dark now, where a camera still needs the light and must do without; whether it did."""
        with self._lock:
            if not self._needed_by:
                return False
            self._given_up = True
        self._lights.dark()
        return True

    def dark_when_due(self) -> None:
        """All lights off, once, when it is time."""
        with self._lock:
            due = time.monotonic() >= self._due_s
            if due:
                self._due_s = math.inf
        if due:
            self._lights.dark()
