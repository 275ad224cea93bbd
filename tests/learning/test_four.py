"""The four networks: what each sees and says, their training, and their use one after another."""

from __future__ import annotations

import copy
import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from learning.augment import AugmentConfig
from learning.checkpoint import INDEX, load_generator, read_checkpoint
from learning.commands import infer_command
from learning.data import Batch, DataConfig, PatchData
from learning.encoding import srgb_from_linear
from learning.errors import CheckpointError
from learning.four.channels import (
    DEPTH_MM,
    DIFFUSE_ALBEDO,
    DIFFUSE_NORMAL,
    PARTS,
    SPECULAR_ALBEDO,
    SPECULAR_NORMAL,
    infer_in_sequence,
    pairs,
    seen_of,
)
from learning.four.config import FourTrainConfig
from learning.four.infer import infer_four, seen_texture
from learning.four.networks import fresh_networks, load_four_networks
from learning.four.train import FourTrainer, config_of_part
from learning.infer import prepare
from learning.networks.discriminator import DiscriminatorConfig, feature_loss
from learning.networks.generator import GeneratorConfig
from learning.patch_config import PatchConfig
from learning.presets import FAMILIES, preset
from learning.render.environments import RandomLightConfig
from learning.render.shading import unit
from learning.train import train
from lightstage.commands import quiet
from lightstage.formats.exr import read_exr, write_exr
from lightstage.formats.mesh import Mesh, read_obj, write_obj
from lightstage.formats.processed import ProcessedFolder
from processing.dataset import open_store

TINY = FourTrainConfig(
    generator=GeneratorConfig(width=8, downsamplings=2, global_blocks=1, local_blocks=1),
    discriminator=DiscriminatorConfig(width=4, scales=2),
    data=DataConfig(patch_px=32, stride_px=32, patches_in_memory=16, shadow_rows=24, shadow_sets=2),
    batch=2,
    epochs=1,
    learning_rate=2e-3,
    map_weight=100.0,
    shading="physical",
    log_steps=1,
    score_patches=4,
)


LOSSES = ("adversarial", "features", "maps")
"""Of each of the four generators."""


def drawn(store_path: Path, data: DataConfig = TINY.data, count: int = 2) -> Batch:
    store, rng = open_store(store_path), np.random.default_rng(0)
    people = {scan.subject for scan in store.scans}
    found = PatchData(store, people, data, RandomLightConfig(), AugmentConfig(), rng)
    return found.draw(count, np.random.default_rng(1))


def test_at_full_width_the_four_have_731_million_weights() -> None:
    with torch.device("meta"):
        networks = fresh_networks(GeneratorConfig())
    counts = {part: sum(p.numel() for p in networks.generator(part).parameters()) for part in PARTS}
    assert counts == {
        "diffuse_albedo": 182_706_531,
        "specular_albedo": 182_698_689,
        "diffuse_normal": 182_706_531,
        "specular_normal": 182_706_531,
    }
    assert sum(counts.values()) == 730_818_282


def test_the_presets_are_the_published_four_and_a_narrow_set() -> None:
    assert preset("avatarme", {}, "test") == FourTrainConfig()
    small = preset("avatarme-small", {"seconds": 5.0}, "test")
    assert isinstance(small, FourTrainConfig)
    assert small.generator.width < FourTrainConfig().generator.width
    assert small.data.patch_px % small.generator.multiple_px == 0
    assert {FAMILIES[name].family for name in ("avatarme", "avatarme-small")} == {"four_networks"}


