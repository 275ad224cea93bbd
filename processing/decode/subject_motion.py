"""Motion between photographs: complements are moved together until they sum to full.

A photograph and its complement resemble each other's negatives, so that neither can be placed on
the other; but moved rightly the two sum to the photograph under all lights, whatever the face
[Wilson2010]. Both displacement fields are solved at once: polynomials over the picture, which hold
a turning head's parallax, from rigid to cubic and from blurred to sharp.

`lightstage.checks.subject_motion` solves two shifts of whole photographs while a capture runs, and
how exactly they can be known; this solves fields that photographs can be moved by.
"""

from __future__ import annotations

import dataclasses
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np

STEPS = ((8.0, 0, 3, 4), (4.0, 1, 3, 4), (2.0, 2, 3, 1), (1.0, 3, 4, 1))
"""Blur in cells of the small pictures, degree of the polynomials, how often each is solved, and
the step between the cells that are used."""
SHADING_DEGREE = 2
"""A head that turns is lit otherwise: each part has a gain of this degree over the picture."""
MOST_CELLS = 15_000
"""Cells that a solve takes at most, evenly spread."""
FARTHEST_MM = 12.0
"""Displacements beyond this are not believed."""
RIDGE = 1e-4
"""Share by which each unknown is held where it was: what the pictures do not show stays."""
LIT_SHARE = 0.05
"""A cell is lit above this share of the whole's 95th percentile."""
HUBER = 2.0


@dataclasses.dataclass(frozen=True)
class Flow:
    """The reference's places in another photograph.

    Attributes:
        coefficients: (M, 2) of the monomials in (x, y), for right and down, in pixels.
        centre_px: (2,) where x = y = 0, and
        half_px: of the picture, where the farther of both is 1.
        degree: of the polynomial.
    """

    coefficients: np.ndarray
    centre_px: tuple[float, float]
    half_px: float
    degree: int

    def at(self, x_px: np.ndarray, y_px: np.ndarray) -> np.ndarray:
        """(..., 2) displacement in pixels at places in pixels, the first pixel's centre at 0.5."""
        x, y = (x_px - self.centre_px[0]) / self.half_px, (y_px - self.centre_px[1]) / self.half_px
        return np.asarray(monomials(x, y, self.degree) @ self.coefficients)


@dataclasses.dataclass(frozen=True)
class PairMotion:
    """How the two parts of a whole moved.

    Attributes:
        first, second: their displacements.
        rms_px: (2,) root mean square displacement over the lit pixels, of each part.
        before: what the sum left over, robust mean as a share of the whole's mean.
        after: the same once both are moved.
    """

    first: Flow
    second: Flow
    rms_px: tuple[float, float]
    before: float
    after: float


def monomials(x: np.ndarray, y: np.ndarray, degree: int) -> np.ndarray:
    """(..., M) all products x^i y^j with i + j <= degree, the constant first."""
    terms = [x**i * y ** (n - i) for n in range(degree + 1) for i in range(n, -1, -1)]
    return np.stack(terms, axis=-1)


