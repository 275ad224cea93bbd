"""What evaluation raises."""

from processing.errors import ProcessingError


class EvaluationError(ProcessingError):
    """Result and truth that have nothing to compare."""
