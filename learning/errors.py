"""Errors of the `learning` package; a command exits 2 on each."""

from __future__ import annotations

from lightstage.errors import LightstageError


class LearningError(LightstageError):
    """Base of this package's own errors."""


class MapsError(LearningError):
    """Maps, meshes or light sets that do not fit together."""


class NoReliefError(MapsError):
    """Maps whose normals are the mesh's own: they have no pores and folds."""


class CheckpointError(LearningError):
    """A checkpoint that is missing, damaged or of another network."""


class DeviceMemoryError(LearningError):
    """A network, its batch or its tile that a GPU's memory does not hold."""


class RecogniserError(LearningError):
    """A file that is no face recogniser, or one that makes no embedding of a picture."""


class TrainingError(LearningError):
    """Training data that cannot be trained on, or a training that diverged."""
