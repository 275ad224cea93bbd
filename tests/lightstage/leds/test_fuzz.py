"""Two independent hands on any bytes: the driver's decoder and the simulated device's.

What one accepts the other accepts, nothing crashes, and lamps change only by a whole packet.
"""

from __future__ import annotations

import hashlib
import struct

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from lightstage.leds import wire
from lightstage.leds.wire import Kind, Packet, PacketReader, WireError
from lightstage.leds.wire_leds import WireLeds
from sim.devices.led_protocol import LedProtocol

LIGHTS = 5
START = np.arange(LIGHTS, dtype="<u2") * 1000


def device(lights=LIGHTS):
    return LedProtocol(lights, 1, lambda _: None)


def lit_device():
    """A device on which START is lit under number 7."""
    lamps = device()
    lamps.feed(wire.encode(Packet(Kind.SET, 7, wire.set_payload(START))))
    assert np.array_equal(lamps.counts, START)
    return lamps


def accepted(frames):
    """What the driver's decoder takes of frames (bytes between zeros)."""
    packets = []
    for frame in frames:
        try:
            packets.append(wire.decode(frame))
        except WireError:
            continue
    return packets


counts = st.lists(st.integers(0, 65535), min_size=LIGHTS, max_size=LIGHTS)
mutations = st.lists(
    st.tuples(
        st.sampled_from(["flip", "set", "insert", "delete", "double", "cut"]),
        st.integers(0, 10_000),
        st.integers(0, 255),
    ),
    min_size=1,
    max_size=6,
)


def mutated(frame, changes):
    data = bytearray(frame)
    for what, where, value in changes:
        place = where % (len(data) + 1)
        if what == "insert":
            data[place:place] = bytes([value])
        elif what == "cut":
            data = data[:place]
        elif what == "double":
            data[place:place] = data[place : place + value % 8]
        elif place < len(data):
            if what == "flip":
                data[place] ^= 1 << value % 8
            elif what == "set":
                data[place] = value
            else:
                del data[place]
    return bytes(data)


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=600), st.integers(1, 80))
@example(b"\0" * 50, 3)
@example(b"\xff" * 600, 600)
def test_both_hands_take_the_same_packets_out_of_any_bytes(noise, step):
    lamps, reader = lit_device(), PacketReader()
    heard = lamps.heard
    pieces = [noise[i : i + step] for i in range(0, len(noise), step)] + [b"\0"]
    ours = [packet for piece in pieces for packet in reader.feed(piece)]
    for piece in pieces:
        lamps.feed(piece)
    assert lamps.heard - heard == len(ours) == len(accepted(noise.split(b"\0")))
    if not ours:
        assert np.array_equal(lamps.counts, START)


@settings(max_examples=300, deadline=None)
@given(counts, st.integers(0, 65535), mutations)
def test_a_damaged_set_changes_no_lamp_unless_the_other_hand_reads_it_as_whole(
    wanted, sequence, changes
):
    lamps = lit_device()
    payload = wire.set_payload(np.array(wanted, "<u2"))
    stream = mutated(wire.encode(Packet(Kind.SET, sequence, payload)), changes) + b"\0"
    lamps.feed(stream)
    expected = START
    last = 7
    for packet in accepted(frame for frame in stream.split(b"\0") if frame):
        if packet.sequence == last or (packet.sequence - last) % 65536 >= 32768:
            continue
        last = packet.sequence
        if packet.kind == Kind.SET and len(packet.payload) == 2 + 2 * LIGHTS:
            (count,) = struct.unpack_from("<H", packet.payload)
            if count == LIGHTS:
                expected = np.frombuffer(packet.payload[2:], "<u2")
        elif packet.kind == Kind.DARK and not packet.payload:
            expected = np.zeros(LIGHTS, "<u2")
    assert np.array_equal(lamps.counts, expected)


