"""The network of occlusion: its numbers beside plain float64, its training, and whom it serves."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from learning.checkpoint import shipped_weights
from learning.errors import CheckpointError, MapsError, TrainingError
from learning.maps import load_head
from learning.occlusion_run import (
    Head,
    bake_heads,
    fingerprint,
    load_occlusion_network,
    occlusion_network_for,
    read_head,
    save_occlusion,
    table_of,
)
from learning.relight import shadows_of
from learning.render import occlusion_training
from learning.render.light_dome import even_directions
from learning.render.occlusion_model import (
    OcclusionConfig,
    bake_dome,
    bake_table,
)
from learning.render.occlusion_network import (
    OcclusionNetwork,
    OcclusionNetworkConfig,
    described,
    shares,
    unit_directions,
)
from learning.render.occlusion_score import OcclusionScore, unseen_lights
from learning.render.occlusion_training import (
    BakedHeads,
    OcclusionTrainConfig,
    OcclusionTrainer,
    linear_fit,
)
from learning.render.uv import rasterise
from lightstage.formats.environment import LightSet
from lightstage.formats.files import write_json
from lightstage.formats.mesh import Mesh, read_mesh, write_obj
from lightstage.formats.processed import ProcessedFolder
from tests.learning.scenes import screen

SMALL = OcclusionNetworkConfig(lights=2, order=1, features=6, connected=8)
FIGURES = OcclusionScore(0.5, 0.1, 0.3, 0.2, 0.6, 0.2, 0.3, 3.0, 1.0, 2.0, 10)


def fresh(config: OcclusionNetworkConfig = SMALL, seed: int = 0) -> OcclusionNetwork:
    """Random weights and running means, one texel without surface."""
    torch.manual_seed(seed)
    network = OcclusionNetwork(config)
    for module in network.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            module.running_mean.uniform_(-0.5, 0.5)
            module.running_var.uniform_(0.2, 2.0)
            torch.nn.init.uniform_(module.weight, 0.5, 1.5)
            torch.nn.init.uniform_(module.bias, -0.5, 0.5)
    network.face.zero_()
    network.face[0, 0] = -1
    return network.eval()


def plain_elu(x: np.ndarray) -> np.ndarray:
    return np.where(x > 0, x, np.exp(np.minimum(x, 0)) - 1)


def plain_conv(x: np.ndarray, weight: np.ndarray, bias: np.ndarray) -> np.ndarray:
    """3 x 3 over (c, h, w), zeros around."""
    rows, columns = x.shape[1:]
    padded = np.pad(x, ((0, 0), (1, 1), (1, 1)))
    out = np.zeros((len(weight), rows, columns)) + bias[:, None, None]
    for i in range(3):
        for j in range(3):
            part = padded[:, i : i + rows, j : j + columns]
            out += np.einsum("oc,chw->ohw", weight[:, :, i, j], part)
    return out


def plain_doubled(x: np.ndarray, axis: int) -> np.ndarray:
    """Twice as long, linear between the centres: 3/4 of the nearest and 1/4 of the next."""
    count = x.shape[axis]
    before = np.take(x, np.maximum(np.arange(count) - 1, 0), axis)
    after = np.take(x, np.minimum(np.arange(count) + 1, count - 1), axis)
    both = np.stack([0.75 * x + 0.25 * before, 0.75 * x + 0.25 * after], axis=axis + 1)
    shape = list(x.shape)
    shape[axis] *= 2
    return both.reshape(shape)


def plain_occlusion(network: OcclusionNetwork, features: np.ndarray) -> np.ndarray:
    """One picture from L = [l_1 .. l_n, c_1 .. c_n], in float64."""
    value = {k: v.double().numpy() for k, v in network.state_dict().items()}

    def linear(name: str, x: np.ndarray) -> np.ndarray:
        return value[f"{name}.weight"] @ x + value[f"{name}.bias"]

    def normed(name: str, x: np.ndarray) -> np.ndarray:
        part = [value[f"{name}.{key}"][:, None, None] for key in ("running_mean", "running_var")]
        x = (x - part[0]) / np.sqrt(part[1] + 1e-5)
        return value[f"{name}.weight"][:, None, None] * x + value[f"{name}.bias"][:, None, None]

    x = linear("regressor", features)
    x = plain_elu(linear("widen.2", plain_elu(linear("widen.0", x))))
    x = x.reshape(network.small)
    for block in range(5):
        x = plain_doubled(plain_doubled(x, 1), 2)
        for conv, norm in ((0, 1), (3, 4)):
            name = f"decoder.{2 * block + 1}"
            bias = value[f"{name}.{conv}.bias"]
            x = plain_conv(x, value[f"{name}.{conv}.weight"], bias)
            x = plain_elu(normed(f"{name}.{norm}", x))
    x = plain_conv(x, value["decoder.10.weight"], value["decoder.10.bias"])[0]
    return np.where(value["face"] >= 0, 1 / (1 + np.exp(-x)), 1.0)


def test_the_networks_pictures_are_those_of_its_plain_twin_in_float64() -> None:
    network = fresh()
    position = np.array([[300.0, -200, 900], [-800, 100, 50]])
    rgb = np.array([[0.2, 0.4, 0.6], [0.1, 0.0, 0.2]])
    toward = position / np.linalg.norm(position, axis=1)[:, None]
    features = np.concatenate([toward.ravel(), [0.8, 0.2]])
    expected = plain_occlusion(network, features)
    given_ = torch.from_numpy(position).float(), torch.from_numpy(rgb).float()
    with torch.inference_mode():
        found = network.for_lights(*given_, (96, 64))
        exact = network.double().for_lights(*(x.double() for x in given_), (96, 64))
    np.testing.assert_allclose(exact[0].numpy(), expected, atol=1e-12)
    np.testing.assert_allclose(found[0].numpy(), expected, atol=1e-5)
    # All lights of a set have the set's picture; there is no shadow where no surface is.
    torch.testing.assert_close(found[1], found[0])
    assert float(found[0, 0, 0]) == 1
    assert expected[1:].std() > 0.005


def test_what_is_published_of_the_sizes_is_so() -> None:
    network = OcclusionNetwork(OcclusionNetworkConfig())
    for part in (network.encoder, network.decoder):
        blocks = [m for m in part.children() if isinstance(m, torch.nn.Sequential)]
        kinds = [[type(m).__name__ for m in block] for block in blocks]
        assert kinds == [2 * ["Conv2d", "BatchNorm2d", "ELU"]] * 5
    assert network.regressor.out_features == 64
    assert network.widen[0].out_features == 256


LARGE = 2.0**100
PLACES = st.floats(-LARGE, LARGE, width=32) | st.sampled_from([0.0, 1e-38, -1e-30, 3e38])
STRANGE = st.sampled_from([np.nan, np.inf, -np.inf])


@settings(max_examples=80, deadline=None)
@given(place=st.tuples(PLACES, PLACES, PLACES | STRANGE))
def test_a_direction_is_unit_or_it_is_nan(place: tuple[float, float, float]) -> None:
    given_ = torch.tensor([place, (1.0, 2.0, -2.0)], dtype=torch.float32)
    found = unit_directions(given_).numpy()
    np.testing.assert_allclose(found[1], [1 / 3, 2 / 3, -2 / 3], rtol=1e-6)
    exact = given_[0].double().numpy()
    if not np.isfinite(exact).all() or not exact.any():
        assert np.isnan(found[0]).any()
        return
    # Divided first as well: in float64 nothing of this is out of range.
    expected = exact / np.linalg.norm(exact)
    np.testing.assert_allclose(found[0], expected, atol=1e-5)


@settings(max_examples=80, deadline=None)
@given(
    strength=st.lists(
        st.floats(0, LARGE, width=32) | st.sampled_from([0.0, 3e38, 1e-38]), min_size=1, max_size=5
    )
)
def test_shares_sum_to_one_however_strong_or_dark_the_lights_are(strength: list[float]) -> None:
    given_ = torch.tensor([strength], dtype=torch.float32)
    found = shares(given_)[0].numpy()
    exact = given_[0].double().numpy()
    even = np.full(len(exact), 1 / len(exact))
    expected = exact / exact.sum() if exact.any() else even
    np.testing.assert_allclose(found, expected, atol=1e-5)
    assert torch.isnan(shares(torch.tensor([[np.nan, 1.0]]))).any()


def test_a_light_without_a_direction_spoils_its_own_picture_alone() -> None:
    network = fresh(dataclasses.replace(SMALL, lights=1))
    places = torch.tensor([[0.0, 0, 900], [0, 0, 0], [np.nan, 0, 1], [100, 0, 0]])
    with torch.inference_mode():
        found = network.for_lights(places, torch.ones(4, 3), (24, 16))
        alone = network.for_lights(places[[0, 3]], torch.zeros(2, 3), (24, 16))
    assert found.shape == (4, 24, 16)
    torch.testing.assert_close(found[[0, 3]], alone)
    assert torch.isnan(found[1, 12, 8])
    assert torch.isnan(found[2, 12, 8])


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 1000),
    dull=st.sampled_from(["none", "zeros", "equal columns", "one row"]),
)
def test_the_linear_fit_is_the_smallest_of_the_best(seed: int, dull: str) -> None:
    rng = np.random.default_rng(seed)
    inputs, outputs = rng.normal(size=(9, 4)), rng.normal(size=(9, 3))
    if dull == "zeros":
        inputs[:] = 0
    elif dull == "equal columns":
        inputs[:, 1] = inputs[:, 0]
    elif dull == "one row":
        inputs, outputs = inputs[:1], outputs[:1]
    expected = np.linalg.pinv(np.c_[inputs, np.ones(len(inputs))], rcond=1e-10) @ outputs
    weight, bias = linear_fit(torch.from_numpy(inputs), torch.from_numpy(outputs))
    np.testing.assert_allclose(weight.numpy(), expected[:-1].T, atol=1e-9)
    np.testing.assert_allclose(bias.numpy(), expected[-1], atol=1e-9)


def baked_screen(count: int = 64) -> BakedHeads:
    directions = even_directions(count)
    seen = bake_dome(screen(), 96, directions)[0] > 0.5
    return BakedHeads(rasterise(screen(), 96, 64), directions, seen[None])


def test_training_brings_the_pictures_nearer_to_unseen_shadows_and_the_seed_decides_all() -> None:
    baked = baked_screen()
    sizes = dataclasses.replace(SMALL, lights=1)
    config = OcclusionTrainConfig(sizes, steps=4, regressed=70, joint_steps=12, batch=6)
    unseen = unseen_lights([screen()], 96, 1, 20, np.random.default_rng(5))
    steps: list[tuple[int, int]] = []
    trainer = OcclusionTrainer(baked, config, lambda done, total: steps.append((done, total)))
    errors = []
    for stage in (trainer.train_autoencoder, trainer.fit_regressor, trainer.train_jointly):
        stage()
        errors.append(unseen.errors(unseen.by_network(trainer.network))[0])
    # Batch norm's running means are young after so few steps.
    assert errors[2] < 0.97 * errors[1]
    assert steps[-1] == (16, 16)

    def weights(seed: int) -> Tensor:
        quick = dataclasses.replace(config, steps=1, regressed=2, joint_steps=1, seed=seed)
        again = OcclusionTrainer(baked, quick)
        again.train_autoencoder()
        again.fit_regressor()
        again.train_jointly()
        return torch.cat([p.detach().flatten() for p in again.network.parameters()])

    first = weights(1)
    assert torch.equal(first, weights(1))
    assert not torch.equal(first, weights(2))


def test_a_loss_that_is_not_finite_ends_the_training(monkeypatch: pytest.MonkeyPatch) -> None:
    def nan(found: Tensor, expected: Tensor) -> Tensor:
        return (found * torch.nan).mean()

    monkeypatch.setattr(occlusion_training, "binary_cross_entropy_with_logits", nan)
    config = OcclusionTrainConfig(SMALL, steps=2, batch=2)
    with pytest.raises(TrainingError, match=r"step 0: found loss nan, .*learning_rate"):
        OcclusionTrainer(baked_screen(4), config).train_autoencoder()


def test_truth_is_the_rays_and_the_table_is_scored_as_it_serves() -> None:
    unseen = unseen_lights([screen(), screen()], 48, 2, 5, np.random.default_rng(0))
    seen, covered = bake_dome(screen(), 48, unseen.toward.reshape(-1, 3))
    one = seen.reshape(5, 2, -1)
    both = unseen.share[:, :1] * one[:, 0] + unseen.share[:, 1:] * one[:, 1]
    np.testing.assert_allclose(unseen.truth, [both, both], atol=1e-6)
    table = bake_table(screen(), OcclusionConfig(48, 300))
    flat = torch.from_numpy(unseen.toward.reshape(-1, 3)).float()
    single = table.for_lights(flat, (48, 32)).numpy().reshape(5, 2, 48, 32)
    error = np.abs((unseen.share[..., None, None] * single).sum(axis=1)[:, covered] - both).mean()
    np.testing.assert_allclose(unseen.errors(unseen.by_table(table)), [error, error], rtol=1e-5)
    assert unseen.errors(np.ones((5, 48, 32)))[0] > error > 0


def saved(folder: Path, mesh: Mesh, any_head: bool = True, lights: int = 1) -> Path:
    """A network of random weights for a mesh's UV."""
    network = fresh(dataclasses.replace(SMALL, lights=lights))
    with torch.no_grad():
        network.regressor.weight.mul_(50)  # so that pictures differ
    network.face.copy_(torch.from_numpy(rasterise(mesh, 96, 64).face))
    config = OcclusionTrainConfig(network.config)
    heads = [Head(mesh, fingerprint(mesh))]
    save_occlusion(folder, network, config, heads, any_head, FIGURES)
    return folder


