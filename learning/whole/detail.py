"""What a lit texture shows of skin finer than the network sees.

The network's answer is blurred; the texture's logarithm, less its own blurred one, has the detail,
and the edges of shadows too. Each band of sizes is added with the share of it that is skin and not
light, one number a band, by least squares over people whose albedo is known. With shares of 1 the
answer is the texture over its own shading at low resolution; with 0 it is the network's alone.
"""

from __future__ import annotations

import cv2
import numpy as np

from learning.networks.whole_face import BANDS, DARKEST

BLURS = (1 / 768, 1 / 384, 1 / 192)
"""Standard deviations of the blurs between the bands, of a texture's rows: 2, 4 and 8 of 1536."""
assert len(BLURS) + 1 == BANDS


def bands(texture: np.ndarray, seen: np.ndarray, small: np.ndarray) -> list[np.ndarray]:
    """Take a texture apart by the size of what it shows.

    Args:
        texture: (rows, columns, 3) linear.
        seen: (rows, columns) bool, what was photographed; detail is 0 elsewhere, and nothing that
            was not photographed affects its neighbours.
        small: (h, w, 3) linear, the same texture as the network saw it.

    Returns:
        `BANDS` arrays (rows, columns, 3) of natural logarithms, the finest first; their sum is the
        texture's logarithm less the small one's.
    """
    rows = texture.shape[0]
    known = seen.astype(np.float32)[..., None]
    finer = np.log(np.maximum(texture, DARKEST), dtype=np.float32) * known
    found = []
    for share in BLURS:
        sigma = share * rows
        weight = blurred(known, sigma)
        coarser = blurred(finer * known, sigma) / np.maximum(weight, 1e-3) * known
        found.append((finer - coarser) * known)
        finer = coarser
    whole = enlarged(np.log(np.maximum(small, DARKEST)), rows, texture.shape[1])
    found.append((finer - whole) * known)
    return found


def enlarged(image: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """(h, w[, c]) enlarged to (rows, columns[, c]) float32, linearly between texels."""
    values = np.ascontiguousarray(image, np.float32)
    return cv2.resize(values, (columns, rows), interpolation=cv2.INTER_LINEAR)


def with_detail(
    log_albedo: np.ndarray,
    texture: np.ndarray,
    seen: np.ndarray,
    small: np.ndarray,
    shares: list[float],
) -> np.ndarray:
    """The albedo at a texture's own size.

    Args:
        log_albedo: (h, w, 3), natural logarithm of what the network found.
        texture: (rows, columns, 3) as of `bands`.
        seen: (rows, columns) bool as of `bands`.
        small: (h, w, 3) as of `bands`.
        shares: of each band, 0..1.

    Returns:
        (rows, columns, 3) float32 linear, 0 to 1.
    """
    total = enlarged(log_albedo, *texture.shape[:2])
    for band, share in zip(bands(texture, seen, small), shares, strict=True):
        total += share * band
    return np.exp(np.minimum(total, 0.0))


class Shares:
    """Least squares for the shares, one pair after the other."""

    def __init__(self) -> None:
        """Nothing seen."""
        self._normal = np.zeros((BANDS, BANDS))
        self._right = np.zeros(BANDS)

    def add(self, parts: list[np.ndarray], wanted: np.ndarray, weight: np.ndarray) -> None:
        """Add a pair.

        Args:
            parts: (rows, columns, 3) each, of `bands`.
            wanted: (rows, columns, 3) true log albedo less the network's.
            weight: (rows, columns), how much a texel counts.
        """
        root = np.sqrt(weight)[..., None]
        columns = np.stack([(part * root).ravel() for part in parts]).astype(np.float64)
        self._normal += columns @ columns.T
        self._right += columns @ (wanted * root).ravel()

    def solve(self) -> list[float]:
        """The shares, each within 0..1; the network's answer alone where nothing was seen."""
        size = np.trace(self._normal)
        if not size > 0:
            return [0.0] * BANDS
        steady = self._normal + 1e-6 * size * np.eye(BANDS)
        return np.clip(np.linalg.solve(steady, self._right), 0, 1).tolist()


def blurred(image: np.ndarray, sigma: float) -> np.ndarray:
    """An (h, w[, c]) image by a Gaussian; nothing comes in over the borders."""
    out = cv2.GaussianBlur(image, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)
    return out.reshape(image.shape)
