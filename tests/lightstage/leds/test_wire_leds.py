"""The serial driver as a conversation: bytes it must send, bytes it gets; leftovers fail."""

import contextlib
import hashlib
import os
import pty
import struct
import threading
import time
import tty
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from cobs import cobs
from crc import Calculator, Crc16

from lightstage.errors import DeviceError
from lightstage.leds.controller import LightLostError
from lightstage.leds.opening import open_leds
from lightstage.leds.serial_port import SerialPort
from lightstage.leds.wire_leds import WireLeds

CRC = Calculator(Crc16.IBM_3740, optimized=True)


def packet(kind, sequence, payload=b""):
    body = struct.pack("<BBH", 1, kind, sequence) + payload
    return cobs.encode(body + struct.pack("<H", CRC.checksum(body))) + b"\0"


def hello(sequence, boot_id=7, lights=3):
    return packet(0x02, sequence, struct.pack("<IH", boot_id, lights) + b"fw")


def lit(sequence, *counts):
    return packet(0x20, sequence, hashlib.sha256(np.array(counts, "<u2").tobytes()).digest())


def set_(sequence, *counts):
    return packet(
        0x10, sequence, struct.pack("<H", len(counts)) + np.array(counts, "<u2").tobytes()
    )


class Conversation:
    """The far end of a pty: expects bytes in order, answers with bytes in order."""

    def __init__(self, *turns, timeout_s=0.8, delay_s=0.0):
        self.device, self.host = pty.openpty()
        for end in (self.device, self.host):
            tty.setraw(end)
        self.path = os.ttyname(self.host)
        self.timeout_s = timeout_s
        self.turns = list(turns)
        self.delay_s = delay_s
        self.got = b""
        self.thread = threading.Thread(target=self._serve, daemon=True)

    def opened(self, first_sequence):
        """A controller at the other end."""

        def line():
            return SerialPort(self.path)

        return WireLeds("the device", line, self.timeout_s, first_sequence=first_sequence)

    def __enter__(self):
        self.thread.start()
        return self

    def _serve(self):
        while True:
            try:
                self.got += os.read(self.device, 4096)
            except OSError:
                return
            while self.turns and self.got.startswith(self.turns[0][0]):
                expected, reply = self.turns.pop(0)
                self.got = self.got[len(expected) :]
                if expected[2:3] != b"\x01":
                    time.sleep(self.delay_s)
                os.write(self.device, reply)

    def __exit__(self, kind, *_):
        time.sleep(0.02)
        os.close(self.host)
        os.close(self.device)
        if kind is None:
            assert self.got == b"", f"sent unasked: {self.got.hex()}"
            assert not self.turns, f"not sent: {[t[0].hex() for t in self.turns]}"


OPENING = (packet(0x01, 5), hello(5))


@contextlib.contextmanager
def talking(*turns, **settings):
    """A controller that has greeted and whose next request has number 6."""
    with Conversation(OPENING, *turns, **settings) as far, far.opened(5) as leds:
        yield leds


def test_hello_set_state_dark_in_their_exact_bytes():
    turns = (
        (set_(6, 0, 32768, 65535), lit(6, 0, 32768, 65535)),
        (packet(0x12, 7), lit(7, 0, 32768, 65535)),
        (packet(0x11, 8), lit(8, 0, 0, 0)),
    )
    with talking(*turns) as leds:
        assert (leds.hello.boot_id, leds.hello.light_count, leds.hello.firmware) == (7, 3, "fw")
        driven = leds.light(np.array([0, 0.5, 1]))
        assert np.array_equal(driven, np.array([0, 32768, 65535]) / 65535)
        leds.confirm()
        leds.dark()


def test_a_silent_device_is_asked_again_with_the_same_bytes():
    request = set_(6, 1, 2, 3)
    turns = ((request, b""), (request, lit(6, 1, 2, 3)))
    with talking(*turns) as leds:
        leds.light(np.array([1, 2, 3]) / 65535)


def test_a_damaged_answer_is_dropped_and_the_request_repeated():
    request = set_(6, 1, 2, 3)
    broken = bytearray(lit(6, 1, 2, 3))
    broken[9] ^= 4
    turns = ((request, bytes(broken)), (request, lit(6, 1, 2, 3)))
    with talking(*turns) as leds:
        leds.light(np.array([1, 2, 3]) / 65535)


