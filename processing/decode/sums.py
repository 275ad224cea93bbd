"""What sums of photographs show: ambient light, flicker, and photographs of another pattern.

Light is linear: a gradient and its complement sum to full, less what no lamp made. That holds in
every pixel, whatever the face, so that a = I_a + I_b - I_full is the ambient light, the same for
every pair; where pairs disagree, something moved, flickered, or another pattern was lit.

`lightstage.checks.sums` fits the gains of one sum while a capture runs, with their standard errors;
this fits the pairs of a whole session together, and takes flicker and ambient light apart.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from lightstage.formats.session import Session
from lightstage.formats.sums import UNLIKE, UNLIKE_RATIO
from processing.decode.completing import Pair

LIT_SHARE = 0.05
"""A cell is lit above this share of the whole's 95th percentile."""
ROUNDS = 4
MOST_CELLS = 40_000
"""Cells that a fit of gains takes at most, evenly spread."""
BALL_ROWS = 24
"""Rows of the coarse picture in which a head is taken for a ball."""


@dataclasses.dataclass(frozen=True)
class SumsFit:
    """How the sums of one whole agree.

    Attributes:
        flicker: pattern to the factor that it must be multiplied by; 1 where nothing flickered.
        ambient: (3,) light that no lamp made, share of the whole, by colour; after `flicker`.
        apart: largest difference between two pairs' ambient light, share of the whole.
        left: mean absolute residual per pair once flicker and ambient are taken off, share of the
            whole: motion, bands, and noise.
    """

    flicker: dict[str, float]
    ambient: np.ndarray
    apart: float
    left: dict[str, float]


def mean_colour(picture: np.ndarray) -> np.ndarray:
    """(...,) means over the three colours of (..., 3)."""
    # NumPy's own mean over so short an axis takes ten times as long.
    total = picture[..., 0] + picture[..., 1] + picture[..., 2]
    return np.asarray(total / total.dtype.type(3))


def _total(colours: np.ndarray) -> np.ndarray:
    """(3,) float64 sums of (n, 3)."""
    return np.array([colours[:, c].sum(dtype=float) for c in range(3)])


def lit_cells(whole: np.ndarray, free: np.ndarray) -> np.ndarray:
    """(h, w) bool, cells that show the subject lit and nothing clipped.

    Args:
        whole: (h, w, 3) small picture under the most light.
        free: (h, w) bool, cells without a clipped or missing pixel.
    """
    mean = mean_colour(whole)
    level = float(np.quantile(mean, 0.95))
    return np.asarray(free & (mean > LIT_SHARE * level) & (mean > 0))


