"""The operator's warning that lights may flash faster than photosensitive people can bear."""

from __future__ import annotations

from collections.abc import Sequence

from lightstage.findings import Finding
from lightstage.safety.plan import SafetyConfig, flash_rate_per_s
from lightstage.sequence import Shot

SAFE_FLASHES_PER_S = 3.0
"""Light that flashes more often can cause seizures [WCAG-Flashes, Harding2005]."""


def photosensitivity_findings(shots: Sequence[Shot], config: SafetyConfig) -> list[Finding]:
    """A warning where a configuration allows more flashes than are held to be safe.

    Three flashes in a second are the limit of the Web Content Accessibility Guidelines
    [WCAG-Flashes]; flashes of 3 Hz or more are a hazard [Harding2005].

    Args:
        shots: what is to be lit.
        config: the limits.

    Returns:
        One finding, or none where the configured limit is the safe one.
    """
    if config.max_flashes_per_s <= SAFE_FLASHES_PER_S:
        return []
    rate = flash_rate_per_s(shots, config.light_interval_s)
    return [
        Finding(
            "warn",
            "photosensitivity",
            "configuration, [safety] max_flashes_per_s",
            found=f"{config.max_flashes_per_s:g} flashes per second allowed, of which these "
            f"patterns need up to {min(rate, config.max_flashes_per_s):g}",
            expected=f"at most {SAFE_FLASHES_PER_S:g} (WCAG 2.3.1)",
            hint="Flashing light can cause epileptic seizures, also in people who do not know that "
            "they are photosensitive. Ask the person before the lights go on, or remove the line "
            "from the configuration.",
        )
    ]
