"""SafeLights: what it refuses, what it waits for, and how it ends."""

from __future__ import annotations

import os
import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from lightstage.errors import CaptureError, DeviceError
from lightstage.leds.controller import Hello, LightLostError
from lightstage.leds.opening import open_leds
from lightstage.safety import SafeLights, SafetyConfig
from lightstage.safety import lights as safe_lights
from sim.devices.faults import Fault, Story
from sim.devices.led_device import LedDevice
from sim.devices.sacn_device import SacnDevice
from tests.waiting import until

QUICK = SafetyConfig(light_interval_s=0.0, max_flashes_per_s=30.0)
FULL = np.ones(8)


class Lamps:
    """A controller without a device, which notes what is asked of it and when."""

    pulse_hz = None

    def __init__(self, acknowledged=True, watchdog_s=None):
        self.acknowledged = acknowledged
        self.hello = Hello(1, 8, "lamps", watchdog_s)
        self.asked = []
        self.times_s = []
        self.fails = {}
        self.levels = FULL

    def _ask(self, what):
        self.asked.append(what)
        if what in self.fails:
            raise self.fails[what]

    def light(self, levels):
        self._ask("light")
        self.times_s.append(time.monotonic())
        self.levels = levels
        return levels

    def confirm(self):
        self._ask("confirm")

    def dark(self):
        self._ask("dark")
        self.levels = np.zeros(8)

    def recover(self):
        self._ask("recover")
        self.levels = np.zeros(8)
        return self.hello

    def close(self):
        self._ask("close")


def test_outside_of_its_with_no_light_goes_on(small_rig):
    lamps = Lamps()
    lights = SafeLights(lamps, QUICK, small_rig)
    with pytest.raises(DeviceError, match="no watch over them"):
        lights.light(FULL)
    with lights:
        lights.light(FULL)
    with pytest.raises(DeviceError, match="no watch over them"):
        lights.light(FULL)
    assert not lamps.levels.any()
    assert lamps.asked == ["light", "dark"]


def test_closing_is_dark_first(small_rig):
    lamps = Lamps()
    with SafeLights(lamps, QUICK, small_rig) as lights:
        lights.light(FULL)
        lights.close()
        assert lamps.asked == ["light", "dark", "close"]


@pytest.mark.parametrize("error", [ValueError("x"), KeyboardInterrupt(), SystemExit(3)])
def test_an_error_passes_through_and_the_lights_are_dark(small_rig, error):
    lamps = Lamps()

    def capture():
        with SafeLights(lamps, QUICK, small_rig) as lights:
            lights.light(FULL)
            raise error

    with pytest.raises(type(error)):
        capture()
    assert lamps.asked == ["light", "dark"]


def test_lights_that_do_not_go_out_are_reported_with_what_happened_before(small_rig):
    lamps = Lamps()
    lamps.fails["dark"] = DeviceError("no answer")
    with (
        pytest.raises(DeviceError, match="no answer The lights may still be on: switch"),
        SafeLights(lamps, QUICK, small_rig) as lights,
    ):
        lights.light(FULL)
    with (
        pytest.raises(CaptureError, match=r"(?s)a camera.*then: no answer The lights may still"),
        SafeLights(lamps, QUICK, small_rig),
    ):
        raise DeviceError("a camera")


def test_signals_during_the_last_dark_are_put_off_until_it_is_done(small_rig):
    lamps = Lamps()

    def slow():
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(0.05)
        lamps.levels = np.zeros(8)

    lamps.dark = slow
    with (
        pytest.raises(KeyboardInterrupt),
        SafeLights(lamps, QUICK, small_rig) as lights,
    ):
        lights.light(FULL)
    assert not lamps.levels.any()


def test_changes_of_light_are_never_closer_than_the_interval(small_rig):
    lamps = Lamps()
    config = SafetyConfig(light_interval_s=0.05, max_flashes_per_s=30.0)
    with SafeLights(lamps, config, small_rig) as lights:
        for number in range(5):
            lights.light(np.full(8, number / 5))
    assert np.diff(lamps.times_s).min() >= 0.05


