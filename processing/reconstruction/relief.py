"""Positions and normals together: each view's points take their fine relief from the normals.

After [Nehab2005], in the view: ln of inverse depth is what is sought, since its differences between
pixels are given by the normals alone, whatever the distance. Photometric normals are right in the
small and wrong in the large (shadows, lamps, colour), matched depth the other way round. So first
the normals' low frequencies are replaced by those of the points, then the surface is sought that
keeps near the points and follows the mended normals. In hollows (beside the nose, between the lips)
normals go wrong within a millimetre, too: where points and normals disagree at a third of the
wavelength, more of the normals is replaced.
"""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit, prange

from processing.reconstruction.config import ReconstructConfig
from processing.reconstruction.grow import JUMP_MM

TOLERANCE = 1e-4
"""Residual at which the solver ends, relative to its start: points move by less than a tenth of a
millimetre, so that is .01 micrometre."""
MOST_STEPS = 300
SHARE = 1 / 3
"""Share of `bias_mm`: where normals are doubted, they are trusted only in smaller relief than this.
"""
USUAL = 2.0
"""Disagreement less than so many times the median is noise of the points, and no doubt."""


def with_relief(
    points: np.ndarray,
    slopes: np.ndarray,
    known: np.ndarray,
    lens: np.ndarray,
    pose: np.ndarray,
    config: ReconstructConfig,
) -> tuple[np.ndarray, np.ndarray]:
    """Move a view's points along their rays so that they follow the normals in the small.

    Args:
        points: (h, w, 3) world, mm, NaN where there is none.
        slopes: (h, w, 2) of `slopes.plane_slopes`: relative slopes of inverse depth by the normals.
        known: (h, w) bool, where there is a normal.
        lens: (4,) fx, fy, cx, cy.
        pose: (3, 4) cam_from_world.
        config: its `relief_mm`, `bias_mm` and `doubt_deg`.

    Returns:
        Points (h, w, 3) float32, NaN where there was none, and (h, w, 3) float32 unit normals,
        world, outward: the mended ones, NaN where there is no point or no normal.
    """
    moved = np.full(points.shape, np.nan, np.float32)
    normals = np.full(points.shape, np.nan, np.float32)
    box = _box(np.isfinite(points[..., 0]))
    if box is not None:
        shifted = lens - [0, 0, box[1].start, box[0].start]
        moved[box], normals[box] = _in_box(
            points[box], slopes[box], known[box], shifted, pose, config
        )
    return moved, normals


def _in_box(
    points: np.ndarray,
    slopes: np.ndarray,
    known: np.ndarray,
    lens: np.ndarray,
    pose: np.ndarray,
    config: ReconstructConfig,
) -> tuple[np.ndarray, np.ndarray]:
    """As `with_relief`, of a part of the picture that holds points."""
    depth = points.astype(float) @ pose[2, :3] + pose[2, 3]
    valid = np.isfinite(depth) & (depth > 0)
    moved = np.full(points.shape, np.nan, np.float32)
    middle = float(np.median(depth[valid])) if valid.any() else 1.0
    z = -np.log(np.where(valid, depth, middle))
    pixel_mm = middle / float(0.5 * (lens[0] + lens[1]))
    steps, links = [], []
    for axis, place in ((1, 0), (0, 1)):
        first, second = _neighbours(axis)
        step = 0.5 * (slopes[..., place][first] + slopes[..., place][second]).astype(float)
        both = valid[first] & valid[second] & known[first] & known[second]
        both &= np.abs(np.diff(z, axis=axis) - step) * middle < JUMP_MM
        steps.append(step)
        links.append(both)
    sigma_px = config.bias_mm / pixel_mm
    excess = [np.diff(z, axis=1 - k) - steps[k] for k in range(2)]
    # (h, w) slopes that the points have beyond the normals' own, in the large.
    doubt = np.tan(np.radians(config.doubt_deg)) * pixel_mm / middle
    beyond = [_beyond(excess[k], links[k], sigma_px, doubt) for k in range(2)]
    misses = [excess[k] - beyond[k] for k in range(2)]
    shift = solve(misses, links, valid, (pixel_mm / config.relief_mm) ** 2)
    centre = -pose[:, :3].T @ pose[:, 3]
    moved[valid] = (centre + (points - centre) * np.exp(-shift)[..., None])[valid]
    turned = [slopes[..., k] + at_pixels(beyond[k], 1 - k) for k in range(2)]
    normals = normals_of(turned[0], turned[1], lens, pose)
    normals[~(valid & known)] = np.nan
    return moved, normals


