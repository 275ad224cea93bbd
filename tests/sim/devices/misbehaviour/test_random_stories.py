"""Any story of LED faults: the real driver on a line without a clock of its own.

A wrong state may be refused; it may never be acknowledged as right.
"""

from __future__ import annotations

import contextlib
import types

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from lightstage.errors import DeviceError
from lightstage.leds import wire_leds
from lightstage.leds.wire_leds import WireLeds
from sim.devices.fault_names import LEDS, NAMES, OF_ICL
from sim.devices.faults import Fault, FaultLog, Story
from sim.devices.led_faults import FaultyLeds, Wait

LIGHTS = 4
HIDDEN = ("stuck-on-hidden", "dead-light-hidden", "swapped-bank")
"""Of these the device knows nothing: no wire can tell them."""
TOLD = [
    name for name, known in NAMES.items() if known.device == LEDS and name not in (*HIDDEN, *OF_ICL)
]


class Port:
    """A line whose far end is a device; time passes only while somebody waits for it."""

    handles = ()

    def __init__(self, story: Story) -> None:
        self.now_s = 0.0
        self.lamps = np.zeros(LIGHTS)
        self.log = FaultLog()
        self.device = FaultyLeds(LIGHTS, 1, self.show, story, self.log)
        self._inbox, self._outbox = b"", b""
        self._busy_until_s, self._deaf = 0.0, False
        self._steps = iter(())

    def show(self, levels):
        self.lamps = levels

    def opened(self):
        self._steps = self.device.opened()
        self._pump()
        return self

    def write(self, data):
        self._inbox += data
        self._pump()

    def read(self, wait_s):
        if not self._outbox:
            self.wait(wait_s)
        data, self._outbox = self._outbox, b""
        return data

    def close(self):
        pass

    def wait(self, seconds):
        self.now_s += seconds
        self._pump()

    def _pump(self):
        while self.now_s >= self._busy_until_s:
            if self._deaf:
                self._inbox, self._deaf = b"", False
            step = next(self._steps, None)
            if isinstance(step, Wait):
                self._busy_until_s, self._deaf = self.now_s + step.seconds, step.deaf
            elif step is not None:
                self._outbox += step
            elif self._inbox:
                self._steps, self._inbox = self.device.feed(self._inbox), b""
            else:
                return


@pytest.fixture(scope="module", autouse=True)
def ports():
    """The driver opens `ports.port` and lives in its time."""
    held = types.SimpleNamespace(port=None)
    with pytest.MonkeyPatch.context() as patch:
        clock = types.SimpleNamespace(monotonic=lambda: held.port.now_s)
        patch.setattr(wire_leds, "time", clock)
        yield held


def opened(port, attempts=3):
    return WireLeds("the line", port.opened, timeout_s=0.3, attempts=attempts)


def own_fields(name):
    fields = {}
    for key in NAMES[name].fields:
        fields[key] = {
            "way": st.sampled_from(["request", "answer"]),
            "bits": st.integers(1, 40),
            "seconds": st.sampled_from([0.0, 0.05, 0.29, 0.31, 0.7]),
            "lights": st.lists(st.integers(0, LIGHTS - 1), min_size=1, max_size=2),
        }[key]
    return fields


@st.composite
def faults(draw):
    name = draw(st.sampled_from(TOLD))
    fields = {key: draw(value) for key, value in own_fields(name).items()}
    broken = "lights" in fields
    if broken:
        fields["at"] = draw(st.integers(1, 20))  # and stays so: a lamp does not mend itself
    elif draw(st.booleans()):
        fields["at"] = draw(st.integers(1, 20))
        if draw(st.booleans()):
            fields["until"] = fields["at"] + draw(st.integers(0, 4))
    else:
        fields["probability"] = draw(st.sampled_from([0.02, 0.1, 0.3, 0.7]))
    return Fault(name, **fields)


stories = st.builds(Story, st.lists(faults(), min_size=1, max_size=4), st.integers(0, 999))
STATES = [np.array(state, float) for state in ([1, 1, 1, 1], [1, 1, 0, 0], [0, 0.5, 1, 0.25])]


def same(lamps, driven):
    return np.array_equal(np.round(lamps * 65535), np.round(driven * 65535))


@settings(max_examples=250, deadline=None)
@given(stories, st.lists(st.integers(0, 2), min_size=1, max_size=5))
# The only SET of three that arrives does so behind the DARK with which the host gives up.
@example(Story([Fault("drop", at=2, until=3), Fault("reorder", at=4)]), [0])
def test_no_story_ends_in_a_wrong_state_acknowledged_as_right(ports, story, sequence):
    port = ports.port = Port(story)
    with contextlib.suppress(DeviceError), opened(port) as leds:
        try:
            for number in sequence:
                driven = leds.light(STATES[number])
                exposed = port.lamps
                leds.confirm()
                # Both answered: this was the light of the photographs.
                assert same(exposed, driven), port.log.names()
        finally:
            leds.dark()
            # Nothing that is still on its way may light them again. (A lamp may break later.)
            port.wait(60.0)
            assert not port.device.protocol.counts.any(), port.log.names()


@pytest.mark.parametrize("seed", range(20))
def test_a_line_that_loses_one_packet_in_ten_both_ways_still_carries_a_capture(ports, seed):
    bad = [
        Fault(name, probability=0.05, way=way)
        for name in ("drop", "corrupt")
        for way in ("request", "answer")
    ]
    port = ports.port = Port(Story(bad, seed))
    with opened(port, 12) as leds:
        for state in STATES:
            driven = leds.light(state)
            assert same(port.lamps, driven)
            leds.confirm()
        leds.dark()
    assert not port.lamps.any()


@settings(max_examples=150, deadline=None)
@given(stories, st.lists(st.binary(max_size=60), max_size=12))
def test_random_bytes_light_nothing_whatever_else_goes_wrong(story, noise):
    own = {"stuck-on"}
    story = Story([fault for fault in story.faults if fault.name not in own], story.seed)
    port = Port(story)
    for data in noise:
        port.write(data + b"\0")
        port.wait(0.1)
    port.wait(60.0)
    assert not port.lamps.any()
