"""One place for light: what is checked before a light goes on, and who alone lights the lamps."""

from lightstage.safety.lights import SafeLights
from lightstage.safety.photosensitivity import photosensitivity_findings
from lightstage.safety.plan import SafetyConfig, check_shots, flash_rate_per_s, light_on_s

__all__ = [
    "SafeLights",
    "SafetyConfig",
    "check_shots",
    "flash_rate_per_s",
    "light_on_s",
    "photosensitivity_findings",
]
