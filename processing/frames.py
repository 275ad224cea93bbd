"""Decoded photographs of a camera: what later stages read instead of the session's files."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np

from lightstage.errors import FormatError
from lightstage.formats.files import atomic_path


@dataclasses.dataclass(frozen=True)
class Frames:
    """One camera's photographs, in its own pixels (lens distortion is not undone).

    Attributes:
        patterns: P names, in the session's order, without dark frames.
        images: (P, h, w, 3) float32 linear, a white diffuser at the origin facing +z lit by `full`
            reads 1; finite, 0 where not `valid`.
        valid: (h, w) bool, false where a channel of any pattern is clipped or not a number.
    """

    patterns: tuple[str, ...]
    images: np.ndarray
    valid: np.ndarray


def frames_path(out: Path, camera_id: str) -> Path:
    """Where a camera's decoded photographs lie in a processed folder."""
    return out / "work" / "frames" / f"{camera_id}.npz"


def foreground_path(out: Path, camera_id: str) -> Path:
    """Where the mask that the photographs alone give lies: 255 where something was lit."""
    return out / "work" / "foreground" / f"{camera_id}.png"


def write_frames(out: Path, camera_id: str, frames: Frames) -> Path:
    """Write decoded photographs atomically, as half floats of a common scale.

    Half floats keep 11 bits: an error of 1 in 4096, a fifth of a sensor's own noise or less.

    Returns:
        The file's path.
    """
    path = frames_path(out, camera_id)
    peak = float(np.abs(frames.images).max(initial=0.0)) or 1.0
    with atomic_path(path) as beside:
        np.savez(
            beside,
            patterns=np.array(frames.patterns),
            images=(frames.images / np.float32(peak)).astype(np.float16),
            scale=np.float64(peak),
            valid=np.packbits(frames.valid),
        )
    return path


def read_frames(out: Path, camera_id: str) -> Frames:
    """Read a camera's decoded photographs.

    Raises:
        FormatError: missing or damaged.
    """
    path = frames_path(out, camera_id)
    try:
        with np.load(path, allow_pickle=False) as file:
            images = file["images"].astype(np.float32)
            images *= np.float32(file["scale"])
            height, width = images.shape[1:3]
            valid = np.unpackbits(file["valid"], count=height * width).astype(bool)
            patterns = tuple(str(name) for name in file["patterns"])
    except FileNotFoundError:
        raise FormatError(
            path,
            found="no such file",
            expected=f"the decoded photographs of {camera_id}",
            hint="Run the stage `decode` first: lightstage-processing run --until decode.",
        ) from None
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise FormatError(path, found=str(error), expected="images, scale, valid") from None
    return Frames(patterns, images, valid.reshape(height, width))


def write_foreground(out: Path, camera_id: str, mask: np.ndarray) -> Path:
    """Write a camera's (h, w) bool foreground mask; returns its path."""
    path = foreground_path(out, camera_id)
    with atomic_path(path) as beside:
        cv2.imwrite(str(beside), mask.astype(np.uint8) * 255)
    return path


def read_foreground(out: Path, camera_id: str) -> np.ndarray:
    """Read a camera's foreground mask: (h, w) bool; FormatError when missing."""
    path = foreground_path(out, camera_id)
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) if path.is_file() else None
    if image is None:
        raise FormatError(path, found="no readable picture", expected="a mask written by decode")
    return np.asarray(image) > 127
