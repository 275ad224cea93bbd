"""Every controller against its simulated device, over real terminals and sockets."""

from __future__ import annotations

import socket
import threading

import numpy as np
import pytest

from lightstage.errors import ConfigError, DeviceError
from lightstage.leds import connection, serial_port
from lightstage.leds.controller import LightLostError
from lightstage.leds.opening import open_leds
from sim.devices.adalight_device import AdalightDevice
from sim.devices.led_device import LedDevice
from sim.devices.sacn_device import SacnDevice
from tests.waiting import until

KINDS = ("pty", "socket", "adalight", "sacn")


def unwatched(levels):
    """Nobody looks."""


def far_end(kind, lights=8, **more):
    if kind == "adalight":
        return AdalightDevice(lights, unwatched, **more)
    if kind == "sacn":
        return SacnDevice(lights, unwatched, **more)
    return LedDevice(lights, unwatched, over=kind, **more)


def url(device, **more):
    options = "&".join(f"{key}={value}" for key, value in more.items())
    if isinstance(device, LedDevice):
        return f"{device.url(20.0, 2)}&{options}".rstrip("&")
    return device.url(options)


def shines(device, driven):
    return np.array_equal(device.states[-1].counts, np.round(driven * 65535))


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_driven_is_what_shines_and_dark_is_dark(kind):
    levels = np.random.default_rng(1).random(8)
    with far_end(kind) as device, open_leds(url(device), 8) as leds:
        assert leds.hello.light_count == 8
        assert leds.acknowledged == (kind in ("pty", "socket"))
        driven = leds.light(levels)
        step = 1 / 65535 if leds.acknowledged else 1 / 255
        assert np.abs(driven - levels).max() <= step / 2 + 1e-9
        until(lambda: shines(device, driven))
        leds.confirm()
        leds.dark()
        until(lambda: device.dark)


@pytest.mark.parametrize("kind", KINDS)
def test_ten_thousand_lights_shine_as_driven(kind):
    levels = np.random.default_rng(2).random(10_000)
    more = {"baud": 4_000_000} if kind == "adalight" else {}
    with far_end(kind, 10_000) as device, open_leds(url(device, **more), 10_000) as leds:
        driven = leds.light(levels)
        until(lambda: shines(device, driven))
        leds.confirm()
        leds.dark()
        until(lambda: device.dark)
        if kind == "sacn":
            assert (device.lost, device.dropped, device.malformed) == (0, 0, 0)


def test_ten_thousand_lights_on_a_slow_line_are_refused_before_it_is_opened():
    with pytest.raises(ConfigError, match=r"timeout_s: found 2 for 10000 lamps.*1\.7 s at 115200"):
        open_leds("serial:///dev/none?baud=115200", 10_000)


@pytest.mark.parametrize("url", ["pty:///dev/none", "socket://h:1", "adalight:///dev/none"])
def test_more_lights_than_a_wire_can_count_are_refused_before_it_is_opened(url):
    with pytest.raises(ConfigError, match="found 65536 lamps in the rig, expected at most 65535"):
        open_leds(url, 65536)


def test_more_lights_than_universes_are_refused():
    with pytest.raises(ConfigError, match="universe: found 65535 lamps up to universe 66037"):
        open_leds("sacn://127.0.0.1?universe=63990&channels=16", 65535)


@pytest.mark.parametrize("kind", KINDS)
def test_a_second_capture_on_one_device_is_refused_and_the_first_goes_on(kind, monkeypatch):
    monkeypatch.setattr(connection, "BUSY_WAIT_S", 0.1)
    monkeypatch.setattr(serial_port, "BUSY_WAIT_S", 0.1)
    with far_end(kind) as device, open_leds(url(device), 8) as leds:
        with pytest.raises(DeviceError, match=r"another program that is using it.*Two on one"):
            open_leds(url(device), 8)
        driven = leds.light(np.full(8, 0.25))
        until(lambda: shines(device, driven))


@pytest.mark.parametrize("kind", KINDS)
def test_a_device_given_back_may_be_opened_again(kind):
    with far_end(kind) as device:
        for _ in range(2):
            with open_leds(url(device), 8) as leds:
                leds.light(np.ones(8))


def test_a_port_that_is_given_back_in_time_is_waited_for():
    with far_end("pty") as device, open_leds(url(device), 8) as leds:
        later = threading.Timer(0.1, leds.close)
        later.start()
        with open_leds(url(device), 8) as second:
            second.light(np.ones(8))
        later.join()


def test_a_device_that_serves_another_machine_turns_this_one_away_until_it_is_free():
    with far_end("socket") as device:
        host, port = device.path.split(":")
        other = socket.create_connection((host, int(port)))
        until(device.connected.is_set)
        later = threading.Timer(0.2, other.close)
        later.start()
        with open_leds(url(device), 8) as leds:
            leds.light(np.ones(8))
        later.join()
        with socket.create_connection((host, int(port))):
            until(device.connected.is_set)
            with pytest.raises(DeviceError, match="a line that stays open"):
                open_leds(url(device), 8)


def test_nobody_at_the_other_end_is_reported():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    with pytest.raises(DeviceError, match="refused, expected a port that opens"):
        open_leds(f"socket://127.0.0.1:{port}", 8)
    with pytest.raises(DeviceError, match="a host and a network that are there"):
        open_leds("sacn://no-such-host.invalid", 8)
    with pytest.raises(DeviceError, match=r"found no such host, expected a name .*spelled right"):
        open_leds("socket://no-such-host.invalid:5000", 8)
    with pytest.raises(DeviceError, match="a port that opens"):
        open_leds("adalight:///dev/tty-none", 8)


@pytest.mark.parametrize("kind", ["adalight", "sacn"])
def test_a_wrong_count_or_level_sends_nothing_to_a_device_that_cannot_refuse(kind):
    with far_end(kind) as device, open_leds(url(device, gamma=2), 8) as leds:
        for wrong in (np.ones(7), np.full(8, 1.1), np.full(8, -0.01), np.full(8, np.nan)):
            with pytest.raises(DeviceError, match="levels"):
                leds.light(wrong)
        leds.light(np.ones(8))
        until(lambda: len(device.states) == 2)


def test_a_connection_that_breaks_is_lost_light_and_is_opened_again():
    with far_end("socket") as device, open_leds(url(device), 8) as leds:
        leds.light(np.ones(8))
        device._end._host.shutdown(socket.SHUT_RDWR)
        until(lambda: not device.connected.is_set())
        with pytest.raises(LightLostError, match="a line that stays open"):
            leds.confirm()
        leds.recover()
        assert device.dark
        driven = leds.light(np.full(8, 0.5))
        assert shines(device, driven)


def test_a_terminal_that_hangs_up_is_lost_light():
    device = far_end("pty")
    with device:
        leds = open_leds(url(device), 8)
        leds.light(np.ones(8))
    with leds, pytest.raises(LightLostError, match="a line that stays open"):
        leds.confirm()


@pytest.mark.parametrize("over", ["pty", "socket"])
def test_a_devices_own_watchdog_puts_silent_lights_out_and_the_host_learns_it(over):
    with far_end(over, watchdog_s=0.1) as device, open_leds(url(device), 8) as leds:
        assert leds.hello.watchdog_s == 0.1
        leds.light(np.ones(8))
        until(lambda: device.dark)
        with pytest.raises(LightLostError, match="not as they were set"):
            leds.confirm()
        leds.recover()
        assert shines(device, leds.light(np.ones(8)))
