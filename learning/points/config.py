"""Configuration of the training of the network of template points."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class PointsConfig:
    """Settings of the training.

    Attributes:
        faces: number of faces drawn; each is learned from mirrored, too.
        held_out: number of further faces that are scored alone.
        epochs: how often each is seen, and its mirror image.
        batch: faces of a step.
        learning_rate: of Adam at the beginning; it ends at zero along a cosine.
        trunk_share: of it, for the trunk, which is trained already.
        average: decay of the weights' moving average, which is kept.
        seed: of all random numbers.
    """

    faces: int = 13_000
    held_out: int = 200
    epochs: int = 4
    batch: int = 24
    learning_rate: float = 1.5e-3
    trunk_share: float = 0.4
    average: float = 0.998
    seed: int = 0
