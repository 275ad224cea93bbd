"""Folders of decoded photographs: their arrays while they are written, and facts about them."""

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
    """The folder of a camera's decoded photographs in a processed folder."""
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
    def of(cls, clipped: np.ndarray, first: int = 0) -> Marks:
        """Of (n, w) uint8 bits, whose first pixel is the window's `first`."""
        flat = clipped.reshape(-1)
        places = np.flatnonzero(flat) if flat.max(initial=0) else np.zeros(0, np.intp)
        return cls((places + first).astype(np.uint32), flat[places])

    @classmethod
    def joined(cls, parts: Sequence[Marks]) -> Marks:
        """Of several parts of a photograph in the order of their rows."""
        places = [part.places for part in parts]
        return cls(np.concatenate(places), np.concatenate([part.bits for part in parts]))

    def add_to(self, clipped: np.ndarray) -> None:
        """Add the bits to (h, w) uint8, contiguous, in place."""
        clipped.reshape(-1)[self.places] |= self.bits


@dataclasses.dataclass(frozen=True)
class Draft:
    """Frames that are being written: mapped arrays to fill.

    Attributes:
        half: (P, h, w, 3) float16, zeros at first.
        clipped: (h, w) uint8, zeros at first.
        file: descriptor of the file that `half` maps.
        facts: JSON-ready, kept beside the arrays (`read_facts`).
        marks: pattern to its own clipped pixels, for the next run that decodes only some.
    """

    half: np.memmap
    clipped: np.memmap
    file: int
    facts: dict[str, Any] = dataclasses.field(default_factory=dict)
    marks: dict[str, Marks] = dataclasses.field(default_factory=dict)

    def write_rows(self, k: int, top: int, rows: np.ndarray) -> None:
        """Write rows (n, w, 3) float16 of pattern `k` from row `top` on.

        A file's new pages are cheaper written than mapped. Other threads run meanwhile.
        """
        data = memoryview(np.ascontiguousarray(rows).view(np.uint8).data).cast("B")
        _, height, width, _ = self.half.shape
        place = self.half.offset + (k * height + top) * width * 6
        while data:
            written = os.pwrite(self.file, data, place)
            data, place = data[written:], place + written

    def settle(self) -> None:
        """Bring to the disk what `half` holds by now; other threads run meanwhile."""
        os.fsync(self.file)


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
        half = _mapped(beside / HALVES, np.float16, size)
        clipped = _mapped(beside / CLIPPED, np.uint8, window.shape)
        file = os.open(beside / HALVES, os.O_RDWR)
        try:
            yield (draft := Draft(half, clipped, file))
        finally:
            os.close(file)
        value = {
            "schema": SCHEMA,
            "patterns": list(patterns),
            "scale": scale,
            "window": dataclasses.asdict(window),
            "shape": list(shape),
            "told": draft.facts,
        }
        marks = {
            f"{kind} {name}": getattr(own, kind)
            # Threads end in any order: the file's bytes must not depend on it.
            for name, own in sorted(draft.marks.items())
            for kind in ("places", "bits")
        }
        np.savez(beside / MARKS, **marks)
        (beside / FACTS).write_text(json.dumps(value, indent=1, allow_nan=False) + "\n")
        for name in (HALVES, CLIPPED, MARKS, FACTS):
            fsync_path(beside / name)


def _mapped(path: Path, kind: type, shape: tuple[int, ...]) -> np.memmap:
    """A new mapped array whose bytes the disk has promised.

    A page written to a mapped file on a full disk ends the process by a signal, without a message.
    """
    array = np.lib.format.open_memmap(path, "w+", kind, shape)
    file = os.open(path, os.O_RDWR)
    try:
        os.posix_fallocate(file, 0, path.stat().st_size)
    finally:
        os.close(file)
    return array


def read_facts(folder: Path, camera_id: str) -> dict[str, Any]:
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
