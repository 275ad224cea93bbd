"""What a texture and a mesh are looked through for before maps are inferred from them.

A network answers to any picture. What it was not made for is refused here, or is warned of.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from learning.errors import MapsError
from learning.map_checks import looks_encoded
from lightstage.formats.mesh import Mesh

UNSEEN = 1e-4
"""Linear value up to which a texel counts as not photographed."""
HEAD_MM = (100.0, 1000.0)
"""Longest edge of the box around a head, from a face alone to one with shoulders."""
FLATTEST = 0.1
"""Shortest edge of that box over the longest one; a face alone has about a half."""
BRIGHTEST_MEDIAN, BRIGHTEST = 2.0, 5.0
"""Skin reflects less than 0.8 of light, of which there is about 1; the 95th percentile may be a
highlight."""
MOST_NEGATIVE = 0.02
"""Share of a surface's texels whose mean is negative: noise about black makes a few."""
DARKEST = 0.005
"""A texture whose 95th percentile is darker than this was exposed for something else."""
MOST_BLACK, SAID_BLACK = 0.95, 0.5
"""Share of a surface's texels that were not photographed: refused above, warned of above."""
ASPECT_OFF = 0.02
"""Share by which rows over columns may differ: sizes are whole numbers."""
LEAST_LIKENESS, MORE_LIKE = 0.1, 0.1
"""Correlation with the mean person's brows, eyes and lips that a face upside down has at least once
it is turned over, and how much more than as it is. Of 300 upright ones in random light 95 % have
more than 0.21, and at most 0.06 when they are turned over; none is refused, and of 300 upside down
28 are taken."""
CHANCE_DEVIATIONS = 10.0
"""So many standard deviations of the correlation of unrelated texels must be exceeded, too."""
SURROUNDINGS = 1 / 72
"""Standard deviation of the blur that separates a pattern from light, as a share of the rows."""
MOST_TEXELS = 2**28
"""Texels of a texture, at most: ten times the published 6144 x 4096."""


def require_head(mesh: Mesh, where: str | Path) -> None:
    """MapsError where a mesh has not the size in millimetres or the depth of a head."""
    edges = np.sort(np.ptp(mesh.vertices, axis=0))
    low, high = HEAD_MM
    if not low <= edges[2] <= high:
        raise MapsError(
            where,
            field="vertices",
            found=f"a box whose longest edge is {edges[2]:.3g}",
            expected=f"a head in millimetres, {low:g} to {high:g}",
            hint="Is the mesh in metres or centimetres? Multiply it by 1000 or 10.",
        )
    if edges[0] < FLATTEST * edges[2]:
        raise MapsError(
            where,
            field="vertices",
            found=f"a box of {edges[2]:.3g} x {edges[1]:.3g} x {edges[0]:.3g} mm",
            expected="a head, which is not flat",
            hint="Name the registered mesh that the texture belongs to.",
        )


def require_size(rows: int, columns: int, where: str | Path) -> None:
    """MapsError where a texture of this size would be too large to work with."""
    if rows * columns > MOST_TEXELS:
        raise MapsError(
            where,
            found=f"{rows} x {columns} texels at the size the network was trained on",
            expected=f"at most {MOST_TEXELS / 1e6:.0f} million",
            hint="Is the texture an atlas of rows : columns = 3 : 2?",
        )


def same_aspect(rows: int, columns: int, like: tuple[int, int]) -> bool:
    """Whether a texture is as high for its width as another one, (h, w), but for rounding."""
    high, wide = like
    return abs(rows * wide / (columns * high) - 1) <= ASPECT_OFF


def require_aspect(rows: int, columns: int, like: tuple[int, int], where: str | Path) -> None:
    """MapsError where a texture is not as high for its width as those trained on, (h, w)."""
    if not same_aspect(rows, columns, like):
        raise MapsError(
            where,
            found=f"{rows} x {columns} texels",
            expected=f"rows : columns = {like[0]} : {like[1]}, as the textures trained on",
            hint="Is it part of an atlas, or another template's? Texels would be elsewhere on "
            "the head.",
        )


