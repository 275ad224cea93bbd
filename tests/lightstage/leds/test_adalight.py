"""Adalight's bytes, as the sketch reads them."""

from __future__ import annotations

import os
import pty
import threading
import tty

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.leds.adalight import BOOT_WORD, AdalightLeds, Tint, header
from lightstage.leds.address import AdalightOptions
from lightstage.leds.opening import open_leds
from sim.devices.adalight_device import cut_frames


def test_headers_of_known_counts_have_known_bytes():
    # Count less one, big endian, and both bytes XOR 0x55.
    assert header(1) == b"Ada\x00\x00\x55"
    assert header(25) == b"Ada\x00\x18\x4d"
    assert header(168) == b"Ada\x00\xa7\xf2"
    assert header(300) == b"Ada\x01\x2b\x7f"
    assert header(65536) == b"Ada\xff\xff\x55"


def test_a_frame_has_these_bytes_on_the_line():
    device, host = pty.openpty()
    for end in (device, host):
        tty.setraw(end)
    got = []

    def read(count):
        while sum(map(len, got)) < count:
            got.append(os.read(device, 100))

    url = f"adalight://{os.ttyname(host)}?attempts=1&settle_s=0&timeout_s=0.05"
    url += "&colour=ff8000&order=grb"
    with open_leds(url, 2) as leds:
        reader = threading.Thread(target=read, args=(12,), daemon=True)
        reader.start()
        driven = leds.light(np.array([1.0, 0.5]))
        reader.join(30)
    assert b"".join(got) == b"Ada\x00\x01\x54" + bytes([128, 255, 0, 64, 128, 0])
    assert driven.tolist() == [1.0, 128 / 255]
    os.close(device)
    os.close(host)


def test_a_strip_that_is_silent_when_opened_is_used_all_the_same():
    device, host = pty.openpty()
    tty.setraw(host)
    with open_leds(f"adalight://{os.ttyname(host)}?timeout_s=0.05&attempts=1", 2) as leds:
        leds.light(np.ones(2))
        assert os.read(device, 100) == b"Ada\x00\x01\x54" + 6 * b"\xff"
    os.close(device)
    os.close(host)


@given(
    st.lists(st.floats(0, 1), min_size=1, max_size=20),
    st.sampled_from(["ffffff", "ff8040", "0000ff", "010203", "808080"]),
    st.sampled_from(["rgb", "grb", "bgr"]),
    st.sampled_from([0.5, 1.0, 2.2]),
)
def test_what_is_reported_to_be_driven_is_what_the_strongest_primary_is_sent(
    levels, colour, order, gamma
):
    tint = Tint(colour, order, gamma)
    wanted = np.array(levels)
    steps = tint.steps(wanted)
    pixels = np.frombuffer(tint.pixels(steps), np.uint8).reshape(-1, 3)
    full = max(bytes.fromhex(colour))
    assert np.array_equal(pixels.max(axis=1), steps)
    driven = tint.driven(steps)
    assert driven == pytest.approx((steps / full) ** gamma)
    # No other step comes nearer, in what the device is sent.
    assert np.abs(steps - full * wanted ** (1 / gamma)).max() <= 0.5 + 1e-9


@given(
    st.lists(st.lists(st.integers(0, 255), min_size=6, max_size=6), max_size=5),
    st.integers(1, 50),
)
def test_frames_are_found_by_another_hand_however_the_line_cuts_them(frames, step):
    stream = b"".join(header(2) + bytes(frame) for frame in frames)
    found, left = [], b""
    for place in range(0, len(stream), step):
        whole, left = cut_frames(left + stream[place : place + step])
        found += whole
    assert [list(frame[6:]) for frame in found] == frames


@given(st.binary(max_size=500))
def test_any_bytes_are_frames_with_true_headers_or_none(noise):
    frames, left = cut_frames(noise)
    for frame in frames:
        assert frame in noise
        assert header((len(frame) - 6) // 3) == frame[:6]
    assert noise.endswith(left)


class Nowhere:
    """A line that takes everything."""

    handles = (0,)

    def write(self, data):
        pass

    def read(self, _):
        return BOOT_WORD

    def drain(self):
        pass

    def close(self):
        pass


def test_the_last_will_ends_a_frame_cut_anywhere_and_is_black():
    with AdalightLeds("x", Nowhere, 2, AdalightOptions()) as leds:
        ((will, _),) = leds.last_will().messages
    white = header(2) + b"\xff" * 6
    for cut in range(len(white) + 1):
        frames, left = cut_frames(white + white[:cut] + will)
        assert frames[-1] == header(2) + bytes(6)
        assert len(left) <= 2
        # What was half sent is ended by darkness, not by the black frame's own header.
        lit = sum(byte > 0 for frame in frames[1:] for byte in frame[6:])
        assert lit <= max(0, cut - 6)
