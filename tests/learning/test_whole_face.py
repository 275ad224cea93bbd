"""The network over a whole face: what it is shown, what it learns, what it says of a texture."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy.spatial.transform import Rotation

from learning.augment import AugmentConfig, draw, recolour
from learning.checkpoint import load_generator, load_whole_face, shipped_weights
from learning.devices import CPU
from learning.encoding import shrink
from learning.errors import CheckpointError, MapsError, TrainingError
from learning.maps import to_batch
from learning.networks.whole_face import (
    Attention,
    WholeFaceConfig,
    WholeFaceNetwork,
    face_input,
)
from learning.presets import preset
from learning.render.environments import RandomLightConfig
from learning.train import train
from learning.whole.config import WholeTrainConfig
from learning.whole.displacement import displaced, displacement
from learning.whole.faces import FaceBatch, Faces, FacesConfig
from learning.whole.infer import infer_whole_face
from learning.whole.score import score_faces
from learning.whole.train import WholeFaceTrainer, face_losses, measured_doubt
from lightstage.commands import ProgressCallback
from lightstage.errors import ConfigError
from lightstage.formats.exr import read_exr, write_exr
from lightstage.formats.mesh import Mesh
from processing.dataset import build_store, open_store

SIZE = WholeFaceConfig(rows=48, columns=32, width=4, halvings=2)
TINY = WholeTrainConfig(
    network=SIZE,
    faces=FacesConfig(shadow_sets=3),
    steps=80,
    learning_rate=0.01,
    log_steps=1,
    detail_pairs=2,
    doubt_faces=8,
    score_lights=2,
)
PLAIN = FacesConfig(shadow_sets=3, white_balance=0.0, noise=0.0, partial_share=0.0)
OWN = AugmentConfig(melanin=0.0, haemoglobin=0.0)


def faces_of(
    store_path: Path,
    config: FacesConfig = PLAIN,
    skins: AugmentConfig = OWN,
    lit_on: torch.device = CPU,
) -> Faces:
    store = open_store(store_path)
    people = {scan.subject for scan in store.scans}
    rng = np.random.default_rng(0)
    lights = RandomLightConfig()
    return Faces(store, people, SIZE, config, lights, skins, rng, lit_on=lit_on)


def stopping_after(steps: int) -> ProgressCallback:
    def stop(done: int, total: int) -> None:
        if done == steps:
            raise KeyboardInterrupt

    return stop


def test_a_pair_is_the_store_relit_at_the_networks_size(store_path: Path) -> None:
    batch = faces_of(store_path).batch([1], np.random.default_rng(1))
    assert batch.inputs.shape == (1, 10, 48, 32)
    store, everything = open_store(store_path), slice(None)
    truth = to_batch(store.read(1, "diffuse_albedo", everything, everything))
    torch.testing.assert_close(batch.diffuse_albedo, shrink(truth, (48, 32)), atol=2e-3, rtol=0)
    # Light of at most 1.1 on this skin, and shadow somewhere.
    ratio = batch.texture / batch.diffuse_albedo
    assert float(ratio.max()) < 2.5
    assert float(ratio.min()) < 0.6 * float(ratio.max())
    assert float(batch.skin.mean()) > 0.9


def test_the_same_randomness_gives_the_same_pair_and_other_randomness_another(
    store_path: Path,
) -> None:
    faces = faces_of(store_path, TINY.faces, TINY.augment)
    first, second, third = (faces.draw(2, np.random.default_rng(seed)) for seed in (5, 5, 6))
    assert torch.equal(first.inputs, second.inputs)
    assert not torch.equal(first.inputs, third.inputs)


def test_what_a_partial_pair_does_not_show_says_nothing(store_path: Path) -> None:
    config = dataclasses.replace(PLAIN, partial_share=1.0)
    batch = faces_of(store_path, config).batch([0, 1, 2], np.random.default_rng(0))
    seen = batch.inputs[:, 9:]
    share = seen.mean(dim=(1, 2, 3))
    assert bool(((share > 0.2) & (share < 0.8)).all())
    assert not bool((batch.inputs[:, :3] * (1 - seen)).any())
    # The truth is asked for there too.
    assert float(batch.weight.min()) == 1.0


def test_a_pair_without_eyes_and_hair_shows_skin_alone(store_path: Path) -> None:
    def pair(config: FacesConfig) -> FaceBatch:
        faces = faces_of(store_path, config)
        faces.faces[1].skin[..., :20] = 0
        return faces.batch([1], np.random.default_rng(3))

    whole, batch = pair(PLAIN), pair(dataclasses.replace(PLAIN, skin_share=1.0))
    assert 0.2 < float(batch.skin.mean()) < 0.9
    torch.testing.assert_close(batch.inputs[:, 9:], batch.skin)
    torch.testing.assert_close(batch.inputs[:, :3], whole.inputs[:, :3] * batch.skin)
    assert torch.equal(batch.weight, whole.weight)


def test_a_pair_with_closed_eyes_is_not_shown_the_whites_that_inference_hides(
    store_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hidden = np.zeros((48, 32), bool)
    hidden[20:24, 10:15] = True
    monkeypatch.setattr("learning.whole.faces.eyes_of", lambda *_: hidden)
    whole, batch = (
        faces_of(store_path, config).batch([1], np.random.default_rng(3))
        for config in (PLAIN, dataclasses.replace(PLAIN, closed_share=1.0))
    )
    assert not batch.inputs[0, [0, 1, 2, 9]][:, hidden].any()
    assert torch.equal(batch.inputs[:, :, ~hidden], whole.inputs[:, :, ~hidden])
    assert torch.equal(batch.weight, whole.weight)


def test_eyes_and_hair_have_a_gain_of_their_own_and_skin_keeps_its_complexion() -> None:
    albedo = torch.rand(1, 3, 6, 4, generator=torch.Generator().manual_seed(0))
    skin = torch.zeros(1, 1, 6, 4, dtype=torch.bool)
    skin[..., :2] = True
    config = AugmentConfig(beside=0.5)
    plain, drawn = (
        draw(np.random.default_rng(4), dataclasses.replace(config, beside=beside))
        for beside in (0.0, 0.5)
    )
    before, after = (recolour(albedo, each, skin) for each in (plain, drawn))
    assert torch.equal(before[..., :2], after[..., :2])
    assert torch.equal(before[..., 2:], albedo[..., 2:])
    expected = albedo * torch.tensor(drawn.beside).view(1, 3, 1, 1)
    torch.testing.assert_close(after[..., 2:], expected[..., 2:].clamp_max(1))
    several = [draw(np.random.default_rng(k), config).beside for k in range(400)]
    logarithms = np.log(several)
    assert np.allclose(logarithms.std(axis=0), 0.5 * (10 / 9) ** 0.5, rtol=0.15)
    # Most of it is one gain for all colours.
    assert np.corrcoef(logarithms.T).min() > 0.8


def test_attention_takes_weighted_means_of_what_places_show() -> None:
    torch.manual_seed(3)
    attention = Attention(channels=5, places=12, heads=2)
    attention.here.data.normal_()
    features = torch.randn(3, 5, 4, 3)
    found = attention(features).detach().numpy()
    plain = features.numpy().astype(np.float64).reshape(3, 5, 12)
    key, own = (x.detach().numpy().astype(np.float64) for x in attention.seen.parameters())
    score = np.einsum("hc,bcn->bhn", key[:, :, 0, 0], plain) + own[:, None]
    score = np.exp(score + attention.here.detach().numpy())
    weights = score / score.sum(axis=2, keepdims=True)
    expected = np.einsum("bhn,bcn->bhc", weights, plain).reshape(3, 10)
    np.testing.assert_allclose(found, expected, atol=1e-5)
    # Whatever weighs them, means of one value are that value.
    level = attention(torch.full((1, 5, 4, 3), 0.7))
    torch.testing.assert_close(level, torch.full((1, 10), 0.7))


def test_a_network_without_attention_has_the_weights_of_before() -> None:
    torch.manual_seed(0)
    before, with_heads = (
        WholeFaceNetwork(dataclasses.replace(SIZE, heads=heads)) for heads in (0, 2)
    )
    names = set(before.state_dict())
    assert names < set(with_heads.state_dict())
    assert not any(name.startswith(("attention", "back")) for name in names)


def test_a_displaced_pair_shows_other_places_and_its_truth_stays(store_path: Path) -> None:
    in_place = faces_of(store_path).batch([0, 1], np.random.default_rng(3))
    config = dataclasses.replace(PLAIN, displaced_mm=8.0)
    batch = faces_of(store_path, config).batch([0, 1], np.random.default_rng(3))
    assert torch.equal(batch.diffuse_albedo, in_place.diffuse_albedo)
    assert torch.equal(batch.weight, in_place.weight)
    # Normals and positions are the fitted shape's, in place.
    assert torch.equal(batch.inputs[:, 3:9], in_place.inputs[:, 3:9])
    assert not torch.equal(batch.inputs[:, :3], in_place.inputs[:, :3])
    assert bool((batch.inputs[:, 9] <= in_place.inputs[:, 9]).all())


def test_a_displaced_image_is_read_beside_each_texel_by_its_own_size() -> None:
    image = torch.arange(5.0 * 8).view(1, 1, 5, 8)
    texel_mm = torch.full((1, 1, 5, 8), 2.0)
    shift = torch.zeros(1, 2, 2, 2)
    torch.testing.assert_close(displaced(image, shift, texel_mm), image)
    shift[:, 0] = 4.0
    right = displaced(image, shift, texel_mm)
    torch.testing.assert_close(right[..., :-2], image[..., 2:])
    assert not bool(right[..., -2:].any())
    shift[:, 0], shift[:, 1] = 0.0, -2.0
    texel_mm[:, :, :, :4] = 1.0
    down = displaced(image, shift, texel_mm)
    torch.testing.assert_close(down[:, :, 2:, :4], image[:, :, :-2, :4])
    torch.testing.assert_close(down[:, :, 1:, 4:], image[:, :, :-1, 4:])


def test_displacements_have_the_deviation_that_is_asked_for() -> None:
    drawn = [displacement(np.random.default_rng(seed), 4.0) for seed in range(400)]
    fields = torch.cat(drawn)
    assert 2.8 < float(fields.square().mean().sqrt()) < 4.2
    size = fields.square().mean(dim=(1, 2, 3)).sqrt()
    # Among them are faces in place and faces far off.
    assert float(size.min()) < 0.1
    assert float(size.max()) > 8.0


def test_what_people_have_in_common_is_their_mean_and_directions_at_right_angles(
    store_path: Path,
) -> None:
    faces = faces_of(store_path)
    known = faces.in_common(5)
    directions = known.modes.flatten(1)
    found = int((known.deviations > 0).sum())
    assert 1 <= found <= len(faces.faces) - 1
    square = directions[:found] @ directions[:found].T
    torch.testing.assert_close(square, torch.eye(found), atol=1e-4, rtol=0)
    assert not bool(directions[len(faces.faces) - 1 :].any())
    # Each person is the mean and a sum of the directions.
    albedo = shrink(faces.faces[0].maps["diffuse_albedo"], (48, 32)).clamp_min(1e-3)
    beside = (albedo.log() - known.log_albedo).flatten()
    torch.testing.assert_close((directions @ beside) @ directions, beside, atol=1e-3, rtol=0)
    assert float(known.deviations[0]) >= float(known.deviations[1])


def test_an_untrained_network_answers_the_mean_person_to_any_texture(store_path: Path) -> None:
    faces = faces_of(store_path)
    network = WholeFaceNetwork(SIZE)
    network.set_people(faces.in_common(network.config.modes))
    answer = network(faces.draw(2, np.random.default_rng(0)).inputs)
    albedos = [shrink(face.maps["diffuse_albedo"], (48, 32)).log() for face in faces.faces]
    mean = torch.cat(albedos).mean(dim=0).exp()
    torch.testing.assert_close(answer.diffuse_albedo[0], mean)
    torch.testing.assert_close(answer.diffuse_albedo[1], mean)


@given(
    arrays.arrays(
        np.float32, (3, 48, 32), elements=st.sampled_from([0.0, 1e-30, 1e-6, 0.2, 1.0, 1e6, 3e38])
    )
)
@settings(max_examples=20, deadline=None)
def test_whatever_the_texture_albedo_lies_between_0_and_1(texture: np.ndarray) -> None:
    torch.manual_seed(0)
    network = WholeFaceNetwork(SIZE)
    with torch.no_grad():
        for weights in network.parameters():
            weights.add_(torch.randn_like(weights))
    zeros = torch.zeros(1, 3, 48, 32)
    with torch.inference_mode():
        shown = torch.from_numpy(texture)[None]
        answer = network(face_input(shown, zeros, zeros, torch.ones(1, 1, 48, 32)))
    for values in (answer.diffuse_albedo, answer.specular_albedo):
        assert 0 < float(values.min()) <= float(values.max()) <= 1
    assert bool(((answer.deviation >= 0.003) & (answer.deviation <= 0.5)).all())


def test_the_expected_error_does_not_change_the_answer(store_path: Path) -> None:
    batch = faces_of(store_path).draw(2, np.random.default_rng(0))
    network = WholeFaceTrainer(TINY).network
    torch.nn.init.normal_(network.here.weight)
    face_losses(network, batch)["deviation"].backward()
    touched = {n for n, w in network.named_parameters() if w.grad is not None and w.grad.any()}
    assert touched
    assert all(name.startswith("unsure") for name in touched)


def test_losses_in_double_precision_are_those_of_a_plain_twin(store_path: Path) -> None:
    batch = faces_of(store_path).draw(2, np.random.default_rng(0))
    network = WholeFaceNetwork(SIZE)
    network.set_people(faces_of(store_path).in_common(network.config.modes))
    answer = network(batch.inputs)
    weight = batch.weight.double().numpy()

    def curve(x: np.ndarray) -> np.ndarray:
        return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)

    found, true = (
        v.detach().double().numpy() for v in (answer.diffuse_albedo, batch.diffuse_albedo)
    )
    square = (curve(found) - curve(true)) ** 2
    variance = answer.deviation.detach().double().numpy() ** 2
    given_error = square.mean(axis=1, keepdims=True)
    expected = {
        "diffuse": (square * weight).sum() / (3 * weight.sum()),
        "deviation": ((given_error / variance + np.log(variance)) * weight).sum() / weight.sum(),
    }
    losses = face_losses(network, batch)
    for name, value in expected.items():
        assert float(losses[name].detach()) == pytest.approx(value, rel=1e-4)


def test_training_learns_scores_and_leaves_whole_files(store_path: Path, tmp_path: Path) -> None:
    result = train(open_store(store_path), tmp_path / "run", TINY)
    assert result.steps == 80
    assert result.examples == 2
    assert result.held_out == ["person-2"]
    lines = [json.loads(s) for s in (tmp_path / "run" / "metrics.jsonl").read_text().splitlines()]
    assert [line["step"] for line in lines] == [*range(80), 80]
    assert result.score.psnr_db > result.score.psnr_input_db
    assert result.score.psnr_gain_db >= result.score.psnr_db
    # The rest is made meanwhile.
    assert result.shares["network"] + result.shares["idle"] == pytest.approx(1)
    assert result.shares.keys() == {"data", "rendering", "network", "idle"}
    assert min(result.shares.values()) > 0
    for name, share in result.shares.items():
        assert lines[-1][f"share_{name}"] == round(share, 4)
    network, checkpoint = load_whole_face(tmp_path / "run")
    assert checkpoint.metrics["psnr_db"] == result.score.psnr_db
    assert not network.training
    # On the same faces: of two people, the tones that a batch draws decide how hard it is.
    faces, untrained = faces_of(store_path, TINY.faces, TINY.augment), WholeFaceNetwork(SIZE)
    untrained.set_people(faces.in_common(SIZE.modes))
    pair = faces.draw(32, np.random.default_rng(9))
    trained, before = (face_losses(n, pair)["diffuse"] for n in (network, untrained))
    assert trained < 0.7 * before
    # Of the people trained on, in lights that the training did not draw.
    store, rng = open_store(store_path), np.random.default_rng([TINY.seed, 1])
    drawn = (TINY.lights, TINY.augment, rng, TINY.shading)
    own = Faces(store, {"person-0", "person-1"}, SIZE, TINY.faces, *drawn)
    torch.testing.assert_close(network.mode_doubt, measured_doubt(network, own, TINY))
    everything = slice(None)
    places = [
        shrink(to_batch(store.read(scan.index, "position", everything, everything)), (48, 32))
        for scan in store.scans
        if scan.subject != "person-2"
    ]
    mean = torch.cat(places).mean(dim=0, keepdim=True)
    torch.testing.assert_close(network.mean_position_mm, mean, atol=0.05, rtol=0)
    with pytest.raises(CheckpointError, match="family: found whole_face, expected patches"):
        load_generator(tmp_path / "run")


def test_a_network_that_is_right_scores_without_error(store_path: Path) -> None:
    faces = faces_of(store_path)
    faces.faces = faces.faces[:1]

    network = WholeFaceNetwork(SIZE)
    network.set_people(faces.in_common(network.config.modes))
    score = score_faces(network, faces, 2, 0)
    # Of one person the mean person is the person.
    assert score.psnr_db > 50
    assert score.psnr_mean_db == pytest.approx(score.psnr_db)
    assert score.psnr_input_db < score.psnr_tone_db < 40
    assert score.specular_rmse < 1e-3 < score.specular_constant_rmse


@pytest.fixture(scope="module")
def trained(store_path: Path, tmp_path_factory: pytest.TempPathFactory) -> WholeFaceNetwork:
    out = tmp_path_factory.mktemp("trained")
    train(open_store(store_path), out, dataclasses.replace(TINY, steps=10))
    return load_whole_face(out)[0]


def test_maps_have_the_textures_size_and_the_meshs_normals(
    trained: WholeFaceNetwork, ball_mesh: Mesh
) -> None:
    texture = np.full((120, 80, 3), 0.3, np.float32)
    texture[:, 40:] = 0
    found = infer_whole_face(trained, texture, ball_mesh)
    assert found.maps["diffuse_albedo"].shape == (120, 80, 3)
    assert all(np.isfinite(values).all() for values in found.maps.values())
    assert not found.maps["confidence"][:, 40:].any()
    assert found.maps["confidence"][:, :36].min() > 0
    # What was not photographed is filled with what the network says.
    assert found.maps["diffuse_albedo"][:, 60:].min() > 0.01
    rows, columns = np.mgrid[0:120, 0:80]
    azimuth = ((columns + 0.5) / 80 - 0.5) * 2 * np.pi
    elevation = (0.5 - (rows + 0.5) / 120) * np.pi
    true = np.stack(
        [
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
            np.cos(elevation) * np.cos(azimuth),
        ],
        axis=-1,
    )
    cosine = (found.maps["diffuse_normal"] * true).sum(axis=-1)
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() < 3


def test_a_mesh_in_any_axes_gives_the_same_albedo_and_normals_in_its_own(
    trained: WholeFaceNetwork, ball_mesh: Mesh
) -> None:
    rng = np.random.default_rng(1)
    texture = rng.uniform(0.1, 0.5, (96, 64, 3)).astype(np.float32)
    turned = Rotation.from_rotvec([0.5, -2.0, 1.0]).as_matrix()
    moved = dataclasses.replace(ball_mesh, vertices=ball_mesh.vertices @ turned.T + [900, -50, 3])
    here = infer_whole_face(trained, texture, ball_mesh).maps
    there = infer_whole_face(trained, texture, moved).maps
    for name in ("diffuse_albedo", "specular_albedo", "confidence"):
        np.testing.assert_allclose(there[name], here[name], atol=2e-4)
    np.testing.assert_allclose(there["diffuse_normal"] @ turned, here["diffuse_normal"], atol=5e-3)
    with pytest.raises(MapsError, match=r"found texels \d{3} mm from where the people"):
        infer_whole_face(trained, texture, moved, np.eye(3, 4))


def test_another_layout_another_size_and_a_tiny_texture_are_refused(
    trained: WholeFaceNetwork, ball_mesh: Mesh
) -> None:
    texture = np.full((96, 64, 3), 0.3, np.float32)
    assert ball_mesh.uvs is not None
    upside_down = dataclasses.replace(ball_mesh, uvs=ball_mesh.uvs * [1, -1] + [0, 1])
    with pytest.raises(MapsError, match=r"uv: found texels \d+ mm from where the people"):
        infer_whole_face(trained, texture, upside_down)
    corner = dataclasses.replace(ball_mesh, uvs=0.05 * ball_mesh.uvs)
    with pytest.raises(MapsError, match=r"uv: found \d+ texels of the network's in common"):
        infer_whole_face(trained, texture, corner)
    metres = dataclasses.replace(ball_mesh, vertices=ball_mesh.vertices / 1000)
    with pytest.raises(MapsError, match="a head in millimetres"):
        infer_whole_face(trained, texture, metres)
    with pytest.raises(MapsError, match="at least 48 x 32, which the network sees"):
        infer_whole_face(trained, texture[:40], ball_mesh)
    with pytest.raises(MapsError, match="exposure"):
        infer_whole_face(trained, 1000 * texture, ball_mesh)


def test_scans_of_two_layouts_are_not_trained_on_together(
    strangers: list[Path], tmp_path: Path
) -> None:
    folders = [shutil.copytree(path, tmp_path / path.name) for path in strangers]
    for name in ("position", "diffuse_albedo"):
        file = folders[1] / "atlas" / f"{name}.exr"
        write_exr(file, np.ascontiguousarray(read_exr(file)[::-1]))
    store = build_store(folders, tmp_path / "store")
    with pytest.raises(TrainingError, match=r"found person-0001 .neutral. in another texture"):
        faces_of(store)


def test_a_network_of_other_proportions_than_the_maps_is_refused_before_it_is_trained(
    store_path: Path, tmp_path: Path
) -> None:
    # `infer` takes no texture for it.
    wide = dataclasses.replace(TINY, network=dataclasses.replace(SIZE, columns=48))
    with pytest.raises(TrainingError, match=r"found 48 x 48, expected rows : columns = 96 : 64"):
        train(open_store(store_path), tmp_path / "run", wide)
    assert not (tmp_path / "run").exists()


def test_the_modern_preset_refuses_what_cannot_be() -> None:
    modern = WholeTrainConfig(network=WholeFaceConfig(heads=8), batch=16)
    assert preset("modern", {}, "test") == modern
    for wrong, message in (
        ({"network": {"rows": 50}}, "network.rows: found 50, expected a multiple of 8"),
        ({"network": {"width": -1}}, "network.width: found -1, expected 2 or more"),
        ({"faces": {"partial_share": 2.0}}, "faces.partial_share: found 2.0"),
        ({"learning_rate": float("nan")}, "learning_rate: found nan"),
        ({"generator": {"width": 8}}, "an unknown key"),
    ):
        with pytest.raises(ConfigError, match=message):
            preset("modern", wrong, "test")


def test_the_shipped_weights_beat_the_plain_guesses_on_people_not_trained_on(
    strangers: list[Path], tmp_path: Path
) -> None:
    store = open_store(build_store(strangers, tmp_path / "store"))
    network, _ = load_whole_face(shipped_weights())
    people = {scan.subject for scan in store.scans}
    rng = np.random.default_rng(0)
    faces = Faces(store, people, network.config, PLAIN, RandomLightConfig(), OWN, rng)
    score = score_faces(network, faces, 3, 0)
    assert score.psnr_db > 23
    assert score.psnr_gain_db > 32
    assert score.psnr_db > max(score.psnr_input_db, score.psnr_mean_db) + 4
    assert score.specular_rmse < 0.9 * score.specular_constant_rmse
    assert 0.5 < score.deviation_ratio < 2
