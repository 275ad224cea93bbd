"""The LED device's end of the wire, as a conversation of bytes (docs/led_wire.md)."""

from __future__ import annotations

import hashlib
import struct

import numpy as np
import pytest
from cobs import cobs
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.errors import DeviceError
from lightstage.leds.opening import open_leds
from sim.devices.led_device import LedDevice
from sim.devices.led_protocol import LedProtocol, Shining

BOOT = 0xA1B2C3D4


def crc(data: bytes) -> int:
    """CRC-16/IBM-3740, bit by bit as the specification has it."""
    value = 0xFFFF
    for byte in data:
        value ^= byte << 8
        for _ in range(8):
            value = (value << 1) ^ 0x1021 if value & 0x8000 else value << 1
            value &= 0xFFFF
    return value


def packet(kind: int, sequence: int, payload: bytes = b"", version: int = 1) -> bytes:
    body = struct.pack("<BBH", version, kind, sequence) + payload
    return cobs.encode(body + struct.pack("<H", crc(body))) + b"\0"


def level_payload(*levels: int) -> bytes:
    return struct.pack(f"<{1 + len(levels)}H", len(levels), *levels)


def lit(sequence: int, *levels: int) -> bytes:
    return packet(0x20, sequence, hashlib.sha256(struct.pack(f"<{len(levels)}H", *levels)).digest())


class Lamps:
    """Three lamps and what they were told to show."""

    def __init__(self) -> None:
        self.shown: list[list[float]] = []
        self.device = LedProtocol(3, BOOT, lambda levels: self.shown.append(levels.tolist()))

    def answer(self, *packets: bytes) -> bytes:
        return self.device.feed(b"".join(packets))


def test_our_check_sum_is_the_published_one():
    assert crc(b"123456789") == 0x29B1


def test_a_capture_as_a_conversation():
    lamps = Lamps()
    hello = struct.pack("<IH", BOOT, 3) + b"lightstage-sim 1"
    assert lamps.device.hello() == packet(0x02, 0, hello)
    assert lamps.answer(packet(0x01, 7)) == packet(0x02, 7, hello)
    assert lamps.answer(packet(0x12, 8)) == lit(8, 0, 0, 0)
    assert lamps.answer(packet(0x10, 9, level_payload(65535, 0, 13107))) == lit(9, 65535, 0, 13107)
    assert lamps.answer(packet(0x12, 10)) == lit(10, 65535, 0, 13107)
    assert lamps.answer(packet(0x11, 11)) == lit(11, 0, 0, 0)
    assert lamps.shown == [[1.0, 0.0, 0.2], [0.0, 0.0, 0.0]]


def test_a_repeated_packet_is_answered_again_and_changes_nothing():
    lamps = Lamps()
    first = packet(0x10, 5, level_payload(65535, 0, 0))
    assert lamps.answer(first, first) == 2 * lit(5, 65535, 0, 0)
    # The same number again is a repetition even if its bytes differ.
    assert lamps.answer(packet(0x11, 5)) == lit(5, 65535, 0, 0)
    assert len(lamps.shown) == 1


def test_a_repeated_packet_is_answered_with_what_is_lit_by_then():
    broken: list[int] = []

    def lamps(commanded: np.ndarray) -> Shining:
        counts = commanded.copy()
        counts[broken] = 65535
        return Shining(counts, counts)

    device = LedProtocol(3, BOOT, lambda _: None, lamps)
    assert device.feed(packet(0x11, 5)) == lit(5, 0, 0, 0)
    broken.append(1)
    device.refresh()
    assert device.feed(packet(0x11, 5)) == lit(5, 0, 65535, 0)


def test_a_packet_that_is_behind_the_last_one_came_too_late():
    lamps = Lamps()
    first = packet(0x10, 65534, level_payload(65535, 0, 0))
    assert lamps.answer(packet(0x01, 65533)) != b""
    # The numbers go round: 1 is ahead of 65534.
    assert lamps.answer(packet(0x11, 1)) == lit(1, 0, 0, 0)
    assert lamps.answer(first) == b""
    assert lamps.shown == []
    # A new host begins with HELLO?, whatever its number.
    assert lamps.answer(packet(0x01, 40000)) != b""
    assert lamps.answer(packet(0x10, 40001, level_payload(1, 1, 1))) == lit(40001, 1, 1, 1)


def test_the_state_lit_already_is_acknowledged_without_a_change():
    lamps = Lamps()
    assert lamps.answer(packet(0x11, 1)) == lit(1, 0, 0, 0)
    assert lamps.shown == []


@pytest.mark.parametrize(
    ("asked", "code"),
    [
        (packet(0x33, 1), 1),
        (packet(0x10, 1, level_payload(1, 2)), 2),
        (packet(0x10, 1, level_payload(1, 2, 3) + b"\1"), 3),
        (packet(0x10, 1, b"\3"), 3),
        (packet(0x11, 1, b"\0"), 3),
    ],
)
def test_what_cannot_be_done_is_refused_with_its_code(asked, code):
    lamps = Lamps()
    answer = cobs.decode(lamps.answer(asked).rstrip(b"\0"))
    assert answer[1] == 0x2F
    assert answer[4] == code
    assert lamps.shown == []


def test_damaged_packets_are_dropped_in_silence():
    lamps = Lamps()
    good = packet(0x10, 1, level_payload(65535, 65535, 65535))
    for place in range(len(good) - 1):
        for flip in (0x01, 0x80, 0xFF):
            damaged = bytearray(good)
            damaged[place] ^= flip
            assert lamps.answer(bytes(damaged), b"\0") == b""
    assert lamps.answer(packet(0x12, 2, version=2)) == b""
    assert lamps.shown == []


@settings(max_examples=100, deadline=None)
@given(st.binary(max_size=300))
def test_noise_on_the_line_lights_nothing_and_is_forgotten(noise):
    lamps = Lamps()
    lamps.answer(noise, b"\0")
    assert lamps.shown == []
    assert lamps.answer(packet(0x12, 9)) == lit(9, 0, 0, 0)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(1, 40), min_size=1, max_size=30))
def test_packets_arrive_whole_however_the_line_cuts_them(cuts):
    lamps = Lamps()
    stream = packet(0x10, 1, level_payload(1, 256, 0)) + packet(0x11, 2)
    answers, place = b"", 0
    for cut in [*cuts, len(stream)]:
        answers += lamps.device.feed(stream[place : place + cut])
        place += cut
    assert answers == lit(1, 1, 256, 0) + lit(2, 0, 0, 0)


def test_the_driver_lights_the_device_through_a_pseudo_terminal():
    shown: list[np.ndarray] = []
    with LedDevice(4, shown.append) as device:
        with open_leds(device.url(5.0), 4) as leds:
            assert leds.hello.light_count == 4
            driven = leds.light(np.array([0.0, 0.25, 0.5, 1.0]))
            leds.dark()
        np.testing.assert_allclose(shown[0], driven)
        np.testing.assert_array_equal(shown[1], 0)
        assert [state.counts.sum() for state in device.states] == [0, 16384 + 32768 + 65535, 0]
        times = [state.at_s for state in device.states]
        assert times == sorted(times)


def test_a_lamp_that_fails_is_not_acknowledged():
    def broken(levels: np.ndarray) -> None:
        raise RuntimeError("no current")

    with LedDevice(2, broken) as device:
        with (
            open_leds(device.url(0.3), 2) as leds,
            pytest.raises(DeviceError, match="no answer"),
        ):
            leds.light(np.ones(2))
        assert str(device.failure) == "no current"
