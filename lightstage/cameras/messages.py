"""Messages between a capture and its camera processes: length-prefixed JSON and bytes."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from typing import Any

_HEADER = struct.Struct("<4sII")
_MAGIC = b"cam1"
MAX_BYTES = 1 << 30
"""No photograph is larger; a length beyond it is no message."""


def head(value: dict[str, Any], data_size: int = 0) -> bytes:
    """What precedes a message's data: magic, lengths of JSON and data (u32 each), the JSON."""
    text = json.dumps(value).encode()
    return _HEADER.pack(_MAGIC, len(text), data_size) + text


def read(take: Callable[[int], bytes]) -> tuple[dict[str, Any], bytes] | None:
    """Read one message.

    Args:
        take: gives exactly so many bytes, fewer only at the stream's end.

    Returns:
        The JSON and the data; None where the stream ends before the message does.

    Raises:
        ValueError: what stands there is no message.
    """
    header = take(_HEADER.size)
    if len(header) < _HEADER.size:
        return None
    magic, text_size, data_size = _HEADER.unpack(header)
    if magic != _MAGIC or text_size > MAX_BYTES or data_size > MAX_BYTES:
        raise ValueError(f"no message: {header[:12]!r}")
    text, data = take(text_size), take(data_size)
    if len(text) < text_size or len(data) < data_size:
        return None
    value = json.loads(text)
    if not isinstance(value, dict):
        raise ValueError("no message: its JSON is no object")
    return value, data
