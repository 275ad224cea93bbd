"""Configuration of the `avatarme` training."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

from learning.augment import AugmentConfig
from learning.data import DataConfig
from learning.forward import Compile, Precision
from learning.networks.discriminator import DiscriminatorConfig
from learning.networks.generator import GeneratorConfig
from learning.render.environments import RandomLightConfig
from learning.render.shading import Mode


@dataclasses.dataclass(frozen=True)
class FourTrainConfig:
    """A training of four networks; the defaults are the published ones [Lattas2020, Wang2018].

    Each network is trained on the truth of what it is given: none waits for another.

    Attributes:
        generator: size of each network.
        discriminator: size of those of each network.
        data: which patches.
        lights: which environments.
        augment: which other skins.
        batch: patches a step; every step trains all four networks on the same patches.
        epochs: passes over the patches.
        seconds: time to train in one call, instead of the epochs.
        learning_rate: Adam's.
        beta1: Adam's.
        beta2: Adam's.
        constant_share: part of the training before the learning rate falls linearly to 0.
        feature_weight: of feature matching.
        map_weight: of the maps' own L1; not in the paper, 0 there. It makes a training of minutes
            converge.
        shading: the renderer's formulas for the training's pictures.
        precision: of the networks' steps, as of `TrainConfig`.
        compile: through torch.compile, as of `TrainConfig`.
        ema: decay of the weights' moving averages, which are scored and inferred with; 0 for none.
        seed: of everything random.
        log_steps: steps between lines of metrics.jsonl.
        save_seconds: time between checkpoints.
        score_patches: patches of the people held out that are scored.
    """

    family: ClassVar[str] = "four_networks"
    generator: GeneratorConfig = dataclasses.field(default_factory=GeneratorConfig)
    discriminator: DiscriminatorConfig = dataclasses.field(default_factory=DiscriminatorConfig)
    data: DataConfig = dataclasses.field(default_factory=DataConfig)
    lights: RandomLightConfig = dataclasses.field(default_factory=RandomLightConfig)
    augment: AugmentConfig = dataclasses.field(default_factory=AugmentConfig)
    batch: int = 1
    epochs: int = 200
    seconds: float | None = None
    learning_rate: float = 2e-4
    beta1: float = 0.5
    beta2: float = 0.999
    constant_share: float = 0.5
    feature_weight: float = 10.0
    map_weight: float = 0.0
    shading: Mode = "paper"
    precision: Precision = "auto"
    compile: Compile = "auto"
    ema: float = 0.0
    seed: int = 0
    log_steps: int = 20
    save_seconds: float = 60.0
    score_patches: int = 32
