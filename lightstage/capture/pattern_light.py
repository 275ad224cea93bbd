"""A pattern's light, as long as cameras need it, and whether it lasted through each exposure."""

from __future__ import annotations

import math
import threading
import time

import numpy as np

from lightstage.errors import DeviceError
from lightstage.leds.controller import LightLostError
from lightstage.safety import SafeLights


class PatternLight:
    """Lights a pattern; turns it off when all cameras have exposed and downloads take long.

    Args:
        lights: the stage's.
        levels: (n,) in 0..1.
        cameras: how many need it.
        after_s: how long it stays lit after the last exposure.

    Attributes:
        driven: (n,) levels that are really driven.
        lit_s: from asking for the light until it was acknowledged.

    Raises:
        LightLostError: it is not lit.
    """

    def __init__(
        self, lights: SafeLights, levels: np.ndarray, cameras: int, after_s: float
    ) -> None:
        begun_s = time.monotonic()
        self._lights = lights
        self.driven = lights.light(levels)
        self._state = lights.state
        self.lit_s = time.monotonic() - begun_s
        self._needed = cameras
        self._after_s = after_s
        self._due_s = math.inf
        self._lock = threading.Lock()

    def over(self) -> DeviceError | None:
        """One camera needs the light no more; what speaks against it having lasted until now.

        A light that was put out in between did not last, though the device confirms the darkness
        that it was told since.
        """
        try:
            self._lights.confirm()
            if self._lights.state != self._state:
                return LightLostError("lights", found="put out meanwhile", expected="still lit")
        except DeviceError as error:
            return error
        finally:
            with self._lock:
                self._needed -= 1
                if self._needed == 0:
                    self._due_s = time.monotonic() + self._after_s
        return None

    def dark_when_due(self) -> None:
        """All lights off, once, when it is time."""
        with self._lock:
            due = time.monotonic() >= self._due_s
            if due:
                self._due_s = math.inf
        if due:
            self._lights.dark()
