"""Who alone lights the lamps: keeps them awake, within their limits, and dark at the end."""

from __future__ import annotations

import threading
import time
from types import TracebackType

import numpy as np

from lightstage.errors import CaptureError, DeviceError, LightstageError
from lightstage.interrupts import signals_put_off
from lightstage.leds.controller import Hello, LedController, LightLostError, require_levels
from lightstage.leds.guard import Guardians, last_wills
from lightstage.rig import Rig
from lightstage.safety.budget import FlashCounter, Spent
from lightstage.safety.plan import SafetyConfig

AWAKE_S = 0.5
"""A device receives a packet at least so often, or four times in its watchdog's time, or as often
as its protocol requires."""
SLACK_S = 0.5
"""Beyond what the plan allowed a state, until the lights are put out."""
MAY_BE_ON = "The lights may still be on: switch their power supply off."


class SafeLights:
    """The lights as a capture has them (LedController): `with SafeLights(...) as lights`.

    Only inside the `with` can a light go on, and at its end all are dark, or the message warns that
    they may not be. Meanwhile a thread keeps the device awake and puts the lights out when a state
    stays longer than the plan allowed; a guardian process does so when this one is killed or
    hangs. Several threads may call.

    Args:
        lights: the device; nobody else may talk to it meanwhile.
        config: limits.
        rig: the lights' names.
        shot_worst_s: longest that one state may stay lit; without it, as long as the budgets last.

    Raises:
        LightLostError: what is lit is not what was set: `recover`, then light and shoot again.
        DeviceError: the device fails otherwise, or a limit would be broken.
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
        self._shot_worst_s = shot_worst_s
        self._turn = threading.Lock()
        self._state = threading.Condition()
        self._flashes = FlashCounter(len(rig.lights))
        self._spent = Spent(len(rig.lights), config.heat_time_constant_s)
        self._number = 0  # of the state; one more with each light and each dark
        self._lit_number = 0
        self._failure: LightstageError | None = None
        self._changed_s = self._heard_s = -np.inf
        self._until_s = np.inf
        self._guardian: Guardians | None = None
        self._stop = threading.Event()
        self._threads: list[threading.Thread] = []
        self._sending = False  # a light is on its way to the device
        watchdog_s = lights.hello.watchdog_s
        asked_s = min(AWAKE_S, watchdog_s / 4 if watchdog_s else AWAKE_S)
        self._awake_s = lights.hello.keep_alive_s or asked_s

    @property
    def hello(self) -> Hello:
        """Who is there."""
        return self._lights.hello

    @property
    def acknowledged(self) -> bool:
        """Whether the device reports what is lit."""
        return self._lights.acknowledged

    @property
    def pulse_hz(self) -> float | None:
        """How often a second the lights are switched to dim them."""
        return self._lights.pulse_hz

    @property
    def state(self) -> int:
        """Number of what was asked for last: another with every light and every dark."""
        return self._number

    @property
    def lit_state(self) -> int:
        """`state` of the last light that was lit: another one since then is not that light."""
        return self._lit_number

    @property
    def guardian_pid(self) -> int | None:
        """The process that makes the lights dark if this one is killed; None where none can.

        Of several devices, that of the first.
        """
        return None if self._guardian is None else self._guardian.pids[0]

    def light(self, levels: np.ndarray) -> np.ndarray:
        """Wait until light may change, then light; returns what is driven.

        Args:
            levels: (n,) in 0..1, in the rig's order.

        Raises:
            LightLostError: dark was asked for meanwhile, or the device lost the light.
            DeviceError: levels out of range, or a lamp whose time or warmth is used up.
        """
        require_levels(levels)
        if len(levels) != len(self._rig.lights):
            expected = f"{len(self._rig.lights)}, as in the rig"
            raise DeviceError("levels", found=str(len(levels)), expected=expected)
        with self._turn:
            if not self._threads or self._stop.is_set():
                raise DeviceError("lights", found="no watch over them", expected="`with` around it")
            with self._state:
                number = self._number = self._number + 1
                self._wait_to_change(levels, number)
                allowed_s = self._allowed_s(levels)
                self._failure = None
                self._spent.light(time.monotonic(), levels)
                self._until_s = time.monotonic() + allowed_s + SLACK_S
            try:
                self._sending = True
                driven = self._lights.light(levels)
            finally:
                self._sending = False
                self._note_change()
            if self._number != number:
                # Dark was asked for, and done, just before this light was sent.
                self.dark()
                raise _put_out_meanwhile()
            self._lit_number = number
            return driven

    def confirm(self) -> None:
        """DeviceError unless the lights are, and have been all the time, as last set."""
        self._raise_failure()
        self._ask()
        self._raise_failure()

    def dark(self) -> None:
        """All lights off, at once; a light that waits for its turn stays off too."""
        with self._state:
            self._number += 1
            self._state.notify_all()
        self._lights.dark()
        self._note_dark()

    def recover(self) -> Hello:
        """After LightLostError: greet the device again, dark; then the shot may be taken again."""
        with self._turn:
            self._dismiss_guardian()  # it has the lock of a line that may have to be opened anew
            with self._state:
                self._number += 1
            hello = self._lights.recover()
            self._set_guardian()
            self._note_dark()
            self._failure = None
            return hello

    def close(self) -> None:
        """Dark, then the port is given back."""
        self.__exit__(None, None, None)
        self._lights.close()

    def __enter__(self) -> SafeLights:
        self._stop.clear()
        self._set_guardian()
        self._threads = [
            threading.Thread(target=work, name=f"lights{work.__name__}", daemon=True)
            for work in (self._watch, self._keep_awake)
        ]
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with signals_put_off():
            self._stop.set()
            try:
                self.dark()
            except LightstageError as failure:
                if kind is None:
                    raise DeviceError(f"{failure} {MAY_BE_ON}") from None
                reason = str(error) or kind.__name__
                raise CaptureError(f"{reason}\n  then: {failure} {MAY_BE_ON}") from error
            finally:
                with self._turn:
                    pass  # a light that was under way in another thread is out again
                for thread in self._threads:
                    thread.join()
                self._threads = []
                self._dismiss_guardian()

    def _wait_to_change(self, levels: np.ndarray, number: int) -> None:
        """Wait until light may change again; LightLostError when it is put out meanwhile."""
        while True:
            now_s = time.monotonic()
            left_s = max(
                self._changed_s + self.config.light_interval_s - now_s,
                self._flashes.wait_s(now_s, levels, self.config.max_flashes_per_s),
            )
            if self._number != number:
                raise _put_out_meanwhile()
            if left_s <= 0:
                return
            self._state.wait(left_s)

    def _allowed_s(self, levels: np.ndarray) -> float:
        """How long these levels may last; DeviceError when that is too short."""
        config = self.config
        self._spent.advance(time.monotonic())
        allowed = self._spent.allowed_s(levels, config.max_light_on_s, config.max_heat)
        place = int(np.argmin(allowed))
        needed_s = 1e-3 if self._shot_worst_s is None else self._shot_worst_s
        if allowed[place] >= needed_s:
            return float(allowed[place]) if self._shot_worst_s is None else needed_s
        light = self._rig.lights[place]
        on_s, heat = self._spent.on_s[place], self._spent.heat[place]
        raise DeviceError(
            "lights",
            field="budget",
            found=f"lamp {light.id} ({light.name}) on for {on_s:.0f} s at full level so far, at "
            f"{heat:.2f} of full power's warmth: {allowed[place]:.3g} s left for this state",
            expected=f"{needed_s:.3g} s within max_light_on_s {config.max_light_on_s:g} and "
            f"max_heat {config.max_heat:g}",
            hint="Let the lamps cool for some minutes, then continue in a new capture.",
        )

    def _note_change(self) -> None:
        """The lights have changed, at the latest now."""
        with self._state:
            self._changed_s = self._heard_s = time.monotonic()
            self._flashes.add(self._changed_s, self._spent.levels)

    def _note_dark(self) -> None:
        """All lights are off."""
        with self._state:
            was_lit = bool(self._spent.levels.any())
            self._spent.light(time.monotonic(), np.zeros(len(self._rig.lights)))
            self._until_s = np.inf
            if was_lit:
                self._note_change()

    def _raise_failure(self) -> None:
        failure = self._failure
        if failure is not None:
            raise type(failure)(str(failure))

    def _fail(self, failure: LightstageError, number: int) -> None:
        """Keep for `confirm` what happened to a state, unless another is lit by now."""
        with self._state:
            if self._number == number and self._failure is None:
                self._failure = failure

    def _set_guardian(self) -> None:
        try:
            wills = last_wills(self._lights)
            if wills:
                self._guardian = Guardians(wills, self.config.max_silence_s)
        except (OSError, ValueError) as error:
            raise LightLostError(
                "lights", field="guardian", found=str(error), expected="a line that is open"
            ) from None

    def _dismiss_guardian(self) -> None:
        if self._guardian is not None:
            self._guardian.goodbye()
            self._guardian = None

    def _keep_awake(self) -> None:
        """Send to the device during every wait; one that does not answer gets its state again."""
        pause_s = self._awake_s / 2
        while not self._stop.wait(pause_s):
            with self._state:
                number = self._number
                lit = bool(self._spent.levels.any()) or not self._lights.acknowledged
                left_s = self._heard_s + self._awake_s - time.monotonic()
            pause_s = self._awake_s / 2
            if not lit or self._failure is not None:
                continue  # nothing to keep awake
            if self._sending and self._lights.acknowledged:
                continue  # its answer is waited for
            if left_s > 0:
                pause_s = min(pause_s, left_s)
                continue
            try:
                self._ask()
            except LightstageError as failure:
                self._fail(failure, number)

    def _ask(self) -> None:
        """Ask the device what is lit. Its watchdog counts from the question, not the answer."""
        asked_s = time.monotonic()
        self._lights.confirm()
        self._heard_s = asked_s

    def _watch(self) -> None:
        """Report to the guardian that we live, and put out what stays too long.

        Apart from keeping the device awake: an answer that does not come must not hold this up.
        """
        while not self._stop.wait(self._awake_s / 2):
            guardian = self._guardian
            if guardian is not None and guardian.alive:
                guardian.beat()
            with self._state:
                number = self._number
                lit = bool(self._spent.levels.any())
                overdue = lit and time.monotonic() > self._until_s
            try:
                if guardian is not None and not guardian.alive:
                    self._mourn(guardian, number)
                elif overdue:
                    self._put_out(number)
            except LightstageError as failure:
                self._fail(failure, number)

    def _put_out(self, number: int) -> None:
        """Dark, because this state has stayed too long; nothing where the next is under way."""
        if not self._turn.acquire(blocking=False):
            return
        try:
            if self._number == number:
                expected = "within max_light_on_s and max_heat"
                if self._shot_worst_s is not None:
                    expected = f"at most {self._shot_worst_s:g} s"
                found = "put out: this state stayed longer than the plan allows"
                self._fail(LightLostError("lights", found=found, expected=expected), number)
                self.dark()
        finally:
            self._turn.release()

    def _mourn(self, guardian: Guardians, number: int) -> None:
        """The guardian has ended: it took this process for dead, or was killed itself."""
        if not self._turn.acquire(blocking=False):
            return  # a light is under way; the next look will do
        try:
            if self._guardian is guardian:  # else dismissed, as it should be
                found = "it has ended, and put the lights out if this process hung"
                expected = "one that watches"
                self._fail(
                    LightLostError("lights", field="guardian", found=found, expected=expected),
                    number,
                )
                self._guardian = None
                guardian.goodbye()  # those of other devices may live
                self._set_guardian()
        finally:
            self._turn.release()


def _put_out_meanwhile() -> LightLostError:
    return LightLostError("lights", found="put out by another thread", expected="a light to stay")
