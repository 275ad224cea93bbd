"""Folders of decoded photographs: their arrays while they are written, and what is told of them."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.errors import FormatError
from lightstage.formats.files import atomic_folder, fsync_path, read_json
from processing.frames.window import Window

SCHEMA = "processing.frames/1"
FACTS, HALVES, CLIPPED, MARKS = "frames.json", "half.npy", "clipped.npy", "marks.npz"
RED, GREEN, BLUE, NOT_A_NUMBER = 1, 2, 4, 8
"""Bits of `Frames.clipped`."""


def frames_path(out: Path, camera_id: str) -> Path:
    """The folder in which a camera's decoded photographs lie in a processed folder."""
    return out / "work" / "frames" / camera_id


@dataclasses.dataclass(frozen=True)
class Marks:
    """Clipped pixels of one photograph: few, so only they are kept.

    Attributes:
        places: (n,) uint32 indices into the window's pixels in row order.
        bits: (n,) uint8 of them.
    """

    places: np.ndarray
    bits: np.ndarray

    @classmethod
    def of(cls, clipped: np.ndarray) -> Marks:
        """Of (h, w) uint8 bits."""
        flat = clipped.reshape(-1)
        places = np.flatnonzero(flat)
        return cls(places.astype(np.uint32), flat[places])

    def add_to(self, clipped: np.ndarray) -> None:
        """Add the bits to (h, w) uint8, contiguous, in place."""
        clipped.reshape(-1)[self.places] |= self.bits


@dataclasses.dataclass(frozen=True)
class Draft:
    """Frames that are being written: mapped arrays to fill.

    Attributes:
        half: (P, h, w, 3) float16, zeros at first.
        clipped: (h, w) uint8, zeros at first.
        told: JSON-ready, kept beside the arrays (`read_told`).
        marks: pattern to its own clipped pixels, for the next run that decodes only some.
    """

    half: np.memmap
    clipped: np.memmap
    told: dict[str, Any] = dataclasses.field(default_factory=dict)
    marks: dict[str, Marks] = dataclasses.field(default_factory=dict)

    def write_row(self, k: int, picture: np.ndarray) -> None:
        """Write pattern `k`, (h, w, 3) float16: a file's new pages are cheaper written than mapped.

        Other threads run meanwhile.
        """
        row = memoryview(np.ascontiguousarray(picture).view(np.uint8).data).cast("B")
        place = self.half.offset + k * len(row)
        with Path(str(self.half.filename)).open("r+b", buffering=0) as file:
            while row:
                written = os.pwrite(file.fileno(), row, place)
                row, place = row[written:], place + written


@contextlib.contextmanager
def new_frames(
    out: Path,
    camera_id: str,
    patterns: Sequence[str],
    scale: float,
    window: Window,
    shape: tuple[int, int],
) -> Iterator[Draft]:
    """Yield mapped arrays to fill; they take the place of the camera's frames when all is written.

    Args:
        out: processed folder.
        camera_id: whose.
        patterns: P names.
        scale: what the half floats are multiplied by to be linear.
        window: see Frames.
        shape: rows and columns of the whole picture.
    """
    with atomic_folder(frames_path(out, camera_id), FACTS) as beside:
        size = (len(patterns), *window.shape, 3)
        half = np.lib.format.open_memmap(beside / HALVES, "w+", np.float16, size)
        clipped = np.lib.format.open_memmap(beside / CLIPPED, "w+", np.uint8, window.shape)
        draft = Draft(half, clipped)
        yield draft
        value = {
            "schema": SCHEMA,
            "patterns": list(patterns),
            "scale": scale,
            "window": dataclasses.asdict(window),
            "shape": list(shape),
            "told": draft.told,
        }
        marks = {
            f"{kind} {name}": getattr(own, kind)
            for name, own in draft.marks.items()
            for kind in ("places", "bits")
        }
        np.savez(beside / MARKS, **marks)
        (beside / FACTS).write_text(json.dumps(value, indent=1, allow_nan=False) + "\n")
        for name in (HALVES, CLIPPED, MARKS, FACTS):
            fsync_path(beside / name)


def read_told(folder: Path, camera_id: str) -> dict[str, Any]:
    """What is written of a camera's frames beside their arrays; FormatError where missing."""
    if not (folder / FACTS).is_file():
        raise FormatError(
            folder,
            found="no such file",
            expected=f"the decoded photographs of {camera_id}",
            hint="Run the stage `decode` first: lightstage-processing run --until decode.",
        )
    return dict(read_json(folder / FACTS, SCHEMA))


def read_marks(folder: Path, patterns: Sequence[str]) -> dict[str, Marks]:
    """Clipped pixels of photographs as `Draft.marks` kept them; those not kept are left out."""
    out = {}
    with np.load(folder / MARKS, allow_pickle=False) as file:
        for name in patterns:
            if f"places {name}" in file:
                out[name] = Marks(file[f"places {name}"], file[f"bits {name}"])
    return out