def test_a_network_comes_back_and_serves_the_heads_of_its_uv_or_its_own_alone(
    people: list[ProcessedFolder], tmp_path: Path
) -> None:
    mesh, other = (read_mesh(person.registered_mesh) for person in people[:2])
    every, own = saved(tmp_path / "every", mesh), saved(tmp_path / "own", mesh, any_head=False)
    for path in (every, every / "checkpoint.json"):
        network, about = load_occlusion_network(path)
        assert not network.training
        assert about.metrics["table"] == FIGURES.table
        for name, value in fresh(network.config).state_dict().items():
            if name not in ("face", "regressor.weight"):
                torch.testing.assert_close(network.state_dict()[name], value)
    for head in (mesh, other):
        occlusion_network_for(every, head, 5)
    occlusion_network_for(own, mesh, 5)
    with pytest.raises(CheckpointError, match=r"heads: found 1 other head that it was trained on"):
        occlusion_network_for(own, other, 5)
    with pytest.raises(CheckpointError, match=r"uv: found \d+% of the texels show the triangle"):
        occlusion_network_for(every, screen(), 5)
    assert mesh.uvs is not None
    outside = dataclasses.replace(mesh, uvs=mesh.uvs + 5)
    with pytest.raises(CheckpointError, match=r"uv: found 0% of the texels"):
        occlusion_network_for(every, outside, 5)
    three = saved(tmp_path / "three", mesh, lights=3)
    occlusion_network_for(three, mesh, 3)
    with pytest.raises(CheckpointError, match=r"lights: found a network of 3 lights, expected one"):
        occlusion_network_for(three, mesh, 2)
    with pytest.raises(CheckpointError, match=r"family: found whole_face, expected occlusion"):
        occlusion_network_for(shipped_weights(), mesh, 2)
    index = json.loads((own / "checkpoint.json").read_text())
    del index["config"]["heads"]
    write_json(own / "checkpoint.json", index)
    with pytest.raises(CheckpointError, match=r"config.heads: found None"):
        occlusion_network_for(own, mesh, 5)


