"""The inputs and outputs that an ONNX file states, read from its bytes (onnx.proto3).

OpenCV runs such a file but does not report its inputs.
"""

from __future__ import annotations

import dataclasses

from learning.protobuf import fields

GRAPH = 7
"""Field of a model."""
INITIALIZER, INPUT, OUTPUT = 5, 11, 12
"""Fields of a graph."""


@dataclasses.dataclass(frozen=True)
class Value:
    """An input or output of a network.

    Attributes:
        name: as the file has it.
        shape: sizes; None where the file leaves one open.
    """

    name: str
    shape: tuple[int | None, ...]

    def __str__(self) -> str:
        return f"{self.name} of " + " x ".join("?" if n is None else str(n) for n in self.shape)


def inputs_and_outputs(data: bytes) -> tuple[list[Value], list[Value]]:
    """The inputs that a caller must give, and the outputs.

    Args:
        data: the whole file. What older versions list among the inputs but set in the file
            (weights) is left out.

    Raises:
        ValueError: these bytes are no ONNX model.
    """
    graph = _only(memoryview(data), GRAPH)
    set_here = {_text(t, 8) for t in _messages(graph, INITIALIZER)}
    inputs = [_value(v) for v in _messages(graph, INPUT)]
    return (
        [value for value in inputs if value.name not in set_here],
        [_value(v) for v in _messages(graph, OUTPUT)],
    )


def _value(data: memoryview) -> Value:
    """A ValueInfoProto: name, and type.tensor_type.shape.dim."""
    shape = _only(_only(_only(data, 2), 1), 2)
    sizes: list[int | None] = []
    for dim in _messages(shape, 1):
        values = [n for number, n in fields(dim) if number == 1 and isinstance(n, int)]
        # A size of zero, or one with the sign bit set, means that it is open.
        sizes.append(values[-1] if values and 0 < values[-1] < 1 << 31 else None)
    return Value(_text(data, 1), tuple(sizes))


def _messages(data: memoryview, wanted: int) -> list[memoryview]:
    return [v for number, v in fields(data) if number == wanted and isinstance(v, memoryview)]


def _only(data: memoryview, wanted: int) -> memoryview:
    """A message's message; empty ones where it is left out, but for the graph's."""
    found = _messages(data, wanted)
    if not found and wanted == GRAPH:
        raise ValueError("no graph")
    return found[-1] if found else memoryview(b"")


def _text(data: memoryview, wanted: int) -> str:
    return b"".join(_messages(data, wanted)[-1:]).decode()