def test_light_never_flashes_faster_than_allowed_however_it_is_asked(small_rig):
    lamps = Lamps()
    config = SafetyConfig(light_interval_s=0.0, max_flashes_per_s=3.0)
    with SafeLights(lamps, config, small_rig) as lights:
        for number in range(8):
            lights.light(FULL * (number % 2 == 0))
    # Six changes in any second: the seventh comes later than a second after the first.
    times = np.array(lamps.times_s)
    assert (times[6:] - times[:-6]).min() > 1.0


@pytest.mark.parametrize(
    "wrong", [np.ones(7), np.full(8, 1.5), np.full(8, np.nan), np.ones((8, 1))]
)
def test_levels_that_are_none_are_refused(small_rig, wrong):
    lamps = Lamps()
    with SafeLights(lamps, QUICK, small_rig) as lights, pytest.raises(DeviceError, match="levels"):
        lights.light(wrong)
    assert "light" not in lamps.asked


@pytest.mark.parametrize(
    "limit", [{"max_light_on_s": 10.0}, {"max_heat": 0.2, "heat_time_constant_s": 50.0}]
)
def test_what_the_plan_could_not_know_is_refused_when_it_would_pass_a_limit(
    small_rig, limit, monkeypatch
):
    now = [100.0]
    config = SafetyConfig(light_interval_s=0.0, max_flashes_per_s=30.0, **limit)
    lamps = Lamps()
    with SafeLights(lamps, config, small_rig, shot_worst_s=6.0) as lights:
        monkeypatch.setattr(safe_lights.time, "monotonic", lambda: now[0])
        lights.light(FULL)
        now[0] += 6.0
        with pytest.raises(DeviceError, match=r"budget: found lamp 0 \(corner0\) on for 6 s"):
            lights.light(FULL)
        # Half as bright is half as long and half as warm.
        lights.light(FULL / 2)
        monkeypatch.undo()
    assert lamps.asked.count("light") == 2


def test_a_shot_that_overstays_its_plan_is_put_out_and_the_capture_learns_it(
    small_rig, monkeypatch
):
    monkeypatch.setattr(safe_lights, "SLACK_S", 0.0)
    lamps = Lamps(watchdog_s=0.04)
    with SafeLights(lamps, QUICK, small_rig, shot_worst_s=0.05) as lights:
        lights.light(FULL)
        until(lambda: not lamps.levels.any())
        for _ in range(2):
            with pytest.raises(LightLostError, match="longer than the plan allows"):
                lights.confirm()
        lights.recover()
        lights.light(FULL / 2)
        lights.confirm()


def test_without_a_plan_a_state_stays_as_long_as_the_budget_lasts(small_rig, monkeypatch):
    monkeypatch.setattr(safe_lights, "SLACK_S", 0.0)
    config = SafetyConfig(light_interval_s=0.0, max_flashes_per_s=30.0, max_light_on_s=0.1)
    lamps = Lamps(watchdog_s=0.04)
    with SafeLights(lamps, config, small_rig) as lights:
        lights.light(FULL)
        until(lambda: not lamps.levels.any())
        with pytest.raises(DeviceError, match="budget"):
            lights.light(FULL)


@pytest.mark.parametrize("acknowledged", [True, False])
def test_a_device_is_kept_awake_while_lit_and_one_that_never_answers_always(
    small_rig, acknowledged
):
    lamps = Lamps(acknowledged, watchdog_s=0.04)
    with SafeLights(lamps, QUICK, small_rig) as lights:
        if not acknowledged:
            until(lambda: lamps.asked.count("confirm") > 2)
        assert acknowledged == ("confirm" not in lamps.asked)
        lights.light(FULL)
        before = lamps.asked.count("confirm")
        until(lambda: lamps.asked.count("confirm") > before + 2)