def require_upright(texture: np.ndarray, pattern: np.ndarray, where: str | Path) -> None:
    """MapsError where a texture shows a face's pattern only with its rows in reverse order.

    Light changes slowly over a face, and brows, eyes and lips do not: compared are the two as they
    are beside their surroundings.

    Args:
        texture: (h, w, 3) linear, at the network's size; 0 where it was not photographed.
        pattern: (h, w, 3) natural logarithm of the mean person's albedo; 0 where nothing is
            compared.
        where: what to name in an error.
    """
    shown = (texture.max(axis=2) > UNSEEN) & (pattern != 0).any(axis=2)
    logarithm, mean = np.log(np.maximum(texture, UNSEEN)).mean(axis=2), pattern.mean(axis=2)
    upright = _likeness(logarithm, mean, shown)
    over = _likeness(logarithm[::-1], mean, shown[::-1])
    # Of few texels a correlation is large by chance.
    by_chance = CHANCE_DEVIATIONS / max(float(shown.sum()), 1.0) ** 0.5
    if over > max(LEAST_LIKENESS, by_chance, upright + MORE_LIKE):
        raise MapsError(
            where,
            found=f"a face upside down: like others by {over:.2f} turned over, by {upright:.2f} "
            "as it is (correlation)",
            expected="row 0 at the top of the texture, as the mesh has it",
            hint="Was it read or written with v pointing down? Reverse its rows.",
        )


def _likeness(image: np.ndarray, pattern: np.ndarray, shown: np.ndarray) -> float:
    """Correlation of two (h, w) pictures, each beside its blurred surroundings."""
    known = (shown & (pattern != 0)).astype(np.float32)
    sigma = SURROUNDINGS * len(image)
    weight = np.maximum(cv2.GaussianBlur(known, (0, 0), sigma), 1e-3)
    beside = []
    for values in (image, pattern):
        values = (values * known).astype(np.float32)
        beside.append((values - cv2.GaussianBlur(values, (0, 0), sigma) / weight) * known)
    norms = np.linalg.norm(beside[0]) * np.linalg.norm(beside[1])
    return float((beside[0] * beside[1]).sum() / max(norms, 1e-12))


def look_through(texture: np.ndarray, covered: np.ndarray, where: str | Path) -> list[str]:
    """Look through a texture's exposure and its black texels.

    Args:
        texture: (rows, columns, 3) linear.
        covered: (rows, columns) bool, where the mesh's surface is.
        where: what to name in an error.

    Returns:
        Notes for the user, a line each.

    Raises:
        MapsError: hardly a texel that was photographed, or one exposed far too much or too little.
    """
    negative = float((texture[covered].mean(axis=1) < -UNSEEN).mean()) if covered.any() else 0.0
    if negative > MOST_NEGATIVE:
        raise MapsError(
            where,
            found=f"{100 * negative:.1f} % of the surface's texels negative",
            expected=f"at most {100 * MOST_NEGATIVE:g} %: light is 0 or more",
            hint="Was too high a black level or a background subtracted?",
        )
    brightest = texture[covered].max(axis=1, initial=0.0)
    seen = brightest[brightest > UNSEEN]
    black = 1 - len(seen) / max(1, len(brightest))
    if not len(seen) or black > MOST_BLACK:
        raise MapsError(
            where,
            found=f"{100 * black:.1f} % of the surface's texels black",
            expected=f"at most {100 * MOST_BLACK:.0f} %",
            hint="Does the texture belong to this mesh, and is it linear light?",
        )
    middle, high = np.percentile(seen, [50, 95])
    if middle > BRIGHTEST_MEDIAN or high > BRIGHTEST or high < DARKEST:
        raise MapsError(
            where,
            field="exposure",
            found=f"a median of {middle:.3g} and a 95th percentile of {high:.3g}",
            expected=f"a median of at most {BRIGHTEST_MEDIAN:g} and a 95th percentile of "
            f"{DARKEST:g} to {BRIGHTEST:g}, where 1 is a white diffuser in the light",
            hint="Multiply the texture by one number, so that lit skin is about 0.1 to 0.6.",
        )
    notes = []
    if black > SAID_BLACK:
        notes.append(
            f"{100 * black:.0f} % of the surface was not photographed; its confidence is 0"
        )
    if looks_encoded(texture, covered):
        notes.append(f"{where} looks like an 8-bit sRGB picture; linear light is expected")
    return notes
