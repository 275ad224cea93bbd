"""Several photographs of one person as one texture, in the light of the first.

Each photograph is brought into the texels of its own mesh. Its light is taken out and the first
one's put in, by the ratio of the same skin under both. What is left of a difference, such as
exposure, white balance and a light that is not quite right, is smooth: it is measured where two
photographs show the same texels, and continued beyond. Each texel is then mostly that of the
photograph that shows it best, as a mean would show features twice where the shape is off; over some
texels the photographs go over into each other, as in a mosaic [Burt1983].
"""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np

from learning.whole.detail import blurred
from learning.whole.gaps import continued
from learning.whole.unlit import light_edges, lit_enough

DARK = 0.01
"""Added to both before the logarithm of a ratio is taken."""
SHARP = 8.0
"""Power of a photograph's quality in its share of a texel: at twice another one's quality, it has
99.6 %."""
FACING = 2.0
"""Power of the cosine to the camera in a photograph's quality."""
RELIT = 0.2
"""Quality of a photograph whose light was replaced, as a share of the first one's: it is taken
where the first one sees a texel at less than half the cosine."""
GRAZING = 0.35
"""Cosine to its camera below which a later photograph is not taken: the fitted outline is never
quite the person's, and what is beside it comes in."""
MOST_GAIN = 4.0
"""Ratio of the first one's light to a photograph's above which it is not taken: noise would grow,
and an error of the shape with it."""
SMOOTH_SHARE = 1 / 40
"""Standard deviation over which two photographs' difference is measured, of a texture's rows:
features that lie a little apart in the two are smaller."""
BORDER_SHARE = 1 / 100
"""Distance over which one photograph goes over into the next, of a texture's rows."""
LEAST_OVERLAP = 1e-3
"""Share of the texels that two photographs must both show, to measure their difference."""
MOST_APART = 1.0
"""Difference of two photographs' logarithms, less its median, above which the later one shows
something else there than skin."""


@dataclasses.dataclass(frozen=True)
class View:
    """What one photograph shows of a texture.

    Attributes:
        texture: (rows, columns, 3) linear.
        seen: (rows, columns) bool, where it shows the person's skin.
        facing: (rows, columns) cosine between the surface and the direction to the camera.
        pixels: of the photograph along a texel's side where the surface faces the camera.
        model: (rows, columns, 3) a skin under this photograph's light; None where no light was
            found.
    """

    texture: np.ndarray
    seen: np.ndarray
    facing: np.ndarray
    pixels: float
    model: np.ndarray | None


@dataclasses.dataclass(frozen=True)
class Joined:
    """One texture of several photographs, in the light of the first.

    Attributes:
        texture: (rows, columns, 3) float32 linear; zero where nothing is seen.
        seen: (rows, columns) bool, in some photograph.
        facing: (rows, columns) float32, 0..1, cosine to the camera of the photographs that show it.
        source: (rows, columns) int16, which photograph shows it most, from 0; -1 for none.
        first: (rows, columns) bool, what the first photograph shows.
    """

    texture: np.ndarray
    seen: np.ndarray
    facing: np.ndarray
    source: np.ndarray
    first: np.ndarray


def join(views: list[View]) -> Joined:
    """Join photographs of one person; one alone stays as it is.

    Args:
        views: the first one's light is the texture's. All models are of the same skin.
    """
    first = views[0]
    logs = [_log(first.texture)]
    masks = [first.seen]
    whole, seen = logs[0] * first.seen[..., None], first.seen
    left = list(range(1, len(views)))
    order = [0]
    while left:
        # The one that shares most with what is joined: its difference is measured best.
        index = max(left, key=lambda i: int((views[i].seen & seen).sum()))
        left.remove(index)
        log, mask = under_first(first, views[index])
        both = mask & seen
        if both.mean() > LEAST_OVERLAP:
            other = _other_things(log - whole, both)
            mask, both = mask & ~other, both & ~other
            log = log - _smooth(log - whole, both)
        logs.append(log)
        masks.append(mask)
        order.append(index)
        whole = np.where((mask & ~seen)[..., None], log, whole)
        seen = seen | mask
    shares = _shares([_quality(views[i], m, i) for i, m in zip(order, masks, strict=True)], masks)
    total = sum(share[..., None] * log for share, log in zip(shares, logs, strict=True))
    facing = sum(
        share * np.clip(views[i].facing, 0, 1) for share, i in zip(shares, order, strict=True)
    )
    most = np.array(order, np.int16)[np.argmax(shares, axis=0)]
    texture = np.where(seen[..., None], np.maximum(np.exp(total) - DARK, 0), 0)
    alone = shares[0] > 1 - 1e-6
    texture = np.where(alone[..., None], first.texture, texture)
    return Joined(
        texture.astype(np.float32),
        seen,
        np.asarray(facing, np.float32),
        np.where(seen, most, -1).astype(np.int16),
        first.seen,
    )


