"""E1.31 packets against the standard's table, and against a receiver of another hand."""

from __future__ import annotations

import socket

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.leds import e131
from lightstage.leds.opening import open_leds
from sim.devices.sacn_device import SacnDevice, read_packet
from tests.waiting import until

CID = bytes(range(16))


def test_a_packet_has_the_bytes_of_the_standards_table():
    packet = e131.data_packet(CID, "stage", 0x1234, 7, bytes([9, 8]), 150, e131.TERMINATED)
    assert len(packet) == 638
    expected = {
        0: "0010 0000",
        4: "4153432d45312e3137000000",  # ASC-E1.17
        16: "726e 00000004",  # 622 bytes from here
        22: CID.hex(),
        38: "7258 00000002",  # 600
        44: b"stage".hex() + "00" * 59,
        108: "96 0000 07 40 1234",
        115: "720b 02 a1 0000 0001 0201",  # 523; 513 values, the start code among them
        125: "00 09 08 00",
    }
    for place, text in expected.items():
        data = bytes.fromhex(text.replace(" ", ""))
        assert packet[place : place + len(data)] == data, place
    assert not any(packet[128:])


@given(
    st.binary(min_size=16, max_size=16),
    st.text(max_size=80).filter(lambda text: "\0" not in text),
    st.integers(1, 63999),
    st.integers(0, 1000),
    st.binary(max_size=512),
    st.integers(0, 200),
    st.booleans(),
)
def test_another_hand_reads_what_was_written(
    cid, name, universe, sequence, slots, priority, terminated
):
    options = e131.TERMINATED if terminated else 0
    packet = read_packet(e131.data_packet(cid, name, universe, sequence, slots, priority, options))
    assert packet is not None
    assert (packet.cid, packet.universe, packet.priority) == (cid, universe, priority)
    assert packet.sequence == sequence % 256
    assert packet.terminated == terminated
    assert packet.slots == slots.ljust(512, b"\0")
    assert name.startswith(packet.name)
    assert len(packet.name.encode()) > 59 or packet.name == name


@given(st.binary(max_size=700), st.integers(0, 637), st.integers(0, 255))
def test_any_datagram_is_read_or_refused(noise, place, value):
    read_packet(noise)
    packet = bytearray(e131.data_packet(CID, "x", 1, 1, b"\1\2\3"))
    packet[place] = value
    read_packet(bytes(packet))
    assert read_packet(bytes(packet[:place])) is None


def test_a_multicast_group_is_its_universe():
    assert e131.multicast_host(1) == "239.255.0.1"
    assert e131.multicast_host(63999) == "239.255.249.255"


def test_multicast_reaches_each_universes_own_group_and_nobody_elses():
    groups = {}
    try:
        for universe in (300, 301):
            end = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            end.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            group = e131.multicast_host(universe)
            end.bind((group, groups[300].getsockname()[1] if groups else 0))
            member = socket.inet_aton(group) + socket.inet_aton("127.0.0.1")
            end.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
            end.settimeout(30)
            groups[universe] = end
        port = groups[300].getsockname()[1]
        url = f"sacn://multicast:{port}?universe=300&interface=127.0.0.1&attempts=1"
        with open_leds(url, 600) as leds:
            leds.light(np.linspace(0, 1, 600))
            for universe, end in groups.items():
                packet = read_packet(end.recv(1000))
                assert packet.universe == universe
                assert any(packet.slots)
    finally:
        for end in groups.values():
            end.close()


@pytest.mark.parametrize(("channels", "bits"), [(1, 8), (3, 8), (4, 16), (1, 16)])
def test_lights_fill_universes_whole_and_in_order(channels, bits):
    levels = np.linspace(0, 1, 300)
    with SacnDevice(300, lambda _: None, 5, channels, bits) as device:
        with open_leds(device.url("settle_s=0"), 300) as leds:
            driven = leds.light(levels)
            until(lambda: np.array_equal(device.states[-1].counts, np.round(driven * 65535)))
            step = 1 / (255 if bits == 8 else 65535)
            assert np.abs(driven - levels).max() <= step / 2 + 1e-12
        universes = -(-300 // (512 // (channels * bits // 8)))
        until(lambda: len(device.terminated) == universes)
        assert device.terminated == list(range(5, 5 + universes))
        assert device.dark
    assert (device.lost, device.dropped, device.strangers, device.malformed) == (0, 0, 0, 0)


def test_gamma_is_undone_in_what_is_reported_to_be_driven():
    with SacnDevice(3, lambda _: None) as device, open_leds(device.url("gamma=2"), 3) as leds:
        driven = leds.light(np.array([0.0, 0.25, 1.0]))
        until(lambda: len(device.states) > 1)
        assert device.states[-1].counts.tolist() == [0, 128 * 257, 65535]
        assert driven == pytest.approx([0, (128 / 255) ** 2, 1])


def test_sequence_numbers_go_round_without_a_loss():
    with SacnDevice(2, lambda _: None) as device:
        with open_leds(device.url("settle_s=0"), 2) as leds:
            for number in range(100):
                leds.light(np.array([number / 100, 1.0]))
        until(lambda: device.terminated == [1])
        assert (device.lost, device.dropped) == (0, 0)
        assert device.packets > 300


def test_a_source_that_falls_silent_is_lost_and_its_lights_go_out():
    with SacnDevice(2, lambda _: None) as device, open_leds(device.url(), 2) as leds:
        leds.light(np.ones(2))
        until(lambda: device.source_losses == [1])
        assert device.dark
        leds.confirm()  # sends the state again: the source is back
        until(lambda: not device.dark)


def test_the_stream_of_every_universe_ends_with_three_packets_that_mark_the_end():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(20)
        port = receiver.getsockname()[1]
        with open_leds(f"sacn://127.0.0.1:{port}?universe=7&settle_s=0", 600) as leds:
            leds.light(np.ones(600))
            leds.dark()
        packets = []
        while len(packets) < 18:  # two states three times and three ends, of two universes
            packets.append(read_packet(receiver.recv(1000)))
        receiver.setblocking(False)
        with pytest.raises(BlockingIOError):
            receiver.recv(1000)
    assert [packet.terminated for packet in packets] == 12 * [False] + 6 * [True]
    for universe in (7, 8):
        own = [packet for packet in packets if packet.universe == universe]
        numbers = [packet.sequence for packet in own]
        assert numbers == list(range(numbers[0], numbers[0] + 9))
        assert not any(own[-1].slots)
