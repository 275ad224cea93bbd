"""A rig's addresses say on which channel of the device each light is, on every kind of device."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest

from lightstage.errors import RigError
from lightstage.leds.guard import Guardian
from lightstage.leds.opening import open_leds, open_rig_leds
from lightstage.rig import LightAddress, Rig
from tests.lightstage.conftest import make_rig
from tests.lightstage.leds.test_opening import KINDS, far_end, shines, until, url

CHANNELS = (5, 0, 9, 2, 7, 1, 3, 4)
"""Of eight lights; channels 6 and 8 have none."""


def wired(channels=CHANNELS, controllers=("main",) * 8) -> Rig:
    rig = make_rig()
    lights = [
        dataclasses.replace(light, address=LightAddress(channel, controller))
        for light, channel, controller in zip(rig.lights, channels, controllers, strict=True)
    ]
    return dataclasses.replace(rig, lights=tuple(lights))


@pytest.mark.parametrize("kind", KINDS)
def test_each_light_shines_on_its_own_channel_and_free_channels_stay_dark(kind):
    levels = np.random.default_rng(1).uniform(0.1, 1, 8)
    with far_end(kind, 10) as device, open_rig_leds(url(device), wired()) as leds:
        driven = leds.light(levels)
        assert np.abs(driven - levels).max() < 1 / 255
        line = np.zeros(10)
        line[list(CHANNELS)] = driven
        until(lambda: shines(device, line))
        leds.confirm()
        leds.recover()
        assert leds.hello.light_count == 10
        leds.light(np.eye(8)[2])
        until(lambda: shines(device, np.eye(10)[9]))
        leds.dark()
        until(lambda: device.dark)


@pytest.mark.parametrize("kind", KINDS)
def test_a_rig_without_addresses_lights_as_one_that_counts_its_list(kind):
    levels = np.random.default_rng(2).random(8)
    for rig in (make_rig(), wired(range(8))):
        with far_end(kind) as device, open_rig_leds(url(device), rig) as leds:
            driven = leds.light(levels)
            until(functools.partial(shines, device, driven))
        with far_end(kind) as device, open_leds(url(device), 8) as leds:
            assert np.array_equal(leds.light(levels), driven)


def test_a_device_of_more_channels_than_a_rig_with_addresses_needs_is_lit():
    with far_end("pty", 16) as device, open_rig_leds(url(device), wired()) as leds:
        leds.light(np.ones(8))
        assert [int(i) for i in np.flatnonzero(device.states[-1].counts)] == sorted(CHANNELS)


def test_a_guardian_makes_all_channels_dark():
    with far_end("socket", 10) as device, open_rig_leds(url(device), wired()) as leds:
        leds.light(np.ones(8))
        guardian = Guardian(leds.last_will(), 60.0)
        guardian.leave()
        assert device.dark


def test_lights_of_two_controllers_are_refused_where_one_is_opened():
    rig = wired(controllers=("left",) * 4 + ("right",) * 4)
    with pytest.raises(RigError, match=r"2 controllers \(left, right\), expected one"):
        open_rig_leds("pty:///dev/pts/none", rig)