def test_the_next_question_is_due_from_when_the_last_one_was_asked_not_answered(small_rig):
    lamps = Lamps(watchdog_s=60.0)
    asked_s = []

    def slow():
        asked_s.append(time.monotonic())
        time.sleep(0.02)

    lamps.confirm = slow
    with SafeLights(lamps, QUICK, small_rig) as lights:
        lights.light(FULL)
        lights.confirm()
        assert lights._heard_s <= asked_s[-1]
        # The device's own watchdog began then, at the earliest.
        assert lights._heard_s > lamps.times_s[-1]


def test_a_light_lost_meanwhile_is_reported_by_the_next_confirm_though_it_be_back(small_rig):
    lamps = Lamps(watchdog_s=0.04)
    with SafeLights(lamps, QUICK, small_rig) as lights:
        lights.light(FULL)
        lamps.fails["confirm"] = LightLostError("reset")
        before = lamps.asked.count("confirm")
        until(lambda: lamps.asked.count("confirm") > before)
        until(lambda: lights._failure is not None)
        lamps.fails.clear()
        with pytest.raises(LightLostError, match="reset"):
            lights.confirm()
        lights.light(FULL / 2)
        lights.confirm()


def test_dark_from_another_thread_keeps_a_waiting_light_off(small_rig):
    lamps = Lamps()
    config = SafetyConfig(light_interval_s=60.0)
    with SafeLights(lamps, config, small_rig) as lights:
        lights.light(FULL)
        with ThreadPoolExecutor(1) as pool:
            waits = pool.submit(lights.light, FULL / 2)
            until(lambda: lights._turn.locked())
            lights.dark()
            with pytest.raises(LightLostError, match="put out by another thread"):
                waits.result(30)
    assert lamps.asked.count("light") == 1


def test_a_light_that_comes_just_behind_a_dark_is_put_out_again(small_rig):
    lamps = Lamps()
    inside, go_on = threading.Event(), threading.Event()
    plain = lamps.light

    def late(levels):
        inside.set()
        assert go_on.wait(30)
        return plain(levels)

    lamps.light = late
    with SafeLights(lamps, QUICK, small_rig) as lights, ThreadPoolExecutor(1) as pool:
        sent = pool.submit(lights.light, FULL)
        assert inside.wait(30)
        lights.dark()
        go_on.set()
        with pytest.raises(LightLostError, match="put out by another thread"):
            sent.result(30)
        assert not lamps.levels.any()


def test_nine_threads_may_confirm_while_the_lights_change(small_rig):
    with (
        LedDevice(8, lambda _: None, watchdog_s=2.0) as device,
        open_leds(device.url(20.0), 8) as leds,
        SafeLights(leds, QUICK, small_rig) as lights,
        ThreadPoolExecutor(9) as pool,
    ):
        for number in range(10):
            driven = lights.light(np.full(8, number / 10))
            for asked in [pool.submit(lights.confirm) for _ in range(9)]:
                asked.result()
            assert np.array_equal(device.states[-1].counts, np.round(driven * 65535))


def test_a_device_with_a_watchdog_stays_lit_for_as_long_as_somebody_watches(small_rig):
    with (
        LedDevice(8, lambda _: None, watchdog_s=0.4) as device,
        open_leds(device.url(20.0), 8) as leds,
        SafeLights(leds, QUICK, small_rig) as lights,
    ):
        lights.light(FULL)
        time.sleep(1.2)
        lights.confirm()
        assert len(device.states) == 2


def test_a_host_that_waits_to_change_the_light_keeps_the_lit_one_awake(small_rig):
    config = SafetyConfig(light_interval_s=1.6)
    with (
        LedDevice(8, lambda _: None, watchdog_s=0.8) as device,
        open_leds(device.url(20.0), 8) as leds,
        SafeLights(leds, config, small_rig) as lights,
    ):
        lights.light(FULL)
        lights.light(FULL / 2)
        assert [state.counts.max() for state in device.states] == [0, 65535, 32768]
        assert device.silences == 0


