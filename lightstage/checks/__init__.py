"""What a photograph must show before the operator moves on."""

from lightstage.checks.session import CheckReport, check_session

__all__ = ["CheckReport", "check_session"]
