"""The same bytes to the firmware and to the simulated device: the same lamps, the same replies.

Two hands that share no line: firmware/ in C, sim/devices/led_protocol.py in Python.
"""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.leds import wire
from lightstage.leds.wire import Kind, Packet
from sim.devices.led_protocol import LedProtocol
from tests.firmware.bench import BOOT, Bench, states

KINDS = (Kind.SET, Kind.SET, Kind.SET, Kind.DARK, Kind.ASK_STATE, Kind.ASK_HELLO, 0x20, 0x33, 0xFF)
WATCHDOG_S = 0.9


class Pair:
    """Both devices, dark, side by side."""

    def __init__(self, bench: Bench, lights: int) -> None:
        self.bench, self.lights = bench, lights
        self.shown: list[list[int]] = [[0] * lights]
        self.simulated = LedProtocol(lights, BOOT, self._show, watchdog_s=WATCHDOG_S)
        begun = bench.reset()
        assert begun.replies == self.simulated.hello()
        assert states(begun.lamps) == self.shown

    def _show(self, levels: np.ndarray) -> None:
        self.shown.append(np.round(levels * wire.FULL).astype(int).tolist())

    def feed(self, data: bytes) -> bytes:
        """Give both the same bytes, and compare; what they said."""
        before = self.shown[-1]
        self.shown = [before]
        replies = self.simulated.feed(data)
        heard = self.bench.line(data)
        assert heard.replies == replies
        assert states([np.array(before), *heard.lamps]) == self.shown
        return replies


@pytest.fixture(autouse=True)
def same_name(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only the name tells them apart."""
    monkeypatch.setattr("sim.devices.led_protocol.FIRMWARE", "lightstage-firmware 1")


@pytest.fixture(scope="module", params=[3, 168])
def sides(request, compiled):
    """A bench and its lamp count; 168 lights fill more than one COBS block."""
    with Bench(compiled("bench", request.param)) as bench:
        yield bench, request.param


def drawn_stream(rng: np.random.Generator, lights: int, count: int) -> tuple[bytes, int]:
    """Frames, every other one damaged; and how many are whole."""
    stream, whole, sequence = b"", 0, 0
    for _ in range(count):
        sequence = int(rng.integers(65536) if rng.random() < 0.05 else sequence + 1) % 65536
        kind = KINDS[rng.integers(len(KINDS))]
        payload = b""
        if kind == Kind.SET:
            stated = lights if rng.random() < 0.9 else int(rng.integers(400))
            there = stated if rng.random() < 0.9 else int(rng.integers(400))
            levels = rng.integers(0, 65536, there) * (rng.random(there) < 0.7)
            payload = struct.pack("<H", stated) + levels.astype("<u2").tobytes()
            payload = payload[: len(payload) - int(rng.random() < 0.1)]
        elif rng.random() < 0.1:
            payload = rng.bytes(int(rng.integers(1, 600)))
        frame = bytearray(wire.encode(Packet(kind, sequence, payload)))
        damage = rng.integers(8)
        place = int(rng.integers(len(frame)))
        if damage == 0:
            frame[place] ^= 1 << int(rng.integers(8))
        elif damage == 1:
            del frame[place]
        elif damage == 2:
            frame[place:place] = rng.bytes(int(rng.integers(1, 4)))
        elif damage == 3:  # it comes twice
            frame *= 2
        else:
            whole += 1
        stream += bytes(frame)
    return stream, whole


def test_thousands_of_frames_whole_and_damaged_do_the_same_to_both(sides) -> None:
    bench, lights = sides
    rng = np.random.default_rng(lights)
    pair = Pair(bench, lights)
    stream, whole = drawn_stream(rng, lights, 2000)
    replies = place = 0
    while place < len(stream):
        size = int(rng.integers(1, 20_000))
        replies += pair.feed(stream[place : place + size]).count(0)
        place += size
    assert whole > 800
    assert replies > whole / 2  # of the others the number is behind


@settings(max_examples=100)
@given(data=st.data())
def test_any_bytes_do_the_same_to_both(sides, data) -> None:
    bench, lights = sides
    pair = Pair(bench, lights)
    full = wire.set_payload(np.full(lights, wire.FULL, "<u2"))
    pair.feed(wire.encode(Packet(Kind.SET, 7, full)))
    packets = st.builds(
        Packet, st.sampled_from(KINDS), st.integers(0, 65535), st.one_of(st.binary(), st.just(full))
    )
    pieces = st.one_of(st.binary(max_size=300), packets.map(wire.encode), st.just(b"\0"))
    for piece in data.draw(st.lists(pieces, max_size=6)):
        pair.feed(piece)
    pair.feed(b"\0")


def test_a_repetition_is_answered_again_whatever_the_answer_was(sides) -> None:
    bench, lights = sides
    pair = Pair(bench, lights)
    full = wire.set_payload(np.full(lights, wire.FULL, "<u2"))
    for number, (kind, payload) in enumerate(
        [(0x10, full), (0x10, full[:-1]), (0x33, b""), (0x01, b""), (0x12, b"x"), (0x11, b"")], 5
    ):
        first = pair.feed(wire.encode(Packet(kind, number, payload)))
        assert first
        # Also where the bytes of the repetition differ.
        assert pair.feed(wire.encode(Packet(0x10, number, full))) == first


def test_numbers_go_round_and_hello_begins_anywhere(sides) -> None:
    bench, lights = sides
    pair = Pair(bench, lights)
    full = wire.set_payload(np.full(lights, wire.FULL, "<u2"))
    for kind, number, payload, answered in [
        (Kind.ASK_HELLO, 65534, b"", True),
        (Kind.SET, 2, full, True),
        (Kind.DARK, 65535, b"", False),
        (Kind.SET, 32770, full, False),
        (Kind.SET, 32769, full, True),
        (Kind.DARK, 1, b"", False),
        (Kind.ASK_HELLO, 1, b"", True),
        (Kind.DARK, 2, b"", True),
    ]:
        assert bool(pair.feed(wire.encode(Packet(kind, number, payload)))) == answered


def test_every_flipped_bit_of_a_packet_is_dropped_by_both(sides) -> None:
    bench, lights = sides
    pair = Pair(bench, lights)
    frame = wire.encode(Packet(Kind.SET, 7, wire.set_payload(np.arange(lights) * 390 + 1)))[:-1]
    for bit in range(0, 8 * len(frame), 1 if lights < 10 else 17):
        broken = bytearray(frame)
        broken[bit // 8] ^= 1 << bit % 8
        assert pair.feed(bytes(broken) + b"\0") == b""
    assert pair.shown == [[0] * lights]


def test_packets_of_many_more_lights_are_refused_by_both(sides) -> None:
    bench, lights = sides
    pair = Pair(bench, lights)
    payload = wire.set_payload(np.full(65535, 9))
    reply = wire.decode(pair.feed(wire.encode(Packet(Kind.SET, 1, payload)))[:-1])
    assert wire.parse_refused(reply.payload) == f"wrong lamp count: 65535 of {lights} lights"
    unknown = wire.encode(Packet(0x44, 2, bytes(100_000)))
    assert wire.decode(pair.feed(unknown)[:-1]).kind == Kind.REFUSED
