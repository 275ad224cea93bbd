"""What is made sure before a light goes on, and that it stays so."""

from lightstage.preflight.check import device_findings, preflight, refusals, require
from lightstage.preflight.config import Plan, PreflightConfig
from lightstage.preflight.consent import consent_findings
from lightstage.preflight.drift import drift, set_back
from lightstage.preflight.measured_rig import measured_rig_findings
from lightstage.preflight.photo_settings import photograph_findings
from lightstage.preflight.privacy import clear_privacy
from lightstage.preflight.pseudonyms import require_known
from lightstage.preflight.settings import settings_findings
from lightstage.preflight.skew import SkewReport, skew_findings

__all__ = [
    "Plan",
    "PreflightConfig",
    "SkewReport",
    "clear_privacy",
    "consent_findings",
    "device_findings",
    "drift",
    "measured_rig_findings",
    "photograph_findings",
    "preflight",
    "refusals",
    "require",
    "require_known",
    "set_back",
    "settings_findings",
    "skew_findings",
]
