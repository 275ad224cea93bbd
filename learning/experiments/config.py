"""How large an experiment is: its people, seeds, steps and networks."""

from __future__ import annotations

import dataclasses
from typing import Any

from lightstage.errors import ConfigError
from lightstage.formats.config import make_config, require_bounds


@dataclasses.dataclass(frozen=True)
class ExperimentConfig:
    """The size of an experiment; the defaults are those of `small`.

    Attributes:
        published: whether networks, losses and rates are those of the presets `paper` and
            `avatarme` in place of `demo` and `avatarme-small`; then `epochs` holds in place of
            `steps`, which may only be 0, and values of `SMALL_ONLY` are refused.
        steps: number of steps of each training of equal steps; 0 for none of these.
        seconds: seconds of the steps of each training of equal time; 0 for none of these.
        epochs: number of epochs, in place of `steps`, with `published`; refused without it.
        seeds: number of trainings of each setting, which differ by their seed alone.
        people: number of people trained on, at most; 0 for all that are not held out.
        held_out: number of people who are measured and never trained on, the last ones by name.
        held_out_names: names of the people held out, in place of `held_out`.
        train_names: names of the people trained on, in place of all others.
        environments: number of lights in which the people held out are measured, from the first of
            `learning.experiments.lights.NAMES` on; of 2 to 6 the last one is the lamp from the
            right, `side-right`, in place of the name that is there.
        patch_px: side of a patch; the blur of the texture's contrast grows with it.
        width: channels of the generators.
        discriminator_width: channels of the discriminators.
        batch: number of patches of one step.
        whole_width: channels of the whole-face network.
        whole_batch: number of faces of one step.
        shadow_sets: number of sets of lights of each scan whose shadows are baked.
        shadow_rows: rows of the grid on which shadows are baked.
        render_weight: weight of the rendering loss, over a patch's norm.
        refine_seconds: seconds of the refinement of one texture, at most.
        save_seconds: seconds between two checkpoints of a training.
    """

    published: bool = False
    steps: int = 600
    seconds: float = 60.0
    epochs: int = 200
    seeds: int = 5
    people: int = 0
    held_out: int = 5
    held_out_names: tuple[str, ...] = ()
    train_names: tuple[str, ...] = ()
    environments: int = 10
    patch_px: int = 64
    width: int = 16
    discriminator_width: int = 8
    batch: int = 2
    whole_width: int = 16
    whole_batch: int = 4
    shadow_sets: int = 16
    shadow_rows: int = 96
    render_weight: float = 0.3
    refine_seconds: float = 20.0
    save_seconds: float = 20.0


BOUNDS: dict[str, tuple[float, float]] = {
    "steps": (0, 1_000_000_000),
    "seconds": (0, 1e9),
    "epochs": (1, 1_000_000),
    "seeds": (1, 1000),
    "people": (0, 1_000_000),
    "held_out": (1, 1_000_000),
    "environments": (1, 10),
    "patch_px": (16, 8192),
    "width": (2, 1024),
    "discriminator_width": (1, 1024),
    "batch": (1, 4096),
    "whole_width": (2, 512),
    "whole_batch": (1, 4096),
    "shadow_sets": (1, 100_000),
    "shadow_rows": (16, 8192),
    "render_weight": (1e-6, 1e6),
    "refine_seconds": (0.1, 3600),
    "save_seconds": (0, 1e9),
}
"""Least and largest value of each number."""
SMALL_ONLY = (
    "patch_px",
    "width",
    "discriminator_width",
    "batch",
    "whole_width",
    "whole_batch",
    "shadow_sets",
)
"""Sizes that the published networks and `modern` have of their presets where `published` is set."""
SIZES: dict[str, dict[str, Any]] = {
    "tiny": {
        "steps": 2,
        "seconds": 0.0,
        "seeds": 1,
        "held_out": 1,
        "environments": 2,
        "patch_px": 32,
        "width": 2,
        "discriminator_width": 2,
        "whole_width": 2,
        "whole_batch": 1,
        "shadow_sets": 1,
        "shadow_rows": 32,
        "refine_seconds": 1.0,
    },
    "demo": {
        "steps": 150,
        "seconds": 60.0,
        "seeds": 1,
        "held_out": 2,
        "environments": 4,
        "shadow_sets": 8,
    },
    "small": {},
    "full": {"published": True, "steps": 1, "seconds": 0.0},
}
"""Named sizes: to try the command, for minutes and for hours of two cores, and as published."""


def sized(size: str, overrides: dict[str, Any], where: str) -> ExperimentConfig:
    """A named size with some values changed.

    Args:
        size: of `SIZES`.
        overrides: by name.
        where: what to name in errors.

    Raises:
        ConfigError: an unknown size or key, a value out of bounds, one that no training of the
            experiment has, or no training at all.
    """
    if size not in SIZES:
        raise ConfigError("--size", found=repr(size), expected=f"one of {', '.join(SIZES)}")
    config = make_config(ExperimentConfig, {**SIZES[size], **overrides}, where)
    require_bounds(config, where, BOUNDS)
    if config.published:
        _refuse_small(config, overrides, where)
    elif "epochs" in overrides:
        raise ConfigError(
            where,
            field="epochs",
            found=str(config.epochs),
            expected="no value without published networks, which alone are trained for epochs",
            hint="Set steps, or choose --size full.",
        )
    if not config.steps and not config.seconds:
        raise ConfigError(
            where,
            field="steps, seconds",
            found="0 each",
            expected="at least one above 0",
            hint="Trainings are compared at equal steps, at equal time, or both.",
        )
    return config


def effective(values: dict[str, Any]) -> dict[str, Any]:
    """Those values of an experiment by name that change its trainings.

    Args:
        values: of an `ExperimentConfig`, by name.
    """
    if not values.get("published"):
        return {name: value for name, value in values.items() if name != "epochs"}
    found = {name: value for name, value in values.items() if name not in SMALL_ONLY}
    return {**found, "steps": bool(found.get("steps"))}


def _refuse_small(config: ExperimentConfig, overrides: dict[str, Any], where: str) -> None:
    """Refuse values that trainings of published networks do not have."""
    unused = [name for name in SMALL_ONLY if name in overrides]
    if unused:
        raise ConfigError(
            where,
            field=", ".join(unused),
            found="a value",
            expected="none with published networks, which have sizes of their own",
            hint="Leave it out, or choose another --size.",
        )
    if overrides.get("steps"):
        raise ConfigError(
            where,
            field="steps",
            found=str(config.steps),
            expected="0 or no value with published networks, which are trained for epochs",
            hint="Set epochs, or choose another --size.",
        )
    if "epochs" in overrides and not config.steps:
        raise ConfigError(
            where,
            field="epochs",
            found=f"{config.epochs}, and 0 steps",
            expected="no value where steps is 0, as trainings of equal time have no epochs",
            hint="Leave out one of the two.",
        )
