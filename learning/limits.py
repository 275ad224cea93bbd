"""What a training, or a fit, may be configured as: bounds of every number, checked before all work.

A width of minus one, a patch that the network's strides do not divide or a network of a terabyte
end here in one message, not in a library's traceback.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from learning.domain.config import DomainConfig
from learning.networks.discriminator import DiscriminatorConfig
from learning.networks.generator import GeneratorConfig
from learning.networks.whole_face import WholeFaceConfig
from learning.photo.config import FitConfig
from learning.points.config import PointsConfig
from learning.render.environments import RandomLightConfig, TargetLight
from learning.render.occlusion_network import ROWS_MULTIPLE, OcclusionNetworkConfig
from learning.upscale.network import RcanConfig
from lightstage.counting import counted
from lightstage.errors import ConfigError
from lightstage.formats.config import make_config, read_toml

ConfigT = TypeVar("ConfigT", FitConfig, DomainConfig, PointsConfig)
_POSITIVE, _ANY = 1e-30, 1e12
LIMITS: dict[str, tuple[float, float]] = {
    "generator.width": (2, 1024),
    "generator.downsamplings": (1, 8),
    "generator.global_blocks": (0, 64),
    "generator.local_blocks": (0, 64),
    "discriminator.width": (1, 1024),
    "discriminator.layers": (1, 8),
    "discriminator.scales": (1, 8),
    "data.patch_px": (8, 8192),
    "data.stride_px": (1, 8192),
    "data.min_coverage": (0, 1),
    "data.held_out_subjects": (1, 1_000_000),
    "data.patches_in_memory": (1, 10_000_000),
    "data.shadow_rows": (0, 8192),
    "data.shadow_sets": (1, 100_000),
    "data.detail_px": (0, 4096),
    "lights.lights": (1, 64),
    "lights.distance_mm": (1, 1e6),
    "lights.exposure": (1e-3, 1e3),
    "lights.ambient_share": (0, 1),
    "lights.tint": (0, 3),
    "lights.ambient_tint": (0, 3),
    "lights.behind": (-0.9, 1),
    "lights.backlit_share": (0, 1),
    "lights.unfilled_share": (0, 1),
    "lights.camera_mm": (1, 1e6),
    "lights.position_spread": (0, 0.99),
    "lights.camera_spread": (0, 0.99),
    "lights.intensity_spread": (0, 0.99),
    "domain.textures": (1, 1000),
    "domain.seconds": (1, 86400),
    "domain.rounds": (1, 100),
    "domain.steps": (0, 100_000),
    "domain.rate": (_POSITIVE, 1),
    "domain.shadow_steps": (1, 100_000),
    "augment.melanin": (0, 3),
    "augment.haemoglobin": (0, 3),
    "augment.pattern": (0, 3),
    "augment.beside": (0, 3),
    "augment.shininess": (1, 1e4),
    "augment.translucency": (0, 1),
    "network.rows": (16, 1024),
    "network.columns": (16, 1024),
    "network.width": (2, 512),
    "network.halvings": (1, 6),
    "network.modes": (1, 1000),
    "network.heads": (0, 256),
    "network.groups": (1, 64),
    "network.blocks": (1, 256),
    "network.tail_width": (1, 512),
    "network.reduction": (1, 512),
    "network.times": (2, 8),
    "pictures.patch_px": (8, 1024),
    "pictures.count": (2, 1_000_000),
    "pictures.min_coverage": (0, 1),
    "pictures.mirrored_share": (0, 1),
    "pictures.held_out_subjects": (1, 1_000_000),
    "pictures.shadow_sets": (1, 10_000),
    "patches.patch_px": (8, 1024),
    "patches.textures": (1, 1_000_000),
    "patches.of_each": (1, 1_000_000),
    "patches.min_known": (0, 1),
    "patches.mirrored_share": (0, 1),
    "patches.lamp_deg": (0, 45),
    "patches.strength": (0, 1),
    "patches.shadow_px": (0, 100),
    "patches.noise": (0, 1),
    "patches.contrast": (_POSITIVE, 100),
    "patches.held_out_subjects": (1, 1_000_000),
    "patches.shadow_sets": (1, 10_000),
    "shading_weight": (0, _ANY),
    "faces.held_out_subjects": (1, 1_000_000),
    "faces.shadow_sets": (1, 10_000),
    "faces.white_balance": (0, 1),
    "faces.noise": (0, 1),
    "faces.ggx_share": (0, 1),
    "faces.partial_share": (0, 1),
    "faces.skin_share": (0, 1),
    "faces.closed_share": (0, 1),
    "faces.beside_skin": (0, 1),
    "faces.displaced_mm": (0, 50),
    "occlusion.rows": (ROWS_MULTIPLE, 10 * ROWS_MULTIPLE),
    "occlusion.lights": (1, 64),
    "occlusion.order": (1, 20),
    "occlusion.features": (1, 4096),
    "occlusion.connected": (1, 4096),
    "fit.rows": (192, 12288),
    "fit.search_rows": (192, 12288),
    "fit.landmark_percent": (0.1, 50),
    "fit.focal_spread": (1e-3, 2),
    "fit.focal_told_spread": (1e-3, 1),
    "fit.identity_modes": (0, 1000),
    "fit.depth_deviation": (1e-3, 1),
    "fit.mesh_share": (0, 1),
    "fit.mesh_deviation": (0, 2),
    "fit.free_modes": (0, 400),
    "fit.free_mm": (1e-3, 500),
    "fit.free_length_mm": (1e-3, 500),
    "fit.asymmetry": (0, 1),
    "fit.expression_spread": (1e-3, 2),
    "fit.refine_seconds": (0, 3600),
    "fit.rounds": (1, 5),
    "fit.pixel_rounds": (0, 20),
    "fit.pixel_deviation": (1e-3, 10),
    "fit.pixel_alike_mm2": (1e-2, 1e6),
    "fit.albedo_deviation": (1e-4, 3),
    "fit.outline_mm": (1e-2, 1e3),
    "points.faces": (1, 10_000_000),
    "points.held_out": (1, 1_000_000),
    "points.epochs": (1, 1_000_000),
    "points.batch": (1, 4096),
    "points.learning_rate": (_POSITIVE, 1),
    "points.trunk_share": (0, 1),
    "points.average": (0, 0.999999),
    "points.seed": (0, 2**63 - 1),
    "regressed": (1, 1_000_000),
    "joint_steps": (0, 1_000_000_000),
    "batch": (1, 4096),
    "steps": (1, 1_000_000_000),
    "weight_decay": (0, 1),
    "specular_weight": (0, _ANY),
    "deviation_weight": (0, _ANY),
    "detail_pairs": (1, 10_000),
    "doubt_faces": (1, 1_000_000),
    "score_lights": (1, 10_000),
    "epochs": (1, 1_000_000),
    "seconds": (_POSITIVE, _ANY),
    "learning_rate": (_POSITIVE, 1),
    "ema": (0, 0.999999),
    "beta1": (0, 0.999999),
    "beta2": (0, 0.999999),
    "constant_share": (0, 1),
    "rates": (1, 1000),
    "feature_weight": (0, _ANY),
    "render_weight": (0, _ANY),
    "map_weight": (0, _ANY),
    "environments": (0, 64),
    "seed": (0, 2**63 - 1),
    "log_steps": (1, 1_000_000_000),
    "save_seconds": (0, _ANY),
    "score_patches": (1, 1_000_000),
}
"""Smallest and largest value of each number; of a pair, of both, the first not above the second."""
LEAST_SHADOW_ROWS = 16
"""Rows of a grid that still has the shape of a head."""
MOST_WEIGHTS = 4e9
"""Weights of a network, at most: 16 GB of float32."""


def require_within(config: Any, where: str | Path, table: str = "") -> None:
    """Refuse a configuration whose numbers are out of bounds.

    Args:
        config: a TrainConfig, one of its tables, a FitConfig (`table` is ``fit``), a DomainConfig
            (``domain``) or a PointsConfig (``points``).
        where: what to name in an error.
        table: the name of `config` within a TrainConfig; nothing for all of it.

    Raises:
        ConfigError: a number out of its bounds, or one that does not fit the others.
    """
    if isinstance(config, TargetLight):
        _require_target(config, where, table)
        return
    for field in dataclasses.fields(config):
        name = f"{table}.{field.name}" if table else field.name
        value = getattr(config, field.name)
        if dataclasses.is_dataclass(value):
            require_within(value, where, name)
        elif value is not None and not isinstance(value, bool | str):
            _require(value, name, where)
    if isinstance(config, RandomLightConfig):
        _require_behind(config, where, table)
    if isinstance(config, WholeFaceConfig):
        _require_halvings(config, where)
    if isinstance(config, RcanConfig):
        _require_channels(config, where)
    if isinstance(config, OcclusionNetworkConfig):
        _require_blocks(config, where)
    if isinstance(config, GeneratorConfig | DiscriminatorConfig | WholeFaceConfig | RcanConfig):
        _require_size(config, where, table)
    if isinstance(config, FitConfig):
        _require_fit(config, where)
    if hasattr(config, "generator") and hasattr(config, "data"):
        _require_patch(config.data.patch_px, config.generator, where)
        _require_shadows(config.data.shadow_rows, where)
        _require_losses(config, where)
        _require_skin_alone(config.augment.beside, where)


def configured(
    kind: type[ConfigT], file: Path | None, options: Mapping[str, tuple[str, Any]], table: str
) -> ConfigT:
    """A command's configuration: its file's, and what options state in place of that.

    Args:
        kind: a FitConfig, a DomainConfig or a PointsConfig.
        file: TOML; the defaults where None.
        options: by the field, the option's name and its value; None where it was not given.
        table: of `LIMITS`. Errors do not name it: files have no such table.

    Raises:
        ConfigError: what `make_config` and `require_within` refuse; an option's by its name.
    """
    where = file or kind.__name__
    config = make_config(kind, read_toml(file) if file else {}, where)
    _require_named(config, where, table)
    for field, (option, value) in options.items():
        if value is not None:
            config = dataclasses.replace(config, **{field: value})
            _require_named(config, option, table, field)
    return config


def _require_named(config: Any, where: str | Path, table: str, named: str = "") -> None:
    """`require_within`; the error names a field by its name in a file, `named` by `where` alone."""
    try:
        require_within(config, where, table)
    except ConfigError as error:
        field = error.field.removeprefix(f"{table}.")
        raise ConfigError(
            error.where,
            field="" if field == named else field,
            found=error.found,
            expected=error.expected,
            hint=error.hint,
        ) from None


def _require(value: Any, name: str, where: str | Path) -> None:
    low, high = LIMITS[name]
    numbers = value if isinstance(value, tuple) else (value,)
    good = all(math.isfinite(n) and low <= n <= high for n in numbers)
    if not good or list(numbers) != sorted(numbers):
        least = "more than 0" if low == _POSITIVE else f"{low:g} or more"
        most = "a finite number" if high == _ANY else f"at most {high:g}"
        order = ", the smaller first" if len(numbers) > 1 else ""
        raise ConfigError(where, field=name, found=str(value), expected=f"{least}, {most}{order}")


def _require_target(light: TargetLight, where: str | Path, table: str) -> None:
    """A target light has lamps away from the head, each with a colour, of no absurd strength."""
    places, rgb = (np.array(each, float).reshape(-1, 3) for each in (light.position_mm, light.rgb))
    most, least = LIMITS["lights.lights"][1], LIMITS["lights.camera_mm"][0]
    farthest = LIMITS["lights.camera_mm"][1]
    if not 1 <= len(places) <= most or len(places) != len(rgb):
        raise ConfigError(
            where,
            field=f"{table}.position_mm",
            found=f"{counted(len(places), 'lamp')}, {counted(len(rgb), 'colour')}",
            expected=f"1 to {most:g} lamps, and a colour of each",
        )
    for name, at in (("position_mm", places), ("camera_mm", np.array([light.camera_mm]))):
        away = np.linalg.norm(at, axis=1)
        if not ((away >= least) & (away <= farthest)).all():
            raise ConfigError(
                where,
                field=f"{table}.{name}",
                found=f"a distance of {away.min():g} to {away.max():g} mm",
                expected=f"{least:g} to {farthest:g} mm from the head's origin",
            )
    low, high = 0.0, LIMITS["lights.exposure"][1]
    values = np.concatenate([rgb.ravel(), np.array(light.ambient_rgb)])
    if not ((values >= low) & (values <= high)).all():
        raise ConfigError(
            where,
            field=f"{table}.rgb",
            found=f"{values.min():g} to {values.max():g}",
            expected=f"{low:g} to {high:g}",
        )


def _require_behind(config: RandomLightConfig, where: str | Path, table: str) -> None:
    """Environments that are lit from behind alone need lights that may be there."""
    if config.backlit_share > 0 and config.behind <= 0:
        raise ConfigError(
            where,
            field=f"{table}.backlit_share",
            found=f"{config.backlit_share:g}, with {table}.behind = {config.behind:g}",
            expected="0, or lights.behind more than 0",
        )


def _require_fit(config: FitConfig, where: str | Path) -> None:
    """A texture is three rows to two columns; each size of change has a strength."""
    if config.rows % 3:
        raise ConfigError(
            where, field="fit.rows", found=str(config.rows), expected="a multiple of 3"
        )
    if len(config.free_mm) != len(config.free_length_mm):
        raise ConfigError(
            where,
            field="fit.free_length_mm",
            found=f"{len(config.free_length_mm)} distances",
            expected=f"{len(config.free_mm)}, as many as free_mm has",
        )


def _require_halvings(config: WholeFaceConfig, where: str | Path) -> None:
    """A face must halve evenly."""
    multiple = 2**config.halvings
    for name in ("rows", "columns"):
        value = getattr(config, name)
        if value % multiple:
            raise ConfigError(
                where,
                field=f"network.{name}",
                found=str(value),
                expected=f"a multiple of {multiple}",
                hint=f"The network halves a face {counted(config.halvings, 'time')}.",
            )


def _require_blocks(config: OcclusionNetworkConfig, where: str | Path) -> None:
    """Five blocks must halve the pictures evenly."""
    if config.rows % ROWS_MULTIPLE:
        raise ConfigError(
            where,
            field="occlusion.rows",
            found=str(config.rows),
            expected=f"a multiple of {ROWS_MULTIPLE} for a network",
        )


def _require_channels(config: RcanConfig, where: str | Path) -> None:
    """Some channel must be left in the attention, and each layer of upsampling doubles."""
    if config.reduction > config.width:
        raise ConfigError(
            where,
            field="network.reduction",
            found=str(config.reduction),
            expected=f"at most {config.width}, as network.width",
        )
    if config.times not in (2, 4, 8):
        raise ConfigError(
            where, field="network.times", found=str(config.times), expected="2, 4 or 8"
        )


def _require_size(config: Any, where: str | Path, table: str) -> None:
    """By the largest layers alone: a network at its narrowest place, or all of its blocks."""
    if isinstance(config, GeneratorConfig):
        widest = config.width * 2**config.downsamplings
        weights = 9.0 * widest**2 * (2 * config.global_blocks + 1)
        hint = "Lower width, downsamplings or global_blocks."
    elif isinstance(config, DiscriminatorConfig):
        weights = 16.0 * (8 * config.width) ** 2 * config.layers * config.scales
        hint = "Lower width, layers or scales."
    elif isinstance(config, WholeFaceConfig):
        # 2.5 convolutions of the widest with nine places, and a third as much at larger sizes.
        weights = (30.0 + config.heads) * (config.width * 2**config.halvings) ** 2
        hint = "Lower width, halvings or heads."
    else:
        weights = 18.0 * config.width**2 * config.groups * config.blocks
        hint = "Lower width, groups or blocks."
    if weights > MOST_WEIGHTS:
        raise ConfigError(
            where,
            field=table,
            found=f"about {weights / 1e9:.0f} thousand million weights",
            expected=f"at most {MOST_WEIGHTS / 1e9:.0f}",
            hint=hint,
        )


def _require_patch(patch_px: int, generator: GeneratorConfig, where: str | Path) -> None:
    """A patch must halve evenly down to two texels, which the blocks' padding needs."""
    multiple = generator.multiple_px
    least = max(8, 2 * multiple)
    if patch_px % multiple or patch_px < least:
        raise ConfigError(
            where,
            field="data.patch_px",
            found=str(patch_px),
            expected=f"a multiple of {multiple}, at least {least}",
            hint=f"The generator halves a patch {counted(multiple.bit_length() - 1, 'time')}.",
        )


def _require_shadows(rows: int, where: str | Path) -> None:
    """A head of a few rows is all in its own shadow, or casts none."""
    if 0 < rows < LEAST_SHADOW_ROWS:
        raise ConfigError(
            where,
            field="data.shadow_rows",
            found=str(rows),
            expected=f"0 for no shadows, or {LEAST_SHADOW_ROWS} or more",
        )


def _require_skin_alone(beside: float, where: str | Path) -> None:
    """Patches show nothing but skin, so that what else a person has cannot differ in them."""
    if beside:
        raise ConfigError(
            where,
            field="augment.beside",
            found=f"{beside:g}",
            expected="0 for networks of patches, which are shown skin alone",
            hint="Leave it out; whole faces have eyes and hair.",
        )


def _require_losses(config: Any, where: str | Path) -> None:
    """Some loss must compare with the truth, and each that has a weight must be defined."""
    names = ("feature_weight", "render_weight", "map_weight")
    weights = [name for name in names if hasattr(config, name)]
    if not any(getattr(config, name) > 0 for name in weights):
        raise ConfigError(
            where,
            field=", ".join(weights),
            found="0 each",
            expected="at least one above 0",
            hint="The adversarial loss alone does not require the maps of the person shown.",
        )
