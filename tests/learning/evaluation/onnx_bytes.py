"""Small ONNX files, written by the bytes of their protocol buffers (onnx.proto3)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

FLOAT = 1


def linear_network(
    weights: np.ndarray, shapes: Sequence[Sequence[int | str]], outputs: int = 1
) -> bytes:
    """A model: its first input, flattened, times the weights.

    Args:
        weights: (k, d), k the numbers of a picture.
        shapes: of its inputs; a word is a size that stays open.
        outputs: how many; those after the first are the flattened input again.
    """
    names = [f"picture{place}" for place in range(len(shapes))]
    graph = field(1, _node("Flatten", names[:1], "flat"))
    graph += field(1, _node("MatMul", ["flat", "weights"], "embedding"))
    graph += field(2, "linear")
    tensor = b"".join(field(1, size) for size in weights.shape)
    tensor += field(2, FLOAT) + field(8, "weights") + field(9, weights.astype("<f4").tobytes())
    graph += field(5, tensor)
    for name, shape in zip(names, shapes, strict=True):
        graph += field(11, _value(name, shape))
    # Older files list their weights among the inputs.
    graph += field(11, _value("weights", weights.shape))
    for name in ("embedding", "flat")[:outputs]:
        graph += field(12, _value(name, ["n", "d"]))
    return field(1, 8) + field(7, graph) + field(8, field(2, 13))


def field(number: int, content: int | str | bytes) -> bytes:
    """One field of a message."""
    if isinstance(content, int):
        return varint(number << 3) + varint(content)
    data = content.encode() if isinstance(content, str) else content
    return varint(number << 3 | 2) + varint(len(data)) + data


def varint(value: int) -> bytes:
    """A whole number, seven bits a byte, lowest first."""
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    return bytes([*out, value])


def _node(kind: str, inputs: Sequence[str], output: str) -> bytes:
    given = b"".join(field(1, name) for name in inputs)
    return given + field(2, output) + field(3, f"{output} node") + field(4, kind)


def _value(name: str, shape: Sequence[int | str]) -> bytes:
    dims = b"".join(field(1, field(1 if isinstance(n, int) else 2, n)) for n in shape)
    return field(1, name) + field(2, field(1, field(1, FLOAT) + field(2, dims)))
