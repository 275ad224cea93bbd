"""Lights in the rig's order, on one or several devices that count them by their own channels."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from lightstage.closing import Closing
from lightstage.errors import DeviceError, LightstageError
from lightstage.leds.controller import Hello, LedController, LightLostError
from lightstage.leds.guard import LastWill, last_wills
from lightstage.rig import LightAddress


class WiredLeds(Closing):
    """A controller (LedController) whose lights are at the rig's addresses.

    Several devices do each request at the same time, so that the slowest one alone is waited for;
    where one fails, the others have done theirs, and the request fails. Channels that no light has
    stay dark.

    Args:
        devices: by the name of the controller in the rig; each takes levels in the order of its
            channels.
        addresses: of each light of the rig, none twice, on these devices.
    """

    def __init__(
        self, devices: Mapping[str, LedController], addresses: Sequence[LightAddress]
    ) -> None:
        self._devices = dict(devices)
        self.rewire(addresses)

    @property
    def counts(self) -> dict[str, int]:
        """How many channels each device has, by its controller's name."""
        return {name: device.hello.light_count for name, device in self._devices.items()}

    @property
    def hello(self) -> Hello:
        """Who is there; the lamp count is that of all channels."""
        hellos = {name: device.hello for name, device in self._devices.items()}
        if len(hellos) == 1:
            return next(iter(hellos.values()))
        watchdogs = [each.watchdog_s for each in hellos.values()]
        known = [each for each in watchdogs if each is not None]
        repeats = [each.keep_alive_s for each in hellos.values() if each.keep_alive_s is not None]
        return Hello(
            0,
            sum(each.light_count for each in hellos.values()),
            "; ".join(f"{name}: {each.firmware}" for name, each in hellos.items()),
            max(known) if len(known) == len(watchdogs) else None,
            self.pulse_hz,
            # The device that goes dark first, or repeats most often, sets the interval for all.
            min([*repeats, *(each / 4 for each in known)], default=None),
        )

    @property
    def acknowledged(self) -> bool:
        """Whether every device reports what is lit."""
        return all(device.acknowledged for device in self._devices.values())

    @property
    def pulse_hz(self) -> float | None:
        """How often a second lights are switched to dim them; None where devices differ."""
        found = {device.pulse_hz for device in self._devices.values()}
        return found.pop() if len(found) == 1 else None

    def light(self, levels: np.ndarray) -> np.ndarray:
        """Set all lights, each on its own channel; (n,) in and out, in the rig's order."""
        driven = np.zeros(len(levels))

        def light(name: str, device: LedController) -> None:
            places, channels = self._wires[name]
            # A device of fewer channels refuses the levels; a preflight has reported it before.
            count = max(device.hello.light_count, channels.max(initial=-1) + 1)
            line = np.zeros(count)
            line[channels] = levels[places]
            driven[places] = np.asarray(device.light(line))[channels]

        self._each(light)
        return driven

    def rewire(self, addresses: Sequence[LightAddress]) -> None:
        """Use these addresses from the next light on."""
        wires = {}
        for name in self._devices:
            places = [i for i, each in enumerate(addresses) if each.controller == name]
            channels = [addresses[i].channel for i in places]
            wires[name] = np.array(places, int), np.array(channels, int)
        self._wires = wires

    def confirm(self) -> None:
        """Ask what is lit."""
        self._each(lambda _, device: device.confirm())

    def dark(self) -> None:
        """All channels of all devices off."""
        self._each(lambda _, device: device.dark())

    def recover(self) -> Hello:
        """Greet the devices again, dark."""
        self._each(lambda _, device: device.recover())
        return self.hello

    def last_wills(self) -> tuple[LastWill, ...]:
        """Each device's own: all channels off."""
        return tuple(will for device in self._devices.values() for will in last_wills(device))

    def close(self) -> None:
        """Give the ports back."""
        for device in self._devices.values():
            device.close()

    def _each(self, act: Callable[[str, LedController], object]) -> None:
        """Do something with all devices at the same time; what failed is raised after all ended."""
        if len(self._devices) == 1:
            ((name, device),) = self._devices.items()
            act(name, device)
            return
        failed: list[tuple[str, BaseException]] = []

        def work(name: str, device: LedController) -> None:
            try:
                act(name, device)
            except BaseException as error:
                failed.append((name, error))

        threads = [
            threading.Thread(target=work, args=item, name=f"leds {item[0]}", daemon=True)
            for item in self._devices.items()
        ]
        try:
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
        except BaseException:
            # A stop: what is under way must not light anything after the dark that follows it.
            for device in self._devices.values():
                with contextlib.suppress(LightstageError):
                    device.dark()
            for thread in threads:
                if thread.ident is not None:
                    thread.join()
            raise
        _raise_all(failed)


def _raise_all(failed: Sequence[tuple[str, BaseException]]) -> None:
    """Raise what devices failed with, by name; lost light only where nothing else is wrong."""
    if not failed:
        return
    for _, error in failed:
        if not isinstance(error, LightstageError):
            raise error
    lost = all(isinstance(error, LightLostError) for _, error in failed)
    errors = "; ".join(
        f"{name}: {error}" for name, error in sorted(failed, key=lambda each: each[0])
    )
    raise (LightLostError if lost else DeviceError)(errors)
