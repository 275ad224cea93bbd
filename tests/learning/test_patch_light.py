"""The light of patches: around a target, with its own shadows, in the input and the losses."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from learning.augment import AugmentConfig
from learning.data import DataConfig, PatchData
from learning.losses import rendering_loss
from learning.patch_config import TrainConfig
from learning.patch_light import ScanLight, Scene, groups_around, target_environment
from learning.presets import preset
from learning.render.environments import (
    Environment,
    RandomLightConfig,
    random_environment,
    random_lights,
)
from learning.render.occlusion import PositionGrid
from learning.render.shading import ShadeOptions, shade
from processing.dataset import open_store
from tests.learning.conftest import RADIUS_MM

DATA = DataConfig(
    patch_px=32, stride_px=32, patches_in_memory=16, shadow_rows=24, shadow_sets=3, relative=True
)
LIGHTS = RandomLightConfig()
EVERYTHING = (0.0, 0.0, 1.0, 1.0)


def patches(
    store_path: Path, config: DataConfig = DATA, people: tuple[str, ...] = ("person-0",), seed=4
) -> PatchData:
    store, rng = open_store(store_path), np.random.default_rng(len(people))
    return PatchData(store, set(people), config, LIGHTS, AugmentConfig(), rng, draws=2, seed=seed)


def how_far(found: Environment, target: Environment) -> dict[str, float]:
    """Largest moves relative to the target's distances and intensities."""
    far = (found.position_mm - target.position_mm).norm(dim=-1) / target.position_mm.norm(dim=-1)
    camera = (found.camera_mm - target.camera_mm).norm(dim=-1) / target.camera_mm.norm(dim=-1)
    return {
        "position": float(far.max()),
        "intensity": float((found.rgb / target.rgb - 1).abs().max()),
        "camera": float(camera.max()),
    }


def test_the_papers_inputs_and_draws_lie_around_one_target(store_path: Path) -> None:
    paper = preset("paper", {}, "test")
    assert isinstance(paper, TrainConfig)
    assert paper.data.target == "one"
    target = target_environment(LIGHTS, "physical", 4)
    assert target.rgb.shape == (1, LIGHTS.lights, 3)
    seen = []
    for people in (("person-0", "person-1"), ("person-2",)):
        data = patches(store_path, people=people)
        for step in range(8):
            batch = data.draw(1, np.random.default_rng(step))
            assert len(batch.draws) == 2
            for found in (batch.environment, *(scene.environment for scene in batch.draws)):
                far = how_far(found, target)
                assert far["position"] <= 0.5 + 1e-5
                assert far["intensity"] <= 0.25 + 1e-5
                assert far["camera"] <= 0.25 + 1e-5
                seen.append(far["position"])
    assert max(seen) > 0.3
    assert min(seen) > 0.01
    other = target_environment(LIGHTS, "physical", 5)
    assert how_far(target, other)["position"] > 0.1


def test_each_set_may_have_a_target_of_its_own() -> None:
    rng = np.random.default_rng(0)
    groups = groups_around(None, 20, 3, LIGHTS, rng)
    assert len(groups) == 20
    for group in groups:
        assert len(group.sets_mm) == 4
        distance = np.linalg.norm(group.target_mm, axis=1)
        for places in group.sets_mm:
            assert places.shape == group.target_mm.shape
            far = np.linalg.norm(places - group.target_mm, axis=1) / distance
            assert 0 < far.max() <= 0.5 + 1e-9
    first = np.array([group.target_mm[0] for group in groups])
    assert np.ptp(first / np.linalg.norm(first, axis=1, keepdims=True), axis=0).min() > 0.5
    # No target is drawn for one that is given; a set more than there are is the first again.
    target = target_environment(LIGHTS, "physical", 0)
    (group,) = groups_around(target, 2, 3, LIGHTS, rng)
    chosen, sets = ScanLight([group], None).draw(rng, 4)
    assert chosen == 0
    assert sorted(sets[:2]) == [0, 1]
    assert sets[2:] == sets[:2]


@pytest.mark.parametrize("target", ["one", "each"])
def test_every_environment_has_the_shadows_of_its_own_lights(store_path: Path, target: str) -> None:
    config = dataclasses.replace(DATA, target=target, shadow_rows=96)
    data = patches(store_path, config)
    checked = 0
    for step in range(6):
        batch = data.draw(1, np.random.default_rng(step))
        position = batch.skin.position_mm[0].double().numpy()
        radius = np.linalg.norm(position, axis=0).mean()
        assert radius == pytest.approx(RADIUS_MM, rel=0.15)
        for scene in (Scene(batch.environment, batch.visibility), *batch.draws):
            lights = scene.environment.position_mm[0]
            for light, seen in zip(lights, scene.visibility[0], strict=True):
                # On a ball a light is seen where it is above the horizon.
                toward = light.double().numpy()[:, None, None] - position
                cosine = (toward * position).sum(axis=0)
                cosine /= radius * np.linalg.norm(toward, axis=0)
                found = seen.numpy()
                inner = np.zeros_like(cosine, bool)
                inner[3:-3, 3:-3] = True
                assert found[inner & (cosine > 0.3)].min(initial=1) > 0.99
                assert found[inner & (cosine < -0.3)].max(initial=0) < 0.01
                checked += int((cosine < -0.3).any())
    assert checked > 3


