"""Configuration of trainings on patches."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

from learning.config import TrainingConfig
from learning.data import DataConfig
from learning.losses import RenderNorm
from learning.networks.discriminator import DiscriminatorConfig
from learning.networks.generator import GeneratorConfig
from learning.render.shading import Mode


@dataclasses.dataclass(frozen=True)
class PatchConfig(TrainingConfig):
    """What one network of patches and four share; the defaults are pix2pixHD's [Wang2018].

    Attributes:
        generator: the generator's size.
        discriminator: the discriminators' size.
        data: the patches that are trained on.
        epochs: number of steps, as that of passes over the patches; each step draws its patches at
            random.
        steps: number of steps, in place of `epochs`.
        beta1: Adam's decay of the mean gradient.
        beta2: Adam's decay of the mean squared gradient.
        constant_share: share of the training before the learning rate falls linearly to 0.
        feature_weight: weight of feature matching.
        map_weight: weight of the maps' own L1; not in the paper, 0 there. It makes a training of
            minutes converge.
        score_patches: number of patches of the people held out that are scored.
    """

    generator: GeneratorConfig = dataclasses.field(default_factory=GeneratorConfig)
    discriminator: DiscriminatorConfig = dataclasses.field(default_factory=DiscriminatorConfig)
    data: DataConfig = dataclasses.field(default_factory=DataConfig)
    epochs: int = 200
    steps: int | None = None
    beta1: float = 0.5
    beta2: float = 0.999
    constant_share: float = 0.5
    feature_weight: float = 10.0
    map_weight: float = 0.0
    shading: Mode = "paper"
    score_patches: int = 32

    @property
    def held_out_subjects(self) -> int:
        """See `TrainingConfig`."""
        return self.data.held_out_subjects

    @property
    def draws(self) -> int:
        """Environments of each pair beside the input's own."""
        return 0


@dataclasses.dataclass(frozen=True)
class TrainConfig(PatchConfig):
    """A training of one network; the defaults are the published ones [Lattas2021].

    Attributes:
        render_weight: weight of the rendering loss.
        render_norm: norm of the rendering loss: over the `patch`, under which the published weight
            of .3 matters, or the mean of `texel`s (see learning.losses).
        environments: number of environments of the rendering loss, n_L; 0 for the input's own
            environment alone.
    """

    family: ClassVar[str] = "patches"
    render_weight: float = 0.3
    render_norm: RenderNorm = "patch"
    environments: int = 3

    @property
    def draws(self) -> int:
        """See `PatchConfig`."""
        return self.environments if self.render_weight > 0 else 0
