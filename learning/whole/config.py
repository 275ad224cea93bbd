"""Configuration of the `modern` training."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

from learning.config import TrainingConfig
from learning.networks.whole_face import WholeFaceConfig
from learning.whole.faces import FacesConfig


@dataclasses.dataclass(frozen=True)
class WholeTrainConfig(TrainingConfig):
    """A training on whole faces, by AdamW: its rate rises in the first steps and falls as a cosine.

    Attributes:
        network: its size.
        faces: how faces are shown.
        steps: of the training.
        weight_decay: AdamW's.
        specular_weight: of the squared error of the specular albedo's logarithm, beside the
            squared error of the sRGB-encoded diffuse albedo.
        deviation_weight: of the expected error's likelihood.
        detail_pairs: pairs at the textures' own size that the shares of detail are fitted to.
        doubt_faces: faces over which the network's error along people's modes is measured.
        score_lights: environments under which each held-out scan is scored.
    """

    family: ClassVar[str] = "whole_face"
    network: WholeFaceConfig = dataclasses.field(default_factory=WholeFaceConfig)
    faces: FacesConfig = dataclasses.field(default_factory=FacesConfig)
    batch: int = 4
    steps: int = 6000
    learning_rate: float = 2e-3
    weight_decay: float = 1e-4
    specular_weight: float = 0.01
    deviation_weight: float = 0.01
    detail_pairs: int = 8
    doubt_faces: int = 256
    score_lights: int = 3

    @property
    def held_out_subjects(self) -> int:
        """See `TrainingConfig`."""
        return self.faces.held_out_subjects
