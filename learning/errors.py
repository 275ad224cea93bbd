"""Errors of the `learning` package; a command exits 2 on each."""

from __future__ import annotations

from lightstage.errors import LightstageError


class LearningError(LightstageError):
    """Base of this package's own errors."""
