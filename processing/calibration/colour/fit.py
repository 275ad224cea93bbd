"""Raw readings of a chart's patches to a colour correction: a matrix and a root-polynomial.

Both are fitted to the same patches, each weighted by how dark it is, and both are tried on patches
that they did not see. The root-polynomial is used only where it does better there, on all patches
and on the two of skin: six terms follow 24 patches closer than three whether or not the camera
needs them, and a stage for faces gains nothing from a truer green.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from processing.calibration.colour.chart_reference import NEUTRAL, SKIN
from processing.calibration.colour.config import ColourFitConfig
from processing.colour import ColourCorrection, root_terms
from processing.colour_difference import delta_e_2000, lab_from_linear
from processing.errors import ProcessingError

PATCHES = 24


@dataclasses.dataclass(frozen=True)
class ChartSample:
    """One chart as one camera saw it.

    Attributes:
        raw: (24, 3) readings, vignetting undone.
        white: (24, 3) what a perfect white reads at each patch, linear.
        clipped: (24,) share of pixels at the white level.
    """

    raw: np.ndarray
    white: np.ndarray
    clipped: np.ndarray


@dataclasses.dataclass(frozen=True)
class ColourFit:
    """A fit and how good it is.

    Attributes:
        correction: what is used.
        matrix: (3, 3).
        root_polynomial: (3, 6), whether it is used or not.
        read: (24, 3) the patches' reflectances as the correction reads them, mean over samples; 0
            where a patch was clipped or not read.
        kept: (24,) bool, patches that were fitted to.
        facts: figures, JSON-ready.
    """

    correction: ColourCorrection
    matrix: np.ndarray
    root_polynomial: np.ndarray
    read: np.ndarray
    kept: np.ndarray
    facts: dict[str, Any]


def fit_colour(
    samples: list[ChartSample],
    known: np.ndarray,
    config: ColourFitConfig,
    exposure: float | None = None,
    where: str = "chart",
) -> ColourFit:
    """Fit a camera's colour correction to charts.

    Source of the root-polynomial: [Finlayson2015].

    Args:
        samples: at least one, all of one camera at one exposure.
        known: (24, 3) reflectances of the patches.
        config: see there.
        exposure: of the photographs, kept with the correction.
        where: to name in errors.

    Raises:
        ProcessingError: too few usable patches.
    """
    usable = _usable(samples, known, config)
    kept = usable
    _require_enough(kept, config, where)
    # A saturated patch may be wrong by much with a matrix alone: it is the chart's for all that.
    error = np.min(
        [_delta_e(_held_out(samples, known, kept, config, bent), known) for bent in (False, True)],
        axis=0,
    )
    kept = kept & ~(error > max(config.outlier_delta_e, 4 * float(np.median(error[kept]))))
    _require_enough(kept, config, where)
    errors = {
        name: _delta_e(_held_out(samples, known, kept, config, name == "root_polynomial"), known)
        for name in ("matrix", "root_polynomial")
    }
    matrix = _solve(samples, known, kept, config, root_polynomial=False)
    bent = _solve(samples, known, kept, config, root_polynomial=True)
    # All patches, and the two of skin: of those, what is left out was unusable or unlike a chart.
    skin = kept & (np.arange(PATCHES) < SKIN.stop)
    means = {
        name: [float(each[kept].mean()), float(each[skin].mean() if skin.any() else np.nan)]
        for name, each in errors.items()
    }
    needed = 1 - config.gain_of_root_polynomial
    better = all(
        np.isnan(mine) or mine < needed * other
        for mine, other in zip(means["root_polynomial"], means["matrix"], strict=True)
    )
    chosen = {"auto": better, "matrix": False, "root_polynomial": True}[config.use]
    correction = ColourCorrection(matrix, bent if chosen else None, exposure)
    read = np.where(usable[:, None], _reflectance(correction, samples), 0.0)
    final = _delta_e(read, known)
    balanced = _reflectance(ColourCorrection(_white_balance(samples, known, kept)), samples)
    facts = {
        "used": "root_polynomial" if chosen else "matrix",
        "held_out_delta_e": {
            name: {"all": round(mean, 3), "skin": None if np.isnan(of_skin) else round(of_skin, 3)}
            for name, (mean, of_skin) in means.items()
        },
        "delta_e": {
            "white_balance_alone": round(float(_delta_e(balanced, known)[kept].mean()), 3),
            "mean": round(float(final[kept].mean()), 3),
            "largest": round(float(final[kept].max()), 3),
        },
        "reflectance_rms": round(float(np.sqrt(np.mean((read - known)[kept] ** 2))), 5),
        "neutral_scale": round(_neutral_scale(read, known, kept), 5),
        "patch_delta_e": [
            round(float(e), 2) if good else None for e, good in zip(final, usable, strict=True)
        ],
        "patch_residual": [
            np.round(off, 5).tolist() if good else None
            for off, good in zip(read - known, usable, strict=True)
        ],
        "left_out": {
            "clipped": (np.flatnonzero(~usable) + 1).tolist(),
            "unlike_the_chart": (np.flatnonzero(usable & ~kept) + 1).tolist(),
        },
        "charts": len(samples),
    }
    return ColourFit(correction, matrix, bent, read, kept, facts)


def _usable(samples: list[ChartSample], known: np.ndarray, config: ColourFitConfig) -> np.ndarray:
    """(24,) bool: finite, lit and not clipped in every sample."""
    usable = np.isfinite(known).all(axis=1)
    for sample in samples:
        finite = np.isfinite(sample.raw).all(axis=1) & np.isfinite(sample.white).all(axis=1)
        lit = finite & (sample.raw > 0).all(axis=1) & (sample.white > 0).all(axis=1)
        usable &= lit & (sample.clipped <= config.max_clipped_share)
    return np.asarray(usable)


def _require_enough(kept: np.ndarray, config: ColourFitConfig, where: str) -> None:
    neutral = int(kept[NEUTRAL].sum())
    if kept.sum() >= config.min_patches and neutral >= 3:
        return
    raise ProcessingError(
        where,
        found=f"{kept.sum()} of {PATCHES} usable chart patches, {neutral} of them neutral",
        expected=f"at least {config.min_patches}, and 3 neutral ones",
        hint="Is the chart overexposed, shadowed or shining? Is it a classic 24-patch chart?",
    )


def _solve(
    samples: list[ChartSample],
    known: np.ndarray,
    kept: np.ndarray,
    config: ColourFitConfig,
    root_polynomial: bool,
) -> np.ndarray:
    """(3, 3) or (3, 6) least squares from readings to what they are to read."""
    weight = 1.0 / (np.maximum(known, 0).mean(axis=1) + config.dark_floor)
    weight[NEUTRAL] *= config.neutral_weight
    weight[SKIN] *= config.skin_weight
    rows, targets = [], []
    for sample in samples:
        # Divided by its own white each patch counts alike however it was lit; both ways of
        # correcting are homogeneous, so a patch under its mean light represents it.
        light = sample.white.mean(axis=1, keepdims=True)
        raw = sample.raw / light
        terms = root_terms(raw) if root_polynomial else raw
        rows.append(weight[kept, None] * terms[kept])
        targets.append(weight[kept, None] * (known * sample.white / light)[kept])
    solution, *_ = np.linalg.lstsq(np.concatenate(rows), np.concatenate(targets), rcond=None)
    return np.asarray(solution.T)


def _held_out(
    samples: list[ChartSample],
    known: np.ndarray,
    kept: np.ndarray,
    config: ColourFitConfig,
    root_polynomial: bool,
) -> np.ndarray:
    """(24, 3) reflectances, each read by a fit that did not see that patch."""
    out = np.zeros((PATCHES, 3))
    for patch in range(PATCHES):
        others = kept.copy()
        others[patch] = False
        solved = _solve(samples, known, others, config, root_polynomial)
        bent = solved if root_polynomial else None
        correction = ColourCorrection(solved[:, :3], bent)
        out[patch] = _reflectance(correction, samples)[patch]
    return out


def _reflectance(correction: ColourCorrection, samples: list[ChartSample]) -> np.ndarray:
    """(24, 3) mean over samples of what a correction reads, divided by white."""
    read = [
        np.divide(
            correction.apply(np.asarray(sample.raw, float)),
            sample.white,
            out=np.zeros((PATCHES, 3)),
            where=sample.white > 0,
        )
        for sample in samples
    ]
    return np.asarray(np.mean(read, axis=0))


def _white_balance(samples: list[ChartSample], known: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """(3, 3) diagonal: one gain a channel that brings the neutral patches to what they are."""
    neutral = np.flatnonzero(kept)
    neutral = neutral[neutral >= NEUTRAL.start]
    raw = np.concatenate([sample.raw[neutral] / sample.white[neutral] for sample in samples])
    target = np.concatenate([known[neutral]] * len(samples))
    return np.diag(np.sum(raw * target, axis=0) / np.sum(raw * raw, axis=0))


def _delta_e(read: np.ndarray, known: np.ndarray) -> np.ndarray:
    """(24,) colour differences; what is no number counts as infinitely different."""
    difference = delta_e_2000(lab_from_linear(read), lab_from_linear(known))
    return np.where(np.isfinite(difference), difference, 1000.0)


def _neutral_scale(read: np.ndarray, known: np.ndarray, kept: np.ndarray) -> float:
    """What the neutral patches read as a share of what they are: 1 is right."""
    neutral = kept & (np.arange(PATCHES) >= NEUTRAL.start)
    return float(np.sum(read[neutral] * known[neutral]) / np.sum(known[neutral] ** 2))
