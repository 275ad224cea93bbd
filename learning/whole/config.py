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
        network: the network's size.
        faces: how faces are shown.
        steps: number of steps.
        weight_decay: weight decay of AdamW.
        specular_weight: weight of the squared error of the specular albedo's logarithm, where the
            squared error of the sRGB-encoded diffuse albedo has 1.
        deviation_weight: weight of the expected error's likelihood.
        detail_pairs: number of pairs at the textures' own size to which the shares of detail are
            fitted.
        doubt_faces: number of faces over which the network's error along people's modes is
            measured.
        score_lights: number of environments under which each held-out scan is scored.
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
