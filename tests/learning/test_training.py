from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from learning import augment
from learning.checkpoint import load_generator
from learning.data import DataConfig, PatchData
from learning.encoding import (
    decode_colour,
    decode_maps,
    encode_colour,
    encode_maps,
    local_contrast,
    turn,
)
from learning.errors import TrainingError
from learning.losses import RenderNorm, maps_loss, rendering_loss
from learning.networks.discriminator import DiscriminatorConfig
from learning.networks.generator import Generator, GeneratorConfig
from learning.patch_config import TrainConfig
from learning.patch_light import Scene, sampled
from learning.patch_train import PatchTrainer
from learning.presets import PRESETS, preset
from learning.render.environments import (
    RandomLightConfig,
    around,
    random_environment,
    random_lights,
)
from learning.render.shading import ShadeOptions, shade, unit
from learning.run import split
from learning.score import answers_of, score
from learning.train import train
from lightstage.errors import ConfigError
from processing.dataset import open_store

TINY = TrainConfig(
    generator=GeneratorConfig(width=8, downsamplings=2, global_blocks=1, local_blocks=1),
    discriminator=DiscriminatorConfig(width=4, scales=2),
    data=DataConfig(
        patch_px=32,
        stride_px=32,
        patches_in_memory=16,
        shadow_rows=24,
        shadow_sets=2,
        relative=True,
    ),
    batch=2,
    epochs=1,
    learning_rate=2e-3,
    map_weight=10.0,
    environments=1,
    shading="physical",
    log_steps=1,
    score_patches=4,
)


def patches(store_path: Path, config: DataConfig = TINY.data, draws: int = 0) -> PatchData:
    store = open_store(store_path)
    people = {scan.subject for scan in store.scans}
    rng = np.random.default_rng(0)
    return PatchData(store, people, config, TINY.lights, TINY.augment, rng, draws=draws)


def test_a_pair_is_the_store_relit(store_path: Path) -> None:
    data = patches(store_path)
    assert len(data.places) == 3 * 6
    place = data.places[3]
    batch = data.batch([place], np.random.default_rng(1))
    assert batch.inputs.shape == (1, 9, 32, 32)
    assert batch.target.shape == (1, 13, 32, 32)
    scan, row, column = place
    store = open_store(store_path)
    truth = store.read(scan, "diffuse_albedo", slice(row, row + 32), slice(column, column + 32))
    found = decode_colour(batch.target[:, :3], batch.reference.albedo)[0].permute(1, 2, 0).numpy()
    gain = (found / truth).reshape(-1, 3)
    # One complexion for the whole patch.
    np.testing.assert_allclose(gain, np.broadcast_to(gain.mean(axis=0), gain.shape), rtol=2e-2)
    specular = decode_maps(batch.target, batch.reference).specular_albedo[0, 0].numpy()
    expected = store.read(scan, "specular_albedo", slice(row, row + 32), slice(column, column + 32))
    np.testing.assert_allclose(specular, expected[..., 0], atol=1e-5)
    normal = store.read(scan, "diffuse_normal", slice(row, row + 32), slice(column, column + 32))
    found = decode_maps(batch.target, batch.reference).diffuse_normal[0].permute(1, 2, 0).numpy()
    np.testing.assert_allclose(found, normal, atol=5e-3)
    # In the frame of the shape the ball's normals all point nearly ahead.
    assert float(batch.target[:, 6].median()) > 0.99
    # Shape normals come from the positions and point outward, as the ball's do.
    facing = (batch.inputs[0, 3:6].permute(1, 2, 0).numpy() * normal).sum(axis=2)
    assert np.median(facing) > 0.99


def test_the_same_randomness_gives_the_same_pair(store_path: Path) -> None:
    first, second = (patches(store_path).draw(2, np.random.default_rng(5)) for _ in range(2))
    assert torch.equal(first.inputs, second.inputs)
    assert not torch.equal(
        first.inputs, patches(store_path).draw(2, np.random.default_rng(6)).inputs
    )


def test_few_patches_are_kept_in_memory(store_path: Path) -> None:
    data = patches(store_path, dataclasses.replace(TINY.data, patches_in_memory=2))
    regions = [data.patch(place) for place in data.places]
    again = data.patch(data.places[0])
    assert again is not regions[0]
    assert torch.equal(again.maps["diffuse_albedo"], regions[0].maps["diffuse_albedo"])
    assert data.patch(data.places[-1]) is regions[-1]


