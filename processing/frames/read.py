"""Decoded photographs of a camera: what later stages read instead of the session's files."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numba import njit, prange

from lightstage.errors import FormatError
from lightstage.formats.half import as_float
from lightstage.formats.png import write_png
from processing.frames.drafts import (
    CLIPPED,
    HALVES,
    NOT_A_NUMBER,
    frames_path,
    new_frames,
    read_facts,
)
from processing.frames.window import Window, whole


@dataclasses.dataclass(frozen=True)
class Frames:
    """One camera's photographs, in its own pixels (lens distortion is not undone).

    Only the window that holds the face is kept, as half floats: 11 bits, an error of 1 in 4096 at
    most, a fifth of a sensor's own noise or less. What is read from a folder is mapped, so that
    only the pages that are touched come into memory.

    Attributes:
        patterns: P names, in the session's order, without dark frames.
        half: (P, h, w, 3) float16 of the window, finite; times `scale` it is linear, a white
            diffuser at the origin facing +z lit by `full` reads 1.
        scale: a power of two.
        window: where in the picture `half` is.
        shape: rows and columns of the whole picture.
        clipped: (h, w) uint8 of the window: bits RED, GREEN, BLUE where any pattern's channel is
            clipped, NOT_A_NUMBER where any is none or is not to be used for another reason.
    """

    patterns: tuple[str, ...]
    half: np.ndarray
    scale: float
    window: Window
    shape: tuple[int, int]
    clipped: np.ndarray

    @classmethod
    def of(cls, patterns: Sequence[str], images: np.ndarray, valid: np.ndarray) -> Frames:
        """Frames of whole pictures in memory.

        Args:
            patterns: P names.
            images: (P, H, W, 3) linear; what is not finite becomes 0 and not valid.
            valid: (H, W) bool.
        """
        finite = np.isfinite(images)
        clean = images if finite.all() else np.where(finite, images, 0)
        scale = power_of_two(float(np.abs(clean).max(initial=0.0)))
        usable = valid & finite.all(axis=(0, 3))
        shape = (images.shape[1], images.shape[2])
        half = (clean / np.float32(scale)).astype(np.float16)
        clipped = np.where(usable, 0, NOT_A_NUMBER).astype(np.uint8)
        return cls(tuple(patterns), half, scale, whole(shape), shape, clipped)

    @property
    def bits(self) -> np.ndarray:
        """(P, h, w, 3) uint16 bits of `half`, read-only as a file's: loops are compiled once."""
        bits = np.asarray(self.half).view(np.uint16)
        bits.flags.writeable = False
        return bits

    @property
    def valid(self) -> np.ndarray:
        """(H, W) bool of the whole picture: in the window, nothing clipped, all finite."""
        return self.window.placed(np.asarray(self.clipped) == 0, self.shape)

    @property
    def images(self) -> np.ndarray:
        """(P, H, W, 3) float32, the whole pictures, 0 outside of the window; made anew each time.

        `image` and `pixels` take less memory.
        """
        return np.stack([self.image(k) for k in range(len(self.patterns))])

    def image(self, k: int) -> np.ndarray:
        """(H, W, 3) float32, the whole picture of pattern `k`, 0 outside of the window."""
        inner = np.asarray(self.half[k]).astype(np.float32)
        inner *= np.float32(self.scale)
        return self.window.placed(inner, self.shape)

    def brightest(self) -> np.ndarray:
        """(H, W, 3) float32, the picture of the pattern that lights most."""
        means = [half[::8, ::8].mean(dtype=float) for half in self.half]
        return self.image(int(np.argmax(means)))

    def pixels(self, mask: np.ndarray, patterns: Sequence[str] | None = None) -> np.ndarray:
        """What the pixels of a mask read, without the whole pictures.

        Args:
            mask: (H, W) bool of the whole picture with n true pixels.
            patterns: P of these frames' patterns, in the order wanted; None for all. No page of
                another pattern is read.

        Returns:
            (n, P, 3) float32 in row order of the mask; 0 outside of the window.
        """
        if mask.shape != self.shape:
            raise ValueError(f"mask of {mask.shape}, picture of {self.shape}")
        first = np.concatenate([[0], np.cumsum(np.count_nonzero(mask, axis=1))])
        wanted = self.patterns if patterns is None else patterns
        rows = np.array([self.patterns.index(name) for name in wanted], np.int64)
        out = np.zeros((int(first[-1]), len(rows), 3), np.float32)
        scale, corner = np.float32(self.scale), (self.window.top, self.window.left)
        _gather(self.bits, rows, np.ascontiguousarray(mask), first, corner, scale, out)
        return out