def test_each_network_sees_what_is_published(store_path: Path) -> None:
    batch = drawn(store_path)
    found = pairs(batch)
    albedo = srgb_from_linear(batch.skin.diffuse_albedo).double().numpy()
    inputs = {part: pair.inputs.double().numpy() for part, pair in found.items()}
    assert {p: x.shape for p, x in inputs.items()} == {
        p: (2, n, 32, 32) for p, (n, _) in PARTS.items()
    }
    # The batch's patches are covered everywhere.
    assert bool(batch.covered.all())
    depth = batch.skin.position_mm[:, 2].double().numpy() / DEPTH_MM
    np.testing.assert_allclose(inputs[DIFFUSE_ALBEDO][:, 3], depth, atol=1e-6)
    texture = 2 * srgb_from_linear(batch.texture).double().numpy() - 1
    np.testing.assert_allclose(inputs[DIFFUSE_ALBEDO][:, :3], texture, atol=1e-5)
    np.testing.assert_allclose(inputs[SPECULAR_ALBEDO], 2 * albedo - 1, atol=1e-5)
    luma = 0.2126 * albedo[:, 0] + 0.7152 * albedo[:, 1] + 0.0722 * albedo[:, 2]
    for part in (DIFFUSE_NORMAL, SPECULAR_NORMAL):
        np.testing.assert_allclose(inputs[part][:, 0], 2 * luma - 1, atol=1e-5)
    head = batch.inputs[:, 3:6].double().numpy()
    np.testing.assert_allclose(inputs[DIFFUSE_NORMAL][:, 1:], head, atol=1e-6)
    # In tangent space the component along the smooth shape's normal is z, whatever the axes.
    smooth = batch.smooth_normal.double().numpy()
    np.testing.assert_allclose(np.linalg.norm(smooth, axis=1), 1, atol=1e-5)
    along = (head * smooth).sum(axis=1)
    np.testing.assert_allclose(inputs[SPECULAR_NORMAL][:, 3], along, atol=1e-5)
    assert np.median(along) > 0.98
    targets = {part: pair.target for part, pair in found.items()}
    assert torch.equal(torch.cat(list(targets.values()), dim=1), batch.target[:, :10])


def test_specular_normals_are_encoded_in_tangent_space_and_diffuse_ones_in_the_heads(
    store_path: Path,
) -> None:
    batch = drawn(store_path)
    diffuse, specular = batch.target[:, 4:7], batch.target[:, 7:10]
    torch.testing.assert_close(diffuse, unit(batch.skin.diffuse_normal), atol=1e-5, rtol=0)
    shape = batch.inputs[:, 3:6]
    along = (unit(batch.skin.specular_normal) * shape).sum(dim=1)
    torch.testing.assert_close(specular[:, 2], along, atol=1e-5, rtol=0)
    head = drawn(store_path, dataclasses.replace(TINY.data, specular_frame="head"))
    specular = unit(head.skin.specular_normal)
    torch.testing.assert_close(head.target[:, 7:10], specular, atol=1e-5, rtol=0)
    for name in ("paper", "avatarme"):
        config = preset(name, {}, "test")
        assert isinstance(config, PatchConfig)
        assert config.data.specular_frame == "tangent"


@pytest.mark.parametrize("relative", [False, True])
def test_right_answers_one_after_the_other_are_the_truth(store_path: Path, relative: bool) -> None:
    data = dataclasses.replace(TINY.data, relative=relative, detail_px=6.0 if relative else 0.0)
    batch = drawn(store_path, data)
    trained = pairs(batch)
    given: dict[str, Tensor] = {}

    def run_part(part: str, inputs: Tensor) -> Tensor:
        given[part] = inputs
        return trained[part].target

    found = infer_in_sequence(run_part, seen_of(batch))
    torch.testing.assert_close(
        found.diffuse_albedo, batch.skin.diffuse_albedo, atol=1e-4, rtol=1e-3
    )
    torch.testing.assert_close(found.specular_albedo, batch.skin.specular_albedo, atol=1e-5, rtol=0)
    normal = unit(batch.skin.specular_normal)
    torch.testing.assert_close(found.specular_normal, normal, atol=1e-4, rtol=0)
    for part, inputs in given.items():
        torch.testing.assert_close(inputs, trained[part].inputs, atol=2e-3, rtol=0)


def test_a_few_steps_bring_every_network_nearer_to_the_truth(store_path: Path) -> None:
    batch = drawn(store_path)
    trainer = FourTrainer(TINY)
    lines = [trainer.step(batch) for _ in range(12)]
    for part in PARTS:
        assert lines[-1][f"{part}.error"] < 0.8 * lines[0][f"{part}.error"], part
        assert lines[-1][f"{part}.maps"] < 0.8 * lines[0][f"{part}.maps"], part
        assert lines[-1][f"{part}.discriminators"] < lines[0][f"{part}.discriminators"], part
    errors = [lines[-1][f"{part}.error"] for part in PARTS]
    assert lines[-1]["error"] == pytest.approx(sum(errors))
    assert not any("rendering" in name for name in lines[0])