def fit_sums(
    small: Mapping[str, np.ndarray], pairs: Sequence[Pair], free: np.ndarray, least_flicker: float
) -> SumsFit | None:
    """Fit the gains of all pairs of one whole, and the ambient light that is left.

    Args:
        small: pattern to (h, w, 3) small picture.
        pairs: of the same whole.
        free: (h, w) bool.
        least_flicker: a gain nearer to the others' than this counts as theirs.

    Returns:
        None where too little is lit.
    """
    whole = small[pairs[0].whole]
    lit = lit_cells(whole, free)
    if lit.sum() < 50:
        return None
    some = slice(None, None, max(1, -(-int(lit.sum()) // MOST_CELLS)))
    target = mean_colour(whole[lit][some]).astype(float)
    gains: dict[str, float] = {}
    for pair in pairs:
        both = (small[name][lit][some] for name in (pair.first, pair.second))
        parts = [mean_colour(part).astype(float) for part in both]
        found = _gains(np.stack(parts, axis=1), target)
        gains |= dict(zip((pair.first, pair.second), map(float, found), strict=True))
    # Ambient light changes all gains alike, flicker those of single photographs.
    common = float(np.median(list(gains.values())))
    flicker = {
        name: gain / common if abs(gain / common - 1) > least_flicker else 1.0
        for name, gain in gains.items()
    }
    base = whole[lit]
    total = _total(base)
    shown = [_off(small, pair, flicker)[lit] for pair in pairs]
    offs = np.stack([_total(off) / total for off in shown])
    ambient = np.median(offs, axis=0)
    spread = float(np.ptp(offs.mean(axis=1)))
    left = {}
    for pair, off in zip(pairs, shown, strict=True):
        rest = mean_colour(off - ambient.astype(np.float32) * base)
        left[pair.axis] = float(np.abs(rest).mean(dtype=float) / target.mean())
    return SumsFit(flicker, ambient, spread, left)


def ambient_ratio(
    small: Mapping[str, np.ndarray],
    pairs: Sequence[Pair],
    free: np.ndarray,
    flicker: Mapping[str, float],
    sigma_cells: float,
) -> np.ndarray:
    """(h, w, 3) float32 ambient light as a share of the whole's, smooth over the subject.

    Args:
        small: pattern to (h, w, 3) float32.
        pairs: as in `fit_sums`.
        free: (h, w) bool.
        flicker: pattern to the factor that removes its flicker.
        sigma_cells: of the Gaussian that takes noise out.
    """
    whole = small[pairs[0].whole]
    lit = lit_cells(whole, free)[..., None]
    off = sum(_off(small, pair, flicker) for pair in pairs) / np.float32(len(pairs))
    above, below = (
        cv2.GaussianBlur(np.where(lit, x, 0).astype(np.float32), (0, 0), sigma_cells)
        for x in (off, whole)
    )
    floor = 1e-3 * float(whole.max(initial=0.0))
    return np.asarray(np.where(below > floor, above / np.maximum(below, floor or 1), 0))


def residual(small: Mapping[str, np.ndarray], pair: Pair) -> np.ndarray:
    """(h, w) what a pair has more than its whole, share of the whole, 0 where that is dark."""
    whole = mean_colour(small[pair.whole])
    floor = LIT_SHARE * float(np.quantile(whole, 0.95))
    off = mean_colour(_off(small, pair, {}))
    return np.asarray(np.where(whole > max(floor, 0), off / np.where(whole > 0, whole, 1), 0))


def wrong_patterns(
    small: Mapping[str, np.ndarray],
    whole: str,
    patterns: Sequence[str],
    free: np.ndarray,
    session: Session,
    camera_id: str,
) -> tuple[dict[str, str], dict[str, np.ndarray]]:
    """Photographs that resemble another pattern's, were the head a ball.

    A head is no ball, so single cells are wrong by a few tenths; the pattern that lit it is clear.

    Args:
        small: pattern to (h, w, 3) small picture.
        whole: the pattern of most light.
        patterns: those to be distinguished.
        free: (h, w) bool.
        session: with the rig and the driven levels.
        camera_id: of the camera that photographed.

    Returns:
        Pattern to the one that it resembles; and pattern to (r, c) how far each coarse cell is
        from what a ball would show, a share of the whole.
    """
    height, width = free.shape
    size = (max(1, round(width * BALL_ROWS / height)), BALL_ROWS)
    coarse = {
        name: cv2.resize(mean_colour(small[name]), size, interpolation=cv2.INTER_AREA)
        for name in {*patterns, whole}
    }
    clear = cv2.resize(free.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.9
    base = coarse[whole]
    lit = clear & (base > LIT_SHARE * np.quantile(base, 0.95)) & (base > 0)
    if lit.sum() < 30:
        return {}, {}
    rows, columns = np.nonzero(lit)
    middle = (rows.min() + rows.max()) / 2, (columns.min() + columns.max()) / 2
    half = (np.ptp(rows) + 1) / 2, (np.ptp(columns) + 1) / 2
    y, x = (rows - middle[0]) / half[0], (columns - middle[1]) / half[1]
    shrink = 0.95 / np.maximum(np.hypot(x, y), 0.95)
    x, y = x * shrink, y * shrink
    local = np.stack([x, y, -np.sqrt(1 - x * x - y * y)], axis=1)
    normals = local @ session.rig.camera(camera_id).cam_from_world[:, :3]
    positions = session.rig.positions_mm
    distance = np.linalg.norm(positions, axis=1, keepdims=True)
    gain = session.rig.rgb_gains.mean(axis=1) / distance[:, 0] ** 2
    facing = np.maximum(positions / distance @ normals.T, 0)
    light = {name: (session.levels(name) * gain) @ facing for name in {*patterns, whole}}
    bottom = np.maximum(light[whole], 1e-3 * light[whole].max())
    expected = {name: light[name] / bottom for name in patterns}
    wrong: dict[str, str] = {}
    maps: dict[str, np.ndarray] = {}
    for name in patterns:
        seen = coarse[name][lit] / base[lit]
        apart = {other: float(np.abs(seen - expected[other]).mean()) for other in patterns}
        best = min(apart, key=lambda other: apart[other])
        if apart[name] > UNLIKE and apart[name] > UNLIKE_RATIO * apart[best]:
            wrong[name] = best
        maps[name] = np.zeros(lit.shape, np.float32)
        maps[name][lit] = np.abs(seen - expected[name])
    return wrong, maps


def _off(small: Mapping[str, np.ndarray], pair: Pair, flicker: Mapping[str, float]) -> np.ndarray:
    parts = [small[n] * np.float32(flicker.get(n, 1.0)) for n in (pair.first, pair.second)]
    return np.asarray(parts[0] + parts[1] - small[pair.whole])


def _gains(parts: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(2,) robust least squares of target = parts @ gains, held to 1 where a part is dark."""
    gains: np.ndarray = np.ones(2)
    weight = 1 / np.maximum(target, 0.1 * target.mean()) ** 2
    for _ in range(ROUNDS):
        normal = parts.T @ (parts * weight[:, None])
        tie = 1e-9 * float(np.trace(normal)) + 1e-300
        gains = np.linalg.solve(normal + tie * np.eye(2), parts.T @ (target * weight) + tie)
        off = np.abs(parts @ gains - target) / np.maximum(target, 0.1 * target.mean())
        spread = max(1.4826 * float(np.median(off)), 1e-9)
        weight = 1 / np.maximum(target, 0.1 * target.mean()) ** 2
        weight = weight / np.maximum(off / (2 * spread), 1)
    return gains
