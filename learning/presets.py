"""Training configuration, and the named sets of values."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar

from learning.augment import AugmentConfig
from learning.data import DataConfig
from learning.forward import Compile, Precision
from learning.four.config import FourTrainConfig
from learning.limits import require_within
from learning.losses import RenderNorm
from learning.networks.discriminator import DiscriminatorConfig
from learning.networks.generator import GeneratorConfig
from learning.render.environments import RandomLightConfig
from learning.render.shading import Mode
from learning.upscale.config import UpscaleTrainConfig
from learning.whole.config import WholeTrainConfig
from lightstage.errors import ConfigError
from lightstage.formats.config import make_config


@dataclasses.dataclass(frozen=True)
class TrainConfig:
    """A training on patches; the defaults are the published ones [Lattas2021, Wang2018].

    Attributes:
        generator: its size.
        discriminator: its size.
        data: which patches.
        lights: which environments.
        augment: which other skins.
        batch: patches a step.
        epochs: passes over the patches.
        seconds: time to train in one call, instead of the epochs.
        learning_rate: Adam's.
        beta1: Adam's.
        beta2: Adam's.
        constant_share: part of the training before the learning rate falls linearly to 0.
        feature_weight: of feature matching.
        render_weight: of the rendering loss.
        render_norm: of the rendering loss: over the `patch`, under which the published weight of .3
            matters, or the mean of `texel`s (see learning.losses).
        map_weight: of the maps' own L1; not in the paper, 0 there. It makes a training of minutes
            converge.
        environments: n_L of the rendering loss.
        shading: the renderer's formulas for the training's pictures and the rendering loss: `paper`
            as printed, `physical` or `ggx` (see learning.render.shading).
        precision: of the network's steps: `bf16` computes in bfloat16 and keeps weights and losses
            in float32, where a CUDA GPU has it; `auto`: where it is.
        compile: through torch.compile: `on`, `off`; `auto`: on CUDA alone.
        ema: decay of the weights' moving average, which is scored and inferred with; 0 for none.
        seed: of everything random.
        log_steps: steps between lines of metrics.jsonl.
        save_seconds: time between checkpoints.
        score_patches: patches of the people held out that are scored.
    """

    family: ClassVar[str] = "patches"
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
    render_weight: float = 0.3
    render_norm: RenderNorm = "patch"
    map_weight: float = 0.0
    environments: int = 3
    shading: Mode = "paper"
    precision: Precision = "auto"
    compile: Compile = "auto"
    ema: float = 0.0
    seed: int = 0
    log_steps: int = 20
    save_seconds: float = 60.0
    score_patches: int = 32


AnyTrainConfig = TrainConfig | FourTrainConfig | WholeTrainConfig | UpscaleTrainConfig
FAMILIES: dict[str, type[AnyTrainConfig]] = {
    "modern": WholeTrainConfig,
    "paper": TrainConfig,
    "demo": TrainConfig,
    "avatarme": FourTrainConfig,
    "avatarme-small": FourTrainConfig,
    "rcan": UpscaleTrainConfig,
    "rcan-small": UpscaleTrainConfig,
}
"""What each preset trains: whole faces, patches by one network or by four, or super-resolution."""
# For minutes on two cores: narrower networks, on patches of an atlas of 1536 rows that show as much
# of the face as 512 of 6144; the texture's contrast goes around the network. A higher rate and the
# maps' own L1 replace 200 epochs. Features and verdicts of young discriminators leave spots and the
# whole face's outlines in a patch, so they count less beside the maps.
_SMALL: dict[str, Any] = {
    "generator": {"width": 16, "downsamplings": 3, "global_blocks": 3, "local_blocks": 2},
    "discriminator": {"width": 8, "scales": 2},
    "data": {
        "patch_px": 128,
        "stride_px": 64,
        "patches_in_memory": 1024,
        "shadow_rows": 192,
        "target": "each",
        "shadow_sets": 16,
        "relative": True,
        "detail_px": 24.0,
    },
    "batch": 2,
    "learning_rate": 5e-4,
    "constant_share": 0.4,
    "feature_weight": 1.0,
    "map_weight": 300.0,
    "shading": "physical",
}
PRESETS: dict[str, dict[str, Any]] = {
    "modern": {},
    "paper": {},
    "demo": {
        **_SMALL,
        "seconds": 90.0,
        "render_weight": 100.0,
        "render_norm": "texel",
        "environments": 1,
    },
    "avatarme": {},
    "avatarme-small": {**_SMALL, "seconds": 300.0},
    "rcan": {},
    # Minutes on two cores. Beside bicubic interpolation it begins where that ends.
    "rcan-small": {
        "network": {
            "groups": 3,
            "blocks": 4,
            "width": 32,
            "tail_width": 8,
            "reduction": 8,
            "beside_bicubic": True,
        },
        "pictures": {"patch_px": 24},
        "batch": 4,
        "steps": 3000,
        "learning_rate": 2e-3,
        "rates": 6,
    },
}


def preset(name: str, overrides: dict[str, Any], where: str) -> AnyTrainConfig:
    """A preset with some values changed.

    Args:
        name: of the preset.
        overrides: nested as the configuration is.
        where: what to name in errors.

    Raises:
        ConfigError: an unknown preset or key, or a value out of bounds.
    """
    if name not in PRESETS:
        raise ConfigError("--preset", found=repr(name), expected=f"one of {', '.join(PRESETS)}")
    values = dict(PRESETS[name])
    for key, value in overrides.items():
        both = isinstance(value, dict) and isinstance(values.get(key), dict)
        values[key] = {**values[key], **value} if both else value
    config = make_config(FAMILIES[name], values, where)
    require_within(config, where)
    return config
