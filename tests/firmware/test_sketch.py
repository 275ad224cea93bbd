"""The Arduino sketch, on a board of this computer with a chain of simulated TLC5947."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from lightstage.leds import wire
from lightstage.leds.wire import Kind, Packet
from tests.firmware.bench import Bench, states

LIGHTS, CHANNELS = 30, 48
DARK = [0] * CHANNELS


@pytest.fixture
def board(compiled):
    if shutil.which("g++") is None:
        pytest.skip("the sketch is not tested: there is no g++")
    with Bench(compiled("sketch", LIGHTS)) as board:
        begun = board.reset(8)
        assert states(begun.lamps) == [DARK]
        yield board


def boot_id(hello: bytes) -> int:
    return wire.parse_hello(wire.decode(hello[:-1]).payload).boot_id


def test_each_light_gets_its_level_on_its_channel_in_twelve_bits(board) -> None:
    rng = np.random.default_rng(0)
    for number in range(1, 20):
        counts = rng.integers(0, 65536, LIGHTS)
        counts[:4] = (0, 65535, 8, 32768)
        payload = wire.set_payload(counts)
        heard = board.line(wire.encode(Packet(Kind.SET, number, payload)))
        assert heard.replies == wire.encode(Packet(Kind.LIT, number, wire.lit_payload(counts)))
        steps = np.zeros(CHANNELS, int)
        steps[:LIGHTS] = np.round(counts * (4095 / 65535))
        # All are dark between two states.
        assert states(heard.lamps) == [DARK, steps.tolist()]


def test_it_goes_dark_after_a_silence(board) -> None:
    board.clock(1000)
    payload = wire.set_payload(np.full(LIGHTS, 65535))
    board.line(wire.encode(Packet(Kind.SET, 1, payload)))
    # A millisecond is the lamps' own.
    assert board.clock(1001 + 899).lamps == []
    assert states(board.clock(1001 + 900).lamps) == [DARK]


def test_each_reset_has_another_boot_id(board) -> None:
    assert boot_id(board.reset(8).replies) == 9
    assert [boot_id(board.reset(0).replies) for _ in range(3)] == [10, 11, 12]
    assert boot_id(board.reset(0xFFFFFFFF).replies) == 0
