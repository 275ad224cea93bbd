"""Shadows that were baked before, kept on the disk: many trainings of the same people share them.

A head is known by the name of its files and not by its positions: these are shrunk by torch, which
rounds otherwise from machine to machine, and what was baked here is to be found there.
"""

from __future__ import annotations

import contextlib
import hashlib
import zipfile
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from pathlib import Path

import numpy as np

from lightstage.formats.files import atomic_path

_FOLDER: ContextVar[Path | None] = ContextVar("folder of kept shadows", default=None)
ROUNDED_MM = 0.01
"""Places of lamps that differ by less are the same: sines differ by their last bit."""


@contextlib.contextmanager
def shadows_kept_in(folder: Path) -> Iterator[None]:
    """Within the block shadows of heads that have a name are read from a folder, or put there."""
    before = _FOLDER.set(folder)
    try:
        yield
    finally:
        _FOLDER.reset(before)


def kept_or_baked(
    name: str, size: tuple[int, ...], position_mm: np.ndarray, bake: Callable[[], np.ndarray]
) -> np.ndarray:
    """Visibility that was kept, or that is baked now and kept where there is a folder for it.

    Args:
        name: of the head; nothing is kept of one without.
        size: rows and columns of its grid.
        position_mm: (L, 3) lights.
        bake: gives (L, rows, columns) float32, 0 or 1.
    """
    folder = _FOLDER.get()
    if folder is None or not name:
        return bake()
    lights = np.round(np.asarray(position_mm, float).reshape(-1, 3) / ROUNDED_MM).astype(np.int64)
    said = hashlib.sha256(f"{name}, {size}, ".encode() + lights.tobytes())
    path = folder / f"{said.hexdigest()[:32]}.npz"
    whole = (len(lights), *size)
    kept = _read(path, whole)
    if kept is not None:
        return kept
    baked = bake()
    folder.mkdir(parents=True, exist_ok=True)
    with atomic_path(path) as beside, beside.open("wb") as file:
        np.savez_compressed(file, bits=np.packbits(baked > 0.5))
    return baked


def _read(path: Path, size: tuple[int, ...]) -> np.ndarray | None:
    """(L, rows, columns) float32; None where there is no file, or a damaged one."""
    try:
        with np.load(path, allow_pickle=False) as file:
            bits = file["bits"]
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
    count = int(np.prod(size))
    if bits.dtype != np.uint8 or bits.shape != (-(-count // 8),):
        return None
    return np.unpackbits(bits, count=count).reshape(size).astype(np.float32)
