"""The scalp of one person: which of the texels that have hair on most people show bare skin.

Hair begins elsewhere on each person, and some have none. A texel of the scalp is skin or hair by
its colour beside the skin's own, which continues from the face: the person's hair is what is far
from that. A skull in a light that is not quite right differs from the face as well, but not by more
than this light leaves uncertain.
"""

from __future__ import annotations

import cv2
import numpy as np

from learning.whole.detail import blurred, enlarged
from learning.whole.gaps import continued

FINEST = 1 / 512
"""Standard deviation over which colours are means, of a texture's rows: single hairs and pores."""
BESIDE_SKIN = 0.1, 0.1, 0.1
"""Standard deviations of bare scalp beside the skin below it in a light that is exactly known: of
the logarithm's mean over channels, and of red and of blue over green."""
LEAST_DEVIATIONS = 4.5
"""Of these and the light's, between hair and skin. Bald skulls have 2.0 to 2.7 by three
photographs and 1.1 to 3.9 by 20 textures on true shapes, blond hair 5.4, darker hair 9 to 13."""
FARTHEST = 75.0
"""Percentile of the distances from the skin, beyond which the search for the hair's colour begins:
a quarter of the shown scalp, which is all of it where hair begins far above most people's."""
LEAST_TEXELS = 100
"""Of the scalp shown, below which it does not show whether it has hair."""
GRAIN = 1 / 192
"""Standard deviation of what strands are finer than, of a texture's rows."""
STRANDS = 2.0
"""Grain of a scalp over that of skin above which it has hair: bald heads have 1.0, blond hair on
light skin 2.5, darker hair 1.6 to 5."""
ROUNDS = 20
MIDDLE = 0.35, 0.65
"""Part of the way from skin to hair between which a texel is both."""
AROUND = 1 / 48
"""How far below the scalp's border texels may have hair, too, of a texture's rows."""
JOINED = 1 / 384
"""Distance from bare skin within which a texel may be both, of a texture's rows."""
HAIRLINE_SHARE = 1 / 96
"""Standard deviation over which hair goes over into skin where no photograph shows it, of a
texture's rows."""
UNSHOWN = 0.05
"""Weight of hair, beside what is shown around, where none of the scalp is shown."""


def log_colour(log_rgb: np.ndarray) -> np.ndarray:
    """(..., 3) the mean of natural logarithms, and red and blue over green, of (..., 3)."""
    green = log_rgb[..., 1]
    return np.stack([log_rgb.mean(axis=-1), log_rgb[..., 0] - green, log_rgb[..., 2] - green], -1)