@pytest.mark.parametrize(
    ("settle_s", "interval_s"), [(2.8, 0.0), (0.0, 2.8)], ids=["settling", "waiting to change"]
)
def test_an_e131_receiver_never_loses_its_source_while_the_host_waits(
    small_rig, settle_s, interval_s
):
    config = SafetyConfig(light_interval_s=interval_s)
    with SacnDevice(8, lambda _: None) as device:
        with (
            open_leds(device.url(f"settle_s={settle_s}"), 8) as leds,
            SafeLights(leds, config, small_rig) as lights,
        ):
            lights.light(FULL)
            if interval_s:
                lights.light(FULL / 2)
        until(lambda: device.terminated == [1])
        assert device.source_losses == []
        assert [bool(state.counts.any()) for state in device.states] == (
            [False, True, True, False] if interval_s else [False, True, False]
        )


def test_dark_does_not_wait_for_a_light_that_settles(small_rig):
    with (
        SacnDevice(8, lambda _: None) as device,
        open_leds(device.url("settle_s=1.5"), 8) as leds,
        SafeLights(leds, QUICK, small_rig) as lights,
        ThreadPoolExecutor(1) as pool,
    ):
        settling = pool.submit(lights.light, FULL)
        until(lambda: not device.dark)
        lights.dark()
        until(lambda: device.dark)
        assert not settling.done()
        with pytest.raises(LightLostError, match="put out by another thread"):
            settling.result(30)


def test_a_board_that_resets_in_a_shot_is_recovered_and_lit_again(small_rig):
    # HELLO? 1, SET 2, STATE? 3: there it restarts.
    story = Story([Fault("reset", at=3, seconds=0.05)])
    with (
        LedDevice(8, lambda _: None, story=story) as device,
        open_leds(device.url(1.0, 2), 8) as leds,
        SafeLights(leds, QUICK, small_rig) as lights,
    ):
        lights.light(FULL)
        first = lights.guardian_pid
        with pytest.raises(LightLostError, match="boot id"):
            lights.confirm()
        assert lights.recover().boot_id == 2
        assert lights.guardian_pid not in (None, first)
        driven = lights.light(FULL / 2)
        lights.confirm()
        assert np.array_equal(device.states[-1].counts, np.round(driven * 65535))
    assert device.dark


def test_lamps_that_take_long_to_settle_are_no_silence_of_the_capture(small_rig):
    config = SafetyConfig(light_interval_s=0.0, max_flashes_per_s=30.0, max_silence_s=1.0)
    with (
        LedDevice(8, lambda levels: time.sleep(1.8 * bool(levels.any()))) as device,
        open_leds(device.url(60.0), 8) as leds,
        SafeLights(leds, config, small_rig) as lights,
    ):
        first = lights.guardian_pid
        lights.light(FULL)
        lights.confirm()
        assert lights.guardian_pid == first
        assert len(device.states) == 2


def test_an_answer_that_does_not_come_is_no_silence_of_the_capture(small_rig):
    config = SafetyConfig(light_interval_s=0.0, max_flashes_per_s=30.0, max_silence_s=1.0)
    lamps = Lamps(watchdog_s=0.04)
    asked, go_on = threading.Event(), threading.Event()

    def slow():
        asked.set()
        assert go_on.wait(30)

    with SafeLights(lamps, config, small_rig, shot_worst_s=0.05) as lights:
        lamps.confirm = slow
        lights.light(FULL)
        assert asked.wait(30)
        # Put out although the line is still being asked.
        until(lambda: not lamps.levels.any())
        go_on.set()


def test_a_guardian_that_was_killed_is_replaced_and_its_shot_does_not_count(small_rig):
    with (
        LedDevice(8, lambda _: None, watchdog_s=0.4) as device,
        open_leds(device.url(20.0), 8) as leds,
        SafeLights(leds, QUICK, small_rig) as lights,
    ):
        lights.light(FULL)
        first = lights.guardian_pid
        os.kill(first, signal.SIGKILL)
        until(lambda: lights.guardian_pid not in (None, first))
        with pytest.raises(LightLostError, match="guardian"):
            lights.confirm()
        lights.light(FULL)
        lights.confirm()
    assert device.dark
