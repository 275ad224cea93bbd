"""Motion between the photographs of a sum: the two parts are moved until they sum to the whole.

The idea of aligning complements together is Wilson's [Wilson2010]; here both parts' shifts against
the whole are solved at once, from the small pictures, to a fraction of a cell.

Pictures without structure have no place: their edges must stand above what noise makes of an even
surface, and no shift can be known better than the bound of Cramer and Rao for edges of such energy
under such noise allows.

`processing.decode.subject_motion` solves a field of displacements for each part, by which the
photographs are moved; a check needs only how far the subject moved, and how exactly that is known.
"""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np

from lightstage.checks.photo_measures import LIT_SHARE, Photo, pool_size

SCALES = ((6.0, 4, 2), (3.0, 2, 2), (1.5, 2, 1))
"""Blur under which shifts are solved, one after the other: its standard deviation and the step
between the cells that are used, both in cells, and how often it is repeated."""
MARGIN = 8
"""Cells around the lit part that are compared."""
FARTHEST = 12.0
"""Shifts beyond this many cells are not believed."""
MIN_EDGES = 4.0
"""Energy of the differences between cells, in the direction that has least of it, must be this many
times what noise makes."""
MIN_EXPLAINED = 0.25
"""Share of what the sum leaves over that a shift must take away to be believed."""


@dataclasses.dataclass(frozen=True)
class Shift:
    """How far the parts of a sum are from the whole in one camera's photographs.

    Attributes:
        first_px: (2,) right and down, pixels of the photograph.
        second_px: (2,) the same of the second part.
        error_px: standard error of a component.
        explained: share of what the sum leaves over (squared) that the shifts take away.
    """

    first_px: np.ndarray
    second_px: np.ndarray
    error_px: float
    explained: float = 1.0

    @property
    def largest_px(self) -> float:
        """Length of the longer of both."""
        return float(max(np.hypot(*self.first_px), np.hypot(*self.second_px)))


def sum_shift(
    first: Photo,
    second: Photo,
    whole: Photo,
    gains: np.ndarray | tuple[float, float] = (1.0, 1.0),
) -> Shift | None:
    """Solve the shifts of both parts of a sum.

    Args:
        first: a part.
        second: the other part.
        whole: their sum.
        gains: (2,) factors of the parts.

    Returns:
        None where sizes differ, or the pictures have nothing above their noise to align by.
    """
    shape = whole.light.shape
    if first.light.shape != shape or second.light.shape != shape or min(shape[:2]) < 16:
        return None
    a, b = (p.light[..., 1] * np.float32(g) for p, g in zip((first, second), gains, strict=True))
    w = whole.light[..., 1]
    full = (first.full | second.full | whole.full).astype(np.uint8)
    box = _lit_box(w)
    a, b, w, full = a[box], b[box], w[box], full[box]
    if min(w.shape) < MARGIN:
        return None
    free = cv2.dilate(full, np.ones((5, 5), np.uint8)) == 0
    bound = _bound(a, b, free, [_cell_noise(photo) for photo in (first, second, whole)])
    if bound is None:
        return None
    shifts, error = np.zeros(4), np.inf
    for sigma, step, rounds in SCALES:
        smooth = [cv2.GaussianBlur(picture, (0, 0), sigma) for picture in (a, b, w)]
        some = free[::step, ::step]
        for _ in range(rounds):
            moved_a, moved_b = moved(smooth[0], -shifts[:2]), moved(smooth[1], -shifts[2:])
            slopes = [*_slopes(moved_a), *_slopes(moved_b)]
            design = np.stack([slope[::step, ::step][some] for slope in slopes], axis=1)
            left = (smooth[2] - moved_a - moved_b)[::step, ::step][some]
            solved = _solve(design.astype(float), left.astype(float))
            if solved is None:
                return None
            # What is too far right by u is w = a + u da/dx: so u comes out with its own sign.
            shifts, error = (
                np.clip(shifts + solved[0], -FARTHEST, FARTHEST),
                solved[1] * sigma / step,
            )
    before = float(((smooth[2] - smooth[0] - smooth[1])[free] ** 2).sum())
    still = smooth[2] - moved(smooth[0], -shifts[:2]) - moved(smooth[1], -shifts[2:])
    after = float((still[free] ** 2).sum())
    cell = whole.cell_px
    return Shift(
        shifts[:2] * cell,
        shifts[2:] * cell,
        max(error, bound) * cell,
        1.0 - after / before if before > 0 else 0.0,
    )


def _cell_noise(photo: Photo) -> float:
    """Variance of a cell of the small picture by noise, at its lit part's middle."""
    lit = photo.coarse[..., 1] > LIT_SHARE * photo.signal
    spread = photo.spread[lit] if lit.any() else photo.spread
    pool = pool_size(photo.light.shape[:2])
    return float(np.median(spread)) ** 2 * pool**2


def _bound(
    first: np.ndarray, second: np.ndarray, free: np.ndarray, noise: list[float]
) -> float | None:
    """Least standard error, in cells, of a part's shift; None without edges above the noise."""
    if not free.any():
        return None
    sigma = SCALES[-1][0]
    worst = 0.0
    for picture, own in zip((first, second), noise[:2], strict=True):
        right, down = _slopes(cv2.GaussianBlur(picture, (0, 0), sigma))
        edges = np.stack([right[free], down[free]]).astype(float)
        # Variance of the slope of white noise that a Gaussian has smoothed.
        made = own / (8 * np.pi * sigma**4) * edges.shape[1]
        energy = float(np.linalg.eigvalsh(edges @ edges.T)[0]) - made
        if energy <= max(MIN_EDGES * made, 1e-30):
            return None
        worst = max(worst, np.sqrt(sum(noise) / energy))
    return worst


def _lit_box(picture: np.ndarray) -> tuple[slice, slice]:
    """Rows and columns of what is lit, with a margin."""
    lit = picture > LIT_SHARE * float(np.quantile(picture, 0.99))
    rows, columns = np.flatnonzero(lit.any(axis=1)), np.flatnonzero(lit.any(axis=0))
    if not len(rows):
        return slice(0, 0), slice(0, 0)
    return (
        slice(max(int(rows[0]) - MARGIN, 0), int(rows[-1]) + MARGIN + 1),
        slice(max(int(columns[0]) - MARGIN, 0), int(columns[-1]) + MARGIN + 1),
    )


def moved(picture: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """A picture moved right and down by (2,) cells; what comes from outside is as at the edge."""
    matrix = np.array([[1, 0, shift[0]], [0, 1, shift[1]]], float)
    size = picture.shape[1], picture.shape[0]
    return cv2.warpAffine(
        picture, matrix, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )


def _slopes(picture: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Central differences along x and y."""
    down, right = np.gradient(picture)
    return right, down


def _solve(design: np.ndarray, left: np.ndarray) -> tuple[np.ndarray, float] | None:
    """(4,) robust least squares, and the mean standard error of a component."""
    weight = np.ones(len(left))
    solution: np.ndarray = np.zeros(4)
    error = np.inf
    for _ in range(3):
        normal = design.T @ (design * weight[:, None])
        values = np.linalg.eigvalsh(normal)
        if not np.isfinite(values).all() or values[0] <= 1e-6 * max(values[-1], 1e-30):
            return None
        solution = np.linalg.solve(normal, design.T @ (left * weight))
        off = np.abs(left - design @ solution)
        spread = 1.4826 * float(np.median(off[weight > 0])) + 1e-12
        weight = 1.0 / np.maximum(off / (3.0 * spread), 1.0)
        error = float(np.sqrt(np.diag(np.linalg.inv(normal)).mean())) * spread
    return solution, error
