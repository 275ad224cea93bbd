"""A face recogniser that the user supplies: an ONNX file, run by OpenCV."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from learning.errors import RecogniserError
from learning.evaluation.onnx_file import Value, inputs_and_outputs
from lightstage.counting import counted
from lightstage.errors import ConfigError
from lightstage.formats.values import read_regular

MOST_BYTES = 1 << 30
SIDE_PX = (16, 1024)
RANGES = {"signed": (-1.0, 1.0), "unit": (0.0, 1.0), "bytes": (0.0, 255.0)}
"""What black and white are to a network, by the word that names it."""
COSINE = "cosine"
LEAST_NUMBERS = 2
"""Least number of numbers of an embedding: the cosine of single numbers means nothing."""


@dataclasses.dataclass(frozen=True)
class RecogniserRequest:
    """What the user states of a recogniser.

    Attributes:
        path: of the .onnx.
        size_px: side of its square pictures; the file's where None.
        values: of `RANGES`.
    """

    path: Path
    size_px: int | None = None
    values: str = "signed"


class Recogniser:
    """A network that makes an embedding of a face's picture.

    Attributes:
        name: what identity is measured by.
        measure: of two embeddings.
        size: rows and columns of its pictures.
    """

    measure = COSINE

    def __init__(self, request: RecogniserRequest) -> None:
        """Read the file, and try it on a ramp of grey.

        Raises:
            ConfigError: an option out of bounds, or a size that the file contradicts.
            RecogniserError: no ONNX, or not a network from one picture to one embedding.
        """
        self._path = request.path
        self.name = request.path.name
        if request.values not in RANGES:
            raise ConfigError(
                "--recogniser-range", found=repr(request.values), expected=" or ".join(RANGES)
            )
        self._black, self._white = RANGES[request.values]
        data = read_regular(request.path, MOST_BYTES, "a recogniser (.onnx)", RecogniserError)
        try:
            inputs, outputs = inputs_and_outputs(data)
        except ValueError as wrong:
            raise RecogniserError(
                request.path, found=f"no ONNX ({wrong})", expected="a recogniser (.onnx)"
            ) from None
        self.size = _size(request, inputs)
        if len(outputs) != 1:
            raise RecogniserError(
                request.path,
                field="outputs",
                found=_listed(outputs),
                expected="one output, the embedding",
            )
        with _opencv_errors_as_ours(request.path, "OpenCV cannot read it"):
            self._net: Any = cv2.dnn.readNetFromONNX(np.frombuffer(data, np.uint8))
        ramp = np.linspace(0.25, 1, self.size[0] * self.size[1] * 3, dtype=np.float32)
        self.embedding(ramp.reshape(*self.size, 3))

    def embedding(self, picture: np.ndarray) -> np.ndarray:
        """(d,) float64 of length 1.

        Args:
            picture: (rows, columns, 3) sRGB, red green blue, 0..1, of the size `size`.

        Raises:
            RecogniserError: the network cannot take it, or gives NaN, nothing, or one number.
        """
        values = self._black + (self._white - self._black) * picture.astype(np.float32)
        with _opencv_errors_as_ours(
            self._path, f"cannot take 1 x 3 x {self.size[0]} x {self.size[1]}"
        ):
            self._net.setInput(np.ascontiguousarray(values.transpose(2, 0, 1)[None]))
            found = np.ravel(self._net.forward()).astype(float)
        length = float(np.linalg.norm(found))
        if found.size < LEAST_NUMBERS or not np.isfinite(length) or length == 0:
            wrong = "NaN or infinite" if not np.isfinite(length) else "zero"
            raise RecogniserError(
                self._path,
                field="embedding",
                found=counted(found.size, "number")
                if found.size < LEAST_NUMBERS
                else f"{wrong} numbers",
                expected=f"at least {LEAST_NUMBERS} finite numbers that are not all zero",
                hint="--recogniser-range gives the network's numbers of black and white.",
            )
        return found / length


def _size(request: RecogniserRequest, inputs: list[Value]) -> tuple[int, int]:
    """Rows and columns of the pictures, by the file or else by the option."""
    if request.size_px is not None and not SIDE_PX[0] <= request.size_px <= SIDE_PX[1]:
        raise ConfigError(
            "--recogniser-size",
            found=str(request.size_px),
            expected=f"{SIDE_PX[0]} to {SIDE_PX[1]} px",
        )
    shape = inputs[0].shape if len(inputs) == 1 else ()
    if len(shape) != 4 or shape[0] not in (None, 1) or shape[1] not in (None, 3):
        raise RecogniserError(
            request.path,
            field="inputs",
            found=_listed(inputs),
            expected="one input of 1 x 3 x rows x columns, a picture of red, green and blue",
        )
    rows, columns = shape[2] or request.size_px, shape[3] or request.size_px
    if rows is None or columns is None:
        raise RecogniserError(
            request.path,
            field="inputs",
            found=f"{inputs[0]}, without a size",
            expected="the size of its pictures",
            hint="Name it by --recogniser-size; many take 112.",
        )
    if request.size_px is not None and (rows, columns) != (request.size_px, request.size_px):
        raise ConfigError(
            "--recogniser-size",
            found=str(request.size_px),
            expected=f"{rows} x {columns}, as {request.path} has",
            hint="Leave --recogniser-size out.",
        )
    if not all(SIDE_PX[0] <= side <= SIDE_PX[1] for side in (rows, columns)):
        raise RecogniserError(
            request.path,
            field="inputs",
            found=f"pictures of {rows} x {columns}",
            expected=f"{SIDE_PX[0]} to {SIDE_PX[1]} px a side",
        )
    return rows, columns


def _listed(values: list[Value]) -> str:
    return ", ".join(map(str, values)) or "none"


@contextmanager
def _opencv_errors_as_ours(path: Path, what: str) -> Iterator[None]:
    """OpenCV's errors as one of ours; it prints none of its own meanwhile."""
    before = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    except cv2.error as wrong:
        message = " ".join(str(wrong.err).split())[:200]
        raise RecogniserError(
            path, found=f"{what}: {message}", expected="a recogniser that OpenCV's dnn runs"
        ) from None
    finally:
        cv2.utils.logging.setLogLevel(before)