def test_a_steps_losses_are_of_each_networks_answer_and_its_own_discriminators(
    store_path: Path,
) -> None:
    batch, trainer = drawn(store_path), FourTrainer(TINY)
    before = {part: copy.deepcopy(own.generator) for part, own in trainer.trainers.items()}
    losses = trainer.step(batch)
    for part, pair in pairs(batch).items():
        # A step moves the discriminators first, and judges by what they are then.
        judge = trainer.trainers[part].discriminators
        with torch.no_grad():
            found = before[part](pair.inputs)
            real, fake = (judge(torch.cat([pair.inputs, x], 1)) for x in (pair.target, found))
            # The batch's patches are covered everywhere.
            expected = (
                sum((features[-1] - 1).square().mean() for features in fake),
                TINY.feature_weight * feature_loss(real, fake),
                TINY.map_weight * (found - pair.target).abs().mean(),
            )
        for name, value in zip(LOSSES, expected, strict=True):
            assert losses[f"{part}.{name}"] == pytest.approx(float(value), rel=1e-4)


def test_networks_of_one_size_begin_with_weights_of_their_own() -> None:
    networks = FourTrainer(TINY).trained
    first, second = (
        networks.generator(part).coarse[1].weight for part in (DIFFUSE_ALBEDO, DIFFUSE_NORMAL)
    )
    assert first.shape == second.shape
    assert not torch.equal(first, second)
    seeds = [config_of_part(TINY, index).seed for index in range(4)]
    assert len({*seeds, *(s + 4 for s in seeds)}) == 8


