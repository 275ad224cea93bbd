"""What all views together see of the atlas's texels."""

from __future__ import annotations

import dataclasses

import numba
import numpy as np

from processing.atlas.sampling import Reading


@dataclasses.dataclass(frozen=True)
class Seen:
    """Over the views so far, one entry a texel.

    Attributes:
        best: (k,) float32 largest weight, 0 where no view shows it.
        heaviest: (k,) int16 index of the view that has it, -1 for none.
        count: (k,) int16 how many views show it.
    """

    best: np.ndarray
    heaviest: np.ndarray
    count: np.ndarray

    @classmethod
    def none(cls, texels: int) -> Seen:
        """Before any view."""
        return cls(
            np.zeros(texels, np.float32), np.full(texels, -1, np.int16), np.zeros(texels, np.int16)
        )

    def add(self, reading: Reading, index: int) -> None:
        """Enter a view; of views with the same weight the first one stays."""
        _note(reading.slot, reading.weight, index, self.best, self.heaviest, self.count)


@numba.njit(cache=True, parallel=True)
def _note(
    slot: np.ndarray,
    weight: np.ndarray,
    index: int,
    best: np.ndarray,
    heaviest: np.ndarray,
    count: np.ndarray,
) -> None:
    """A slot occurs once in a view's samples."""
    for k in numba.prange(len(slot)):
        texel = slot[k]
        count[texel] += 1
        if weight[k] > best[texel]:
            best[texel] = weight[k]
            heaviest[texel] = index
