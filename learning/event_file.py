"""Scalars of a training as TensorBoard reads them, written by hand: one file for each call.

The file is a row of TFRecords: a length (uint64, little-endian), the masked CRC of its eight bytes,
the bytes, and their masked CRC [TFRecord2024]. The CRC is Castagnoli's [RFC3720-2004], masked as
((crc >> 15) | (crc << 17)) + 0xa282ead8, so that a CRC of bytes that hold CRCs is no special one.
Each record is an `Event` of protocol buffers [TensorFlowEvent2024]:

    Event          wall_time double = 1, step int64 = 2, file_version string = 3, summary = 5,
                   session_log = 7
    Summary        value repeated = 1
    Summary.Value  tag string = 1, simple_value float = 2
    SessionLog     status enum = 1 (START = 1: what other files have from this step on is void)

TensorBoard itself is no dependency: its package brings a web server, and this is all that is
needed of it.
"""

from __future__ import annotations

import math
import secrets
import struct
import time
from collections.abc import Iterable, Mapping
from pathlib import Path

from learning.protobuf import BYTES, EIGHT_BYTES, FOUR_BYTES, VARINT, field, varint

VERSION = "brain.Event:2"
EVENTS = "events.out.tfevents."
"""How the names of these files begin."""
_POLYNOMIAL = 0x82F63B78
"""Castagnoli's, bits reversed."""
_MASK = 0xA282EAD8


class EventFile:
    """A file of scalars, made when the first are added; a killed training's last may be half."""

    def __init__(self, folder: Path) -> None:
        """Nothing is written yet."""
        self._folder = folder
        self._path: Path | None = None
        self._began = b""

    def begin_again(self, step: int, kept: Iterable[Mapping[str, float]] = ()) -> None:
        """Have TensorBoard leave out what files of earlier calls hold from a step on.

        Args:
            step: the first one that is left out.
            kept: scalars of this step that are shown nevertheless: scores of all steps before it.
        """
        start = record(_at(time.time(), step) + field(7, BYTES, field(1, VARINT, varint(1))))
        self._began = start + b"".join(_scalars(step, values) for values in kept)

    def add(self, step: int, values: Mapping[str, float]) -> None:
        """Add the finite ones of some scalars, which a step has."""
        records = _scalars(step, values)
        if self._path is None:
            now = time.time()
            name = f"{EVENTS}{int(now):010d}.{secrets.token_hex(4)}"
            self._folder.mkdir(parents=True, exist_ok=True)
            self._path = self._folder / name
            version = field(3, BYTES, VERSION.encode())
            first = record(field(1, EIGHT_BYTES, struct.pack("<d", now)) + version)
            records = first + self._began + records
        with self._path.open("ab") as handle:
            handle.write(records)


def _scalars(step: int, values: Mapping[str, float]) -> bytes:
    """A TFRecord of the finite ones of some scalars."""
    shown = {tag: value for tag, value in values.items() if math.isfinite(value)}
    return record(event(time.time(), step, shown))


def record(data: bytes) -> bytes:
    """A TFRecord of some bytes."""
    length = struct.pack("<Q", len(data))
    return length + _masked(length) + data + _masked(data)


def event(wall_time_s: float, step: int, values: Mapping[str, float]) -> bytes:
    """An `Event` with scalars; `step` is not negative, numbers are stored as float32."""
    summary = b"".join(
        field(
            1,
            BYTES,
            field(1, BYTES, tag.encode()) + field(2, FOUR_BYTES, _float32(value)),
        )
        for tag, value in values.items()
    )
    return _at(wall_time_s, step) + field(5, BYTES, summary)


def _at(wall_time_s: float, step: int) -> bytes:
    """The fields of an `Event` that state when it was."""
    return field(1, EIGHT_BYTES, struct.pack("<d", wall_time_s)) + field(2, VARINT, varint(step))


def crc32c(data: bytes) -> int:
    """Castagnoli's CRC of some bytes."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc = _TABLE[(crc ^ byte) & 0xFF] ^ (crc >> 8)
    return crc ^ 0xFFFFFFFF


def _masked(data: bytes) -> bytes:
    crc = crc32c(data)
    turned = ((crc >> 15) | (crc << 17)) & 0xFFFFFFFF
    return struct.pack("<I", (turned + _MASK) & 0xFFFFFFFF)


def _float32(value: float) -> bytes:
    """The nearest float32, the largest one where it is beyond all."""
    most = 3.4028234663852886e38
    return struct.pack("<f", min(max(value, -most), most))


def _remainder(byte: int) -> int:
    for _ in range(8):
        byte = (byte >> 1) ^ (_POLYNOMIAL if byte & 1 else 0)
    return byte


_TABLE = [_remainder(byte) for byte in range(256)]
