"""Configuration of the super-resolution's training."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

from learning.config import TrainingConfig
from learning.forward import Compile, Precision
from learning.upscale.network import RcanConfig
from learning.whole.faces import LARGEST_ROWS


@dataclasses.dataclass(frozen=True)
class PicturesConfig:
    """Which pictures are trained on.

    Attributes:
        patch_px: side of an input patch; that of its truth is `network.times` as large.
        count: number of pictures that are made before the first step, lit textures and albedos in
            equal parts, but at least one of each of every scan; 7 kB for each thousand texels.
        min_coverage: smallest share of a patch that must show a surface.
        mirrored_share: share of the patches that are mirrored left to right.
        held_out_subjects: number of people, the last ones by name, who are scored and never trained
            on.
        shadow_sets: number of sets of lights of each scan whose shadows are baked.
    """

    patch_px: int = 64
    count: int = 240
    min_coverage: float = 0.5
    mirrored_share: float = 0.5
    held_out_subjects: int = 1
    shadow_sets: int = 12


@dataclasses.dataclass(frozen=True)
class UpscaleTrainConfig(TrainingConfig):
    """A training of RCAN; the defaults are the published ones [Zhang2018], at 8 times.

    Attributes:
        network: the network's size.
        pictures: the pictures that are trained on.
        steps: number of steps.
        rates: number of equal parts of the training; in each the learning rate is half that of the
            part before.
        score_lights: number of environments under which each held-out scan is scored.
    """

    family: ClassVar[str] = "super_resolution"
    most_rows: ClassVar[int | None] = LARGEST_ROWS
    network: RcanConfig = dataclasses.field(default_factory=RcanConfig)
    pictures: PicturesConfig = dataclasses.field(default_factory=PicturesConfig)
    batch: int = 16
    steps: int = 1_000_000
    learning_rate: float = 1e-4
    rates: int = 5
    # bfloat16 rounds colours by up to .002, beside errors of .013 at 38 dB; compiling is untried.
    precision: Precision = "float32"
    compile: Compile = "off"
    score_lights: int = 3

    @property
    def held_out_subjects(self) -> int:
        """See `TrainingConfig`."""
        return self.pictures.held_out_subjects