@njit(parallel=True, cache=True)
def _gather(
    bits: np.ndarray,
    rows: np.ndarray,
    mask: np.ndarray,
    first: np.ndarray,
    corner: tuple[int, int],
    scale: np.float32,
    out: np.ndarray,
) -> None:
    for y in prange(mask.shape[0]):
        row = y - corner[0]
        if row < 0 or row >= bits.shape[1]:
            continue
        for k in range(len(rows)):
            picture = bits[rows[k]]
            n = first[y]
            for x in range(mask.shape[1]):
                if mask[y, x]:
                    column = x - corner[1]
                    if 0 <= column < bits.shape[2]:
                        for c in range(3):
                            out[n, k, c] = as_float(picture[row, column, c]) * scale
                    n += 1


def power_of_two(peak: float) -> float:
    """The least power of two that is not below a positive number; 1 for 0 and for no number."""
    if not (np.isfinite(peak) and peak > 0):
        return 1.0
    return float(2.0 ** np.clip(np.ceil(np.log2(peak)), -100, 100))


def foreground_path(out: Path, camera_id: str) -> Path:
    """The file of the mask that the photographs alone give: 255 where something was lit."""
    return out / "work" / "foreground" / f"{camera_id}.png"


def write_frames(out: Path, camera_id: str, frames: Frames) -> Path:
    """Write decoded photographs atomically.

    Returns:
        Their folder.
    """
    place = (frames.patterns, frames.scale, frames.window, frames.shape)
    with new_frames(out, camera_id, *place) as draft:
        draft.half[:] = frames.half
        draft.clipped[:] = frames.clipped
    return frames_path(out, camera_id)


def photographed_patterns(out: Path, camera_id: str) -> frozenset[str]:
    """Patterns of a camera that were decoded from photographs, not made of other patterns."""
    facts = read_facts(frames_path(out, camera_id), camera_id)
    # Frames that `write_frames` wrote have no keys: nothing is known to be made of others.
    return frozenset(facts["told"].get("keys", facts["patterns"]))


def read_frames(out: Path, camera_id: str) -> Frames:
    """Map a camera's decoded photographs.

    Raises:
        FormatError: missing or damaged.
    """
    folder = frames_path(out, camera_id)
    value = read_facts(folder, camera_id)
    try:
        half = np.load(folder / HALVES, mmap_mode="r", allow_pickle=False)
        clipped = np.load(folder / CLIPPED, mmap_mode="r", allow_pickle=False)
        window = Window(**value["window"])
        shape = (int(value["shape"][0]), int(value["shape"][1]))
        patterns, scale = tuple(map(str, value["patterns"])), float(value["scale"])
    except (OSError, ValueError, KeyError, TypeError, IndexError, EOFError) as error:
        raise FormatError(folder, found=str(error), expected="half.npy, clipped.npy") from None
    size = (len(patterns), *window.shape, 3)
    whole_files = half.shape == size and clipped.shape == window.shape and window.inside(shape)
    if not whole_files or half.dtype != np.float16 or clipped.dtype != np.uint8:
        raise FormatError(
            folder,
            found=f"{half.dtype} {half.shape} and {clipped.dtype} {clipped.shape}",
            expected=f"float16 {size} and uint8 {window.shape} in a picture of {shape}",
            hint="Run the stage `decode` again: lightstage-processing run --until decode.",
        )
    return Frames(patterns, half, scale, window, shape, clipped)


def write_foreground(out: Path, camera_id: str, mask: np.ndarray) -> Path:
    """Write a camera's (h, w) bool foreground mask; returns its path."""
    options = [cv2.IMWRITE_PNG_BILEVEL, 1]
    return write_png(foreground_path(out, camera_id), mask.astype(np.uint8) * 255, options)


def read_foreground(out: Path, camera_id: str) -> np.ndarray:
    """Read a camera's foreground mask: (h, w) bool; FormatError when missing."""
    path = foreground_path(out, camera_id)
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) if path.is_file() else None
    if image is None:
        raise FormatError(path, found="no readable picture", expected="a mask written by decode")
    return np.asarray(image) > 127