@pytest.fixture(scope="module")
def run(store_path: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("four") / "run"
    result = train(open_store(store_path), out, TINY)
    assert result.steps == 6
    assert result.held_out == ["person-2"]
    # Batches are made meanwhile, and no loss of the four is rendered.
    assert result.shares["network"] + result.shares["idle"] == pytest.approx(1)
    last = json.loads((out / "metrics.jsonl").read_text().splitlines()[-1])
    assert result.shares.keys() == {"data", "rendering", "network", "idle"}
    for name, share in result.shares.items():
        assert share > 0
        assert last[f"share_{name}"] == round(share, 4)
    return out


def test_a_run_holds_figures_of_every_part_and_both_files(run: Path) -> None:
    lines = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    assert [line["step"] for line in lines] == [*range(6), 6]
    logged = {f"{p}.{n}" for p in PARTS for n in (*LOSSES, "discriminators", "error")}
    assert {name for name in lines[0] if "." in name} == logged
    names = {path.name for path in run.iterdir()}
    (events,) = (name for name in names if name.startswith("events.out.tfevents."))
    assert names == {
        events,
        "training.lock",
        "samples.html",
        "checkpoint.json",
        "metrics.jsonl",
        "generators-0000006.safetensors",
        "training-0000006.safetensors",
    }
    checkpoint = read_checkpoint(run)
    assert checkpoint.family == "four_networks"
    assert checkpoint.metrics["psnr_db"] == lines[-1]["psnr_db"]


def test_what_is_loaded_is_what_was_trained_and_no_other_family(
    run: Path, store_path: Path, tmp_path: Path
) -> None:
    networks, checkpoint = load_four_networks(run)
    trainer = FourTrainer(TINY)
    trainer.load(checkpoint)
    for name, value in trainer.trained.state_dict().items():
        assert torch.equal(networks.state_dict()[name], value)
    assert not networks.training
    state = trainer.trainers[SPECULAR_ALBEDO].tensors()["training"]
    steps = [float(v) for k, v in state.items() if k.endswith(".step")]
    assert set(steps) == {6.0}
    with pytest.raises(CheckpointError, match="family: found four_networks, expected patches"):
        load_generator(run)


def test_damaged_networks_are_refused(run: Path, tmp_path: Path) -> None:
    other = tmp_path / "run"
    other.mkdir()
    for path in run.iterdir():
        (other / path.name).write_bytes(path.read_bytes())
    value = json.loads((other / INDEX).read_text())
    value["config"]["generator"]["width"] = 16
    (other / INDEX).write_text(json.dumps(value))
    with pytest.raises(CheckpointError, match="those of the configured network"):
        load_four_networks(other)
    weights = other / "generators-0000006.safetensors"
    weights.write_bytes(weights.read_bytes()[:-4])
    with pytest.raises(CheckpointError, match="other bytes than were saved"):
        load_four_networks(other)


def lit_ball(rows: int = 64, columns: int = 64) -> np.ndarray:
    y, x = np.mgrid[:rows, :columns] / 64.0
    shading = 0.4 + 0.3 * np.sin(6 * x) * np.cos(5 * y)
    return (shading[..., None] * [0.6, 0.4, 0.3]).astype(np.float32)


def test_maps_do_not_depend_on_the_meshs_axes_when_its_pose_is_known(
    run: Path, ball_mesh: Mesh
) -> None:
    networks, _ = load_four_networks(run)
    lines: list[tuple[int, int]] = []

    def progress(done: int, total: int) -> None:
        lines.append((done, total))

    first = infer_four(networks, TINY.data, lit_ball(), ball_mesh, np.eye(3, 4), progress).maps
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    moved = ball_mesh.with_vertices(ball_mesh.vertices @ turn.T + [100, -50, 900])
    pose = np.column_stack([turn.T, -turn.T @ [100, -50, 900]])
    second = infer_four(networks, TINY.data, lit_ball(), moved, pose).maps
    for name in ("diffuse_albedo", "specular_albedo", "confidence"):
        np.testing.assert_allclose(second[name], first[name], atol=2e-3)
    for name in ("diffuse_normal", "specular_normal"):
        np.testing.assert_allclose(second[name], first[name] @ turn.T, atol=1e-2)
    tiles = 3 * 3
    assert lines == [(n + 1, 4 * 2 * tiles) for n in range(4 * 2 * tiles)]


def test_networks_see_in_inference_what_they_saw_in_training(
    store_path: Path, people: list[ProcessedFolder]
) -> None:
    store, rng = open_store(store_path), np.random.default_rng(0)
    own = AugmentConfig(melanin=0.0, haemoglobin=0.0)
    data = PatchData(store, {"person-1"}, TINY.data, RandomLightConfig(), own, rng)
    mesh = read_obj(people[1].registered_mesh)
    seen = seen_texture(prepare(TINY.data, lit_ball(96, 64), mesh, np.eye(3, 4)))
    albedo = torch.from_numpy(read_exr(people[1].atlas_path("diffuse_albedo")).astype(np.float32))
    whole = albedo.permute(2, 0, 1)[None]
    for scan, row, column in data.places:
        batch = pairs(data.batch([(scan, row, column)], np.random.default_rng(0)))
        part = (..., slice(row + 4, row + 28), slice(column + 4, column + 28))
        inner = (..., slice(4, 28), slice(4, 28))
        for name in (SPECULAR_ALBEDO, DIFFUSE_NORMAL, SPECULAR_NORMAL):
            found = seen.input_of(name, whole)[part]
            torch.testing.assert_close(found, batch[name].inputs[inner], atol=0.03, rtol=0)
        depth = seen.input_of(DIFFUSE_ALBEDO, None)[:, 3:][part]
        expected = batch[DIFFUSE_ALBEDO].inputs[:, 3:][inner]
        torch.testing.assert_close(depth, expected, atol=0.01, rtol=0)


def test_the_command_infers_from_a_run(run: Path, ball_mesh: Mesh, tmp_path: Path) -> None:
    texture = write_exr(tmp_path / "texture.exr", lit_ball())
    mesh = write_obj(ball_mesh, tmp_path / "head.obj")
    out = tmp_path / "maps"
    facts = infer_command(texture, mesh, run, out, None, None, quiet)
    assert (facts["rows"], facts["columns"], facts["step"]) == (96, 96, 6)
    names = {"diffuse_albedo", "specular_albedo", "diffuse_normal", "specular_normal", "confidence"}
    assert {path.stem for path in out.glob("*.exr")} == names
    for name in names:
        values = read_exr(out / f"{name}.exr")
        assert values.shape[:2] == (96, 96)
        assert np.isfinite(values).all()
        assert values.any()
