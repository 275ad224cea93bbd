"""Presets: named sets of values for a training."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from learning.config import TrainingConfig
from learning.four.config import FourTrainConfig
from learning.limits import require_within
from learning.mesostructure.config import MesostructureTrainConfig
from learning.patch_config import TrainConfig
from learning.upscale.config import UpscaleTrainConfig
from learning.whole.config import WholeTrainConfig
from lightstage.errors import ConfigError
from lightstage.formats.config import make_config

FAMILIES: dict[str, type[TrainingConfig]] = {
    "modern": WholeTrainConfig,
    "paper": TrainConfig,
    "demo": TrainConfig,
    "avatarme": FourTrainConfig,
    "avatarme-small": FourTrainConfig,
    "rcan": UpscaleTrainConfig,
    "rcan-small": UpscaleTrainConfig,
    "mesostructure": MesostructureTrainConfig,
}
"""What each preset trains: whole faces, patches by one network or by four, super-resolution, or
pores and folds."""
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
    "modern": {"network": {"heads": 8}, "batch": 16},
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
    "mesostructure": {},
}


LENGTHS = ("seconds", "steps", "epochs")
"""How long a training is: the first of these that is there counts alone."""


def require_one_length(overrides: dict[str, Any], where: str | Path) -> None:
    """Refuse a file that states a training's length twice, of which one would do nothing."""
    found = [name for name in LENGTHS if name in overrides]
    if len(found) > 1:
        raise ConfigError(
            where,
            field=", ".join(found),
            found=", ".join(str(overrides[name]) for name in found),
            expected=f"one of {', '.join(LENGTHS)}",
            hint=f"{found[0]} would count alone; leave out the others. --seconds counts in place "
            "of any.",
        )


def preset(name: str, overrides: dict[str, Any], where: str) -> TrainingConfig:
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
    if "seconds" not in overrides and {"steps", "epochs"} & overrides.keys():
        values["seconds"] = None  # the preset's own would count in their place
    config = make_config(FAMILIES[name], values, where)
    require_within(config, where)
    return config
