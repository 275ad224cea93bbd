"""Configuration of the `modern` training."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

from learning.augment import AugmentConfig
from learning.forward import Compile, Precision
from learning.networks.whole_face import WholeFaceConfig
from learning.render.environments import RandomLightConfig
from learning.render.shading import Mode
from learning.whole.faces import FacesConfig


@dataclasses.dataclass(frozen=True)
class WholeTrainConfig:
    """A training on whole faces.

    Attributes:
        network: its size.
        faces: how faces are shown.
        lights: which environments.
        augment: which other skins.
        batch: faces a step.
        steps: of the training.
        seconds: time to train in one call, instead of the steps.
        learning_rate: AdamW's; it rises in the first steps and falls as a cosine.
        weight_decay: AdamW's.
        specular_weight: of the squared error of the specular albedo's logarithm, beside the
            squared error of the sRGB-encoded diffuse albedo.
        deviation_weight: of the expected error's likelihood.
        shading: the renderer's formulas for the training's pictures.
        detail_pairs: pairs at the textures' own size that the shares of detail are fitted to.
        doubt_faces: faces over which the network's error along people's modes is measured.
        precision: of the network's steps: `bf16` computes in bfloat16 and keeps weights and losses
            in float32, where a CUDA GPU has it; `auto`: where it is.
        compile: through torch.compile: `on`, `off`; `auto`: on CUDA alone.
        ema: decay of the weights' moving average, which is scored and inferred with; 0 for none.
        seed: of everything random.
        log_steps: steps between lines of metrics.jsonl.
        save_seconds: time between checkpoints.
        score_lights: environments under which each held-out scan is scored.
    """

    family: ClassVar[str] = "whole_face"
    network: WholeFaceConfig = dataclasses.field(default_factory=WholeFaceConfig)
    faces: FacesConfig = dataclasses.field(default_factory=FacesConfig)
    lights: RandomLightConfig = dataclasses.field(default_factory=RandomLightConfig)
    augment: AugmentConfig = dataclasses.field(default_factory=AugmentConfig)
    batch: int = 4
    steps: int = 6000
    seconds: float | None = None
    learning_rate: float = 2e-3
    weight_decay: float = 1e-4
    specular_weight: float = 0.01
    deviation_weight: float = 0.01
    shading: Mode = "physical"
    detail_pairs: int = 8
    doubt_faces: int = 256
    precision: Precision = "auto"
    compile: Compile = "auto"
    ema: float = 0.0
    seed: int = 0
    log_steps: int = 20
    save_seconds: float = 60.0
    score_lights: int = 3