def _box(some: np.ndarray) -> tuple[slice, slice] | None:
    """The part of a picture that holds all true pixels."""
    if not some.any():
        return None
    rows, columns = (np.flatnonzero(some.any(axis=axis)) for axis in (1, 0))
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def _beyond(excess: np.ndarray, links: np.ndarray, sigma_px: float, doubt: float) -> np.ndarray:
    """The part of the points' excess slope that normals take over: more of it where in doubt."""
    large = low_pass(excess, links, sigma_px)
    apart = np.where(links, low_pass(excess, links, SHARE * sigma_px) - large, 0.0)
    usual = USUAL * float(np.median(np.abs(apart[links]))) if links.any() else 0.0
    limit = max(doubt, usual)
    return np.asarray(large + apart * apart**2 / (apart**2 + limit**2))


def low_pass(values: np.ndarray, links: np.ndarray, sigma_px: float) -> np.ndarray:
    """(h, w) Gaussian mean of values (h, w) at links (h, w) alone; 0 where none is near."""
    weight = links.astype(np.float32)
    value = np.where(links, values, 0.0).astype(np.float32)
    # A wide Gaussian is taken on a coarser grid: a fifth of sigma is fine enough.
    height, width = links.shape
    step = max(1, min(int(sigma_px / 5), min(height, width) // 8))
    pad = ((0, -height % step), (0, -width % step))
    small = []
    for layer in (value, weight):
        wide = np.pad(layer, pad)
        blocks = wide.reshape(wide.shape[0] // step, step, wide.shape[1] // step, step)
        small.append(
            cv2.GaussianBlur(
                blocks.sum(axis=(1, 3)), (0, 0), sigma_px / step, borderType=cv2.BORDER_CONSTANT
            )
        )
    mean = np.divide(small[0], small[1], out=np.zeros_like(small[0]), where=small[1] > 1e-3)
    if step == 1:
        return mean.astype(float)
    size = (mean.shape[1] * step, mean.shape[0] * step)
    wide = cv2.resize(mean, size, interpolation=cv2.INTER_LINEAR)
    return wide[:height, :width].astype(float)


def solve(
    misses: list[np.ndarray],
    links: list[np.ndarray],
    valid: np.ndarray,
    weight: float,
    tolerance: float = TOLERANCE,
    most_steps: int = MOST_STEPS,
) -> np.ndarray:
    """The least-squares shift d: sum over links (d' - d + miss)^2 + weight * sum d^2.

    Conjugate gradients, each pixel scaled by its own weight: staying has so much weight that forty
    steps are enough, each a fraction of what a transform of the picture takes.

    Args:
        misses: across, (h, w - 1), and down, (h - 1, w): how far steps exceed the wanted ones.
        links: (h, w - 1) and (h - 1, w) bool, which of them count; both their pixels are valid.
        valid: (h, w) bool.
        weight: of staying, above 0.
        tolerance: of the residual, as a share of its start.
        most_steps: of the conjugate gradients; a small weight takes hundreds.

    Returns:
        (h, w), 0 where not valid.
    """
    residual = np.zeros(valid.shape)
    for k in range(2):
        _spread(np.where(links[k], -misses[k], 0.0), 1 - k, residual)
    residual[~valid] = 0
    across, down = (np.ascontiguousarray(link) for link in links)
    out = np.zeros(valid.shape)
    start = float(np.linalg.norm(residual))
    if not start > 0:
        return out
    along, pushed, better = (np.zeros(valid.shape) for _ in range(3))
    sums = np.zeros((2, len(valid)))
    _advance(residual, pushed, along, out, 0.0, across, down, weight, better, sums)
    energy, turn = float(sums[0].sum()), 0.0
    for _ in range(most_steps):
        _push(better, turn, along, across, down, weight, pushed, sums)
        length = energy / float(sums[0].sum())
        _advance(residual, pushed, along, out, length, across, down, weight, better, sums)
        fresh, left = float(sums[0].sum()), float(sums[1].sum())
        if np.sqrt(left) < tolerance * start:
            break
        energy, turn = fresh, fresh / energy
    return out


@njit(cache=True, parallel=True)
def _push(
    better: np.ndarray,
    turn: float,
    along: np.ndarray,
    across: np.ndarray,
    down: np.ndarray,
    weight: float,
    pushed: np.ndarray,
    sums: np.ndarray,
) -> None:
    """The next direction, `better + turn * along`, into `along`; the matrix times it, `pushed`."""
    height, width = better.shape
    for row in prange(height):
        for column in range(width):
            along[row, column] = better[row, column] + turn * along[row, column]
    for row in prange(height):
        # Sums by rows: the same whatever the threads.
        total = 0.0
        for column in range(width):
            own = along[row, column]
            value = weight * own
            if column > 0 and across[row, column - 1]:
                value += own - along[row, column - 1]
            if column < width - 1 and across[row, column]:
                value += own - along[row, column + 1]
            if row > 0 and down[row - 1, column]:
                value += own - along[row - 1, column]
            if row < height - 1 and down[row, column]:
                value += own - along[row + 1, column]
            pushed[row, column] = value
            total += own * value
        sums[0, row] = total


@njit(cache=True, parallel=True)
def _advance(
    residual: np.ndarray,
    pushed: np.ndarray,
    along: np.ndarray,
    out: np.ndarray,
    length: float,
    across: np.ndarray,
    down: np.ndarray,
    weight: float,
    better: np.ndarray,
    sums: np.ndarray,
) -> None:
    """One step of `length`; `better`, the residual by each pixel's weight; sums of both squares."""
    height, width = out.shape
    for row in prange(height):
        energy = left = 0.0
        for column in range(width):
            out[row, column] += length * along[row, column]
            rest = residual[row, column] - length * pushed[row, column]
            residual[row, column] = rest
            diagonal = weight
            if column > 0 and across[row, column - 1]:
                diagonal += 1
            if column < width - 1 and across[row, column]:
                diagonal += 1
            if row > 0 and down[row - 1, column]:
                diagonal += 1
            if row < height - 1 and down[row, column]:
                diagonal += 1
            better[row, column] = rest / diagonal
            energy += rest * rest / diagonal
            left += rest * rest
        sums[0, row], sums[1, row] = energy, left


def at_pixels(links: np.ndarray, axis: int) -> np.ndarray:
    """(h, w) values at pixels of those between neighbours along an axis, (h, w - 1) or (h - 1, w):
    means of the two, the ends as they are.
    """
    first, second = _neighbours(axis)
    ends = [(1, 1), (0, 0)] if axis == 0 else [(0, 0), (1, 1)]
    wide = np.pad(links, ends, mode="edge")
    return np.asarray(0.5 * (wide[first] + wide[second]))


def normals_of(a: np.ndarray, b: np.ndarray, lens: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """(h, w, 3) float32 unit normals, world, toward the camera, of planes of these slopes.

    The inverse of `slopes.plane_slopes`.
    """
    height, width = a.shape
    fx, fy, cx, cy = lens
    u, v = np.arange(width) + 0.5, (np.arange(height) + 0.5)[:, None]
    local = -np.stack([fx * a, fy * b, 1 + (cx - u) * a + (cy - v) * b], axis=-1)
    local /= np.linalg.norm(local, axis=-1, keepdims=True)
    return np.asarray(local @ pose[:, :3], np.float32)


def _neighbours(axis: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    every = slice(None)
    one, two = slice(None, -1), slice(1, None)
    return ((one, every), (two, every)) if axis == 0 else ((every, one), (every, two))


def _spread(steps: np.ndarray, axis: int, out: np.ndarray) -> None:
    """Add the transpose of `diff` of steps to `out`."""
    first, second = _neighbours(axis)
    out[first] -= steps
    out[second] += steps
