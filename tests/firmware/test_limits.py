"""What the firmware needs of a board, and what its compile-time limits refuse."""

from __future__ import annotations

import subprocess

import pytest

from lightstage.leds import wire
from lightstage.leds.wire import Kind, Packet
from tests.firmware.conftest import make


def test_every_file_compiles_without_a_warning() -> None:
    checked = make("check")
    assert (checked.returncode, checked.stderr) == (0, "")


def test_nothing_is_called_but_what_any_compiler_calls_by_itself(tmp_path) -> None:
    assert make("size", f"OUT={tmp_path}").returncode == 0
    objects = sorted((tmp_path / "small").glob("*.o"))
    assert [path.name for path in objects] == ["device.o", "packet.o", "sha256.o"]
    printed = subprocess.run(
        ["nm", "--undefined-only", "--format=just-symbols", *objects],
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split()
    names = {word for word in printed if not word.endswith(":") and not word.startswith("ls_")}
    # No heap, no system: gcc wants these four of any board, and some builds guard the stack.
    assert names <= {"memcpy", "memmove", "memset", "memcmp", "__stack_chk_fail"}


def test_there_is_no_state_but_the_callers(tmp_path) -> None:
    made = make("size", f"OUT={tmp_path}")
    rows = [line.split() for line in made.stdout.splitlines()[1:]]
    assert [(row[1], row[2]) for row in rows] == [("0", "0")] * 3  # .data, .bss


@pytest.mark.parametrize(
    ("define", "message"),
    [
        ("-DLS_LIGHTS=0", "LS_LIGHTS must be 1 to 65535"),
        ("-DLS_LIGHTS=65536", "LS_LIGHTS must be 1 to 65535"),
        ("-DLS_WATCHDOG_MS=1001", "dark within a second"),
        ("-DLS_WATCHDOG_MS=99", "dark within a second"),
        ("-DLS_MAX_FRAME=345", "LS_MAX_FRAME must hold a SET"),
        ("-DLS_PULSE_HZ=-1", "LS_PULSE_HZ must be"),
        (f'-DLS_FIRMWARE=\\"{"n" * 250}\\"', "a_reply_is_short"),
    ],
)
def test_a_limit_out_of_range_is_refused_by_the_compiler(define, message) -> None:
    checked = make("check", f"DEFINES={define}", "CHECKED=lightstage_leds/src/device.c")
    assert checked.returncode != 0
    assert message in checked.stderr


@pytest.mark.parametrize(
    "define",
    ["-DLS_LIGHTS=1", "-DLS_LIGHTS=65535", "-DLS_MAX_FRAME=346", "-DLS_PULSE_HZ=20000"],
)
def test_a_limit_at_its_bound_compiles(define) -> None:
    checked = make("check", f"DEFINES={define}", "CHECKED=lightstage_leds/src/device.c")
    assert (checked.returncode, checked.stderr) == (0, "")


def test_what_a_byte_costs_does_not_grow_with_the_frame(compiled) -> None:
    most = {}
    for lights in (3, 168):
        printed = subprocess.run(
            [compiled("steps", lights), "2000", "1"], capture_output=True, text=True, check=True
        )
        most[lights] = [int(number) for number in printed.stdout.split()]
    # Basic blocks of code: of any byte but the last of a whole packet, and of that one.
    assert most[3][0] == most[168][0] < 25
    # The levels are taken over and hashed, once.
    assert most[168][1] - most[3][1] < 250 * (168 - 3)


def test_a_frame_of_the_greatest_length_is_a_packet_and_a_longer_one_is_not(bench) -> None:
    limit = 262_144
    by_size = {}
    for size in range(limit * 254 // 255 - 12, limit * 254 // 255):  # header, CRC, COBS's bytes
        frame = wire.encode(Packet(0x33, 0x101, b"\1" * size))
        by_size[len(frame) - 1] = frame
    assert wire.decode(bench.line(by_size[limit]).replies[:-1]).kind == Kind.REFUSED
    assert bench.line(by_size[limit + 1]).replies == b""
    assert bench.line(by_size[limit + 1][:-1] + b"\1\2\3\0").replies == b""
