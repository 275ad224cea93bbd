"""E1.31 (sACN) packets as pure bytes [ANSI-E131-2018]. All numbers are big endian."""

from __future__ import annotations

import struct

SLOTS = 512
MAX_UNIVERSE = 63999
KEEP_ALIVE_S = 0.9
"""A state that does not change is sent again every 0.8 to 1 s; after 2.5 s its source is lost."""
TERMINATED = 0x40
"""Option bit: this source ends; what it sent is no longer valid."""
IDENTIFIER = b"ASC-E1.17\0\0\0"
_ROOT_DATA, _FRAME_DATA, _SET_PROPERTY = 4, 2, 2
_ADDRESS_TYPE = 0xA1


def data_packet(
    cid: bytes,
    name: str,
    universe: int,
    sequence: int,
    slots: bytes,
    priority: int = 100,
    options: int = 0,
) -> bytes:
    """A data packet: root, framing and DMP layer.

    Args:
        cid: 16 bytes that are this sender's own.
        name: of the sender, as people read it; cut to 63 bytes of UTF-8.
        universe: 1 to 63999.
        sequence: 0 to 255, one more with each packet of a universe.
        slots: at most 512; the missing ones are sent as 0.
        priority: 0 to 200.
        options: such as TERMINATED.

    Returns:
        638 bytes.
    """
    values = b"\0" + slots.ljust(SLOTS, b"\0")  # the start code 0 means dimmer levels
    dmp = struct.pack(">BBHHH", _SET_PROPERTY, _ADDRESS_TYPE, 0, 1, len(values)) + values
    dmp = _length(dmp)
    label = name.encode()[:63].decode(errors="ignore").encode()
    frame = struct.pack(
        ">I64sBHBBH", _FRAME_DATA, label, priority, 0, sequence % 256, options, universe
    )
    frame = _length(frame + dmp)
    root = _length(struct.pack(">I", _ROOT_DATA) + cid + frame)
    return struct.pack(">HH", 16, 0) + IDENTIFIER + root


def multicast_host(universe: int) -> str:
    """Where a universe goes that goes to everybody."""
    high, low = divmod(universe, 256)
    return f"239.255.{high}.{low}"


def _length(body: bytes) -> bytes:
    """A layer behind its flags (0x7) and length, which counts itself."""
    return struct.pack(">H", 0x7000 | (len(body) + 2)) + body
