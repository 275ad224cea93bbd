"""Shadows that were baked before, kept on the disk: many trainings of the same people share them.

A head is known by the name of its files and not by its positions: torch shrinks these, and its
rounding differs from machine to machine, while shadows that one machine baked serve another.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from learning.checkpoint import code_version
from lightstage.formats.files import atomic_path
from lightstage.formats.npz import UNREADABLE_NPZ

ROUNDED_MM = 0.01
"""Places of lamps that differ by less are the same: sines differ by their last bit."""


@dataclasses.dataclass(frozen=True)
class KeptShadows:
    """Where the shadows of one head's surface are kept.

    Attributes:
        folder: of all heads' shadows; made when the first is kept.
        surface: name of the head's files and of the surface that was made from them.
    """

    folder: Path
    surface: str

    def read_or_bake(
        self, size: tuple[int, ...], position_mm: np.ndarray, bake: Callable[[], np.ndarray]
    ) -> np.ndarray:
        """Visibility that was kept, or that is baked now and kept.

        Args:
            size: rows and columns of the surface's grid.
            position_mm: (L, 3) lights.
            bake: gives (L, rows, columns) float32, 0 or 1.

        Returns:
            (L, rows, columns) float32, 0 or 1.
        """
        lights = np.round(np.asarray(position_mm, float).reshape(-1, 3) / ROUNDED_MM)
        digest = hashlib.sha256(f"{self.surface}, {size}, ".encode())
        digest.update(lights.astype(np.int64).tobytes())
        path = self.folder / f"{digest.hexdigest()[:32]}.npz"
        kept = _read(path, (len(lights), *size))
        if kept is not None:
            return kept
        baked = bake()
        self.folder.mkdir(parents=True, exist_ok=True)
        with atomic_path(path) as beside, beside.open("wb") as file:
            np.savez_compressed(file, bits=np.packbits(baked > 0.5))
        return baked


def shadows_of_scan(folder: Path | None, sha256: str, surface: str) -> KeptShadows | None:
    """Where the shadows of a scan's surface are kept; None where they are not.

    Args:
        folder: of kept shadows; None where nothing is kept.
        sha256: of the scan's files; empty for a scan that has none.
        surface: what is made from the scan, since the same scan is shrunk in several ways.
    """
    if folder is None or not sha256:
        return None
    # Other code may bake others.
    return KeptShadows(folder, f"{sha256} of {surface} by {code_version()}")


def _read(path: Path, size: tuple[int, ...]) -> np.ndarray | None:
    """(L, rows, columns) float32; None where there is no file, or a damaged one."""
    try:
        with np.load(path, allow_pickle=False) as file:
            bits = file["bits"]
    except UNREADABLE_NPZ:
        return None
    count = int(np.prod(size))
    if bits.dtype != np.uint8 or bits.shape != (-(-count // 8),):
        return None
    return np.unpackbits(bits, count=count).reshape(size).astype(np.float32)