def test_patches_that_cannot_be_are_a_clear_error(store_path: Path) -> None:
    with pytest.raises(TrainingError, match="patches of 512 texels: found none"):
        patches(store_path, dataclasses.replace(TINY.data, patch_px=512))


def test_colour_encoding_is_inverted() -> None:
    colour = torch.linspace(0, 1, 101).view(1, 1, 1, -1).repeat(1, 3, 1, 1)
    torch.testing.assert_close(decode_colour(encode_colour(colour)), colour, atol=1e-6, rtol=1e-5)
    assert float(encode_colour(torch.tensor(0.18))) == pytest.approx(2 * 0.46135 - 1, abs=1e-4)


def test_maps_survive_encoding(store_path: Path) -> None:
    batch = patches(store_path).draw(1, np.random.default_rng(2))
    skin = batch.skin
    found = decode_maps(
        encode_maps(skin, skin.diffuse_albedo, batch.covered_channels, batch.reference),
        batch.reference,
    )
    torch.testing.assert_close(found.diffuse_albedo, skin.diffuse_albedo, atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(found.specular_albedo, skin.specular_albedo, atol=1e-6, rtol=1e-4)
    torch.testing.assert_close(found.diffuse_normal, unit(skin.diffuse_normal), atol=1e-5, rtol=0)


def test_the_whole_albedos_target_has_the_whole_textures_own_outline(store_path: Path) -> None:
    data = patches(store_path)
    whole = data._whole[data.places[0][0]]
    # The patch ends half way across, the whole texture a quarter of the way down.
    data.patch(data.places[0]).maps["area"][..., 16:] = 0
    whole.maps["area"][..., :8, :] = 0
    target = data.batch([data.places[0]], np.random.default_rng(0)).target
    own, shown = target[0, :10].any(dim=0), target[0, 10:].any(dim=0)
    assert not own[:, 16:].any()
    assert own[:, :16].all()
    assert not shown[:8].any()
    assert shown[8:].all()


def test_a_patch_has_the_part_of_a_faces_pattern_that_the_whole_texture_shows_there(
    store_path: Path,
) -> None:
    data = patches(store_path)
    place = (0, 32, 16)
    box, size = (32 / 96, 16 / 64, 32 / 96, 32 / 64), 32
    pattern = torch.from_numpy(np.random.default_rng(0).normal(size=(1, 3, 6, 4))).float()
    patterned = augment.Variation((1.0, 1.0, 1.0), 30.0, 0.5, pattern)
    one, gains = torch.ones(1, 1, size, size), []
    for region, part in ((data.patch(place), box), (data._whole[0], (0.0, 0.0, 1.0, 1.0))):
        region.maps["diffuse_albedo"].fill_(1e-3)  # so that no gain brings it to 1
        gains.append(1e3 * region.skin(patterned, one, part).diffuse_albedo)
    # The whole texture is shrunk to the patch's size.
    off = gains[0].log() - sampled(gains[1], box, size).log()
    assert gains[0].log().std() > 0.3
    assert off.abs().mean() < 0.02


def test_other_complexions_leave_what_is_no_skin_as_it_is(store_path: Path) -> None:
    data = patches(store_path)
    region = data.patch(data.places[0])
    region.maps["area"][..., 16:] = 0
    darker = augment.Variation((0.5, 0.4, 0.3), 30.0, 0.5)
    given, one = region.maps["diffuse_albedo"], torch.ones_like(region.maps["area"])
    albedo = region.skin(darker, one, (0.0, 0.0, 1.0, 1.0)).diffuse_albedo
    assert torch.equal(albedo[..., 16:], given[..., 16:])
    torch.testing.assert_close(albedo[:, 0, :, :16], 0.5 * given[:, 0, :, :16])


def test_the_papers_preset_shades_by_the_papers_formulas(store_path: Path) -> None:
    assert preset("paper", {}, "test").shading == "paper"
    assert preset("demo", {}, "test").shading == "physical"
    with pytest.raises(ConfigError, match="shading: found 'glossy', expected 'dielectric'"):
        preset("paper", {"shading": "glossy"}, "test")
    store = open_store(store_path)
    config = dataclasses.replace(TINY.data, shadow_rows=0)
    rng = np.random.default_rng(0)
    data = PatchData(store, {"person-0"}, config, TINY.lights, TINY.augment, rng, "paper")
    batch = data.draw(2, np.random.default_rng(1))
    expected = shade(batch.skin, batch.environment, ShadeOptions("paper")) * batch.covered
    # The dot product is not clamped, the photograph is.
    assert float(expected.min()) < 0
    torch.testing.assert_close(batch.texture, expected.clamp_min(0))
    # Not black for want of ambient light, which multiplies the lights' sum.
    assert float((batch.environment.ambient_rgb - 1).abs().max()) <= 0.25 + 1e-6
    assert float(batch.texture.max()) > 0.1
    assert float(rendering_loss(batch.target, batch, "texel")) < 1e-3
    assert float(rendering_loss(-batch.target, batch, "texel")) > 0.02


def test_turning_takes_z_to_the_normal_and_back() -> None:
    rng = np.random.default_rng(0)
    normal = unit(torch.tensor(rng.normal(size=(1, 3, 8, 8))))
    ahead = torch.zeros_like(normal)
    ahead[:, 2] = 1
    torch.testing.assert_close(turn(ahead, normal), normal)
    vectors = torch.tensor(rng.normal(size=(1, 3, 8, 8)))
    torch.testing.assert_close(turn(turn(vectors, normal), normal, back=True), vectors)
    torch.testing.assert_close(turn(vectors, ahead), vectors)


def test_losses_vanish_at_the_truth_and_only_there(store_path: Path) -> None:
    batch = patches(store_path, draws=3).draw(2, np.random.default_rng(3))

    def losses(channels: torch.Tensor) -> list[float]:
        rendered = rendering_loss(channels, batch, "texel")
        return [float(rendered), float(maps_loss(channels, batch))]

    truth = losses(batch.target)
    assert truth[0] < 5e-4
    assert truth[1] == 0
    darker = batch.target.clone()
    darker[:, :3] -= 0.1
    assert min(losses(darker)) > 0.005
    # The whole albedo, channels 10 to 12, is neither rendered nor one of the patch's maps.
    other = batch.target.clone()
    other[:, 10:] = 0
    assert losses(other) == pytest.approx(truth)


def test_contrast_is_without_slow_light_and_without_what_was_not_photographed() -> None:
    rng = np.random.default_rng(0)
    skin = torch.tensor(rng.uniform(0.15, 0.25, (1, 3, 96, 96)), dtype=torch.float32)
    slow = torch.linspace(0.4, 1.2, 96).view(1, 1, 1, 96)
    there, white = torch.ones(1, 1, 96, 96), torch.ones(1, 3, 1, 1)
    inner = (..., slice(20, -20), slice(20, -20))
    even = local_contrast(skin, there, white, 4.0)
    lit = local_contrast(skin * slow, there, white, 4.0)
    assert float(even[inner].std()) > 0.05
    assert float((lit - even)[inner].abs().max()) < 0.15 * float(even[inner].std())
    # Black texels have no contrast, and give their neighbours none.
    holes = skin.clone()
    holes[..., 40:56, 40:56] = 0
    contrast = local_contrast(holes, there, white, 4.0)
    assert torch.equal(contrast[..., 40:56, 40:56], torch.ones(1, 3, 16, 16))
    assert float(contrast[..., 56:60, 40:56].mean()) == pytest.approx(1.0, abs=0.03)
    black = local_contrast(torch.zeros_like(skin), there, white, 4.0)
    assert torch.equal(black, torch.ones_like(skin))


def test_with_detail_one_tone_is_the_evenly_lit_texture(store_path: Path) -> None:
    config = dataclasses.replace(TINY.data, detail_px=6.0)
    batch = patches(store_path, config).draw(2, np.random.default_rng(2))
    detail = batch.reference.detail
    assert detail is not None
    skin = batch.skin
    found = decode_maps(
        encode_maps(skin, skin.diffuse_albedo, batch.covered_channels, batch.reference),
        batch.reference,
    )
    torch.testing.assert_close(found.diffuse_albedo, skin.diffuse_albedo, atol=1e-5, rtol=1e-4)
    flat = torch.zeros_like(batch.target)
    encoded = encode_colour(
        decode_maps(flat, batch.reference).diffuse_albedo, batch.reference.albedo
    )
    torch.testing.assert_close(encoded + 1, detail, atol=1e-4, rtol=1e-4)


def test_a_flat_albedo_scores_as_its_baseline_and_shows_no_detail(store_path: Path) -> None:
    class OneTone(Generator):
        def forward(self, inputs: torch.Tensor) -> torch.Tensor:
            return inputs.new_full((len(inputs), 13, *inputs.shape[2:]), -0.2)

    data = patches(store_path)
    found = score(answers_of(OneTone(TINY.generator)), data, data, 6, 0)
    assert found.detail == pytest.approx(0.0, abs=1e-3)
    assert found.detail_input > 0.1
    assert found.psnr_flat_db > found.psnr_input_db
    assert found.psnr_db <= found.psnr_flat_db + 1.0
    # Whose tone it is is in its name: that of the person held out is another figure.
    assert found.guesses()["the training people's tone alone"] == found.psnr_flat_db
    assert all(f"{name} " in found.sentence() for name in found.guesses())


@pytest.mark.parametrize(("norm", "texels"), [("texel", 1), ("patch", 32**2)])
def test_rendering_loss_of_a_known_difference(
    store_path: Path, norm: RenderNorm, texels: int
) -> None:
    batch = patches(store_path).draw(1, np.random.default_rng(3))
    skin = dataclasses.replace(
        batch.skin,
        diffuse_albedo=torch.ones_like(batch.skin.diffuse_albedo),
        specular_albedo=torch.zeros_like(batch.skin.specular_albedo),
    )
    dark = torch.zeros_like(batch.environment.rgb)
    ambient = torch.full_like(batch.environment.ambient_rgb, 0.5)
    lights = dataclasses.replace(batch.environment, rgb=dark, ambient_rgb=ambient)
    draws = (Scene(lights, batch.visibility),) * 3
    even = dataclasses.replace(batch, skin=skin, environment=lights, draws=draws)
    black = encode_maps(skin, skin.diffuse_albedo, batch.covered_channels, batch.reference)
    black[:, :3] = -1
    # White against black in light of 0.5: rgb differs by 0.5 sqrt(3); four environments over three.
    expected = 4 / 3 * 0.5 * np.sqrt(3) * np.sqrt(texels)
    assert float(rendering_loss(black, even, norm)) == pytest.approx(expected, rel=1e-3)


def test_environments_around_a_target_stay_within_the_published_ranges() -> None:
    rng, config = np.random.default_rng(0), RandomLightConfig()
    target = random_environment(rng, config, random_lights(rng, config))
    distance = target.position_mm.norm(dim=-1, keepdim=True)
    moves, gains, cameras = [], [], []
    for _ in range(1000):
        found = around(target, rng, config)
        moves.append(((found.position_mm - target.position_mm) / distance).norm(dim=-1).max())
        gains.append((found.rgb / target.rgb - 1).abs().max())
        cameras.append((found.camera_mm - target.camera_mm).norm() / target.camera_mm.norm())
    for values, most in ((moves, 0.5), (gains, 0.25), (cameras, 0.25)):
        assert 0.8 * most < float(max(values)) <= most + 1e-5
        # Draws beyond the bound are drawn again, not heaped upon it.
        assert np.mean([float(v) > 0.999 * most for v in values]) < 0.02


def test_random_light_gives_the_exposure_asked_for() -> None:
    config = RandomLightConfig(tint=0.0, exposure=(0.8, 0.8))
    rng = np.random.default_rng(1)
    for _ in range(20):
        front = np.array([[0.0, 0.0, 1000.0], [300.0, 0.0, 900.0]])
        found = random_environment(rng, config, front)
        facing = torch.from_numpy(front[:, 2] / np.linalg.norm(front, axis=1)).float()
        total = (found.rgb[0, :, 0] * facing).sum() + found.ambient_rgb[0, 0]
        assert float(total) == pytest.approx(0.8, rel=1e-4)


def test_complexion_moves_along_melanin_and_blood() -> None:
    only_melanin = augment.AugmentConfig(melanin=0.3, haemoglobin=0.0)
    gain = np.log(augment.draw(np.random.default_rng(0), only_melanin).gain)
    np.testing.assert_allclose(gain / gain[1], augment.MELANIN)


class Perfect(torch.nn.Module):
    """A generator that gives the target; it has a weight, which changes nothing."""

    def __init__(self, target: torch.Tensor) -> None:
        super().__init__()
        self.target, self.nothing = target, torch.nn.Parameter(torch.zeros(()))

    def forward(self, _: torch.Tensor) -> torch.Tensor:
        return self.target + 0 * self.nothing


def test_a_perfect_generator_matches_the_features_exactly(store_path: Path) -> None:
    batch = patches(store_path).draw(2, np.random.default_rng(3))
    trainer = PatchTrainer(TINY)
    trainer._generate = Perfect(batch.target)  # type: ignore[assignment]
    for _ in range(3):
        assert trainer.step(batch)["features"] == 0.0


def test_the_generators_step_gives_the_discriminators_no_gradient(
    store_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    batch = patches(store_path).draw(2, np.random.default_rng(3))
    trainer = PatchTrainer(TINY)
    weights = list(trainer.discriminators.parameters())
    own: list[torch.Tensor] = []
    step = trainer._discriminator_adam.step

    def keep_gradients() -> None:
        own.extend(w.grad.clone() for w in weights if w.grad is not None)
        step()

    monkeypatch.setattr(trainer._discriminator_adam, "step", keep_gradients)
    trainer.step(batch)
    assert len(own) == len(weights)
    for weight, gradient in zip(weights, own, strict=True):
        assert weight.grad is not None
        assert torch.equal(weight.grad, gradient)
    assert all(w.requires_grad for w in weights)


def test_training_learns_scores_and_writes_whole_files(store_path: Path, tmp_path: Path) -> None:
    config = dataclasses.replace(TINY, epochs=4, map_weight=100.0)
    result = train(open_store(store_path), tmp_path / "run", config)
    lines = [json.loads(s) for s in (tmp_path / "run" / "metrics.jsonl").read_text().splitlines()]
    assert result.steps == 24
    assert [line["step"] for line in lines] == [*range(24), 24]
    first = np.mean([line["maps"] for line in lines[:8]])
    last = np.mean([line["maps"] for line in lines[-9:-1]])
    assert last < 0.5 * first
    assert lines[-1]["psnr_db"] == result.score.psnr_db
    assert result.held_out == ["person-2"]
    names = {path.name for path in (tmp_path / "run").iterdir()}
    (events,) = (name for name in names if name.startswith("events.out.tfevents."))
    assert names == {
        events,
        "training.lock",
        "samples.html",
        "checkpoint.json",
        "metrics.jsonl",
        "generator-0000024.safetensors",
        "training-0000024.safetensors",
    }
    generator, checkpoint = load_generator(tmp_path / "run")
    assert checkpoint.step == 24
    assert checkpoint.texture_rows == 96
    assert checkpoint.data_fingerprint == open_store(store_path).fingerprint
    assert checkpoint.metrics["psnr_db"] == result.score.psnr_db
    assert not generator.training


def test_people_are_split_never_patches(store_path: Path) -> None:
    store = open_store(store_path)
    held_out, trained_on = split(store, 1)
    assert held_out == {"person-2"}
    assert trained_on == {"person-0", "person-1"}
    for wrong in (0, 3):
        with pytest.raises(TrainingError, match="subjects: found 3"):
            split(store, wrong)
    # One person's scan under two names.
    same = dataclasses.replace(store.scans[2], sha256=store.scans[0].sha256)
    with pytest.raises(TrainingError, match="the same files of person-0 and person-2, of whom one"):
        split(dataclasses.replace(store, scans=(*store.scans[:2], same)), 1)


def test_presets_resolve_and_refuse_unknown_names() -> None:
    assert preset("paper", {}, "test") == TrainConfig()
    demo = preset("demo", {"generator": {"width": 16}}, "test")
    assert isinstance(demo, TrainConfig)
    assert demo.generator.width == 16
    assert demo.generator.downsamplings == PRESETS["demo"]["generator"]["downsamplings"]
    assert demo.data.patch_px % demo.generator.multiple_px == 0
    with pytest.raises(ConfigError, match="one of modern, paper, demo, avatarme"):
        preset("huge", {}, "test")
    with pytest.raises(ConfigError, match="found an unknown key"):
        preset("demo", {"generator": {"depth": 3}}, "test")
