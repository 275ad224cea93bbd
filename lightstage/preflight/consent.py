"""Whether there is a record of the consent of the person who is photographed."""

from __future__ import annotations

from lightstage.errors import ConfigError
from lightstage.findings import Finding
from lightstage.session.config import SessionConfig

_EXPECTED = "the id of the record of the person's consent, such as C-2026-0041"


def consent_findings(consent: str | None, config: SessionConfig) -> list[Finding]:
    """Findings on a session of a person: a warning where no consent record is named.

    Args:
        consent: id of the record, None where there is none.
        config: whether the lab requires one.

    Raises:
        ConfigError: there is none, and the lab requires one.
    """
    if consent is not None:
        return []
    if config.require_consent:
        raise ConfigError(
            "--consent",
            found="no id",
            expected=_EXPECTED,
            hint="The configuration requires it ([session] require_consent = true). "
            "A session keeps the consent with which it began.",
        )
    return [
        Finding(
            "warn",
            "no-consent",
            "consent",
            "no record of this person's consent",
            _EXPECTED,
            "Give it with --consent; a session that has begun keeps what it began with.",
        )
    ]
