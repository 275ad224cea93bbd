"""Lights dimmed by pulses: how far a photograph's brightness depends on when it began.

A light of level d is fully on for the share d of each period. An exposure of N = n + f periods (n
whole, 0 <= f < 1) holds n d periods of light and, from its last part, between max(0, f + d - 1) and
min(f, d), as the phase falls; a steady light gives N d. Lights are taken to pulse together, which
is the worst case. A whole number of periods sees the same from any phase.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from lightstage.findings import Finding, two_digits
from lightstage.preflight.config import PreflightConfig, Series
from lightstage.preflight.values import exposure_s, true_exposures_s

MARKS = (
    *("1/8000", "1/6400", "1/5000", "1/4000", "1/3200", "1/2500", "1/2000", "1/1600", "1/1250"),
    *("1/1000", "1/800", "1/640", "1/500", "1/400", "1/320", "1/250", "1/200", "1/160", "1/125"),
    *("1/100", "1/80", "1/60", "1/50", "1/40", "1/30", "1/25", "1/20", "1/15", "1/13", "1/10"),
    *("1/8", "1/6", "1/5", "1/4", "0.3", "0.4", "0.5", "0.6", "0.8", "1", "1.3", "1.6", "2"),
    *("2.5", "3.2", "4", "5", "6", "8", "10", "13", "15", "20", "25", "30"),
)
"""Times that cameras offer, in thirds of a stop."""
OTHER_MARKS = (
    *("1/6000", "1/3000", "1/1500", "1/750", "1/350", "1/180", "1/90", "1/45", "1/3"),
    *("1/2.5", "1/1.6", "1/1.3", "0.7", "1.5", "3"),
)
"""Those of half stops, and other ways to mark a third."""
MARKED = 0.01
"""A time this near to a mark is that mark."""


def worst_error(periods: float, level: float) -> float:
    """Largest share by which a photograph's light can be off, over all phases.

    It never grows with the level, so that it also holds for every brighter light.

    Args:
        periods: that the exposure lasts, above 0.
        level: of the light, above 0 and at most 1.

    Returns:
        |light - steady light| / steady light, 0 for a whole number of periods or a full light.
    """
    part = periods - math.floor(periods)
    steady = part * level
    above = min(part, level) - steady
    below = steady - max(0.0, part + level - 1.0)
    return max(above, below) / (periods * level)


def possible_exposures_s(text: str, series: Series) -> tuple[float, ...]:
    """How long a shutter may be open under a marked time; empty where the text is no time.

    A time that is no mark of the series (0.0451) is taken as it is.

    Args:
        text: as the camera reports it.
        series: see PreflightConfig.
    """
    exposure = exposure_s(text)
    if exposure is None:
        return ()
    mark = nearest_mark(exposure[0], exposure[1])
    if mark is None:
        return (exposure[0],)
    marked = _seconds(mark)
    true = true_exposures_s(marked) or (marked,)
    return {"marked": (marked,), "true": true, "either": tuple(sorted({marked, *true}))}[series]


def nearest_mark(time_s: float, off_s: float = 0.0) -> str | None:
    """The mark that a time is, such as ``1/60`` for 0.0166; None where it is none.

    Args:
        time_s: as the camera reports it.
        off_s: how far its text may be off.
    """

    def off(mark: str) -> float:
        return abs(_seconds(mark) - time_s)

    mark = min((*MARKS, *OTHER_MARKS), key=off)
    return mark if off(mark) <= MARKED * time_s + off_s else None


def exposure_error(text: str, pulse_hz: float, level: float, series: Series) -> float | None:
    """Worst error of a marked time under pulsed light; None where the text is no time.

    Args:
        text: as the camera reports it.
        pulse_hz: above 0.
        level: of the dimmest light.
        series: see PreflightConfig.
    """
    times = possible_exposures_s(text, series)
    return max((worst_error(t * pulse_hz, level) for t in times), default=None)


def fitting_marks(text: str, pulse_hz: float, level: float, config: PreflightConfig) -> list[str]:
    """Marked times near one that stay within the limit: the next shorter and the next longer."""
    exposure = exposure_s(text)
    if exposure is None:
        return []
    fit = [
        mark
        for mark in MARKS
        if (exposure_error(mark, pulse_hz, level, config.shutter_series) or 0.0)
        <= config.max_pulse_error
    ]
    shorter = [mark for mark in fit if _seconds(mark) < exposure[0]]
    longer = [mark for mark in fit if _seconds(mark) > exposure[0]]
    return shorter[-1:] + longer[:1]


def pulse_findings(
    shutters: Mapping[str, str | None],
    pulse_hz: float | None,
    lowest_level: float,
    config: PreflightConfig,
) -> list[Finding]:
    """What the lights' pulses do to the cameras' exposures.

    Args:
        shutters: by camera id, as reported; what a camera cannot report is skipped.
        pulse_hz: of the lights; 0 where they are not dimmed by pulses, None where not known.
        lowest_level: of the plan; lights that are only on or off show no pulses.
        config: the limit.
    """
    if lowest_level >= 1 or pulse_hz == 0:
        return []
    if pulse_hz is None:
        return [
            Finding(
                "warn",
                "pulses-unknown",
                "LED device",
                "no pulse frequency",
                "pulse_hz=.. in its URL (--leds)",
                "Not verified: exposures are not compared with the lights' pulses.",
            )
        ]
    groups: dict[str, list[str]] = {}
    for camera_id, text in shutters.items():
        if text is not None:
            groups.setdefault(text, []).append(camera_id)
    findings = []
    for text, ids in groups.items():
        error = exposure_error(text, pulse_hz, lowest_level, config.shutter_series)
        if error is None or error <= config.max_pulse_error:
            continue
        lasts = " or ".join(
            f"{t * pulse_hz:.2f}" for t in possible_exposures_s(text, config.shutter_series)
        )
        marks = fitting_marks(text, pulse_hz, lowest_level, config)
        hint = f"Set {' or '.join(marks)} s, and the ISO or aperture with it. " if marks else ""
        findings.append(
            Finding(
                "refuse",
                "pulses",
                f"camera{'s' if len(ids) > 1 else ''} {', '.join(ids)}, shutter",
                f"{text}: {lasts} pulses of {pulse_hz:g} Hz, brightness off by up to "
                f"{two_digits(100 * error)} %",
                f"at most {100 * config.max_pulse_error:g} % (max_pulse_error)",
                hint + "A whole number of pulses sees the same light in every photograph.",
                camera=ids[0] if len(ids) == 1 else None,
            )
        )
    return findings


def _seconds(mark: str) -> float:
    top, _, bottom = mark.partition("/")
    return float(top) / float(bottom or 1)
