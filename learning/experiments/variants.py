"""What each experiment compares: settings, of which neighbours differ by one thing."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, Literal

from learning.config import TrainingConfig
from learning.experiments.config import ExperimentConfig
from learning.presets import preset

Without = Literal["", "any", "lightest", "darkest"]
STEPS, TIME = "steps", "time"
"""What the trainings that are compared have in common."""
DETAIL_SHARE = 24 / 128
"""Blur of the texture's contrast over a patch's side, as the preset `demo` has them."""


@dataclasses.dataclass(frozen=True)
class Variant:
    """One setting.

    Attributes:
        name: in folders.
        title: in tables.
        preset: that is trained.
        overrides: of the preset's values, nested.
        paper: mean squared error that the paper has for this step of its ladder [Lattas2021].
        refines: the setting whose network's answer is refined: nothing is trained.
        people: trained on, at most; 0 as the experiment has it.
        without: the quarter of the people that is not trained on: by tone, or drawn by the seed.
        against: the setting that it is compared with; the one before it where empty.
    """

    name: str
    title: str
    preset: str
    overrides: dict[str, Any]
    paper: float | None = None
    refines: str = ""
    people: int = 0
    without: Without = ""
    against: str = ""


@dataclasses.dataclass(frozen=True)
class Experiment:
    """Settings that are compared.

    Attributes:
        title: of its report.
        across: name of the curve's axis; nothing where there is no curve.
        variants: in order; each is compared with the one before it, or the one that it names.
        budgets: of `STEPS` and `TIME`, those of the experiment where both are possible.
    """

    title: str
    across: str
    variants: tuple[Variant, ...]
    budgets: tuple[str, ...] = (STEPS, TIME)


CONTROL = "three-quarters"
"""As many people as those settings have that leave a quarter out by tone."""
LAST_PUBLISHED = "occlusion"
"""The last step of the published ladder."""
MODERN, REFINED = "modern", "modern-refined"


def ladder(config: ExperimentConfig) -> Experiment:
    """The published order [Lattas2021], and this project's network beside it."""
    plain = {"whole": False, "shadow_rows": 0}
    lit = {"render_weight": config.render_weight}
    whole = {"shadow_rows": 0}
    rungs = (
        _four(config, "four", "four networks", {"data": plain}, 0.0079),
        _single(config, "single", "single network", _plain(plain), 0.0080),
        _single(config, "rendering", "+ rendering loss", _drawn(plain, 0, lit), 0.0075),
        _single(config, "whole", "+ whole texture", _drawn(whole, 0, lit), 0.0066),
        _single(config, "random", "+ random environment", _drawn(whole, 1, lit), 0.0055),
        _single(config, "several", "+ several environments", _drawn(whole, 3, lit), 0.0048),
        _single(config, LAST_PUBLISHED, "+ occlusion", _drawn({}, 3, lit), 0.0043),
        _modern(config),
        dataclasses.replace(
            _modern(config), name=REFINED, title="`modern`, refined", refines=MODERN
        ),
    )
    return Experiment("The ladder", "", rungs)


def weights(config: ExperimentConfig) -> Experiment:
    """The rendering loss's weight, from 0 to 3."""
    return Experiment(
        "Weight of the rendering loss",
        "weight of the rendering loss",
        tuple(
            _single(
                config,
                f"lambda-{value:g}",
                f"{value:g}",
                _drawn({}, 3, {"render_weight": value}) if value else _plain({}),
            )
            for value in (0.0, 0.1, 0.3, 1.0, 3.0)
        ),
        (STEPS,),
    )


def environments(config: ExperimentConfig) -> Experiment:
    """Environments of the rendering loss, n_L."""
    lit = {"render_weight": config.render_weight}
    return Experiment(
        "Environments of the rendering loss",
        "environments of the rendering loss, n_L",
        tuple(
            _single(config, f"n-{count}", str(count), _drawn({}, count, lit)) for count in (1, 2, 3)
        ),
    )


def scenes(config: ExperimentConfig) -> Experiment:
    """How much the environments of a training differ from its target."""
    lit = {"render_weight": config.render_weight}
    found = []
    for position, camera, intensity in ((0, 0, 0), (50, 25, 25), (75, 50, 50)):
        spread = {
            "position_spread": position / 100,
            "camera_spread": camera / 100,
            "intensity_spread": intensity / 100,
        }
        name = f"{position}/{camera}/{intensity}"
        overrides = {**_drawn({}, 3, lit), "lights": spread}
        found.append(_single(config, f"scene-{position}", name, overrides))
    return Experiment(
        "Variation of the scene",
        "lamps' places, % of their distance",
        tuple(found),
        (STEPS,),
    )


def encodings(config: ExperimentConfig) -> Experiment:
    """Colours as they are, or relative to the lit texture's."""
    lit = {"render_weight": config.render_weight}
    absolute = {"relative": False, "detail_px": 0.0}
    no_detail = {"relative": True, "detail_px": 0.0}
    full = {"relative": True, "detail_px": _detail_px(config)}
    return Experiment(
        "Encoding of colours",
        "encoding",
        (
            _single(config, "absolute", "absolute, as published", _drawn(absolute, 3, lit)),
            _single(config, "relative", "relative to the texture", _drawn(no_detail, 3, lit)),
            _single(config, "contrast", "relative, with its contrast", _drawn(full, 3, lit)),
        ),
        (STEPS,),
    )


