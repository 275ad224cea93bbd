"""Comparisons that need no sum: between cameras, with `full`, with a session before."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from lightstage.checks.ball import BallModel, brightness, seen_shares, unlikeness
from lightstage.checks.config import ChecksConfig
from lightstage.checks.photo_measures import Photo
from lightstage.checks.sharpness import sharpness
from lightstage.checks.single import where
from lightstage.checks.sums import MIN_CELLS, lit_cells
from lightstage.counting import counted
from lightstage.findings import Finding, two_digits
from lightstage.formats.sums import UNLIKE, UNLIKE_RATIO

LIKE_SIGNAL = 0.4
"""A photograph of less than this share of another's light cannot judge that one's focus."""
EXCESS_CELLS = 0.1
"""Share of lit cells that may be brighter than under `full` before it is reported."""


def unlike_findings(
    pattern: str, photos: Mapping[str, Photo], config: ChecksConfig
) -> list[Finding]:
    """Cameras whose exposure under the brightest pattern leaves the others'."""
    levels = {camera: photo.signal for camera, photo in photos.items() if photo.signal > 0}
    if len(levels) < 3:
        return []
    middle = float(np.median(list(levels.values())))
    out = []
    for camera, level in levels.items():
        ratio = level / middle
        if max(ratio, 1 / ratio) > config.max_unlike_ratio:
            out.append(
                Finding(
                    "warn",
                    "unlike-others",
                    where(pattern, camera),
                    f"{two_digits(ratio)} times the light of the other cameras",
                    f"within a factor of {config.max_unlike_ratio:g}",
                    "Read back its ISO, shutter and aperture; is something before the lens?",
                    pattern,
                    camera,
                )
            )
    return out


def looks_like(
    name: str, patterns: Sequence[str], unlike: np.ndarray, allowed: Sequence[str]
) -> tuple[str, float]:
    """Which pattern a photograph is most like by its (P,) unlikeness to each, and how many times
    nearer than to its own.
    """
    own = float(unlike[patterns.index(name)])
    best = min(allowed, key=lambda other: unlike[patterns.index(other)])
    return best, own / max(float(unlike[patterns.index(best)]), 1e-6)


def expected_findings(
    pattern: str,
    whole: str,
    photos: Mapping[str, Photo],
    wholes: Mapping[str, Photo],
    model: BallModel,
    allowed: Sequence[str],
    config: ChecksConfig,
) -> list[Finding]:
    """Photographs that show another pattern, are brighter than `full`, or far too dark."""
    index = model.patterns.index(pattern)
    other: dict[str, str] = {}
    bright: dict[str, float] = {}
    dim: dict[str, float] = {}
    known = 0
    for camera, photo in photos.items():
        if camera not in wholes:
            continue
        seen = seen_shares(photo, wholes[camera])
        expected = model.shares(camera, wholes[camera], whole)
        if seen is None or expected is None:
            continue
        known += 1
        apart = unlikeness(seen, expected)
        name, ratio = looks_like(pattern, model.patterns, apart, allowed)
        if apart[index] > UNLIKE and ratio > UNLIKE_RATIO:
            other[camera] = name
        over = float(np.quantile(seen, 1 - EXCESS_CELLS)) - 1.0
        if over > config.max_excess_share and model.is_part(pattern, whole):
            bright[camera] = over
        cells = lit_cells(wholes[camera])
        weight = wholes[camera].coarse[..., 1][cells].astype(float)
        level = brightness(seen, expected[index], weight)
        if level < 1 / config.max_expected_ratio:
            dim[camera] = level
    out = _shared("wrong-light", "wrong-picture", pattern, other, known, _describe_other)
    named = {finding.camera for finding in out}
    if None in named:
        return out
    for code, values, describe in (
        ("too-bright", bright, _describe_bright),
        ("too-dark", dim, _describe_dim),
    ):
        rest = {camera: value for camera, value in values.items() if camera not in named}
        found = _shared(code, code, pattern, rest, known, describe)
        out += found
        named |= set(rest)
    return out


def _describe_other(pattern: str, values: Sequence[Any]) -> tuple[str, str, str]:
    best = max(set(values), key=list(values).count)
    return (
        f"light that looks like {best}",
        f"that of {pattern}",
        "Retake it; if it stays so, check the lamps' order and wiring.",
    )


def _describe_bright(pattern: str, values: Sequence[Any]) -> tuple[str, str, str]:
    return (
        f"up to {two_digits(100 * float(np.median(values)))} % more light than under all lamps",
        f"{pattern} to be a part of them",
        "Exposure or ISO has changed since, or room light came on: read the settings back.",
    )


def _describe_dim(pattern: str, values: Sequence[Any]) -> tuple[str, str, str]:
    return (
        f"{two_digits(100 * float(np.median(values)))} % of the light expected",
        f"that of {pattern}",
        "Did the lights come on while the shutter was open? Retake it.",
    )