def test_heads_of_one_table_share_their_uv_and_lie_in_the_head_frame(
    people: list[ProcessedFolder], tmp_path: Path
) -> None:
    mesh = read_mesh(people[0].registered_mesh)
    turn = [[0.0, 0, 1, 10], [0, 1, 0, 20], [-1, 0, 0, 30]]
    path = write_obj(mesh, tmp_path / "registered_mesh.obj")
    write_json(tmp_path / "head_from_world.json", {"head_from_world": turn})
    head = read_head(path)
    x, y, z = mesh.vertices.T
    np.testing.assert_allclose(head.mesh.vertices, np.c_[z + 10, y + 20, 30 - x], atol=1e-9)
    assert head.fingerprint == fingerprint(mesh)
    sheet = Head(screen(), "")
    named = [path, tmp_path / "sheet.obj"]
    with pytest.raises(MapsError, match=r"sheet.obj, uv: found another layout"):
        bake_heads([head, sheet], OcclusionConfig(24, 4), named)
    baked = bake_heads([sheet] * 3, OcclusionConfig(24, 4), [path] * 3)
    assert baked.visibility.shape == (3, 4, 24 * 16)
    one = bake_table(screen(), OcclusionConfig(24, 4))
    np.testing.assert_array_equal(table_of(baked).bits, one.bits)


