"""Configuration of the super-resolution's training."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

from learning.augment import AugmentConfig
from learning.render.environments import RandomLightConfig
from learning.render.shading import Mode
from learning.upscale.network import RcanConfig


@dataclasses.dataclass(frozen=True)
class PicturesConfig:
    """Which pictures are trained on.

    Attributes:
        patch_px: side of an input patch; that of its truth is `network.times` as large.
        count: pictures that are made before the first step, lit textures and albedos in equal
            parts; 7 kB for each thousand texels.
        min_coverage: smallest share of a patch that must show a surface.
        mirrored_share: part of the patches that are mirrored left to right.
        held_out_subjects: people, the last ones by name, who are scored and never trained on.
        shadow_sets: sets of lights of each scan whose shadows are baked.
    """

    patch_px: int = 64
    count: int = 240
    min_coverage: float = 0.5
    mirrored_share: float = 0.5
    held_out_subjects: int = 1
    shadow_sets: int = 12


@dataclasses.dataclass(frozen=True)
class UpscaleTrainConfig:
    """A training of RCAN; the defaults are the published ones [Zhang2018], at 8 times.

    Attributes:
        network: its size.
        pictures: which pictures.
        lights: which environments.
        augment: which other skins.
        batch: patches a step.
        steps: of the training.
        seconds: time to train in one call, instead of the steps.
        learning_rate: Adam's.
        rates: equal parts of the training; in each the rate is half that of the part before.
        shading: the renderer's formulas for the training's pictures.
        seed: of everything random.
        log_steps: steps between lines of metrics.jsonl.
        save_seconds: time between checkpoints.
        score_lights: environments under which each held-out scan is scored.
    """

    family: ClassVar[str] = "super_resolution"
    network: RcanConfig = dataclasses.field(default_factory=RcanConfig)
    pictures: PicturesConfig = dataclasses.field(default_factory=PicturesConfig)
    lights: RandomLightConfig = dataclasses.field(default_factory=RandomLightConfig)
    augment: AugmentConfig = dataclasses.field(default_factory=AugmentConfig)
    batch: int = 16
    steps: int = 1_000_000
    seconds: float | None = None
    learning_rate: float = 1e-4
    rates: int = 5
    shading: Mode = "physical"
    seed: int = 0
    log_steps: int = 20
    save_seconds: float = 60.0
    score_lights: int = 3
