"""What every training is configured by, whatever networks it trains."""

from __future__ import annotations

import abc
import dataclasses
from typing import ClassVar

from learning.augment import AugmentConfig
from learning.forward import Compile, Precision
from learning.render.environments import RandomLightConfig
from learning.render.shading import Mode


@dataclasses.dataclass(frozen=True)
class TrainingConfig(abc.ABC):
    """What all families of networks share; each adds its own and begins from its own values.

    Attributes:
        lights: the environments that are drawn.
        augment: the variation of the skins that are drawn.
        batch: number of examples of a step, of all processes together.
        seconds: seconds of training in one call, instead of the family's number of steps.
        learning_rate: learning rate of Adam.
        shading: formulas of the renderer for the training's pictures and losses: `paper` as
            printed, `physical`, `ggx` or `dielectric` (docs/renderer.md).
        precision: precision of the network's steps: `bf16` computes in bfloat16 and keeps weights
            and losses in float32, where a CUDA GPU has it; `auto` is `bf16` there and `float32`
            elsewhere.
        compile: whether networks go through torch.compile: `on`, `off`; `auto` is `on` with CUDA
            alone.
        ema: decay of the weights' moving average, with which is scored and inferred; 0 for none.
        seed: seed of all random numbers.
        log_steps: number of steps between two lines of metrics.jsonl.
        save_seconds: seconds between two checkpoints.
    """

    family: ClassVar[str]
    """Name of the family of networks, as in checkpoints."""
    most_rows: ClassVar[int | None] = None
    """Rows at most at which textures are trained on; finer ones are shrunk to them."""
    lights: RandomLightConfig = dataclasses.field(default_factory=RandomLightConfig)
    augment: AugmentConfig = dataclasses.field(default_factory=AugmentConfig)
    batch: int = 1
    seconds: float | None = None
    learning_rate: float = 2e-4
    shading: Mode = "physical"
    precision: Precision = "auto"
    compile: Compile = "auto"
    ema: float = 0.0
    seed: int = 0
    log_steps: int = 20
    save_seconds: float = 60.0

    def rows_shown(self, rows: int) -> int:
        """Rows at which a store's textures are trained on."""
        return rows if self.most_rows is None else min(rows, self.most_rows)

    @property
    @abc.abstractmethod
    def held_out_subjects(self) -> int:
        """People, the last ones by name, who are scored and never trained on."""
