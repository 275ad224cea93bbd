"""Messages of protocol buffers, field by field: as much as the files that we read and write need.

A message is a row of fields. A field is a key (its number times 8, plus its wire type) and its
content; whole numbers have seven bits a byte, the lowest first, and the highest bit of a byte says
that more follow [ProtobufEncoding2024].
"""

from __future__ import annotations

from collections.abc import Iterator

VARINT, EIGHT_BYTES, BYTES, FOUR_BYTES = 0, 1, 2, 5
"""Wire types: a whole number, eight bytes (a double), a length with its bytes, four (a float)."""
VARINT_BYTES = 10
"""A whole number has no more bytes."""


def field(number: int, kind: int, payload: bytes) -> bytes:
    """A field of a message; of `BYTES` with its length."""
    length = varint(len(payload)) if kind == BYTES else b""
    return varint(number << 3 | kind) + length + payload


def varint(value: int) -> bytes:
    """A whole number that is not negative."""
    found = bytearray()
    while value > 0x7F:
        found.append(value & 0x7F | 0x80)
        value >>= 7
    found.append(value)
    return bytes(found)


def fields(data: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    """Number and content of each whole number and each row of bytes; other fields are left out.

    Bytes are not copied.

    Raises:
        ValueError: these bytes are no message.
    """
    at = 0
    while at < len(data):
        key, at = read_varint(data, at)
        number, kind = key >> 3, key & 7
        if number == 0:
            raise ValueError("a field without a number")
        if kind == VARINT:
            value, at = read_varint(data, at)
            yield number, value
        elif kind == BYTES:
            length, at = read_varint(data, at)
            if length > len(data) - at:
                raise ValueError("a field that ends beyond the file")
            yield number, data[at : at + length]
            at += length
        elif kind in (EIGHT_BYTES, FOUR_BYTES):
            at += 8 if kind == EIGHT_BYTES else 4
        else:
            raise ValueError("a field of an unknown kind")


def read_varint(data: memoryview, at: int) -> tuple[int, int]:
    """A whole number and where it ends; ValueError where it is cut or has too many bytes."""
    value = 0
    for place in range(VARINT_BYTES):
        if at + place >= len(data):
            raise ValueError("a number that is cut")
        byte = data[at + place]
        value |= (byte & 127) << (7 * place)
        if byte < 128:
            return value, at + place + 1
    raise ValueError("a number of too many bytes")
