"""Patterns whose light adds up, and how well their photographs do.

Light is linear: where the levels of two patterns sum to a third's, so do their photographs, less
what is there without a lamp: I_a + I_b - I_whole = ambient. That holds in every cell, whatever the
face, its shadows and its skin; nothing about them need be known.

`processing.decode.sums` fits the pairs of a whole session together, to even out flicker and ambient
light; this fits one sum as soon as its photographs are there, with the gains' standard errors.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from lightstage.checks.photo_measures import LIT_SHARE, Photo, pool_size, pooled
from lightstage.checks.subject_motion import Shift, moved
from lightstage.formats.sums import LEVEL_STEP, SLACK

FLOOR_SHARE = 0.01
"""Share of `full`: residuals below it are motion, flicker and rounding, not noise."""
ROUNDS = 6
MIN_CELLS = 12
"""Fewer lit coarse cells decide nothing."""


@dataclasses.dataclass(frozen=True)
class Sum:
    """Two patterns whose levels sum to a third's."""

    first: str
    second: str
    whole: str

    @property
    def patterns(self) -> tuple[str, str, str]:
        """All three."""
        return self.first, self.second, self.whole

    def __str__(self) -> str:
        return f"{self.first} + {self.second} = {self.whole}"


@dataclasses.dataclass(frozen=True)
class SumFit:
    """How one camera's photographs of a sum agree.

    Attributes:
        gains: (2,) factors by which the two parts must be multiplied to sum to the whole; 1 each
            where all is well, 1 / 4 where a part was exposed four times as long.
        errors: (2,) their standard errors.
        misfit: mean absolute residual after the gains, less what noise makes, as a share of the
            whole.
        before: the same with gains of 1.
        ambient: (3,) light left over with gains of 1, as a share of the whole; by colour.
        off: as `ambient`, of all pixels of the photographs and all colours together.
    """

    gains: np.ndarray
    errors: np.ndarray
    misfit: float
    before: float
    ambient: np.ndarray
    off: float


def find_sums(levels: Mapping[str, np.ndarray]) -> list[Sum]:
    """All sums of two among (n,) levels; polarised patterns only among those of their own kind.

    Between kinds a lens's polariser may have been put in or turned, and then light does not add up.
    """
    kinds: dict[str, list[str]] = {}
    for name, level in levels.items():
        if np.any(np.asarray(level) > 0):
            kinds.setdefault(kind_of(name), []).append(name)
    sums: list[Sum] = []
    for names in kinds.values():
        steps = np.stack([np.round(np.asarray(levels[name]) / LEVEL_STEP) for name in names])
        for k, whole in enumerate(names):
            # A part has no light more than the whole: of 1,000 patterns few are parts of one.
            parts = np.flatnonzero((steps <= steps[k] + SLACK).all(axis=1))
            parts = parts[parts != k]
            missing = steps[k].sum() - steps[parts].sum(axis=1)
            order = np.argsort(missing)
            for i in parts:
                total, slack = steps[i].sum(), SLACK * steps.shape[1]
                low, high = np.searchsorted(missing[order], [total - slack, total + slack])
                others = [int(j) for j in np.sort(parts[order[low:high]]) if j > i]
                if others:
                    near = np.abs(steps[others] + steps[i] - steps[k]).max(axis=1) <= SLACK
                    sums += [Sum(names[i], names[j], whole) for j in np.array(others)[near]]
    return sums


def kind_of(pattern: str) -> str:
    """``parallel``, ``cross``, or nothing where no lens has a polariser."""
    return pattern.partition("@")[2]


def fit_sum(
    first: Photo,
    second: Photo,
    whole: Photo,
    ambient: np.ndarray | None = None,
    shift: Shift | None = None,
) -> SumFit | None:
    """Fit the two gains of a sum by robust least squares over the coarse cells.

    Args:
        first: a part.
        second: the other part.
        whole: their sum.
        ambient: (r, c, 3) what is there without a lamp, share of white; None for nothing.
        shift: moves the parts onto the whole first.

    Returns:
        None where sizes differ, or too few cells are lit and unclipped.
    """
    shape = whole.coarse.shape
    if first.coarse.shape != shape or second.coarse.shape != shape:
        return None
    base = np.zeros(shape) if ambient is None or ambient.shape != shape else ambient
    cell = whole.cell_px
    a = _onto(first, None if shift is None else shift.first_px / cell) - base
    b = _onto(second, None if shift is None else shift.second_px / cell) - base
    w = whole.coarse.astype(float) - base
    lit = lit_cells(whole) & first.usable & second.usable & whole.usable
    if lit.sum() < MIN_CELLS:
        return None
    noise = np.sqrt(first.spread**2 + second.spread**2 + whole.spread**2)[lit].astype(float)
    parts = np.stack([a[lit].ravel(), b[lit].ravel()], axis=1)
    target = w[lit].ravel()
    floor = FLOOR_SHARE * np.abs(target) + 1e-3 * np.abs(target).max()
    sigma = np.hypot(np.repeat(noise, 3), floor)
    gains, errors = _robust(parts, target, sigma)
    total = float(np.abs(w[lit]).sum())
    expected = float(np.sqrt(2 / np.pi) * 3 * noise.sum())
    left = a[lit] + b[lit] - w[lit]
    after = (a[lit] * gains[0] + b[lit] * gains[1] - w[lit]).sum(axis=1)
    off = (first.mean + second.mean - whole.mean - base.mean()) / max(abs(whole.mean), 1e-12)
    return SumFit(
        gains,
        errors,
        max(float(np.abs(after).sum()) - expected, 0.0) / total,
        max(float(np.abs(left.sum(axis=1)).sum()) - expected, 0.0) / total,
        left.sum(axis=0) / np.maximum(np.abs(w[lit]).sum(axis=0), 1e-12),
        float(off),
    )


def _onto(photo: Photo, shift: np.ndarray | None) -> np.ndarray:
    """(r, c, 3) coarse cells of a photograph moved back by (2,) cells of its small picture."""
    if shift is None:
        return photo.coarse.astype(float)
    light = moved(photo.light, -shift)
    return pooled(light, pool_size(light.shape[:2])).astype(float)


def lit_cells(photo: Photo) -> np.ndarray:
    """(r, c) bool, coarse cells that show the subject lit."""
    green = photo.coarse[..., 1]
    return green > max(LIT_SHARE * photo.signal, float(np.median(photo.spread)) * 5, 1e-9)


def _robust(
    parts: np.ndarray, target: np.ndarray, sigma: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(2,) gains and their errors by least squares that doubts cells beyond two deviations."""
    weight = 1.0 / sigma**2
    gains: np.ndarray = np.ones(2)
    errors: np.ndarray = np.full(2, np.inf)
    for _ in range(ROUNDS):
        normal = parts.T @ (parts * weight[:, None])
        # A part without light has no gain to find: a little of "as it should be" keeps it at 1.
        tie = 1e-9 * float(np.diag(normal).max()) + 1e-300
        normal += tie * np.eye(2)
        right = parts.T @ (target * weight) + tie
        gains = np.linalg.solve(normal, right)
        left = (parts @ gains - target) / sigma
        spread = max(1.4826 * float(np.median(np.abs(left))), 1e-6)
        far = np.maximum(np.abs(left) / (2.0 * spread), 1.0)
        weight = 1.0 / (sigma**2 * far)
        # Neighbouring cells err alike; a third of them is taken to be independent.
        errors = np.sqrt(np.diag(np.linalg.inv(normal)) * 3.0) * spread
    return gains, errors
