"""A rig's addresses say on which channel of the device each light is, on every kind of device."""

from __future__ import annotations

import contextlib
import dataclasses
import functools

import numpy as np
import pytest

from lightstage.errors import ConfigError
from lightstage.leds.address import parse_leds, parse_url, worst_answer_s
from lightstage.leds.controller import LightLostError
from lightstage.leds.guard import Guardians, last_wills
from lightstage.leds.opening import open_leds, open_rig_leds
from lightstage.rig import LightAddress, Rig
from sim.devices.faults import Fault, Story
from tests.lightstage.conftest import make_rig
from tests.lightstage.leds.test_opening import KINDS, far_end, shines, url
from tests.waiting import until

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
        guardians = Guardians(last_wills(leds), 60.0)
        guardians.leave()
        assert device.dark


TWO = ("left", "right") * 4


@contextlib.contextmanager
def two(kinds=("pty", "pty"), **more):
    """Two devices, and the lights of a rig that are on them by turns."""
    left, right = kinds
    with (
        far_end(left, 10, **more) as one,
        far_end(right, 10) as other,
        open_rig_leds(f"left={url(one)},right={url(other)}", wired(controllers=TWO)) as leds,
    ):
        yield one, other, leds


def line_of(levels, name):
    """What a controller's channels should show."""
    line = np.zeros(10)
    for level, channel, controller in zip(levels, CHANNELS, TWO, strict=True):
        line[channel] = level if controller == name else 0
    return line


@pytest.mark.parametrize("kinds", [("pty", "socket"), ("adalight", "sacn"), ("pty", "sacn")])
def test_lights_of_two_controllers_shine_each_on_its_own(kinds):
    levels = np.random.default_rng(3).uniform(0.1, 1, 8)
    with two(kinds) as (one, other, leds):
        driven = leds.light(levels)
        until(lambda: shines(one, line_of(driven, "left")))
        until(lambda: shines(other, line_of(driven, "right")))
        leds.confirm()
        assert leds.acknowledged == (kinds == ("pty", "socket"))
        # Without an answer nobody knows of more channels than the rig needs.
        assert leds.hello.light_count == {"pty": 10, "adalight": 10}[kinds[0]] + (
            10 if kinds[1] == "socket" else 5
        )
        leds.dark()
        until(lambda: one.dark and other.dark)


def test_guardians_make_all_controllers_dark():
    with two() as (one, other, leds):
        leds.light(np.ones(8))
        guardians = Guardians(last_wills(leds), 60.0)
        assert guardians.alive
        assert len(set(guardians.pids)) == 2
        guardians.leave()
        assert one.dark
        assert other.dark


def test_a_reset_of_one_controller_is_lost_light_and_both_recover_dark():
    with two(story=Story([Fault("reset", at=3, seconds=0.0)])) as (one, other, leds):
        leds.light(np.ones(8))
        with pytest.raises(LightLostError, match=r"left: .*boot id"):
            leds.confirm()
        assert not other.dark
        leds.recover()
        assert one.dark
        assert other.dark


def test_a_stop_in_the_middle_of_a_light_leaves_nothing_lit():
    with two() as (one, other, leds):

        def light(levels):
            raise KeyboardInterrupt

        leds.light(np.ones(8))
        leds._devices["left"].light = light
        with pytest.raises(KeyboardInterrupt):
            leds.light(np.ones(8))
        leds.dark()
        assert one.dark
        assert other.dark


def test_urls_are_read_by_the_names_of_their_controllers():
    one, other = "serial:///dev/ttyA,B?baud=115200", "sacn://multicast?universe=3"
    assert parse_leds(one) == {"": parse_url(one)}
    both = parse_leds(f"left={one},right={other}")
    assert both == {"left": parse_url(one), "right": parse_url(other)}
    assert worst_answer_s(f"left={one}&timeout_s=9,right={other}") == 27.0
    with pytest.raises(ConfigError, match="expected serial"):
        parse_leds("left=nothing:///x")