def test_what_lies_in_the_inputs_shadow_has_no_part_in_the_rendering_loss(
    store_path: Path,
) -> None:
    batch = patches(store_path).draw(1, np.random.default_rng(1))
    lights = dataclasses.replace(batch.environment, ambient_rgb=torch.zeros(1, 3))
    half = torch.ones_like(batch.visibility)
    half[..., 16:] = 0
    matte = dataclasses.replace(batch.skin, translucency=torch.zeros_like(batch.skin.translucency))
    shadowed = dataclasses.replace(
        batch, skin=matte, environment=lights, visibility=half, draws=(Scene(lights, half),)
    )
    wrong = {}
    for name, columns in (("shadow", slice(16, None)), ("light", slice(0, 16))):
        found = batch.target.clone()
        found[:, :3, :, columns] = -0.9
        wrong[name] = float(rendering_loss(found, shadowed, "patch"))
    nothing = float(rendering_loss(batch.target, shadowed, "patch"))
    assert wrong["shadow"] == pytest.approx(nothing, abs=1e-5)
    assert wrong["light"] > nothing + 0.1
    # Seen by all lights, as the loss was before, the shadowed half counts.
    lit = dataclasses.replace(shadowed, visibility=torch.ones_like(half))
    found = batch.target.clone()
    found[:, :3, :, 16:] = -0.9
    assert float(rendering_loss(found, lit, "patch")) > nothing + 0.1


def test_the_input_is_shaded_with_the_batchs_own_shadows(store_path: Path) -> None:
    batch = patches(store_path).draw(2, np.random.default_rng(2))
    expected = shade(batch.skin, batch.environment, ShadeOptions(), batch.visibility)
    torch.testing.assert_close(batch.texture, expected * batch.covered)
    without = shade(batch.skin, batch.environment, ShadeOptions())
    assert not torch.allclose(batch.texture, without * batch.covered, atol=1e-3)


def grooves(rows: int = 40, columns: int = 60) -> PositionGrid:
    """A plane of 2 mm texels with grooves 24 mm apart and 24 mm deep, toward +z."""
    y, x = np.mgrid[:rows, :columns] * 2.0
    phase = 2 * np.pi * x / 24.0
    z = 12.0 * np.cos(phase)
    normal = np.stack([np.pi * np.sin(phase), np.zeros_like(x), np.ones_like(x)], axis=-1)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    return PositionGrid(np.stack([x, -y, z], axis=-1), normal, np.ones((rows, columns), bool))


def test_grooves_get_less_of_the_ambient_light() -> None:
    rng = np.random.default_rng(0)
    groups = groups_around(None, 1, 0, LIGHTS, rng)
    found = ScanLight(groups, grooves()).openness(EVERYTHING, 60)[0, 0]
    ridges, bottoms = found[20:40, 12:48:12], found[20:40, 18:48:12]
    assert float(ridges.min()) > 0.9
    assert float(bottoms.max()) < 0.6
    none = ScanLight(groups, None)
    assert torch.equal(none.openness(EVERYTHING, 8), torch.ones(1, 1, 8, 8))
    assert torch.equal(none.shadows(0, 0, EVERYTHING, 8, 1.0).unique(), torch.ones(1))


def test_ambient_occlusion_darkens_the_training_pictures(store_path: Path) -> None:
    data = patches(store_path)
    data._lights = RandomLightConfig(ambient_share=(0.5, 0.5))
    data._target = target_environment(data._lights, "physical", 0)
    bright = data.batch([data.places[0]], np.random.default_rng(0))
    assert float(bright.skin.ambient_occlusion.min()) > 0.8
    (light,) = data._light.values()
    assert light.open is not None
    light.open = 0.2 * torch.ones_like(light.open)
    dark = data.batch([data.places[0]], np.random.default_rng(0))
    torch.testing.assert_close(dark.skin.ambient_occlusion, torch.full((1, 1, 32, 32), 0.2))
    assert float(dark.texture.mean()) < 0.9 * float(bright.texture.mean())


def test_random_lights_are_as_many_as_asked_for() -> None:
    rng = np.random.default_rng(0)
    assert {len(random_lights(rng, LIGHTS)) for _ in range(50)} == {1, 2, 3}
    assert {len(random_lights(rng, LIGHTS, 3)) for _ in range(20)} == {3}


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_a_share_of_the_environments_is_lit_from_behind_alone(share: float) -> None:
    config = RandomLightConfig(behind=0.6, backlit_share=share)
    rng, count = np.random.default_rng(0), 1000
    drawn = [random_lights(rng, config, 2) for _ in range(count)]
    depth = np.array([places[:, 2] / np.linalg.norm(places, axis=1) for places in drawn])
    assert depth.min() >= -0.6 - 1e-12
    # Two of any place are both behind in (.6 / 1.6) squared of all draws.
    expected = share + (1 - share) * (0.6 / 1.6) ** 2
    assert abs((depth < 0).all(axis=1).mean() - expected) < 4 * (0.25 / count) ** 0.5


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_a_share_of_the_environments_has_no_ambient_light_and_the_same_exposure(
    share: float,
) -> None:
    exposure = (0.5, 0.500001)
    config = RandomLightConfig(unfilled_share=share, exposure=exposure, ambient_share=(0.2, 0.4))
    rng, count = np.random.default_rng(0), 400
    place = np.array([[0.0, 0.0, 1000.0]])
    drawn = [random_environment(rng, config, place) for _ in range(count)]
    ambient = np.array([each.ambient_rgb.mean().item() for each in drawn])
    assert abs((ambient == 0).mean() - share) < 4 * (0.25 / count) ** 0.5
    plain = dataclasses.replace(config, tint=0.0)
    even = [random_environment(rng, plain, place) for _ in range(20)]
    total = [float((each.rgb[0, 0] + each.ambient_rgb[0]).mean()) for each in even]
    np.testing.assert_allclose(total, 0.5, atol=1e-5)
