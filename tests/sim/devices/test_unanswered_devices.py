"""Devices that never answer: faults happen to them, and nobody is told."""

from __future__ import annotations

import numpy as np
import pytest

from lightstage.leds import e131
from lightstage.leds.opening import open_leds
from sim.devices.adalight_device import AdalightDevice
from sim.devices.faults import Fault, Story
from sim.devices.sacn_device import SacnDevice
from sim.errors import SimError
from tests.waiting import until

DEVICES = (AdalightDevice, SacnDevice)
ONCE = "attempts=1&settle_s=0"


def shown(device):
    return (device.states[-1].counts / 65535).tolist()


@pytest.mark.parametrize("make", DEVICES)
def test_a_dropped_packet_is_made_good_by_the_next_repetition(make):
    with make(2, lambda _: None, story=Story([Fault("drop", at=1)])) as device:
        with open_leds(device.url("attempts=2&settle_s=0"), 2) as leds:
            leds.light(np.ones(2))
            until(lambda: shown(device) == [1, 1])
        assert device.log.names() == ["drop"]


@pytest.mark.parametrize("make", DEVICES)
def test_lamps_that_are_broken_shine_otherwise_than_driven(make):
    story = Story([Fault("stuck-on", lights=[0]), Fault("dead-light-hidden", lights=[2])])
    with make(3, lambda _: None, story=story) as device, open_leds(device.url(ONCE), 3) as leds:
        driven = leds.light(np.array([0.0, 1.0, 1.0]))
        assert driven.tolist() == [0, 1, 1]
        until(lambda: shown(device) == [1, 1, 0])


@pytest.mark.parametrize("make", DEVICES)
def test_a_reset_is_dark_until_the_state_is_sent_again(make):
    story = Story([Fault("reset", at=2, seconds=0.0)])
    with make(2, lambda _: None, story=story) as device, open_leds(device.url(ONCE), 2) as leds:
        leds.light(np.ones(2))
        until(lambda: shown(device) == [1, 1])
        leds.confirm()
        until(lambda: device.dark)
        leds.confirm()
        until(lambda: shown(device) == [1, 1])


@pytest.mark.parametrize("make", DEVICES)
def test_a_dead_device_keeps_its_lights(make):
    with make(2, lambda _: None, story=Story([Fault("die", at=2)])) as device:
        with open_leds(device.url(ONCE), 2) as leds:
            leds.light(np.ones(2))
            until(lambda: shown(device) == [1, 1])
            leds.dark()
        until(lambda: "die" in device.log.names())
        assert shown(device) == [1, 1]


@pytest.mark.parametrize("make", DEVICES)
def test_a_damaged_packet_never_takes_the_device_down(make):
    story = Story([Fault("corrupt", probability=0.5, bits=8)], seed=4)
    with make(4, lambda _: None, story=story) as device, open_leds(device.url(ONCE), 4) as leds:
        for number in range(60):
            leds.light(np.full(4, number / 60))
        until(lambda: len(device.log.names()) > 10)
    assert device.failure is None


@pytest.mark.parametrize("make", DEVICES)
def test_a_light_that_is_not_there_cannot_be_faulty(make):
    with pytest.raises(SimError, match="expected 0 to 1"):
        make(2, lambda _: None, story=Story([Fault("stuck-on", lights=[2])]))


def test_a_late_or_lost_e131_packet_is_counted_and_a_late_one_lights_nothing():
    device = SacnDevice(1, lambda _: None)

    def send(sequence, level, cid=bytes(16), priority=100):
        packet = e131.data_packet(cid, "x", 1, sequence, bytes([level]), priority)
        list(device._feed(packet))
        return device._leds.counts[0] // 257

    assert send(250, 10) == 10
    assert send(252, 20) == 20
    assert device.lost == 1
    assert send(251, 30) == 20
    assert send(252, 30) == 20
    assert device.dropped == 2
    assert send(3, 40) == 40
    # So far behind that it is a source that began anew.
    assert send(200, 50) == 50
    # Another source of the same priority does not count, one of a higher one does.
    assert send(1, 60, bytes([1] * 16)) == 50
    assert device.strangers == 1
    assert send(1, 70, bytes([2] * 16), 101) == 70
    assert send(201, 80) == 70
    with device:
        pass


def test_what_is_no_e131_packet_of_these_universes_is_counted_and_passed_over():
    device = SacnDevice(1, lambda _: None, universe=5)
    for data in (b"", b"Art-Net\0", e131.data_packet(bytes(16), "x", 4, 0, b"\xff")):
        list(device._feed(data))
    assert device.malformed == 3
    assert not device._leds.counts.any()
    with device:
        pass