def solve_pair(
    first: np.ndarray,
    second: np.ndarray,
    whole: np.ndarray,
    usable: np.ndarray,
    cell_px: float,
    px_per_mm: float,
    still_px: float,
) -> PairMotion | None:
    """Displacements of two parts against their whole.

    Args:
        first, second, whole: (h, w) small pictures, one channel or the mean of all, any scale.
        usable: (h, w) bool, cells without a clipped or missing pixel.
        cell_px: pixels a cell of the small pictures.
        px_per_mm: pixels a millimetre, of the photograph.
        still_px: parts that a first, affine solve displaces by less than half of this are taken to
            be still; nothing finer is solved.

    Returns:
        None where the pictures are too dark, too small or too even.

    Source: [Wilson2010].
    """
    height, width = whole.shape
    lit = usable & (whole > LIT_SHARE * np.quantile(whole, 0.95)) & (whole > 0)
    if lit.sum() < 200:
        return None
    scale = np.float32(1 / whole[lit].mean())
    parts = [np.ascontiguousarray(p * scale, np.float32) for p in (first, second)]
    target = np.ascontiguousarray(whole * scale, np.float32)
    rows, columns = np.nonzero(lit)
    centre = (float(columns.mean() + 0.5), float(rows.mean() + 0.5))
    half = max(float(np.ptp(rows)), float(np.ptp(columns)), 2.0) / 2
    inner = cv2.erode(lit.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    rows, columns = np.nonzero(inner)
    some = slice(None, None, max(1, -(-len(rows) // MOST_CELLS)))
    rows, columns = rows[some], columns[some]
    if len(rows) < 100:
        return None
    x = (columns + 0.5 - centre[0]) / half
    y = (rows + 0.5 - centre[1]) / half
    farthest = FARTHEST_MM * px_per_mm / cell_px
    coefficients: np.ndarray = np.zeros((1, 4))
    shade = monomials(x, y, SHADING_DEGREE)
    before = _left(parts, target, coefficients, 0, x, y, rows, columns, shade)
    for sigma, degree, rounds, every in STEPS:
        if sigma * 4 > min(height, width):
            continue
        size = len(monomials(np.zeros(1), np.zeros(1), degree)[0])
        coefficients = np.vstack([coefficients, np.zeros((size - len(coefficients), 4))])
        basis = monomials(x, y, degree)
        smooth = [cv2.GaussianBlur(p, (0, 0), sigma) for p in (*parts, target)]
        planes = [[p, *_slopes(p)] for p in smooth[:2]]
        few = slice(None, None, every)
        aim = smooth[2][rows[few], columns[few]]
        for _ in range(rounds):
            step = _step(planes, aim, coefficients, basis[few], shade[few], rows[few], columns[few])
            if step is None:
                return None
            coefficients = coefficients + step
            flow = basis @ coefficients
            if not np.isfinite(flow).all() or np.abs(flow).max() > farthest:
                return None
        if degree == 1 and np.sqrt((flow**2).sum(axis=1).mean()) * cell_px < still_px / 2:
            break
    after = _left(parts, target, coefficients, degree, x, y, rows, columns, shade)
    flow = basis @ coefficients * cell_px
    rms = [float(np.sqrt((flow[:, k : k + 2] ** 2).sum(axis=1).mean())) for k in (0, 2)]
    place = (centre[0] * cell_px, centre[1] * cell_px)
    flows = [
        Flow(coefficients[:, k : k + 2] * cell_px, place, half * cell_px, degree) for k in (0, 2)
    ]
    return PairMotion(flows[0], flows[1], (rms[0], rms[1]), before, after)


def warp(images: np.ndarray, rows: dict[int, Flow], usable: np.ndarray) -> None:
    """Move photographs onto the reference, in place.

    Args:
        images: (P, h, w, 3) halves or floats.
        rows: which of the P, and where the reference's places are in it.
        usable: (h, w) bool; a place is not usable any more where one of its photographs is not.
    """
    height, width = usable.shape
    good = usable.astype(np.uint8)
    y, x = np.mgrid[:height, :width].astype(np.float32) + np.float32(0.5)

    def move(row: int) -> np.ndarray:
        flow = rows[row].at(x, y).astype(np.float32)
        to_x, to_y = x + flow[..., 0] - np.float32(0.5), y + flow[..., 1] - np.float32(0.5)
        picture = images[row].astype(np.float32)
        continued = cv2.BORDER_REPLICATE
        images[row] = cv2.remap(picture, to_x, to_y, cv2.INTER_CUBIC, borderMode=continued)
        # Whatever a cubic's four by four neighbours held counts, and what is beyond the border.
        bad = cv2.dilate(1 - good, np.ones((3, 3), np.uint8))
        bad = cv2.remap(bad, to_x, to_y, cv2.INTER_LINEAR, borderMode=continued)
        beyond = (np.abs(to_x - (width - 1) / 2) > width / 2) | (
            np.abs(to_y - (height - 1) / 2) > height / 2
        )
        return (bad > 0) | beyond

    with ThreadPoolExecutor(2) as pool:
        for bad in pool.map(move, list(rows)):
            usable &= ~bad


def _step(
    planes: list[list[np.ndarray]],
    target: np.ndarray,
    coefficients: np.ndarray,
    basis: np.ndarray,
    shade: np.ndarray,
    rows: np.ndarray,
    columns: np.ndarray,
) -> np.ndarray | None:
    """(M, 4) change of the coefficients by one robust linear solve with the gains beside it."""
    flow = (basis @ coefficients).astype(np.float32)
    columns_of, readings = [], []
    for k in range(2):
        place = columns + flow[:, 2 * k], rows + flow[:, 2 * k + 1]
        there = [_sampled(plane, *place) for plane in planes[k]]
        readings.append(there[0])
        columns_of += [basis * there[1][:, None], basis * there[2][:, None]]
    design = np.hstack([*columns_of, *(shade * r[:, None] for r in readings)])
    left = target - readings[0] - readings[1]
    weight = np.ones(len(left), np.float32)
    solution: np.ndarray = np.zeros(design.shape[1])
    for _ in range(2):
        normal = design.T @ (design * weight[:, None])
        right = design.T @ (weight * left)
        if not (np.isfinite(normal).all() and (np.diag(normal) > 0).all()):
            return None
        normal[np.diag_indices_from(normal)] *= 1 + RIDGE
        solution = np.linalg.solve(normal, right)
        off = np.abs(left - design @ solution)
        weight = 1 / np.maximum(off / (HUBER * 1.4826 * np.median(off) + 1e-12), 1)
    size = basis.shape[1]
    return np.asarray(solution[: 4 * size]).reshape(4, size).T


def _left(
    parts: list[np.ndarray],
    target: np.ndarray,
    coefficients: np.ndarray,
    degree: int,
    x: np.ndarray,
    y: np.ndarray,
    rows: np.ndarray,
    columns: np.ndarray,
    shade: np.ndarray,
) -> float:
    """What the moved parts leave over after their gains: mean absolute, share of the whole."""
    flow = (monomials(x, y, degree) @ coefficients).astype(np.float32)
    moved = [
        _sampled(parts[k], columns + flow[:, 2 * k], rows + flow[:, 2 * k + 1]) for k in range(2)
    ]
    design = np.hstack([shade * reading[:, None] for reading in moved])
    left = target[rows, columns] - moved[0] - moved[1]
    normal = design.T @ design
    normal[np.diag_indices_from(normal)] *= 1 + RIDGE
    gains = np.linalg.lstsq(normal, design.T @ left, rcond=None)[0]
    return float(np.abs(left - design @ gains).mean())


def _sampled(picture: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(n,) bilinear readings at places in cells, the first cell's centre at 0."""
    height, width = picture.shape
    x, y = np.clip(x, 0, width - 1.001), np.clip(y, 0, height - 1.001)
    left, top = x.astype(np.intp), y.astype(np.intp)
    u, v = x - left, y - top
    above = picture[top, left] * (1 - u) + picture[top, left + 1] * u
    below = picture[top + 1, left] * (1 - u) + picture[top + 1, left + 1] * u
    return np.asarray(above * (1 - v) + below * v)


def _slopes(picture: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Central differences along x and y."""
    down, right = np.gradient(picture)
    return right, down