@settings(max_examples=300, deadline=None)
@given(st.integers(0, 255), st.integers(0, 65535), st.binary(max_size=60), mutations)
def test_the_driver_takes_no_damaged_answer_for_another(kind, sequence, payload, changes):
    sent = Packet(kind, sequence, payload)
    frame = wire.encode(sent)
    lamps = device()
    for packet in PacketReader().feed(mutated(frame, changes) + b"\0"):
        # Whatever is taken is whole: the other hand takes it too.
        lamps.feed(wire.encode(packet))
    assert lamps.heard == len(PacketReader().feed(mutated(frame, changes) + b"\0"))


@settings(max_examples=150, deadline=None)
@given(
    st.lists(st.tuples(counts, st.binary(max_size=20)), min_size=1, max_size=6), st.integers(1, 60)
)
def test_the_last_whole_set_is_what_is_lit_whatever_stands_between(sets, step):
    lamps = device()
    stream, expected = b"", np.zeros(LIGHTS, "<u2")
    for number, (wanted, noise) in enumerate(sets, 1):
        expected = np.array(wanted, "<u2")
        stream += noise + b"\0"
        stream += wire.encode(Packet(Kind.SET, number, wire.set_payload(expected)))
    # Noise that happens to be a whole packet would be one: the other hand says so.
    frames = [frame for frame in stream.split(b"\0") if frame]
    for place in range(0, len(stream), step):
        lamps.feed(stream[place : place + step])
    assert lamps.heard == len(accepted(frames))
    if lamps.heard == len(sets):
        assert np.array_equal(lamps.counts, expected)


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=80))
def test_any_hello_is_read_or_refused(payload):
    try:
        hello = wire.parse_hello(payload)
    except WireError:
        return
    assert 0 <= hello.light_count <= 65535
    assert hello.watchdog_s is None or hello.watchdog_s > 0
    assert hello.pulse_hz is None or hello.pulse_hz > 0


@given(st.binary(max_size=40))
def test_any_refusal_can_be_reported(payload):
    assert wire.parse_refused(payload)


class Direct:
    """A line with the other hand at its end, in this thread."""

    handles = (0,)

    def __init__(self, lamps):
        self.lamps, self.answers = lamps, b""

    def write(self, data):
        self.answers += self.lamps.feed(data)

    def read(self, _):
        answers, self.answers = self.answers, b""
        return answers

    def close(self):
        pass


@pytest.mark.parametrize("first_sequence", [1, 0x7000, 0x9000, 0xFFF0])
def test_the_last_will_is_dark_at_once_wherever_the_last_packet_was_cut(first_sequence):
    cut = wire.encode(Packet(Kind.SET, 1, wire.set_payload(START)))
    for place in range(len(cut) + 1):
        lamps = device()
        line = Direct(lamps)
        with WireLeds("x", lambda end=line: end, first_sequence=first_sequence) as leds:
            leds.light(np.ones(LIGHTS))
            will = leds.last_will()
        lamps.feed(cut[:place])
        ((message, _),) = will.messages
        assert will.answer in lamps.feed(message)
        assert not lamps.counts.any()


def test_a_megabyte_without_an_end_is_forgotten_by_both_and_the_next_packet_counts():
    lamps, reader = lit_device(), PacketReader()
    for _ in range(16):
        noise = b"\x55" * (1 << 16)
        assert reader.feed(noise) == []
        assert lamps.feed(noise) == b""
    dark = wire.encode(Packet(Kind.DARK, 8))
    assert reader.feed(b"\0" + dark) == [Packet(Kind.DARK, 8)]
    lamps.feed(b"\0" + dark)
    assert not lamps.counts.any()


def test_as_many_lights_as_the_count_can_say_pass_whole_between_both_hands():
    lamps = device(65535)
    wanted = np.random.default_rng(0).integers(0, 65536, 65535).astype("<u2")
    stream = wire.encode(Packet(Kind.SET, 1, wire.set_payload(wanted)))
    answer = b"".join(lamps.feed(stream[i : i + 4096]) for i in range(0, len(stream), 4096))
    assert np.array_equal(lamps.counts, wanted)
    assert PacketReader().feed(answer) == [
        Packet(Kind.LIT, 1, hashlib.sha256(wanted.tobytes()).digest())
    ]