def _shared(
    shared_code: str,
    own_code: str,
    pattern: str,
    values: Mapping[str, Any],
    known: int,
    describe: Any,
) -> list[Finding]:
    """One finding where most cameras agree, else one for each camera."""
    if len(values) > known / 2 and known > 1:
        found, expected, hint = describe(pattern, list(values.values()))
        place = f"{len(values)} of {counted(known, 'camera')}, pattern {pattern}"
        return [Finding("retake", shared_code, place, found, expected, hint, pattern, None)]
    out = []
    for camera, value in values.items():
        found, expected, hint = describe(pattern, [value])
        place = where(pattern, camera)
        out.append(Finding("retake", own_code, place, found, expected, hint, pattern, camera))
    return out


def sharpness_findings(
    pattern: str,
    photos: Mapping[str, Photo],
    references: Mapping[str, tuple[str, Photo]],
    config: ChecksConfig,
) -> list[Finding]:
    """Photographs less sharp than another of the same camera, whichever of both it is.

    The blurred one must not be the brighter one by far: a dim photograph is no reference.
    """
    out = []
    for camera, photo in photos.items():
        if camera not in references:
            continue
        name, reference = references[camera]
        ratio = sharpness(photo, reference)
        if ratio is None or ratio <= 0:
            continue
        blurred, than = (pattern, name) if ratio < 1 else (name, pattern)
        soft, sharp = (photo, reference) if ratio < 1 else (reference, photo)
        if sharp.signal < LIKE_SIGNAL * soft.signal:
            continue
        worse = min(ratio, 1 / ratio)
        if worse >= config.warn_sharpness:
            continue
        out.append(
            Finding(
                "retake" if worse < config.min_sharpness else "warn",
                "blurred",
                where(blurred, camera),
                f"{100 * worse:.0f} % of the fine detail of its photograph under {than}",
                f"at least {100 * config.warn_sharpness:g} %",
                "Did the focus or the subject move while the shutter was open? Retake it.",
                blurred,
                camera,
            )
        )
    return out


def whiteness(parallel: Photo, cross: Photo) -> float | None:
    """Logarithm of how much bluer a parallel photograph is than a cross one, against red.

    The mirror reflection is white and skin is red, so parallel is the whiter of the two whatever
    the white balance; None where too little is lit.
    """
    if parallel.coarse.shape != cross.coarse.shape:
        return None
    cells = lit_cells(parallel) & lit_cells(cross) & parallel.usable & cross.usable
    red, blue = (
        [np.maximum(photo.coarse[cells][:, colour], 1e-9) for photo in (parallel, cross)]
        for colour in (0, 2)
    )
    if cells.sum() < MIN_CELLS:
        return None
    return float(np.median(np.log(blue[0] / red[0]) - np.log(blue[1] / red[1])))


def highlight_findings(
    pattern: str,
    photos: Mapping[tuple[str, str], Photo],
    levels: Mapping[str, np.ndarray],
    config: ChecksConfig,
) -> list[Finding]:
    """Swapped polarisation banks: the cross photograph shows the mirror reflection.

    `levels` are (n,) by pattern.
    """
    base, _, kind = pattern.partition("@")
    names = f"{base}@parallel", f"{base}@cross"
    if kind not in ("parallel", "cross") or not all(name in levels for name in names):
        return []
    values = []
    for name, camera in photos:
        if name == names[0] and (names[1], camera) in photos:
            value = whiteness(photos[names[0], camera], photos[names[1], camera])
            values += [value] if value is not None else []
    if not values or float(np.median(values)) >= config.min_highlight_ratio:
        return []
    swapped = float(np.median(values)) < -config.min_highlight_ratio
    return [
        Finding(
            "retake",
            "bank-swapped" if swapped else "no-polarisation",
            f"all cameras, pattern {pattern}",
            f"{'less' if swapped else 'no more'} mirror reflection under {names[0]} than under "
            f"{names[1]}",
            "more",
            "The two banks are plugged in the other way round."
            if swapped
            else "Are the polarisers on lamps and lenses?",
            pattern,
            None,
        )
    ]


def baseline_findings(
    pattern: str,
    shares: Mapping[str, Mapping[str, float]],
    baseline: Mapping[str, Any] | None,
    config: ChecksConfig,
) -> list[Finding]:
    """A pattern whose light against `full` has left an earlier session's in most cameras."""
    before = (baseline or {}).get("shares", {}).get(pattern, {})
    logs = [
        float(np.log(share / before[camera]))
        for camera, share in shares.get(pattern, {}).items()
        if before.get(camera, 0) > 0 and share > 0
    ]
    if not logs or abs(float(np.median(logs))) <= np.log1p(config.max_baseline_change):
        return []
    off = float(np.expm1(np.median(logs)))
    return [
        Finding(
            "warn",
            "unlike-before",
            f"all cameras, pattern {pattern}",
            f"{100 * off:+.2g} % of its light against the whole's in the session before",
            f"within {100 * config.max_baseline_change:g} %",
            "Have lamps failed or been exchanged? Photograph the grey ball.",
            pattern,
            None,
        )
    ]