def test_shadows_are_those_of_the_lights_in_the_heads_frame(
    people: list[ProcessedFolder], tmp_path: Path
) -> None:
    mesh = read_mesh(people[0].registered_mesh)
    folder = saved(tmp_path / "net", mesh, lights=2)
    head = load_head(people[0].root / "atlas", mesh)
    place, rgb = np.array([[0.0, 300, 900], [500, 0, 700]]), np.array([[1.0, 1, 1], [0.5, 0, 0.1]])
    turn = np.array([[0.0, 0, 1, 10], [0, 1, 0, 20], [-1, 0, 0, 30]])
    lights = LightSet("k", place, rgb, np.zeros(3))
    found = shadows_of(head, lights, f"network:{folder}", turn)
    assert found is not None
    network, _ = load_occlusion_network(folder)
    moved = torch.from_numpy(place @ turn[:, :3].T + turn[:, 3]).float()
    with torch.inference_mode():
        expected = network.for_lights(moved, torch.from_numpy(rgb).float(), (96, 64))
    torch.testing.assert_close(found, expected[None])
    still = shadows_of(head, lights, f"network:{folder}")
    assert still is not None
    assert not torch.allclose(found, still, atol=1e-4)


def test_harmonics_distinguish_two_directions_by_their_angle_alone() -> None:
    rng = np.random.default_rng(4)
    pair = rng.normal(size=(2, 3))
    pair /= np.linalg.norm(pair, axis=1, keepdims=True)
    none = torch.zeros(2, 1).double()
    a, b = described(torch.from_numpy(pair)[:, None], none, 6).numpy()
    # The addition theorem: the sum over a band is its Legendre polynomial of the cosine.
    bands = [0.0, *(2 * band + 1.0 for band in range(1, 7))]
    expected = np.polynomial.legendre.legval(pair[0] @ pair[1], bands)
    assert len(a) == OcclusionNetworkConfig(order=6).light_features
    np.testing.assert_allclose(a @ b, expected, atol=1e-12)
    np.testing.assert_array_equal(
        described(torch.from_numpy(pair)[None], none.T, 1).numpy()[0], [*pair.ravel(), 0, 0]
    )
