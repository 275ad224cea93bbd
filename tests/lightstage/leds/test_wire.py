"""The wire as bytes, against a second hand: the crc package and the cobs library."""

import hashlib
import struct

import numpy as np
import pytest
from cobs import cobs
from crc import Calculator, Crc16
from hypothesis import given
from hypothesis import strategies as st

from lightstage.errors import DeviceError
from lightstage.leds import wire
from lightstage.leds.wire import Kind, Packet, PacketReader

packets = st.builds(Packet, st.integers(0, 255), st.integers(0, 0xFFFF), st.binary(max_size=400))

CRC = Calculator(Crc16.IBM_3740, optimized=True)


def by_hand(kind: int, sequence: int, payload: bytes = b"", version: int = 1) -> bytes:
    body = struct.pack("<BBH", version, kind, sequence) + payload
    return cobs.encode(body + struct.pack("<H", CRC.checksum(body))) + b"\0"


def test_crc_has_the_specified_check_value():
    assert wire.crc16(b"123456789") == CRC.checksum(b"123456789") == 0x29B1


def test_known_packets_have_known_bytes():
    assert wire.encode(Packet(Kind.ASK_HELLO, 1)).hex() == "040101010375f600"
    assert wire.encode(Packet(Kind.ASK_HELLO, 1)) == by_hand(1, 1)
    counts = np.array([0, 1, 65535], "<u2")
    payload = bytes.fromhex("0300" + "0000" + "0100" + "ffff")
    assert wire.set_payload(counts) == payload
    assert wire.encode(Packet(Kind.SET, 0x1234, payload)) == by_hand(0x10, 0x1234, payload)
    assert wire.lit_payload(counts) == hashlib.sha256(payload[2:]).digest()


@given(packets)
def test_encoding_matches_a_second_hand_and_decodes_to_itself(packet):
    frame = wire.encode(packet)
    assert frame == by_hand(packet.kind, packet.sequence, packet.payload)
    assert frame.count(0) == 1
    assert wire.decode(frame[:-1]) == packet


@given(st.lists(packets, max_size=5), st.binary(max_size=60), st.integers(1, 40))
def test_packets_survive_any_cut_of_the_stream_and_noise_before_them(sent, noise, step):
    stream = noise + b"\0" + b"".join(wire.encode(packet) for packet in sent)
    reader = PacketReader()
    got = [p for i in range(0, len(stream), step) for p in reader.feed(stream[i : i + step])]
    assert got[len(got) - len(sent) :] == sent


@given(st.binary(max_size=300))
def test_noise_never_crashes_and_nothing_invalid_is_accepted(noise):
    for packet in PacketReader().feed(noise):
        assert by_hand(packet.kind, packet.sequence, packet.payload)[:-1] in noise


def test_every_flipped_bit_of_a_packet_is_refused():
    frame = by_hand(0x10, 7, wire.set_payload(np.arange(168, dtype="<u2") * 390))[:-1]
    for bit in range(8 * len(frame)):
        broken = bytearray(frame)
        broken[bit // 8] ^= 1 << bit % 8
        assert PacketReader().feed(bytes(broken) + b"\0") == []


@given(packets, st.integers(0, 500))
def test_a_cut_packet_is_refused(packet, cut):
    frame = wire.encode(packet)[:-1]
    assert PacketReader().feed(frame[: min(cut, len(frame) - 1)] + b"\0") == []


def test_another_version_is_refused():
    with pytest.raises(wire.WireError, match="version 2"):
        wire.decode(by_hand(1, 1, version=2)[:-1])


def test_a_stream_without_zeros_is_thrown_away():
    reader = PacketReader()
    for _ in range(20):
        assert reader.feed(b"\x55" * 10_000) == []
    assert len(reader._pending) <= wire.MAX_FRAME
    assert reader.dropped > 0
    assert reader.feed(b"\0" + by_hand(2, 3)) == [Packet(2, 3)]


@pytest.mark.parametrize("level", [-0.001, 1.001, np.nan, np.inf])
def test_levels_out_of_range_are_refused_not_clipped(level):
    with pytest.raises(DeviceError, match=r"0\.\.1"):
        wire.level_counts(np.array([0.5, level]))


@given(st.lists(st.floats(0, 1), min_size=1, max_size=20))
def test_levels_round_to_the_nearest_step(levels):
    counts = wire.level_counts(np.array(levels))
    assert np.abs(counts / 65535 - levels).max() <= 0.5 / 65535 + 1e-12


def test_hello_and_refused_payloads_are_read():
    assert wire.parse_hello(struct.pack("<IH", 9, 168) + "v1 é".encode()).firmware == "v1 é"
    for payload in (b"", b"12345", struct.pack("<IH", 9, 168) + b"\xff"):
        with pytest.raises(wire.WireError):
            wire.parse_hello(payload)
    assert wire.parse_refused(b"\x02167 lights") == "wrong lamp count: 167 lights"
    assert wire.parse_refused(b"") == "0"


def test_a_hello_states_its_watchdog_and_pulses_behind_the_firmware_and_older_ones_do_not():
    head = struct.pack("<IH", 9, 168)
    assert wire.parse_hello(head + b"v1").watchdog_s is None
    stated = wire.parse_hello(head + b"v1\0watchdog_ms=2000\0pulse_hz=25000\0colour=blue\0odd")
    assert (stated.firmware, stated.watchdog_s, stated.pulse_hz) == ("v1", 2.0, 25000.0)
    for wrong in (b"watchdog_ms=soon", b"watchdog_ms=-1", b"pulse_hz=nan", b"pulse_hz=0"):
        with pytest.raises(wire.WireError, match=wrong.decode()):
            wire.parse_hello(head + b"v1\0" + wrong)
