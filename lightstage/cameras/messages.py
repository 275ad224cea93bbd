"""Messages between a capture and its camera processes: length-prefixed JSON and bytes."""

from __future__ import annotations

import json
import struct
from typing import Any, BinaryIO

_HEADER = struct.Struct("<II")
MAX_BYTES = 1 << 30
"""No photograph is larger; a length beyond it is no message."""


def pack(value: dict[str, Any], data: bytes = b"") -> bytes:
    """A message: length of the JSON, length of the data (both u32), JSON, data."""
    text = json.dumps(value).encode()
    return _HEADER.pack(len(text), len(data)) + text + data


def unpack(buffer: bytearray) -> tuple[dict[str, Any], bytes] | None:
    """Take the first whole message off a buffer; None while it is not whole.

    Raises:
        ValueError: what stands there is no message.
    """
    if len(buffer) < _HEADER.size:
        return None
    text_size, data_size = _HEADER.unpack_from(buffer)
    if text_size > MAX_BYTES or data_size > MAX_BYTES:
        raise ValueError("no message")
    end = _HEADER.size + text_size + data_size
    if len(buffer) < end:
        return None
    value = json.loads(bytes(buffer[_HEADER.size : _HEADER.size + text_size]))
    data = bytes(memoryview(buffer)[_HEADER.size + text_size : end])
    del buffer[:end]
    if not isinstance(value, dict):
        raise ValueError("no message")
    return value, data


def read(stream: BinaryIO) -> tuple[dict[str, Any], bytes] | None:
    """Read one message from a blocking stream; None at its end."""
    header = stream.read(_HEADER.size)
    if len(header) < _HEADER.size:
        return None
    text_size, data_size = _HEADER.unpack(header)
    return json.loads(stream.read(text_size)), stream.read(data_size)
