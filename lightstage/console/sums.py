"""A picture of light that should add up: two patterns' photographs compared with a third's.

The photographs of `x+` and `x-` sum to that of `full`, whatever the face. Where they do not,
somebody moved, the light was not as meant, or the room's light shows.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from lightstage.console.pictures import SAMPLES, STRIPE_PX, jpeg, read_counts
from lightstage.errors import FormatError

FULL_COLOUR = 0.10
"""Share of the whole at which a difference has its full colour."""
LEAST_SHOWN = 0.02
"""Smaller differences are drawn in no colour: noise makes them."""
LIT_SHARE = 0.1
"""Share of the brightest percent's level; where the whole is darker, no difference is drawn: it is
noise."""
GREY = 0.45
BRIGHTER_BGR, DARKER_BGR = (40.0, 150.0, 255.0), (255.0, 140.0, 60.0)


@dataclasses.dataclass(frozen=True)
class SumFacts:
    """How well two photographs sum to a third, as the capture's checks measure it.

    Attributes:
        off: mean absolute difference without that of noise, as a share of the whole; None where too
            little is lit.
        misfit: the same after the best factor of each part, by which the checks judge.
        moved_px: the larger of the parts' shifts against the whole; None where it is not known.
        error_px: its standard error.
    """

    off: float | None
    misfit: float | None
    moved_px: float | None
    error_px: float


def sum_picture(first: Path, second: Path, whole: Path, longest_px: int) -> tuple[bytes, SumFacts]:
    """A JPEG of where two photographs together differ from a third, and the checks' figures.

    Args:
        first: a part.
        second: the other part.
        whole: their sum, by the same camera.
        longest_px: longer side of the picture, at most.

    Raises:
        FormatError: one of them is no photograph, or has another size.
    """
    from lightstage.checks.photo_measures import measure_photo
    from lightstage.checks.subject_motion import sum_shift
    from lightstage.checks.sums import fit_sum

    a, b, w = (
        read_counts(path, longest_px, SAMPLES).rgb.mean(axis=2) for path in (first, second, whole)
    )
    for path, part in ((first, a), (second, b)):
        if part.shape != w.shape:
            raise FormatError(path, found=f"shape {part.shape}", expected=f"{w.shape}, as {whole}")
    data = jpeg(difference(a + b, w), whole)
    one, two, both = (measure_photo(path) for path in (first, second, whole))
    fit = fit_sum(one, two, both)
    # A wrong factor of a part's light would look like motion.
    shift = sum_shift(one, two, both, (1.0, 1.0) if fit is None else fit.gains)
    return data, SumFacts(
        None if fit is None else float(fit.before),
        None if fit is None else float(fit.misfit),
        None if shift is None else shift.largest_px,
        0.0 if shift is None else float(shift.error_px),
    )


def difference(together: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """(h, w, 3) BGR uint8: grey where both agree, orange where `together` is brighter, blue in
    stripes where it is darker.

    Args:
        together: (h, w) sum of the parts, linear.
        whole: (h, w) what it should be.
    """
    floor = LIT_SHARE * float(np.quantile(whole, 0.99))
    lit = np.isfinite(together) & (whole > max(floor, 1e-9))
    off = np.where(lit, together - whole, 0.0) / np.where(lit, whole, 1.0)
    strength = np.clip(np.abs(off) / FULL_COLOUR, 0.0, 1.0)[..., None]
    strength[np.abs(off) < LEAST_SHOWN] = 0.0
    rows, columns = np.indices(whole.shape)
    gap = (off < 0) & ((rows + columns) // STRIPE_PX % 2 == 0)
    strength[gap] = 0.0
    top = max(float(np.quantile(whole, 0.99)), 1e-9)
    grey = 255 * GREY * np.sqrt(np.clip(np.nan_to_num(whole) / top, 0.0, 1.0))[..., None]
    colour = np.where(off[..., None] > 0, np.array(BRIGHTER_BGR), np.array(DARKER_BGR))
    shown = np.clip(grey * (1 - strength) + colour * strength, 0, 255)
    return np.ascontiguousarray(np.round(shown).astype(np.uint8))
