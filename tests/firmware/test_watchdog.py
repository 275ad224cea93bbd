"""Dark within a second of silence, on a clock that the test sets."""

from __future__ import annotations

import numpy as np
import pytest

from lightstage.leds import wire
from lightstage.leds.wire import Kind, Packet
from tests.firmware.bench import Bench, states

WATCHDOG_MS = 900
LEVELS = np.array([65535, 1, 256])
DARK = [[0, 0, 0]]


def sent(bench: Bench, kind: int, number: int, payload: bytes = b"") -> list[Packet]:
    """Send a packet; the replies."""
    replies = bench.line(wire.encode(Packet(kind, number, payload))).replies
    return [wire.decode(frame) for frame in replies.split(b"\0") if frame]


def lit(bench: Bench, number: int = 1) -> None:
    """Light the lamps."""
    (reply,) = sent(bench, Kind.SET, number, wire.set_payload(LEVELS))
    assert reply == Packet(Kind.LIT, number, wire.lit_payload(LEVELS))


def test_the_second_is_reported_in_hello(bench) -> None:
    (reply,) = sent(bench, Kind.ASK_HELLO, 1)
    hello = wire.parse_hello(reply.payload)
    assert (hello.watchdog_s, hello.light_count) == (WATCHDOG_MS / 1000, 3)
    assert hello.watchdog_s < 1
    assert hello.pulse_hz is None


# Where the clock begins again after 2^32 - 1: before, at and after that moment.
@pytest.mark.parametrize("start", [0, 5, 2**31 - 450, 2**32 - 901, 2**32 - 900, 2**32 - 1])
def test_after_a_silence_all_is_dark_and_not_before(bench, start) -> None:
    bench.clock(start)
    lit(bench)
    for waited in range(0, WATCHDOG_MS, 7):
        assert bench.clock(start + waited).lamps == []
    assert bench.clock(start + WATCHDOG_MS - 1).lamps == []
    assert states(bench.clock(start + WATCHDOG_MS).lamps) == DARK
    (reply,) = sent(bench, Kind.ASK_STATE, 2)
    assert reply == Packet(Kind.LIT, 2, wire.lit_payload(np.zeros(3)))
    # It has done its work: the lamps are left alone until they are lit again.
    assert bench.clock(start + 5000).lamps == []
    lit(bench, 3)


@pytest.mark.parametrize("start", [0, 2**32 - 2000])
def test_questions_keep_the_light_for_as_long_as_they_come(bench, start) -> None:
    bench.clock(start)
    lit(bench)
    for number in range(2, 22):
        assert bench.clock(start + 850 * (number - 1)).lamps == []
        (reply,) = sent(bench, Kind.ASK_STATE, number)
        assert reply.payload == wire.lit_payload(LEVELS)
    assert states(bench.clock(start + 850 * 20 + WATCHDOG_MS).lamps) == DARK


@pytest.mark.parametrize("last", [Kind.ASK_STATE, Kind.ASK_HELLO, 0x33])
def test_any_whole_packet_counts_also_one_that_is_refused_repeated_or_late(bench, last) -> None:
    lit(bench, 10)
    bench.clock(600)
    sent(bench, last, 11)
    bench.clock(1200)
    sent(bench, last, 11)
    bench.clock(1800)
    assert sent(bench, Kind.DARK, 5) == []
    assert bench.clock(2600).lamps == []
    assert states(bench.clock(2700).lamps) == DARK


def test_a_line_full_of_noise_and_damaged_packets_keeps_no_light(bench) -> None:
    lit(bench)
    damaged = bytearray(wire.encode(Packet(Kind.ASK_STATE, 2)))
    damaged[3] ^= 1
    for now in range(50, WATCHDOG_MS, 50):
        bench.clock(now)
        bench.line(bytes(damaged))
        bench.line(b"\0\0\0")
        bench.line(b"\x55" * 50)
    assert states(bench.clock(WATCHDOG_MS).lamps) == DARK


def test_the_time_stands_still_while_lamps_settle(bench) -> None:
    bench.settling(5000)
    lit(bench)
    assert bench.clock(5000 + WATCHDOG_MS - 1).lamps == []
    assert states(bench.clock(5000 + WATCHDOG_MS).lamps) == DARK


def test_a_repetition_of_what_was_lit_before_the_silence_lights_nothing(bench) -> None:
    lit(bench)
    bench.clock(WATCHDOG_MS)
    (reply,) = sent(bench, Kind.SET, 1, wire.set_payload(LEVELS))
    assert reply.payload == wire.lit_payload(np.zeros(3))


def test_a_reset_is_dark_says_hello_and_forgets_the_numbers(bench) -> None:
    lit(bench, 40_000)
    begun = bench.reset(9)
    assert states(begun.lamps) == DARK
    hello = wire.decode(begun.replies[:-1])
    assert (hello.kind, hello.sequence) == (Kind.HELLO, 0)
    assert wire.parse_hello(hello.payload).boot_id == 9
    lit(bench, 1)


def test_noise_without_end_is_passed_over_up_to_its_zero(bench) -> None:
    dark = wire.encode(Packet(Kind.DARK, 2))
    lit(bench)
    # One byte more than a frame may have, then a packet in its tail: no frame of its own.
    assert bench.line(b"\x55" * (1 << 18) + b"\1" + dark).lamps == []
    assert states(bench.line(dark).lamps) == DARK
