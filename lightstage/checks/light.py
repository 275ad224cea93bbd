"""Whether the commanded light was really lit: judgement over all cameras' sums.

One camera alone that disagrees is that camera; all of them together are the light.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from lightstage.checks.config import ChecksConfig
from lightstage.checks.subject_motion import MIN_EXPLAINED, Shift
from lightstage.checks.sums import Sum, SumFit
from lightstage.findings import Finding, two_digits

SURE = 5.0
"""Standard errors beyond which a gain is believed."""
MAJORITY = 0.5


@dataclasses.dataclass(frozen=True)
class Evidence:
    """All that is known of one sum.

    Attributes:
        sum: the patterns.
        fits: camera to its fit.
        shifts: camera to the parts' shifts.
        mm_per_px: camera to millimetres a pixel at the sphere's centre.
        unlike: (pattern, camera) to how much better it fits another pattern: its name and
            the ratio of unlikenesses, 1 where it is most like itself.
        others_hold: cameras whose other sums with the same whole hold.
    """

    sum: Sum
    fits: Mapping[str, SumFit]
    shifts: Mapping[str, Shift]
    mm_per_px: Mapping[str, float]
    unlike: Mapping[tuple[str, str], tuple[str, float]]
    others_hold: frozenset[str]


def judge_sum(evidence: Evidence, config: ChecksConfig) -> list[Finding]:
    """Findings of one sum, each with the pattern and camera to be taken again."""
    fits = evidence.fits
    wrong = [c for c in fits if fits[c].misfit > config.max_misfit_share]
    out: list[Finding] = []
    everywhere = len(wrong) > MAJORITY * len(fits) and len(fits) > 1
    if everywhere:
        out.append(_wrong(evidence, wrong, None))
    else:
        out += [_wrong(evidence, [camera], camera) for camera in wrong]
    sound = [camera for camera in fits if camera not in wrong]
    if not everywhere:
        out += _gains(evidence, sound, config)
    bad = {finding.camera for finding in out}
    if None not in bad:
        out += _motion(evidence, [camera for camera in sound if camera not in bad], config)
    return out


def _wrong(evidence: Evidence, cameras: list[str], camera: str | None) -> Finding:
    """A photograph that shows another light than by its name: which of the three it is."""
    parts = list(evidence.sum.patterns)
    if any(c in evidence.others_hold for c in cameras):
        parts = parts[:2]
    scores = {
        part: float(np.mean([evidence.unlike.get((part, c), ("", 1.0))[1] for c in cameras]))
        for part in parts
    }
    culprit = max(scores, key=lambda part: scores[part])
    names = [evidence.unlike.get((culprit, c), ("", 1.0)) for c in cameras]
    likes = [name for name, ratio in names if name and ratio > 1.0]
    looks = max(set(likes), key=likes.count) if likes else ""
    misfit = float(np.median([evidence.fits[c].misfit for c in cameras]))
    who = (
        camera or "all cameras" if camera or len(cameras) == len(evidence.fits) else "most cameras"
    )
    return Finding(
        "retake",
        "wrong-picture" if camera else "wrong-light",
        f"{who}, pattern {culprit}",
        f"{evidence.sum.first} + {evidence.sum.second} differs from {evidence.sum.whole} by "
        f"{two_digits(100 * misfit)} % on average" + (f"; it looks like {looks}" if looks else ""),
        "patterns that sum",
        "An old picture, or one of another shot: retake it with this camera."
        if camera
        else "The lights showed something else; retake the pattern, check the wiring.",
        culprit,
        camera,
    )


def _gains(evidence: Evidence, cameras: list[str], config: ChecksConfig) -> list[Finding]:
    """Photographs whose exposure, or patterns whose light, is a factor off."""
    if not cameras:
        return []
    first, second, whole = evidence.sum.patterns
    logs = -np.log(np.clip([evidence.fits[c].gains for c in cameras], 1e-3, 1e3))
    errors = np.array([evidence.fits[c].errors for c in cameras])
    shared = np.median(logs, axis=0) if len(cameras) >= 3 else np.zeros(2)
    limit = config.max_gain_error
    out: list[Finding] = []
    # Both parts alike in all cameras is ambient light or the whole's: judged with the other sums.
    common = float(np.sign(shared[0]) * min(abs(shared))) if shared[0] * shared[1] > 0 else 0.0
    for part, name in enumerate((first, second)):
        off = float(shared[part]) - common
        if abs(off) > limit and abs(off) > SURE * float(np.median(errors[:, part])):
            out.append(_level_off(name, whole, off))
    for index, camera in enumerate(cameras):
        off = logs[index] - shared
        sure = np.abs(off) > np.maximum(limit, SURE * errors[index])
        alike = sure.all() and abs(off[0] - off[1]) < 0.25 * np.abs(off).min() + limit
        if alike and camera not in evidence.others_hold:
            out.append(_exposed(whole, f"{first} and {second}", camera, -float(off.mean())))
        else:
            for part, name in enumerate((first, second)):
                if sure[part]:
                    out.append(_exposed(name, whole, camera, float(off[part])))
    return out


def _level_off(pattern: str, whole: str, off: float) -> Finding:
    return Finding(
        "retake",
        "light-level",
        f"all cameras, pattern {pattern}",
        f"{_percent(off)} than by {whole}",
        "the light that was commanded",
        "The lights' supply gave way, or some did not light; retake the pattern.",
        pattern,
        None,
    )


def _exposed(pattern: str, against: str, camera: str, off: float) -> Finding:
    return Finding(
        "retake",
        "exposure",
        f"{camera}, pattern {pattern}",
        f"{_percent(off)} than {against} by the same camera, the other cameras not",
        "one exposure for all",
        "Read back this camera's ISO, shutter and aperture, then take the photograph again.",
        pattern,
        camera,
    )


def _percent(off: float) -> str:
    factor = float(np.exp(abs(off)))
    size = f"{two_digits(factor)} times" if factor > 2 else f"{two_digits(100 * (factor - 1))} %"
    return f"{size} {'brighter' if off > 0 else 'darker'}"


def _believed(evidence: Evidence, camera: str, config: ChecksConfig) -> bool:
    """Whether a camera can see motion of the size that matters, and its shift explains the sum."""
    shift, scale = evidence.shifts[camera], evidence.mm_per_px[camera]
    if SURE * shift.error_px * scale > max(config.max_motion_mm, shift.largest_px * scale):
        return False
    return shift.largest_px * scale <= config.warn_motion_mm or shift.explained > MIN_EXPLAINED


def _motion(evidence: Evidence, cameras: list[str], config: ChecksConfig) -> list[Finding]:
    """The subject's motion, seen by most cameras, or one camera's own."""
    known = [c for c in cameras if c in evidence.shifts and _believed(evidence, c, config)]
    if not known:
        return []
    first, second, whole = evidence.sum.patterns
    lengths = np.array(
        [
            [np.hypot(*shift) * evidence.mm_per_px[c] for shift in (s.first_px, s.second_px)]
            for c, s in ((c, evidence.shifts[c]) for c in known)
        ]
    )
    middle = np.median(lengths, axis=0)
    out: list[Finding] = []
    worst = float(middle.max())
    if worst > config.warn_motion_mm:
        both = middle.min() > 0.6 * worst
        pattern = second if middle[1] >= middle[0] else first
        px = float(np.median([evidence.shifts[c].largest_px for c in known]))
        out.append(
            Finding(
                "retake" if worst > config.max_motion_mm else "warn",
                "motion",
                f"{'most cameras' if len(known) > 1 else known[0]}, pattern {pattern}",
                f"the subject {worst:.1f} mm ({px:.1f} px) from where {whole} shows it",
                f"at most {config.warn_motion_mm:g} mm",
                f"It moved after {whole} and stayed so: sit as before, or take {whole} again too."
                if both
                else "It moved during this pattern: retake it.",
                pattern,
                None,
            )
        )
    for index, camera in enumerate(known if len(known) > 2 else []):
        part = int(lengths[index].argmax())
        off = float(lengths[index, part] - middle[part])
        if off > config.warn_motion_mm:
            pattern = (first, second)[part]
            out.append(
                Finding(
                    "retake" if off > config.max_motion_mm else "warn",
                    "camera-moved",
                    f"{camera}, pattern {pattern}",
                    f"a picture {evidence.shifts[camera].largest_px:.1f} px from {whole}'s, in "
                    "this camera alone",
                    "a camera that does not move",
                    "Tighten its mount; a moved camera must be calibrated again.",
                    pattern,
                    camera,
                )
            )
    return out