def skin_over_scalp(low_albedo: np.ndarray, scalp: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """Continue the skin into the scalp.

    Args:
        low_albedo: (h, w, 3) of a person with hair where most people have it, linear.
        scalp: (rows, columns) bool, where that is.
        covered: (rows, columns) bool, where a surface is.

    Returns:
        (h, w, 3) float32 natural logarithm of the skin; `low_albedo`'s own outside the scalp.
    """
    size = low_albedo.shape[1], low_albedo.shape[0]
    # Hair shows in each texel that has a part of it, and blends into the next.
    hairy, whole = (
        cv2.resize(image.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        for image in (scalp, covered)
    )
    skin = (cv2.dilate(hairy, np.ones((3, 3), np.uint8)) <= 0) & (whole > 0)
    log = np.log(low_albedo).astype(np.float32)
    filled = continued(np.where(skin[..., None], log, 0), skin)
    touched = ~skin & (whole > 0) & skin.any()
    return np.where(touched[..., None], filled, log)


def hair_share(
    unlit: np.ndarray,
    shown: np.ndarray,
    scalp: np.ndarray,
    skin_log: np.ndarray,
    trust: np.ndarray,
) -> np.ndarray:
    """How far each texel is hair, and not skin.

    Args:
        unlit: (rows, columns, 3) texture over its light, linear.
        shown: (rows, columns) bool, where that shows the person.
        scalp: (rows, columns) bool, where most people have hair.
        skin_log: (h, w, 3) of `skin_over_scalp`.
        trust: (rows, columns) of `learning.whole.unlit.trusted`.

    Returns:
        (rows, columns) float32, 0..1. 0 on a bald head. Where nothing shows the scalp it has hair,
        if the person has any; and on a head that shows too little of it all of it has.
    """
    rows = len(scalp)
    if (shown & scalp).sum() < LEAST_TEXELS:
        return scalp.astype(np.float32)
    around = _near(scalp, AROUND * rows)
    known = shown & around
    weight = known.astype(np.float32)
    beside = np.log(unlit) - enlarged(skin_log, *scalp.shape)
    total = blurred((beside * weight[..., None]).astype(np.float32), FINEST * rows)
    colour = log_colour(total / np.maximum(blurred(weight, FINEST * rows), 1e-3)[..., None])
    way = _way_to_hair(colour[shown & scalp], trust[shown & scalp])
    if way is None:
        # Hair in the colour of skin has strands, which a bald head has not.
        log = np.log(unlit).mean(axis=2).astype(np.float32)
        strands = _grain(log, shown & scalp) > STRANDS * _grain(log, shown & ~scalp)
        return (scalp & strands).astype(np.float32)
    share = (colour @ way - MIDDLE[0]) / (MIDDLE[1] - MIDDLE[0])
    share = np.clip(share, 0, 1).astype(np.float32)
    # A light strand is no skin, for bare skin reaches down to the face.
    bare = known & (share < 0.5)
    near = _near(_joined(bare, bare & ~scalp), JOINED * rows)
    share = np.where(scalp & ~near, np.float32(1), share)
    sigma = HAIRLINE_SHARE * rows
    parts = share * weight + UNSHOWN * scalp, weight + np.float32(UNSHOWN)
    total, whole = (blurred(part.astype(np.float32), sigma) for part in parts)
    share = np.where(known, share, np.where(around, total / whole, 0))
    # Hair that hangs far over the forehead ends there softly, and gives way to the skin.
    below = np.where(scalp, 1, np.minimum(2 * blurred(scalp.astype(np.float32), sigma), 1))
    return (share * below).astype(np.float32)


def _grain(image: np.ndarray, mask: np.ndarray) -> float:
    """Median size of what is finer than `GRAIN` in an image, within a mask; 0 where it is thin."""
    sigma = GRAIN * len(mask)
    weight = mask.astype(np.float32)
    around = blurred(image * weight, sigma) / np.maximum(blurred(weight, sigma), 1e-3)
    inner = cv2.erode(mask.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    return float(np.median(np.abs(image - around)[inner])) if inner.any() else 0.0


def _joined(mask: np.ndarray, seeds: np.ndarray) -> np.ndarray:
    """(rows, columns) bool, the parts of a mask that have one of the seeds, which are in it."""
    _, label = cv2.connectedComponents(mask.astype(np.uint8))
    return mask & np.isin(label, np.unique(label[seeds]))


def _near(mask: np.ndarray, distance: float) -> np.ndarray:
    """(rows, columns) bool, texels of a mask and those within a distance in texels."""
    size = 2 * max(1, round(distance)) + 1
    return cv2.dilate(mask.astype(np.uint8), np.ones((size, size), np.uint8)) > 0


def _way_to_hair(colour: np.ndarray, trust: np.ndarray) -> np.ndarray | None:
    """(3,) vector whose product with a `log_colour` beside the skin's is 0 for skin, 1 for hair.

    Two means, of which one is the skin's, at 0, with Fisher's linear discriminant [Fisher1936]
    between them: hair differs from itself more in lightness than in tint.

    Args:
        colour: (n, 3) of a scalp.
        trust: (n,) of it.

    Returns:
        None for a bald head.
    """
    # The light's error, which trust gives the variance of, changes all channels alike.
    skin = np.tile(np.square(BESIDE_SKIN), (len(colour), 1))
    skin[:, 0] /= np.maximum(trust, 1e-3)
    away = np.linalg.norm(colour, axis=1)
    far = away >= np.percentile(away, FARTHEST)
    way = np.zeros(3)
    for _ in range(ROUNDS):
        hair = np.median(colour[far], axis=0)
        across = hair / (colour[far].var(axis=0) + np.median(skin, axis=0))
        way = across / max(float(hair @ across), 1e-9)
        before, far = far, colour @ way > 0.5
        if not far.any():
            return None
        if (far == before).all():
            break
    deviations = np.sqrt((np.square(colour[far]) / skin[far]).sum(axis=1))
    return way if np.median(deviations) > LEAST_DEVIATIONS else None
