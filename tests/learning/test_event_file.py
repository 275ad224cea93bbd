"""TensorBoard's event files: decoded by another hand, bit by bit."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from learning.event_file import EventFile, crc32c, event


def plain_crc(data: bytes) -> int:
    """CRC-32C by polynomial division, a bit at a time, highest bit first."""
    bits = [int(b) for byte in data for b in f"{byte:08b}"[::-1]] + [0] * 32
    for i in range(32):
        bits[i] ^= 1
    divisor = [int(b) for b in f"{0x11EDC6F41:033b}"]
    for i in range(len(bits) - 32):
        if bits[i]:
            for j, bit in enumerate(divisor):
                bits[i + j] ^= bit
    rest = [b ^ 1 for b in bits[-32:]]
    return int("".join(map(str, rest[::-1])), 2)


def records(data: bytes) -> list[bytes]:
    """The records of a file whose CRCs are right."""
    found = []
    while data:
        (length,) = struct.unpack("<Q", data[:8])
        body = data[12 : 12 + length]
        assert len(body) == length
        for checksum, of in ((data[8:12], data[:8]), (data[12 + length : 16 + length], body)):
            crc = plain_crc(of)
            assert (
                struct.unpack("<I", checksum)[0]
                == (((crc >> 15) | (crc << 17 & 0xFFFFFFFF)) + 0xA282EAD8) % 2**32
            )
        found.append(body)
        data = data[16 + length :]
    return found


def fields(data: bytes) -> list[tuple[int, int | bytes]]:
    """A message's fields in order: number, and bytes or a whole number."""

    def varint(at: int) -> tuple[int, int]:
        value = shift = 0
        while True:
            value |= (data[at] & 127) << shift
            at, shift, more = at + 1, shift + 7, data[at] & 128
            if not more:
                return value, at

    found: list[tuple[int, int | bytes]] = []
    at = 0
    while at < len(data):
        key, at = varint(at)
        kind = key & 7
        if kind == 0:
            value, at = varint(at)
            found.append((key >> 3, value))
            continue
        size = {1: 8, 5: 4}.get(kind)
        if size is None:
            assert kind == 2
            size, at = varint(at)
        found.append((key >> 3, data[at : at + size]))
        at += size
    return found


def scalars(data: bytes) -> tuple[float, int, dict[str, float]]:
    """Time, step and scalars of an `Event`."""
    top = dict(fields(data))
    values = {}
    for number, value in fields(top[5]):  # type: ignore[arg-type]
        assert number == 1
        inner = dict(fields(value))  # type: ignore[arg-type]
        values[inner[1].decode()] = struct.unpack("<f", inner[2])[0]  # type: ignore
    return struct.unpack("<d", top[1])[0], int(top[2]), values  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("data", "crc"),
    [  # RFC 3720, B.4
        (bytes(32), 0x8A9136AA),
        (b"\xff" * 32, 0x62A8AB43),
        (bytes(range(32)), 0x46DD794E),
        (b"123456789", 0xE3069283),
        (b"", 0),
    ],
)
def test_the_crc_is_that_of_known_vectors(data: bytes, crc: int) -> None:
    assert crc32c(data) == crc
    assert plain_crc(data) == crc


@given(st.binary(max_size=40))
def test_the_crc_is_that_of_plain_division(data: bytes) -> None:
    assert crc32c(data) == plain_crc(data)


@given(
    st.floats(0, 1e12),
    st.integers(0, 2**63 - 1),
    st.dictionaries(
        st.text(st.characters(exclude_categories=["Cs"]), max_size=20),
        st.floats(allow_nan=False, allow_infinity=False),
        max_size=5,
    ),
)
def test_an_event_states_what_went_in(when: float, step: int, values: dict[str, float]) -> None:
    found = scalars(event(when, step, values))
    assert found[:2] == (when, step)
    assert found[2].keys() == values.keys()
    most = float(np.finfo(np.float32).max)
    for tag, value in values.items():
        assert found[2][tag] == np.float32(min(max(value, -most), most))


def test_a_file_begins_with_its_version_and_leaves_out_what_is_not_finite(tmp_path: Path) -> None:
    events = EventFile(tmp_path / "run")
    assert not (tmp_path / "run").exists()
    events.add(0, {"loss": 0.5, "rate": math.nan})
    events.add(20, {"loss": 0.25, "other": math.inf})
    (path,) = (tmp_path / "run").iterdir()
    assert path.name.startswith("events.out.tfevents.")
    version, first, second = records(path.read_bytes())
    assert dict(fields(version))[3] == b"brain.Event:2"
    assert scalars(first)[1:] == (0, {"loss": 0.5})
    assert scalars(second)[1:] == (20, {"loss": 0.25})
    EventFile(tmp_path / "run").add(21, {"loss": 1.0})
    assert len(list((tmp_path / "run").iterdir())) == 2