def test_nothing_is_repeated_before_the_timeout():
    turns = ((set_(6, 9, 9, 9), lit(6, 9, 9, 9)),)
    with talking(*turns, timeout_s=10, delay_s=0.7) as leds:
        leds.light(np.array([9, 9, 9]) / 65535)


def test_answers_to_other_requests_are_passed_over():
    stale = lit(4, 0, 0, 0) + lit(5, 0, 0, 0)
    turns = ((set_(6, 1, 1, 1), stale + lit(6, 1, 1, 1)),)
    with talking(*turns) as leds:
        leds.light(np.ones(3) / 65535)


def test_a_device_that_boots_late_is_greeted_by_its_unasked_hello():
    turns = ((packet(0x01, 5), hello(0)), (packet(0x11, 6), lit(6, 0, 0, 0)))
    with Conversation(*turns) as far, far.opened(5) as leds:
        leds.dark()


def test_each_hello_has_a_number_of_its_own():
    turns = ((packet(0x01, 0xFFFD), b""), (packet(0x01, 1), hello(1)))
    with Conversation(*turns) as far:
        far.opened(0xFFFD).close()


def test_lights_that_differ_from_what_was_set_are_an_error():
    turns = ((set_(6, 1, 2, 3), lit(6, 1, 2, 4)),)
    with (
        talking(*turns) as leds,
        pytest.raises(
            DeviceError, match=r"SET: found lights that .*type 0x20, state .*expected .*LIT"
        ),
    ):
        leds.light(np.array([1, 2, 3]) / 65535)


def test_a_state_that_changed_since_is_an_error():
    turns = (
        (set_(6, 1, 2, 3), lit(6, 1, 2, 3)),
        (packet(0x12, 7), lit(7, 0, 0, 0)),
    )
    with talking(*turns) as leds:
        leds.light(np.array([1, 2, 3]) / 65535)
        with pytest.raises(DeviceError, match="not as they were set"):
            leds.confirm()


def test_a_refusal_is_reported_with_its_reason():
    turns = ((set_(6, 1, 2), packet(0x2F, 6, b"\x02I have 3")),)
    with (
        talking(*turns) as leds,
        pytest.raises(DeviceError, match=r"refused \(wrong lamp count: I have 3\)"),
    ):
        leds.light(np.array([1, 2]) / 65535)


def test_a_device_that_was_reset_is_an_error():
    turns = ((set_(6, 1, 2, 3), hello(0, boot_id=8)),)
    with talking(*turns) as leds, pytest.raises(DeviceError, match="boot id: found another"):
        leds.light(np.array([1, 2, 3]) / 65535)


def test_a_device_that_never_answers_is_an_error_that_states_how_often_it_was_asked():
    request = packet(0x11, 6)
    turns = ((request, b""), (request, b""), (request, b""))
    with (
        talking(*turns, timeout_s=0.5) as leds,
        pytest.raises(DeviceError, match=r"no answer to 3 DARK of 0\.5 s"),
    ):
        leds.dark()


def test_a_malformed_hello_is_an_error():
    with (
        Conversation((packet(0x01, 5), packet(0x02, 5, b"abc"))) as far,
        pytest.raises(DeviceError, match="HELLO: found a HELLO of 3 bytes"),
    ):
        far.opened(5)


def test_a_level_out_of_range_sends_nothing():
    with talking() as leds, pytest.raises(DeviceError, match="levels"):
        leds.light(np.array([0, 2.0, 0]))


def test_a_port_that_is_not_there_or_in_use_is_an_error(tmp_path):
    with pytest.raises(DeviceError, match="a port that opens"):
        open_leds(f"serial://{tmp_path}/ttyNONE", 3)
    with (
        Conversation(OPENING) as far,
        far.opened(5),
        pytest.raises(DeviceError, match="no other program"),
    ):
        far.opened(9)


