"""Numbers of a training's configuration: every one has bounds, and what is out of them is named."""

import dataclasses
import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from learning.domain.config import DomainConfig
from learning.four.config import FourTrainConfig
from learning.limits import LIMITS, require_within
from learning.mesostructure.config import MesostructureTrainConfig
from learning.networks.generator import GeneratorConfig
from learning.patch_config import TrainConfig
from learning.photo.config import FitConfig
from learning.points.config import PointsConfig
from learning.presets import PRESETS, preset
from learning.render.occlusion_training import OcclusionTrainConfig
from learning.upscale.config import UpscaleTrainConfig
from learning.whole.config import WholeTrainConfig
from lightstage.errors import ConfigError

CONFIGS = (
    TrainConfig(),
    FourTrainConfig(),
    WholeTrainConfig(),
    UpscaleTrainConfig(),
    MesostructureTrainConfig(),
    OcclusionTrainConfig(),
)


def named_numbers(config, table=""):
    """Every number of a configuration by its dotted name."""
    found = {}
    for field in dataclasses.fields(config):
        value, name = getattr(config, field.name), f"{table}{field.name}"
        if dataclasses.is_dataclass(value):
            found |= named_numbers(value, f"{name}.")
        elif not isinstance(value, (bool, str)) and name != "lights.target":
            # A target light has bounds as a whole: see learning/domain/test_domain.py.
            found[name] = value
    return found


def changed(config, name, value):
    head, _, rest = name.partition(".")
    inner = changed(getattr(config, head), rest, value) if rest else value
    return dataclasses.replace(config, **{head: inner})


ALL = [
    *((config, "") for config in CONFIGS),
    (FitConfig(), "fit"),
    (DomainConfig(), "domain"),
    (PointsConfig(), "points"),
]
"""Each configuration, and its name in the table of bounds."""


def numbers_of(config, table):
    return named_numbers(config, f"{table}." if table else "")


def test_every_number_has_bounds_and_every_bound_a_number():
    assert {name for each in ALL for name in numbers_of(*each)} == set(LIMITS)


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_is_within_its_bounds(name):
    require_within(preset(name, {}, "test"), "test")


@pytest.mark.parametrize("name", LIMITS)
def test_a_number_out_of_bounds_is_named_with_its_bounds(name):
    low, high = LIMITS[name]
    known = [each for each in ALL if name in numbers_of(*each)]
    wrongs = [low - 1, high * 2 + 1, math.nan, math.inf, -math.inf]
    for (config, table), wrong in itertools.product(known, wrongs):
        value = (wrong, wrong) if isinstance(numbers_of(config, table)[name], tuple) else wrong
        own = name.removeprefix(f"{table}.") if table else name
        with pytest.raises(ConfigError) as raised:
            require_within(changed(config, own, value), "run.toml", table)
        assert raised.value.field == name
        assert raised.value.where == "run.toml"
        assert "expected" in str(raised.value)


def test_a_pair_whose_first_is_larger_is_refused():
    with pytest.raises(ConfigError, match=r"lights.exposure: found \(2.0, 1.0\).*smaller first"):
        require_within(changed(TrainConfig(), "lights.exposure", (2.0, 1.0)), "run.toml")


@given(st.integers(1, 600), st.integers(1, 6), st.booleans())
def test_a_patch_is_taken_exactly_where_the_generator_takes_it(patch_px, downsamplings, enhancer):
    import torch

    from learning.networks.generator import IN_CHANNELS, Generator

    small = GeneratorConfig(2, downsamplings, 1, 1, enhancer)
    config = changed(changed(TrainConfig(), "generator", small), "data.patch_px", patch_px)
    with torch.device("meta"):
        network = Generator(small)
        try:
            size = network(torch.zeros(1, IN_CHANNELS, patch_px, patch_px)).shape[2:]
            works = tuple(size) == (patch_px, patch_px)
        except (RuntimeError, ValueError):
            works = False
    if works and patch_px >= 8:
        require_within(config, "run.toml")
    else:
        with pytest.raises(ConfigError, match="patch_px"):
            require_within(config, "run.toml")


@pytest.mark.parametrize(
    ("name", "table", "size"),
    [
        ("paper", "generator", {"width": 1024, "downsamplings": 8}),
        ("demo", "discriminator", {"width": 1024, "layers": 8, "scales": 8}),
        ("modern", "network", {"width": 512, "halvings": 6, "rows": 960, "columns": 640}),
        ("rcan", "network", {"width": 512, "groups": 64, "blocks": 256}),
    ],
)
def test_a_network_that_no_machine_holds_is_refused_before_it_is_built(name, table, size):
    with pytest.raises(ConfigError, match=f"{table}: found about .* thousand million weights"):
        preset(name, {table: size}, "run.toml")


def test_shadows_are_baked_on_as_many_rows_as_a_head_needs_or_not_at_all():
    for rows in (1, 15):
        with pytest.raises(ConfigError, match=f"data.shadow_rows: found {rows}, expected 0 for no"):
            preset("demo", {"data": {"shadow_rows": rows}}, "run.toml")
    for rows in (0, 16):
        preset("demo", {"data": {"shadow_rows": rows}}, "run.toml")


def test_networks_of_patches_refuse_a_variation_of_eyes_and_hair_that_they_are_never_shown():
    for name in ("demo", "avatarme"):
        with pytest.raises(ConfigError, match=r"augment.beside: found 0.5, expected 0 for"):
            preset(name, {"augment": {"beside": 0.5}}, "run.toml")
    assert preset("modern", {"augment": {"beside": 0.5}}, "run.toml").augment.beside == 0.5


def test_a_rendering_loss_may_have_no_environment_but_the_input_s_own():
    assert preset("demo", {"environments": 0}, "run.toml").draws == 0
    assert preset("demo", {"environments": 0, "render_weight": 0.0}, "run.toml").draws == 0


def test_a_training_that_no_loss_ties_to_the_truth_is_refused():
    nothing = {"feature_weight": 0.0, "render_weight": 0.0, "map_weight": 0.0}
    with pytest.raises(ConfigError, match=r"feature_weight, render_weight, map_weight: found 0"):
        preset("demo", nothing, "run.toml")
    for name in nothing:
        preset("demo", {**nothing, name: 1.0}, "run.toml")
