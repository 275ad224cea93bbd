"""Errors of the `processing` package; a command exits 2 on each."""

from __future__ import annotations

from lightstage.errors import LightstageError


class ProcessingError(LightstageError):
    """Base of this package's own errors."""


class RegistrationError(ProcessingError):
    """A scan, landmarks or a template that cannot be brought into correspondence."""


class AtlasError(ProcessingError):
    """Views and a mesh that cannot be merged into one texture."""


class PoseError(ProcessingError):
    """A camera that is not where the rig has it."""


class ReconstructionError(ProcessingError):
    """Photographs that give no surface."""


class EvaluationError(ProcessingError):
    """Result and truth that have nothing to compare."""