def test_after_a_reset_the_device_is_greeted_again_dark_and_lights_again():
    turns = (
        (set_(6, 1, 2, 3), hello(0, boot_id=8)),
        (packet(0x01, 7), hello(7, boot_id=8)),
        (packet(0x11, 8), lit(8, 0, 0, 0)),
        (set_(9, 1, 2, 3), lit(9, 1, 2, 3)),
        (packet(0x12, 10), lit(10, 1, 2, 3)),
    )
    with talking(*turns) as leds:
        with pytest.raises(LightLostError, match="boot id"):
            leds.light(np.array([1, 2, 3]) / 65535)
        assert leds.recover().boot_id == leds.hello.boot_id == 8
        leds.light(np.array([1, 2, 3]) / 65535)
        leds.confirm()


def test_a_reset_that_is_told_behind_the_answer_is_not_missed():
    turns = ((set_(6, 1, 2, 3), lit(6, 1, 2, 3) + hello(0, boot_id=8)),)
    with talking(*turns) as leds, pytest.raises(LightLostError, match="boot id"):
        leds.light(np.array([1, 2, 3]) / 65535)


def test_dark_is_asked_of_the_board_that_came_up_when_the_one_before_was_reset():
    turns = ((packet(0x11, 6), hello(0, boot_id=8)), (packet(0x11, 7), lit(7, 0, 0, 0)))
    with talking(*turns) as leds:
        leds.dark()


def test_another_device_after_a_recovery_is_refused():
    turns = (
        (set_(6, 1, 2, 3), hello(0, boot_id=8)),
        (packet(0x01, 7), hello(7, boot_id=8, lights=9)),
    )
    with talking(*turns) as leds:
        with pytest.raises(LightLostError):
            leds.light(np.array([1, 2, 3]) / 65535)
        with pytest.raises(DeviceError, match="lamp count: found 9, expected 3, as before"):
            leds.recover()


def test_dark_does_not_wait_for_another_threads_request():
    request = set_(6, 1, 2, 3)
    turns = ((request, b""), (packet(0x11, 7), lit(7, 0, 0, 0)))
    with talking(*turns, timeout_s=60) as leds:
        failed = []

        def light():
            with pytest.raises(LightLostError, match="another thread put the lights out"):
                leds.light(np.array([1, 2, 3]) / 65535)
            failed.append(True)

        thread = threading.Thread(target=light)
        thread.start()
        while leds._wanted is None:  # the request is on its way
            time.sleep(0.001)
        leds.dark()
        thread.join(30)
        assert failed == [True]


def test_nine_threads_may_ask_at_once():
    turns = [(set_(6, 1, 2, 3), lit(6, 1, 2, 3))]
    turns += [(packet(0x12, 7 + i), lit(7 + i, 1, 2, 3)) for i in range(90)]
    with talking(*turns) as leds:
        leds.light(np.array([1, 2, 3]) / 65535)
        with ThreadPoolExecutor(9) as pool:
            for asked in [pool.submit(leds.confirm) for _ in range(90)]:
                asked.result()


def test_a_packet_that_an_interrupt_cut_short_does_not_spoil_the_next():
    class Cut:
        """A line whose second write is interrupted in its middle."""

        handles = ()

        def __init__(self, port):
            self.port, self.writes = port, 0

        def write(self, data):
            self.writes += 1
            if self.writes == 2:
                self.port.write(data[:4])
                raise KeyboardInterrupt
            self.port.write(data)

        def read(self, wait_s):
            return self.port.read(wait_s)

        def close(self):
            self.port.close()

    half = set_(6, 1, 2, 3)[:4] + b"\0" + packet(0x11, 7)
    with (
        Conversation(OPENING, (half, lit(7, 0, 0, 0))) as far,
        WireLeds("far", lambda: Cut(SerialPort(far.path)), 30.0, first_sequence=5) as leds,
    ):
        with pytest.raises(KeyboardInterrupt):
            leds.light(np.array([1, 2, 3]) / 65535)
        leds.dark()


def test_pulses_are_those_of_the_address_else_those_of_the_device():
    stated = packet(0x02, 5, struct.pack("<IH", 7, 3) + b"fw\0pulse_hz=20000\0watchdog_ms=1500")
    with Conversation((packet(0x01, 5), stated)) as far, far.opened(5) as leds:
        assert leds.pulse_hz == 20000
        assert leds.hello.watchdog_s == 1.5
    with (
        Conversation((packet(0x01, 5), stated)) as far,
        WireLeds("far", lambda: SerialPort(far.path), pulse_hz=25e3, first_sequence=5) as leds,
    ):
        assert leds.pulse_hz == 25000
