"""Configuration of the mesostructure's training."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

from learning.config import TrainingConfig
from learning.forward import Compile, Precision
from learning.mesostructure.network import MesostructureConfig
from learning.whole.faces import LARGEST_ROWS


@dataclasses.dataclass(frozen=True)
class LitPatchesConfig:
    """Which patches are trained on.

    Attributes:
        patch_px: side of a patch.
        textures: number of lit textures from which patches are cut before the first step, but at
            least one of every scan.
        of_each: number of patches of each texture; all are held in memory, 1 MB each at 128 texels.
        min_known: smallest share of a patch's texels that must show skin.
        mirrored_share: share of the patches that are mirrored left to right.
        lamp_deg: standard deviation of the error of a lamp's direction, degrees.
        strength: standard deviation of the error of a light's strength, natural logarithm.
        shadow_px: standard deviation of the error of the place of a shadow's edge, texels.
        noise: standard deviation of the noise of a texel, natural logarithm.
        contrast: smallest and largest factor of the detail of a person's albedo: our people's
            detail is 0.02 of the albedo, a scanned head's 0.06. People are scored as they are.
        held_out_subjects: number of people, the last ones by name, who are scored and never trained
            on.
        shadow_sets: number of sets of lights of each scan whose shadows are baked.
    """

    patch_px: int = 96
    textures: int = 120
    of_each: int = 24
    min_known: float = 0.5
    mirrored_share: float = 0.5
    lamp_deg: float = 3.0
    strength: float = 0.1
    shadow_px: float = 3.0
    noise: float = 0.01
    contrast: tuple[float, float] = (0.7, 4.0)
    held_out_subjects: int = 1
    shadow_sets: int = 12


@dataclasses.dataclass(frozen=True)
class MesostructureTrainConfig(TrainingConfig):
    """A training on patches of lit textures, by Adam; its rate falls as a cosine.

    Attributes:
        network: the network's size.
        patches: the patches that are trained on.
        steps: number of steps.
        shading_weight: weight of the shading's squared error, where that of the tilts has 1.
        score_lights: number of environments under which each held-out scan is scored.
    """

    family: ClassVar[str] = "mesostructure"
    most_rows: ClassVar[int | None] = LARGEST_ROWS
    network: MesostructureConfig = dataclasses.field(default_factory=MesostructureConfig)
    patches: LitPatchesConfig = dataclasses.field(default_factory=LitPatchesConfig)
    batch: int = 8
    steps: int = 3000
    learning_rate: float = 2e-3
    # bfloat16 rounds a detail of .01 by a third of a percent, and compiling is untried.
    precision: Precision = "float32"
    compile: Compile = "off"
    shading_weight: float = 1.0
    score_lights: int = 3

    @property
    def held_out_subjects(self) -> int:
        """See `TrainingConfig`."""
        return self.patches.held_out_subjects