def norms(config: ExperimentConfig) -> Experiment:
    """The rendering loss's norm, which the paper does not state."""
    lit = {"render_weight": config.render_weight}
    texels = {**lit, "render_norm": "texel"}
    # A patch's norm of even errors is the texels' times the patch's side.
    equal = {**texels, "render_weight": config.render_weight * _patch_px(config)}
    return Experiment(
        "Norm of the rendering loss",
        "norm",
        (
            _single(config, "patch", "over the patch", _drawn({}, 3, lit)),
            _single(config, "texel", "mean over texels", _drawn({}, 3, texels)),
            _single(config, "texel-equal", "over texels, weighed alike", _drawn({}, 3, equal)),
        ),
        (STEPS,),
    )


def seeds(config: ExperimentConfig) -> Experiment:
    """The last published step, seed after seed: the spread that all else is held against."""
    lit = {"render_weight": config.render_weight}
    one = _single(config, LAST_PUBLISHED, "the last published step", _drawn({}, 3, lit))
    return Experiment("Spread over seeds", "", (one, _modern(config)), (STEPS,))


def people(config: ExperimentConfig) -> Experiment:
    """How many people are trained on, and whose tones are not among them.

    Fewer people differ in more than their tones, so that those without the lightest or the darkest
    quarter are compared with as many of all tones.
    """
    lit = {"render_weight": config.render_weight}
    found: list[Variant] = []
    for count in (8, 32, 128):
        one = _single(config, f"people-{count}", str(count), _drawn({}, 3, lit))
        found.append(dataclasses.replace(one, people=count))
    control = _single(config, CONTROL, "three quarters of all tones", _drawn({}, 3, lit))
    found.append(dataclasses.replace(control, without="any"))
    for without in ("lightest", "darkest"):
        one = _single(config, f"no-{without}", f"without the {without}", _drawn({}, 3, lit))
        found.append(dataclasses.replace(one, without=without, against=CONTROL))
    return Experiment("People trained on", "people", tuple(found), (STEPS,))


EXPERIMENTS: dict[str, Callable[[ExperimentConfig], Experiment]] = {
    "ladder": ladder,
    "lambda": weights,
    "n_L": environments,
    "scene": scenes,
    "encoding": encodings,
    "norm": norms,
    "seeds": seeds,
    "people": people,
}


def training_of(
    variant: Variant, config: ExperimentConfig, budget: str, seed: int, held_out: int
) -> TrainingConfig:
    """The training of one setting.

    Args:
        variant: the setting.
        config: size of the experiment.
        budget: `STEPS` or `TIME`.
        seed: of the training.
        held_out: people, the last ones of the store by name.
    """
    overrides = {**variant.overrides, "seed": seed, "save_seconds": config.save_seconds}
    # Compiling takes longer than many of these trainings do; figures of all devices compare.
    overrides |= {"compile": "off", "precision": "float32"}
    table = "faces" if variant.preset == "modern" else "data"
    overrides[table] = {**overrides.get(table, {}), "held_out_subjects": held_out}
    if budget == TIME:
        overrides["seconds"] = config.seconds
    elif not config.published:
        overrides |= {"seconds": None, "steps": config.steps}
    return preset(variant.preset, overrides, f"setting {variant.name}")


def _plain(data: dict[str, Any]) -> dict[str, Any]:
    return {"data": data, "render_weight": 0.0, "environments": 0}


def _drawn(data: dict[str, Any], count: int, lit: dict[str, Any]) -> dict[str, Any]:
    """With the rendering loss, in the input's environment and in `count` others."""
    return {"data": data, "render_norm": "patch", **lit, "environments": count}


def _single(
    config: ExperimentConfig,
    name: str,
    title: str,
    overrides: dict[str, Any],
    paper: float | None = None,
) -> Variant:
    chosen = "paper" if config.published else "demo"
    return Variant(name, title, chosen, _patches(config, overrides), paper)


def _four(
    config: ExperimentConfig, name: str, title: str, overrides: dict[str, Any], paper: float
) -> Variant:
    chosen = "avatarme" if config.published else "avatarme-small"
    return Variant(name, title, chosen, _patches(config, overrides), paper)


def _patches(config: ExperimentConfig, overrides: dict[str, Any]) -> dict[str, Any]:
    """Values of a training on patches, with the experiment's sizes beneath them."""
    data: dict[str, Any] = {"target": "one"}
    if config.published:
        return {
            **overrides,
            "epochs": config.epochs,
            "data": {**data, **overrides["data"]},
        }
    data |= {
        "patch_px": config.patch_px,
        "stride_px": config.patch_px // 2,
        "detail_px": _detail_px(config),
        "shadow_rows": config.shadow_rows,
        "shadow_sets": config.shadow_sets,
    }
    return {
        "generator": {"width": config.width},
        "discriminator": {"width": config.discriminator_width},
        "batch": config.batch,
        "score_patches": 4,
        **overrides,
        "data": {**data, **overrides["data"]},
    }


def _modern(config: ExperimentConfig) -> Variant:
    overrides: dict[str, Any] = {
        "network": {"width": config.whole_width},
        "faces": {"shadow_sets": config.shadow_sets},
        "batch": config.whole_batch,
        "doubt_faces": 16 * config.whole_batch,
        "detail_pairs": 4,
        "score_lights": 1,
    }
    overrides = {} if config.published else overrides
    return Variant(MODERN, "`modern`, network alone", "modern", overrides)


def _detail_px(config: ExperimentConfig) -> float:
    return 0.0 if config.published else DETAIL_SHARE * config.patch_px


def _patch_px(config: ExperimentConfig) -> int:
    return 512 if config.published else config.patch_px


def budgets(config: ExperimentConfig, experiment: Experiment) -> tuple[str, ...]:
    """What the trainings of an experiment are compared at."""
    asked = {STEPS: config.steps > 0, TIME: config.seconds > 0}
    found = tuple(budget for budget in experiment.budgets if asked[budget])
    return found or tuple(budget for budget in (STEPS, TIME) if asked[budget])
