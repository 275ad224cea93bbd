"""Super-resolution: the published network, exact tiles, pairs, its score, its command."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from learning.augment import AugmentConfig
from learning.checkpoint import (
    load_super_resolution,
    load_whole_face,
    shipped_super_resolution,
)
from learning.errors import CheckpointError, MapsError, TrainingError
from learning.presets import preset
from learning.render.environments import RandomLightConfig
from learning.train import train
from learning.upscale import infer
from learning.upscale.config import PicturesConfig, UpscaleTrainConfig
from learning.upscale.data import Pictures, downsampled
from learning.upscale.infer import enlarge_encoded, upscale
from learning.upscale.network import Rcan, RcanConfig
from learning.upscale.score import BLOCK_PX, Detail, detail, interpolated, score_upscaling
from lightstage.errors import ConfigError
from lightstage.formats.exr import read_exr, write_exr
from processing.dataset import build_store, open_store
from sim.people.dataset import make_plan, write_people
from sim.people.table import load_table
from tests.learning.export.called import printed, refusal

SMALL = RcanConfig(groups=2, blocks=2, width=8, tail_width=6, reduction=2)
TINY = UpscaleTrainConfig(
    network=dataclasses.replace(SMALL, times=4, beside_bicubic=True),
    pictures=PicturesConfig(patch_px=12, count=4, shadow_sets=2),
    batch=2,
    steps=60,
    learning_rate=3e-3,
    log_steps=1,
    score_lights=1,
)


def network_of(config: RcanConfig) -> Rcan:
    """Random weights under which attention and every layer matter, and answers are about 1."""
    torch.manual_seed(0)
    network = Rcan(config).eval()
    with torch.no_grad():
        for weights in network.parameters():
            weights.copy_(0.3 * torch.randn_like(weights))
        last = network.last
        last.weight.div_(3 * network(torch.rand(1, 3, 16, 16)).std())
        last.bias.zero_()  # type: ignore[union-attr]
    return network


def curve(linear: np.ndarray) -> np.ndarray:
    power = 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055
    return np.where(linear <= 0.0031308, 12.92 * linear, power)


def inverse(encoded: np.ndarray) -> np.ndarray:
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def pictures_of(
    store_path: Path, times: int = 8, config: PicturesConfig = TINY.pictures, seed: int = 0
) -> Pictures:
    store = open_store(store_path)
    people = {scan.subject for scan in store.scans}
    skins, lights = AugmentConfig(), RandomLightConfig()
    rng = np.random.default_rng(seed)
    return Pictures(store, people, times, 6, config, lights, skins, rng)


def test_the_published_preset_has_the_published_layers_and_weights() -> None:
    config = preset("rcan", {}, "test")
    assert isinstance(config, UpscaleTrainConfig)
    network = Rcan(config.network)

    def convolution(channels: int, out: int, side: int = 3) -> int:
        return out * (channels * side**2 + 1)

    block = 2 * convolution(64, 64) + convolution(64, 4, 1) + convolution(4, 64, 1)
    body = 10 * (20 * block + convolution(64, 64)) + convolution(64, 64)
    tail = 3 * convolution(64, 256) + convolution(64, 3)
    count = sum(weights.numel() for weights in network.parameters())
    assert count == convolution(3, 64) + body + tail == 15_740_067
    assert (config.learning_rate, config.batch, config.pictures.patch_px) == (1e-4, 16, 64)
    # Halved every 200,000 steps.
    assert config.steps // config.rates == 200_000
    assert not config.network.beside_bicubic


@pytest.mark.parametrize("times", [2, 4, 8])
def test_a_network_enlarges_as_its_configuration_says(times: int) -> None:
    network = network_of(dataclasses.replace(SMALL, times=times))
    with torch.inference_mode():
        assert network(torch.rand(2, 3, 9, 11)).shape == (2, 3, 9 * times, 11 * times)


def test_beside_bicubic_an_untrained_network_gives_opencvs_result() -> None:
    rng = np.random.default_rng(0)
    image = rng.random((12, 10, 3)).astype(np.float32)
    network = Rcan(dataclasses.replace(SMALL, beside_bicubic=True)).eval()
    expected = interpolated(image, 8, cv2.INTER_CUBIC)
    np.testing.assert_allclose(enlarge_encoded(network, image), expected, atol=1e-5)


def test_the_network_in_float32_is_that_in_float64() -> None:
    network = network_of(SMALL)
    picture = torch.rand(1, 3, 12, 10)
    with torch.inference_mode():
        single = network(picture)
        double = network.double()(picture.double())
    assert float(double.std()) > 0.1
    torch.testing.assert_close(single.double(), double, atol=1e-5, rtol=1e-4)


@settings(max_examples=15, deadline=None)
@given(
    st.integers(3, 30),
    st.tuples(st.integers(0, 2), st.integers(0, 29)),
    st.sampled_from([2, 4, 8]),
    st.booleans(),
)
def test_any_size_and_offset_of_tiles_gives_the_whole_pictures_texture(
    tile_px: int, offset_px: tuple[int, int], times: int, beside_bicubic: bool
) -> None:
    network = network_of(dataclasses.replace(SMALL, times=times, beside_bicubic=beside_bicubic))
    image = np.random.default_rng(tile_px).random((26, 19, 3)).astype(np.float32)
    offset = (offset_px[0], offset_px[1] % tile_px)
    with torch.inference_mode():
        whole = network(torch.from_numpy(image.transpose(2, 0, 1)[None].copy()))
    expected = whole[0].permute(1, 2, 0).numpy()
    assert expected.std() > 0.1
    found = enlarge_encoded(network, image, tile_px, offset)
    np.testing.assert_allclose(found, expected, atol=1e-4)


def test_tiles_with_less_around_them_or_attention_of_their_own_would_show(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    network = network_of(SMALL)
    image = np.random.default_rng(0).random((24, 24, 3)).astype(np.float32)
    expected = enlarge_encoded(network, image, 24)
    monkeypatch.setattr(infer, "TAIL_REACH_PX", 1)
    assert np.abs(enlarge_encoded(network, image, 12) - expected).max() > 1e-4
    alone = enlarge_encoded(network, np.ascontiguousarray(image[:, :16]), 24)
    # Far from the cut, further than any convolution reaches but not further than means.
    assert np.abs(alone[:, :8] - expected[:, :8]).max() > 1e-4


@given(
    arrays.arrays(np.float32, (16, 24, 3), elements=st.sampled_from([0.0, 1e-6, 0.03, 0.5, 1.0]))
)
@settings(max_examples=20, deadline=None)
def test_a_texel_of_the_input_is_the_mean_light_of_those_it_stands_for(image: np.ndarray) -> None:
    encoded = torch.from_numpy(image.transpose(2, 0, 1)[None].copy())
    linear = inverse(image.astype(np.float64)).reshape(2, 8, 3, 8, 3).mean(axis=(1, 3))
    found = downsampled(encoded, 8)[0].permute(1, 2, 0).numpy()
    np.testing.assert_allclose(found, curve(linear), atol=1e-5)


def test_patches_are_pairs_on_the_surface_and_mirrored_at_most_sideways(store_path: Path) -> None:
    plain = dataclasses.replace(TINY.pictures, patch_px=6, mirrored_share=0.0)
    mirrored = dataclasses.replace(plain, mirrored_share=1.0)
    straight, other = (
        pictures_of(store_path, config=plain),
        pictures_of(store_path, config=mirrored),
    )
    pairs = straight.draw(8, np.random.default_rng(1))
    assert pairs.inputs.shape == (8, 3, 6, 6)
    assert pairs.target.shape == (8, 3, 48, 48)
    # Half floats of the truth are a thousandth off.
    torch.testing.assert_close(downsampled(pairs.target, 8), pairs.inputs, atol=2e-3, rtol=0)
    again = straight.draw(8, np.random.default_rng(1))
    assert torch.equal(again.target, pairs.target)
    flipped = other.draw(8, np.random.default_rng(1))
    assert torch.equal(flipped.inputs, pairs.inputs.flip(3))
    assert torch.equal(flipped.target, pairs.target.flip(3))
    # One lit texture and one albedo of each of three people.
    assert len(straight.pictures) == 6
    assert all(picture.high.shape == (3, 96, 64) for picture in straight.pictures)


def test_maps_smaller_than_a_patch_are_refused_before_any_step(store_path: Path) -> None:
    large = dataclasses.replace(TINY.pictures, patch_px=64)
    with pytest.raises(TrainingError, match=r"patches of 512 texels: found none .* Lower pictures"):
        pictures_of(store_path, config=large)


def twin(found: np.ndarray, true: np.ndarray, times: int) -> tuple[float, float]:
    """Energy ratio and correlation of one block, by explicit cosines."""
    place = np.arange(BLOCK_PX)
    basis = np.cos(np.pi * np.outer(place, 2 * place + 1) / (2 * BLOCK_PX))
    basis *= np.sqrt(2 / BLOCK_PX)
    basis[0] /= np.sqrt(2)
    recorded = place / (2 * BLOCK_PX) <= 1 / (2 * times)
    spectra = [np.einsum("kr,rcx,lc->klx", basis, image, basis) for image in (found, true)]
    f, t = (spectrum[~(recorded[:, None] & recorded)] for spectrum in spectra)
    return float((f * f).sum() / (t * t).sum()), float(
        (f * t).sum() / np.sqrt((f * f).sum() * (t * t).sum())
    )


def test_detail_is_that_of_a_plain_twin_and_tells_true_from_invented() -> None:
    rng = np.random.default_rng(0)
    side, everywhere = BLOCK_PX, np.ones((BLOCK_PX, BLOCK_PX), bool)
    true = rng.random((side, side, 3))
    found = 0.5 * true + 0.2 * rng.random((side, side, 3))
    compared = detail(found, true, everywhere, 8)
    assert (compared.energy, compared.correlation) == pytest.approx(twin(found, true, 8))
    assert detail(true, true, everywhere, 8).energy == pytest.approx(1)
    invented = detail(rng.random((side, side, 3)), true, everywhere, 8)
    assert invented.energy > 0.8
    assert abs(invented.correlation) < 0.1
    # A slope that the input records has next to nothing beyond its band.
    slope = np.broadcast_to(np.linspace(0, 1, side)[:, None, None], (side, side, 3))
    assert detail(slope, true, everywhere, 8).energy < 1e-3
    assert detail(found, true, everywhere & False, 8) == Detail()


def test_an_untrained_network_beside_bicubic_scores_as_bicubic(store_path: Path) -> None:
    network = Rcan(dataclasses.replace(SMALL, times=2, beside_bicubic=True)).eval()
    pictures = pictures_of(store_path, 2, dataclasses.replace(TINY.pictures, patch_px=16)).pictures
    score = score_upscaling(network, pictures)
    assert score.psnr_db == pytest.approx(score.psnr_bicubic_db, abs=1e-3)
    bicubic = Detail()
    for picture in pictures:
        low, true = (x.float().permute(1, 2, 0).numpy() for x in (picture.low, picture.high))
        enlarged = interpolated(np.ascontiguousarray(low), 2, cv2.INTER_CUBIC)
        bicubic += detail(np.clip(enlarged, 0, 1), true, picture.skin, 2)
    assert score.correlation == pytest.approx(bicubic.correlation, abs=1e-3)
    assert score.energy == pytest.approx(bicubic.energy, rel=1e-2)
    bare = dataclasses.replace(pictures[0], skin=np.zeros_like(pictures[0].skin))
    with pytest.raises(TrainingError, match="no captured skin"):
        score_upscaling(network, [bare])


def test_training_beats_bicubic_and_scores(store_path: Path, tmp_path: Path) -> None:
    whole = train(open_store(store_path), tmp_path / "whole", TINY)
    assert (whole.steps, whole.held_out) == (60, ["person-2"])
    assert whole.score.psnr_db > whole.score.psnr_bicubic_db + 0.5
    assert "bicubic" in whole.score.sentence()
    lines = [json.loads(s) for s in (tmp_path / "whole" / "metrics.jsonl").read_text().splitlines()]
    rates = [line["learning_rate"] for line in lines[:-1]]
    assert rates[0] == TINY.learning_rate
    assert rates[-1] == pytest.approx(TINY.learning_rate / 16)
    network = load_super_resolution(tmp_path / "whole")[0]
    rng = np.random.default_rng([TINY.seed, 1])
    trained_on, how = {"person-0", "person-1"}, (TINY.lights, TINY.augment, rng, TINY.shading)
    own = Pictures(open_store(store_path), trained_on, 4, 4, TINY.pictures, *how)
    colours = [p.low.numpy()[:, (p.low > 0).any(dim=0).numpy()] for p in own.pictures]
    mean = np.concatenate(colours, axis=1).mean(axis=1, dtype=float)
    np.testing.assert_allclose(network.mean_srgb.numpy(), mean, rtol=1e-4)
    with pytest.raises(CheckpointError, match="found super_resolution, expected whole_face"):
        load_whole_face(tmp_path / "whole")


def test_light_above_white_stays_and_what_is_below_black_is_black() -> None:
    network = Rcan(dataclasses.replace(SMALL, beside_bicubic=True)).eval()
    image = np.full((10, 10, 3), 4.0, np.float32)
    image[:, :, 2] = -1.0
    large = upscale(network, image)
    np.testing.assert_allclose(large[..., :2], 4.0, rtol=1e-4)
    assert not large[..., 2].any()


def test_pictures_that_cannot_be_enlarged_are_refused() -> None:
    network = network_of(SMALL)
    for image, message in (
        (np.zeros((16, 16), np.float32), "found one channel"),
        (np.zeros((4, 400, 3), np.float32), "found 4 x 400 texels, expected 8 or more"),
        (np.zeros((2048, 2048, 3), np.float32), "at most 2 million"),
    ):
        with pytest.raises(MapsError, match=message):
            upscale(network, image, "t.exr")


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"network": {"times": 3}}, "network.times: found 3, expected 2, 4 or 8"),
        ({"network": {"width": 8}}, "network.reduction: found 16, expected at most 8"),
        ({"network": {"groups": 0}}, "network.groups: found 0"),
        ({"pictures": {"patch_px": 2}}, "pictures.patch_px: found 2"),
        ({"generator": {"width": 8}}, "an unknown key"),
    ],
)
def test_the_preset_refuses_what_cannot_be(wrong: dict[str, dict[str, int]], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        preset("rcan", wrong, "test")


TINY_TOML = """
steps = 20
batch = 2
score_lights = 1
[network]
groups = 1
blocks = 1
width = 8
[pictures]
patch_px = 8
count = 4
shadow_sets = 2
"""


def test_train_then_upscale_by_the_commands(store_path: Path, tmp_path: Path) -> None:
    config, trained = tmp_path / "tiny.toml", tmp_path / "run"
    config.write_text(TINY_TOML)
    words = ["train", "--preset", "rcan-small", "--config", config, "--data", store_path]
    assert "textures of the people held out (person-2): PSNR" in printed(*words, "--out", trained)
    rng = np.random.default_rng(0)
    picture = write_exr(tmp_path / "small.exr", rng.random((12, 10, 3)))
    large = tmp_path / "large.exr"
    asked = ["upscale", picture, "--checkpoint", trained, "--out", large]
    facts = json.loads(printed(*asked, "--times", 8, "--json").splitlines()[-1])
    assert (facts["rows"], facts["columns"], facts["trained_rows"]) == (96, 80, 96)
    found = read_exr(large, finite=True)
    assert found.shape == (96, 80, 3)
    small = read_exr(picture)
    assert abs(found.mean() - small.mean()) < 0.1
    large.unlink()
    assert "--times: found 64, expected 8" in refusal(*asked, "--times", 64)
    assert not large.exists()


def test_the_shipped_weights_beat_bicubic_on_a_person_not_trained_on(tmp_path: Path) -> None:
    write_people(make_plan(tmp_path / "people", load_table("balanced"), 1, 1, 900, 768), jobs=1)
    folders = sorted(path.parent for path in (tmp_path / "people").glob("*/report.json"))
    store_path = build_store(folders, tmp_path / "store")
    network, _ = load_super_resolution(shipped_super_resolution())
    store, rng = open_store(store_path), np.random.default_rng(0)
    people, own = {scan.subject for scan in store.scans}, AugmentConfig(0.0, 0.0)
    how = PicturesConfig(shadow_sets=1)
    pictures = Pictures(store, people, 8, 4, how, RandomLightConfig(), own, rng).pictures
    score = score_upscaling(network, pictures)
    assert score.psnr_db > score.psnr_bicubic_db + 1
    assert score.energy_lanczos < score.energy < 1
    assert score.correlation > score.correlation_lanczos
