"""One place for light: what is checked before a light goes on, and who alone lights the lamps."""

from __future__ import annotations

import contextlib
import dataclasses
import signal
import threading
import time
from collections.abc import Iterator, Sequence
from types import TracebackType

import numpy as np

from lightstage.errors import ConfigError, DeviceError, LightstageError, one_error
from lightstage.leds.controller import Hello, LedController
from lightstage.rig import Rig
from lightstage.sequence import Shot


@dataclasses.dataclass(frozen=True)
class SafetyConfig:
    """Limits for the person in the stage and for its lights.

    Attributes:
        max_flashes_per_s: flashes in any second; three is the limit below which photosensitive
            people are held to be safe [WCAG-Flashes].
        light_interval_s: shortest time between two changes of light; a capture waits for it.
        max_light_on_s: time at full level that one light may be on in one capture.
    """

    max_flashes_per_s: float = 3.0
    light_interval_s: float = 0.4
    max_light_on_s: float = 600.0


def flash_rate_per_s(shots: Sequence[Shot], light_interval_s: float) -> float:
    """Most flashes in any second, if lights change as fast as they may.

    Every change of any light counts as a flash, the first one and the last dark included; a flash
    in the sense of [WCAG-Flashes] is a pair of opposing changes, so this is the worst case.
    """
    states = [np.zeros_like(shots[0].levels), *(shot.levels for shot in shots)]
    states.append(states[0])
    changes_s = [
        index * light_interval_s
        for index in range(1, len(states))
        if not np.array_equal(states[index], states[index - 1])
    ]
    # Windows of one second, open at the end, that begin at a change hold the most.
    windows = [sum(start <= time < start + 1.0 for time in changes_s) for start in changes_s]
    return float(max(windows, default=0))


def light_on_s(shots: Sequence[Shot], shot_worst_s: float) -> np.ndarray:
    """(n,) seconds at full level that each light is on, if every shot lasts its longest."""
    return np.sum([shot.levels for shot in shots], axis=0) * shot_worst_s


def check_shots(shots: Sequence[Shot], rig: Rig, config: SafetyConfig, shot_worst_s: float) -> None:
    """Refuse a sequence that flashes too fast or keeps a light on too long.

    Args:
        shots: what is to be lit.
        rig: the lights.
        config: the limits.
        shot_worst_s: longest that one shot can last, when every deadline is used up.

    Raises:
        ConfigError: what was found and which limit it breaks, all in one message.
    """
    problems: list[LightstageError] = []
    rate = flash_rate_per_s(shots, config.light_interval_s)
    if rate > config.max_flashes_per_s:
        problems.append(
            ConfigError(
                "sequence",
                field="flash rate",
                found=f"up to {rate:g} flashes per second",
                expected=f"at most {config.max_flashes_per_s:g} (max_flashes_per_s)",
                hint="Give light_interval_s a larger value.",
            )
        )
    on_s = light_on_s(shots, shot_worst_s)
    hot = np.flatnonzero(on_s > config.max_light_on_s)
    if len(hot):
        worst = rig.lights[int(np.argmax(on_s))]
        problems.append(
            ConfigError(
                "sequence",
                field="duty",
                found=f"{len(hot)} lights over the budget, light {worst.id} ({worst.name}) up to "
                f"{on_s.max():.0f} s at full level",
                expected=f"at most {config.max_light_on_s:g} s (max_light_on_s)",
                hint="Split the sequence, or lower the cameras' deadline.",
            )
        )
    if problems:
        raise one_error(problems)


class SafeLights:
    """The lights as a capture has them (LedController): `with SafeLights(...) as lights`.

    Args:
        lights: the device; nobody else may talk to it meanwhile.
        config: limits.
        rig: the lights' names.
        shot_worst_s: longest that one state may stay lit; without it, max_light_on_s.

    Raises:
        DeviceError: what the device raises, or a limit that a light would break.
    """

    def __init__(
        self,
        lights: LedController,
        config: SafetyConfig,
        rig: Rig,
        shot_worst_s: float | None = None,
    ) -> None:
        self._lights = lights
        self.config = config
        self._rig = rig
        self._shot_worst_s = config.max_light_on_s if shot_worst_s is None else shot_worst_s
        self._changed_s = -np.inf

    @property
    def hello(self) -> Hello:
        """Who is there."""
        return self._lights.hello

    @property
    def acknowledged(self) -> bool:
        """Whether the device tells what is lit."""
        return self._lights.acknowledged

    @property
    def pulse_hz(self) -> float | None:
        """How often a second the lights are switched to dim them."""
        return self._lights.pulse_hz

    def light(self, levels: np.ndarray) -> np.ndarray:
        """Wait until the light may change again, then as the device does."""
        time.sleep(max(0.0, self._changed_s + self.config.light_interval_s - time.monotonic()))
        self._changed_s = time.monotonic()
        return self._lights.light(levels)

    def confirm(self) -> None:
        """DeviceError unless the lights are as last set."""
        self._lights.confirm()

    def dark(self) -> None:
        """All lights off, at once."""
        self._changed_s = time.monotonic()
        self._lights.dark()

    def recover(self) -> Hello:
        """After LightLostError: greet the device again, dark; the shot may then be taken again."""
        return self._lights.recover()

    def close(self) -> None:
        """Dark, then the port is given back."""
        self.dark()
        self._lights.close()

    def __enter__(self) -> SafeLights:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with _signals_held():
            try:
                self.dark()
            except LightstageError as failure:
                warning = "The lights may still be on: switch their power supply off."
                said = f"{str(error) or kind.__name__}\n  then: " if kind is not None else ""
                raise DeviceError(f"{said}{failure} {warning}") from error


@contextlib.contextmanager
def _signals_held() -> Iterator[None]:
    """Put off signals, so that a second Ctrl-C cannot leave the lights on."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    held: list[int] = []
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = [signal.signal(number, lambda got, _: held.append(got)) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)
    if held:
        raise KeyboardInterrupt
