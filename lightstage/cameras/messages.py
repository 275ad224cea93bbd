"""Messages between a capture and its camera processes: length-prefixed JSON, no photographs.

A photograph goes from the driver to the disk inside the camera's process; what passes here is a
few lines of text.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from typing import Any

from lightstage.errors import FormatError
from lightstage.formats.values import LINE, parse_json

_HEADER = struct.Struct("<4sI")
_MAGIC = b"cam2"
MAX_BYTES = 1 << 26
"""No list of a card's files is longer; a length beyond it is no message."""


def pack(value: dict[str, Any]) -> bytes:
    """One message: magic, length of the JSON (u32), the JSON."""
    text = json.dumps(value).encode()
    return _HEADER.pack(_MAGIC, len(text)) + text


def read(take: Callable[[int], bytes]) -> dict[str, Any] | None:
    """Read one message.

    Args:
        take: gives exactly so many bytes, fewer only at the stream's end.

    Returns:
        The JSON; None where the stream ends before the message does.

    Raises:
        ValueError: the bytes are no message.
    """
    header = take(_HEADER.size)
    if len(header) < _HEADER.size:
        return None
    magic, size = _HEADER.unpack(header)
    if magic != _MAGIC or size > MAX_BYTES:
        raise ValueError(f"no message: {header!r}")
    text = take(size)
    if len(text) < size:
        return None
    try:
        value = parse_json(text, "message", LINE)
    except FormatError as error:
        raise ValueError(str(error)) from None
    if not isinstance(value, dict):
        raise ValueError("no message: its JSON is no object")
    return value