def under_first(first: View, other: View) -> tuple[np.ndarray, np.ndarray]:
    """A photograph's logarithm under the first one's light, and where that is known.

    It is not known at grazing angles, where its light is too dark to be divided by, and at edges of
    shadows, which are never quite in place: its own, and the first one's where that shows the texel
    itself.

    Returns:
        (rows, columns, 3), and (rows, columns) bool.
    """
    log = _log(other.texture)
    seen = other.seen & (other.facing > GRAZING)
    if first.model is None or other.model is None:
        return log, seen
    level, wanted = other.model.mean(axis=2), first.model.mean(axis=2)
    known = seen & lit_enough(level, other.seen) & ~light_edges(level, other.seen)
    known &= (wanted + DARK < MOST_GAIN * (level + DARK)) & ~(
        first.seen & light_edges(wanted, first.seen)
    )
    return log + _log(first.model) - _log(other.model), known


def _log(image: np.ndarray) -> np.ndarray:
    """(rows, columns, 3) natural logarithm of an image, finite where that is black."""
    return np.log(np.maximum(image, 0) + DARK, dtype=np.float32)


def _other_things(apart: np.ndarray, both: np.ndarray) -> np.ndarray:
    """(rows, columns) bool, where of two photographs one shows a hand or hair, and around it."""
    typical = np.median(apart[both], axis=0)
    far = both & (np.abs(apart - typical).max(axis=2) > MOST_APART)
    reach = max(1, round(BORDER_SHARE * len(both)))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    # Single texels are features that lie a little apart.
    lump = cv2.morphologyEx(far.astype(np.uint8), cv2.MORPH_OPEN, disc)
    return both & (cv2.dilate(lump, disc) > 0)


def _smooth(apart: np.ndarray, both: np.ndarray) -> np.ndarray:
    """(rows, columns, 3) a difference known in some texels, without what is small, continued."""
    sigma = SMOOTH_SHARE * len(both)
    weight = both.astype(np.float32)
    known = np.where(both[..., None], np.clip(apart, -3, 3), 0).astype(np.float32)
    around = np.maximum(blurred(weight, sigma), 1e-3)[..., None]
    wide = blurred(known, sigma) / around
    return continued((wide * weight[..., None]).astype(np.float32), both)


def _quality(view: View, mask: np.ndarray, index: int) -> np.ndarray:
    """(rows, columns) how well a photograph shows each texel; less toward the mask's border."""
    reach = max(1.0, BORDER_SHARE * len(mask))
    inside = cv2.distanceTransform(np.pad(mask, 1).astype(np.uint8), cv2.DIST_L2, 3)[1:-1, 1:-1]
    near = np.minimum(inside / (2 * reach), 1)
    sharp = min(view.pixels, 1.0)
    kept = 1.0 if index == 0 else RELIT
    quality: np.ndarray = kept * sharp * np.clip(view.facing, 0, 1) ** FACING * near
    return quality


def _shares(qualities: list[np.ndarray], masks: list[np.ndarray]) -> np.ndarray:
    """(n, rows, columns) share of each photograph in each texel; they sum to 1 where any shows."""
    reach = max(1.0, BORDER_SHARE * len(masks[0]))
    quality = np.stack(qualities).astype(np.float32)
    mask = np.stack(masks)
    best = np.maximum(quality.max(axis=0), 1e-12)
    power = np.where(mask, np.maximum(quality / best, 1e-3) ** SHARP, 0)
    power = power / np.maximum(power.sum(axis=0), 1e-30)
    soft = np.stack([blurred(one, reach) for one in power.astype(np.float32)]) * mask
    # A photograph ends softly where another one is there to take over.
    soft = np.where(mask, np.maximum(soft, 1e-12), 0)
    found: np.ndarray = soft / np.maximum(soft.sum(axis=0), 1e-30)
    return found
