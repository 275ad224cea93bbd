"""Pores and folds: evidence in a texture, exact tiles, mirrored patches, training, use."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy.ndimage import gaussian_filter

from learning.augment import AugmentConfig
from learning.checkpoint import load_mesostructure, load_whole_face, shipped_weights
from learning.errors import TrainingError
from learning.maps import load_head
from learning.mesostructure import train as mesostructure_train
from learning.mesostructure.config import LitPatchesConfig, MesostructureTrainConfig
from learning.mesostructure.data import ACROSS, SAID_ACROSS, LitPatches, PatchPool, mirrored
from learning.mesostructure.evidence import (
    CHANNELS,
    MOST_DETAIL,
    MOST_SLOPE,
    detail_of,
    evidence,
    frame_of,
    slope_of,
)
from learning.mesostructure.infer import TrainedMesostructure, find, in_tiles
from learning.mesostructure.network import SAID_CHANNELS, Mesostructure, MesostructureConfig
from learning.mesostructure.score import angle_deg
from learning.relight import lit_texture, shadows_of
from learning.train import train
from learning.whole.infer import infer_whole_face
from lightstage.formats.environment import LightSet
from lightstage.formats.exr import read_exr, write_exr
from lightstage.formats.mesh import read_mesh
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.template import default_template_path, load_template
from processing.dataset import build_store, open_store
from tests.learning.export.called import printed, refusal
from tests.learning.test_whole_face import stopping_after

TINY = MesostructureTrainConfig(
    network=MesostructureConfig(width=8),
    patches=LitPatchesConfig(patch_px=32, textures=8, of_each=8, shadow_sets=2),
    batch=8,
    steps=250,
    learning_rate=5e-3,
    log_steps=1,
    score_lights=1,
)


def network_of(width: int = 6) -> Mesostructure:
    """Random weights under which every layer matters."""
    torch.manual_seed(0)
    network = Mesostructure(MesostructureConfig(width)).eval()
    with torch.no_grad():
        for weights in network.parameters():
            weights.copy_(0.2 * torch.randn_like(weights))
    return network


def ball(side: int = 48) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normals, positions and texels of a ball's front of 100 mm, seen along z."""
    y, x = np.mgrid[0:side, 0:side].astype(np.float32)
    x, y = (2 * x + 1) / side - 1, 1 - (2 * y + 1) / side
    covered = x**2 + y**2 < 0.9
    z = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    normal = np.stack([x, y, z], axis=2) * covered[..., None]
    return normal, 100 * normal, covered


def plain_irradiance(
    normal: np.ndarray, position_mm: np.ndarray, lamps_mm: np.ndarray, strength: np.ndarray
) -> np.ndarray:
    """Float64, a lamp after the other."""
    total = np.zeros(normal.shape[:2])
    for lamp, power in zip(lamps_mm.astype(float), strength, strict=True):
        toward = lamp - position_mm.astype(float)
        distance = np.linalg.norm(toward, axis=2)
        cosine = np.maximum((toward * normal).sum(axis=2) / distance, 0)
        total += power * cosine * (lamp @ lamp) / distance**2
    return total


LAMPS_MM = np.array([[500.0, 300.0, 800.0], [-900.0, 100.0, 500.0]])
STRENGTH = np.array([0.7, 0.4])


def test_the_slope_of_light_is_what_a_small_tilt_changes() -> None:
    normal, position, covered = ball()
    frame = frame_of(normal, position, covered)
    level = plain_irradiance(normal, position, LAMPS_MM, STRENGTH) + 0.1
    seen = np.ones((2, *covered.shape))
    slope = slope_of(frame, position, LAMPS_MM, STRENGTH, seen, level)
    step = 1e-3
    # Lamps that the texel faces well: at its terminator a lamp comes and goes.
    inner = covered & (normal @ (LAMPS_MM / np.linalg.norm(LAMPS_MM, axis=1)[:, None]).T > 0.3).all(
        axis=2
    )
    for axis in range(2):
        tilt = np.zeros((*covered.shape, 2))
        tilt[..., axis] = step
        turned = plain_irradiance(frame.tilted(tilt), position, LAMPS_MM, STRENGTH) + 0.1
        change = (turned - level) / step / level
        np.testing.assert_allclose(slope[inner][:, axis], change[inner], atol=2e-3)


def test_tilted_normals_have_their_tilts_and_are_unit() -> None:
    normal, position, covered = ball()
    frame = frame_of(normal, position, covered)
    tilt = np.random.default_rng(0).uniform(-0.4, 0.4, (*covered.shape, 2))
    turned = frame.tilted(tilt)
    np.testing.assert_allclose(np.linalg.norm(turned[covered], axis=1), 1, atol=1e-5)
    np.testing.assert_allclose(frame.tilt_of(turned)[covered], tilt[covered], atol=1e-5)
    assert not frame.tilt_of(-turned).any()
    first, second = (torch.from_numpy(t.transpose(2, 0, 1))[None] for t in (tilt, 0 * tilt))
    angle = angle_deg(first, second)[0].numpy()
    cosine = (turned * normal).sum(axis=2)
    np.testing.assert_allclose(
        angle[covered], np.degrees(np.arccos(np.clip(cosine[covered], -1, 1))), atol=0.05
    )


def test_a_frame_of_one_texel_or_across_a_seam_is_still_unit_and_perpendicular() -> None:
    normal, position, covered = ball()
    position = position.copy()
    position[:, 24:] += 500
    alone = np.zeros_like(covered)
    alone[20, 20] = True
    for there in (covered, alone):
        shape = normal * there[..., None]
        frame = frame_of(shape, position * there[..., None], there)
        for axis in (frame.across, frame.up):
            np.testing.assert_allclose(np.linalg.norm(axis[there], axis=1), 1, atol=1e-5)
            assert np.abs((axis * shape).sum(axis=2)).max() < 1e-5


@settings(max_examples=25, deadline=None)
@given(
    arrays.arrays(np.float32, (12, 8, 3), elements=st.floats(-1e6, 1e6, width=32, allow_nan=False)),
    arrays.arrays(np.float32, (12, 8), elements=st.floats(0, 1e6, width=32)),
    arrays.arrays(bool, (12, 8)),
)
def test_evidence_of_anything_is_finite_and_bounded(
    logarithm: np.ndarray, level: np.ndarray, known: np.ndarray
) -> None:
    detail = detail_of(logarithm, known)
    assert np.abs(detail).max() <= MOST_DETAIL
    normal, position, covered = ball(12)
    normal, position, covered = (x[:, :8] for x in (normal, position, covered))
    frame = frame_of(normal, position, covered)
    lamps = np.array([[0.0, 0.0, 0.0], [50.0, 20.0, 86.0]])
    seen = np.ones((2, 12, 8))
    slope = slope_of(frame, position, lamps, np.array([1e6, 1e-6]), seen, level)
    assert np.linalg.norm(slope, axis=2).max() <= MOST_SLOPE * (1 + 1e-5)
    given_all = evidence(detail, slope, level, known)
    assert np.isfinite(given_all).all()
    assert not given_all[~known].any()


def test_what_was_not_photographed_may_be_nan() -> None:
    logarithm = np.zeros((24, 16, 3), np.float32)
    known = np.ones((24, 16), bool)
    known[:4] = False
    logarithm[:4] = np.nan
    assert not detail_of(logarithm, known).any()


@pytest.mark.parametrize("tile_px", [7, 32, 64])
def test_tiles_of_any_size_find_the_same(tile_px: int) -> None:
    trained = TrainedMesostructure(network_of(), 64)
    whole = np.random.default_rng(1).normal(size=(64, 48, CHANNELS)).astype(np.float32)
    whole[..., -1] = 1
    once = in_tiles(trained, whole, 1000)
    assert np.abs(once).max() > 1
    np.testing.assert_allclose(in_tiles(trained, whole, tile_px), once, rtol=1e-5, atol=1e-4)


def test_an_answer_depends_on_nothing_beyond_its_reach() -> None:
    network = network_of()
    side = 2 * network.reach_px + 3
    given = torch.randn(1, CHANNELS, side, side)
    given[:, -1] = 1
    changed = given.clone()
    changed[:, :-1, :, 0] += 1
    with torch.inference_mode():
        difference = (network(changed) - network(given)).abs().amax(dim=(0, 1, 2))
    assert difference[network.reach_px] > 0
    assert difference[network.reach_px + 1 :].max() < 1e-6


def test_all_detail_is_skin_by_an_untrained_network() -> None:
    trained = TrainedMesostructure(Mesostructure(MesostructureConfig(4)).eval(), 48)
    unlit = np.random.default_rng(2).uniform(0.1, 0.9, (48, 32, 3)).astype(np.float32)
    known = np.ones((48, 32), bool)
    level = np.ones((24, 16), np.float32)
    found = find(trained, unlit, known, np.zeros((24, 16, 2), np.float32), level)
    assert not any(np.any(x) for x in (found.diffuse_tilt, found.specular_tilt, found.shading))
    assert trained.least_rows == 24


@pytest.mark.parametrize("rows", [24, 48, 96])
def test_textures_of_other_sizes_come_back_at_their_own(rows: int) -> None:
    trained = TrainedMesostructure(network_of(), 48)
    size = (rows, rows * 2 // 3)
    unlit = np.random.default_rng(2).uniform(0.1, 0.9, (*size, 3)).astype(np.float32)
    known = np.ones(size, bool)
    known[: rows // 4] = False
    slope, level = np.ones((*size, 2), np.float32), np.ones(size, np.float32)
    found = find(trained, unlit, known, slope, level)
    assert found.shading.shape == (*size, 3)
    # The network sees means over more texels than its own, and what is between fewer linearly.
    mean, linear = cv2.INTER_AREA, cv2.INTER_LINEAR

    def at_48_rows(image: np.ndarray) -> np.ndarray:
        how = mean if rows > 48 else linear
        return cv2.resize(image.astype(np.float32), (32, 48), interpolation=how)

    there = np.ones((48, 32), bool)
    # Nothing is known between a row that is known and one that is not.
    there[: 13 if rows < 48 else 12] = False
    detail = detail_of(at_48_rows(np.log(unlit)), there)
    answer = in_tiles(trained, evidence(detail, at_48_rows(slope), at_48_rows(level), there))
    answer *= there[..., None]
    back = cv2.resize(answer, size[::-1], interpolation=mean if rows < 48 else linear)
    back *= known[..., None]
    np.testing.assert_allclose(found.diffuse_tilt, back[..., :2], rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(found.specular_tilt, back[..., 2:4], rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(found.shading, back[..., 4:], rtol=1e-4, atol=1e-4)
    assert not found.diffuse_tilt[~known].any()


def test_a_mirrored_patch_has_mirrored_tilts() -> None:
    """What is lit from the left and tilted left becomes lit from the right and tilted right."""
    _, position, covered = ball()
    other = position[:, ::-1] * (-1, 1, 1)
    lamp, strength, seen = LAMPS_MM[:1], STRENGTH[:1], np.ones((1, *covered.shape))
    tilt = np.random.default_rng(0).uniform(-0.2, 0.2, (*covered.shape, 2))
    given = []
    for place, lamps, sign in ((position, lamp, 1), (other, lamp * (-1, 1, 1), -1)):
        shape = (place / 100).astype(np.float32)
        frame = frame_of(shape, place, covered)
        turned = frame.tilted(tilt if sign > 0 else tilt[:, ::-1] * (-1, 1))
        level = plain_irradiance(shape, place, lamps, strength) + 0.1
        light = plain_irradiance(turned, place, lamps, strength) + 0.1
        logarithm = np.log(light / level)[..., None] * np.ones(3)
        slope = slope_of(frame, place, lamps, strength, seen, level)
        both = (
            evidence(detail_of(logarithm, covered), slope, level, covered),
            frame.tilt_of(turned),
        )
        given.append([torch.from_numpy(x.transpose(2, 0, 1).astype(np.float32)) for x in both])
    for one, two, across in zip(*given, (ACROSS, SAID_ACROSS[:1]), strict=True):
        np.testing.assert_allclose(mirrored(one, across).numpy(), two.numpy(), atol=2e-5)


@pytest.fixture(scope="module")
def bumpy(strangers: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store of three people whose true normals wave over the mesh's, their albedo flat."""
    root, folders = tmp_path_factory.mktemp("bumpy"), []
    rng = np.random.default_rng(7)
    for source in strangers:
        folder = ProcessedFolder(Path(shutil.copytree(source, root / source.name)))
        position = folder.read_atlas("position")
        covered = (position != 0).any(axis=2)
        frame = frame_of(folder.read_atlas("diffuse_normal"), position, covered)
        height = rng.normal(size=covered.shape)
        waves = np.stack([gaussian_filter(height, 2, order) for order in ((0, 1), (1, 0))], axis=2)
        turned = frame.tilted(0.15 * waves / waves.std()) * covered[..., None]
        for name in ("diffuse_normal", "specular_normal"):
            folder.write_atlas(name, turned.astype(np.float32))
        albedo = folder.read_atlas("diffuse_albedo")
        folder.write_atlas("diffuse_albedo", np.where(albedo > 0, np.float32(0.4), 0))
        folders.append(folder.root)
    return build_store(folders, root / "store")


@pytest.fixture(scope="module")
def run(bumpy: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("mesostructure") / "run"
    train(open_store(bumpy), out, TINY)
    return out


def test_training_brings_the_losses_down_and_leaves_figures(run: Path) -> None:
    network, checkpoint = load_mesostructure(run)
    assert checkpoint.family == "mesostructure"
    figures = checkpoint.metrics
    assert figures["shape_diffuse_deg"] > 5
    assert figures["diffuse_normal_deg"] < 0.9 * figures["shape_diffuse_deg"]
    assert figures["specular_normal_deg"] < 0.9 * figures["shape_specular_deg"]
    assert figures["psnr_db"] > figures["psnr_skin_db"] + 3
    with torch.inference_mode():
        assert network(torch.ones(1, CHANNELS, 8, 8)).shape == (1, SAID_CHANNELS, 8, 8)


def test_people_held_out_are_scored_with_their_own_skin(
    store_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: dict[str, tuple[LitPatchesConfig, AugmentConfig]] = {}

    def noted(
        _: Any,
        people: set[str],
        patches: LitPatchesConfig,
        __: Any,
        skins: AugmentConfig,
        *___: Any,
    ) -> SimpleNamespace:
        made[people.pop()] = patches, skins
        return SimpleNamespace(draw=None, patches=[])

    monkeypatch.setattr(mesostructure_train, "PatchPool", noted)
    trainer: Any = SimpleNamespace(config=TINY)
    run: Any = None
    task = mesostructure_train.mesostructure_task
    task(trainer, open_store(store_path), {"trained on"}, {"held out"}, run)
    patches, skins = made["trained on"]
    assert (patches.contrast, skins) == (TINY.patches.contrast, TINY.augment)
    patches, skins = made["held out"]
    assert (patches.contrast, skins) == ((1, 1), TINY.augment.as_they_are())


def test_an_interrupted_training_goes_on_to_the_same_bits(bumpy: Path, tmp_path: Path) -> None:
    store, straight, again = open_store(bumpy), tmp_path / "straight", tmp_path / "again"
    few = dataclasses.replace(TINY.patches, textures=2, of_each=4, shadow_sets=1)
    short = dataclasses.replace(TINY, patches=few, steps=8)
    train(store, straight, short)
    with pytest.raises(KeyboardInterrupt):
        train(store, again, short, progress=stopping_after(3))
    train(store, again, short, resume=True)
    for one, two in zip(
        load_mesostructure(straight)[0].state_dict().values(),
        load_mesostructure(again)[0].state_dict().values(),
        strict=True,
    ):
        assert torch.equal(one, two)


def test_patches_that_show_no_skin_are_refused(store_path: Path) -> None:
    store = open_store(store_path)
    people = {scan.subject for scan in store.scans}
    config = dataclasses.replace(TINY.patches, patch_px=1000)
    with pytest.raises(TrainingError, match="patches of 1000 texels"):
        PatchPool(store, people, config, TINY.lights, TINY.augment, np.random.default_rng(0))


def test_a_batch_is_drawn_alike_by_one_process_and_by_two(store_path: Path) -> None:
    store = open_store(store_path)
    people = {scan.subject for scan in store.scans}
    rng = np.random.default_rng(0)
    pool = PatchPool(store, people, TINY.patches, TINY.lights, TINY.augment, rng)

    def drawn(share: slice) -> LitPatches:
        return pool.draw(4, np.random.default_rng(5), share)

    whole, parts = drawn(slice(None)), [drawn(slice(0, 2)), drawn(slice(2, 4))]
    assert torch.equal(whole.inputs, torch.cat([part.inputs for part in parts]))
    assert whole.inputs.shape == (4, CHANNELS, 32, 32)
    assert whole.target.shape == (4, SAID_CHANNELS, 32, 32)


LAMP = LightSet(
    "one hard lamp", np.array([[800.0, 500.0, 700.0]]), np.full((1, 3), 1.0), np.full(3, 0.05)
)


def test_infer_tilts_the_meshs_normals_where_the_texture_tells_and_nowhere_else(
    strangers: list[Path], run: Path, tmp_path: Path
) -> None:
    person = ProcessedFolder(strangers[0])
    mesh = read_mesh(person.registered_mesh)
    head = load_head(person.root / "atlas", mesh, load_template(default_template_path()))
    texture = lit_texture(head, LAMP, np.array([0.0, 0.0, 1100.0]), seen=shadows_of(head, LAMP))
    texture[:40] = 0
    write_exr(tmp_path / "T.exr", texture)
    trained, about = load_mesostructure(run)
    assert about.texture_rows == 192
    asked = ["infer", "--texture", str(tmp_path / "T.exr"), "--mesh", str(person.registered_mesh)]
    found = {}
    for name, chosen in (("with", str(run)), ("without", "none")):
        out = tmp_path / name
        main_args = [*asked, "--out", str(out), "--mesostructure", chosen, "--refine", "600"]
        printed(*main_args)
        found[name] = {k: read_exr(out / f"{k}.exr") for k in ("diffuse_normal", "specular_normal")}
    angle = (found["with"]["diffuse_normal"] * found["without"]["diffuse_normal"]).sum(axis=2)
    there = head.raster.covered
    assert angle[there].min() < np.cos(np.radians(0.2))
    np.testing.assert_allclose(angle[:40][there[:40]], 1, atol=2e-3)
    lengths = np.linalg.norm(found["with"]["specular_normal"][there], axis=1)
    np.testing.assert_allclose(lengths, 1, atol=1e-3)
    # In other axes the same normals come out, turned.
    network, _ = load_whole_face(shipped_weights())
    turn = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    elsewhere = dataclasses.replace(mesh, vertices=mesh.vertices @ turn.T + (5.0, -3.0, 40.0))
    meso = TrainedMesostructure(trained, about.texture_rows)
    maps = infer_whole_face(
        network, texture, elsewhere, refine_seconds=600, mesostructure=meso
    ).maps["diffuse_normal"]
    # The files hold half floats, so that an arc cosine would tell their rounding.
    apart = np.linalg.norm(maps @ turn - found["with"]["diffuse_normal"], axis=2)[there]
    assert np.degrees(apart.mean()) < 0.1


def test_a_texture_with_too_few_rows_keeps_the_meshs_normals_and_reports_it(
    strangers: list[Path], run: Path
) -> None:
    person = ProcessedFolder(strangers[0])
    mesh = read_mesh(person.registered_mesh)
    head = load_head(person.root / "atlas", mesh, load_template(default_template_path()))
    texture = lit_texture(head, LAMP, np.array([0.0, 0.0, 1100.0]), seen=shadows_of(head, LAMP))
    network, _ = load_whole_face(shipped_weights())
    coarse = TrainedMesostructure(load_mesostructure(run)[0], 400)
    found = infer_whole_face(network, texture, mesh, refine_seconds=600, mesostructure=coarse)
    plain = infer_whole_face(network, texture, mesh)
    assert "192 rows, too few for pores and folds, which need 200" in found.notes[-1]
    np.testing.assert_array_equal(found.maps["diffuse_normal"], plain.maps["diffuse_normal"])


def test_a_network_that_would_not_be_used_is_refused(
    strangers: list[Path], run: Path, tmp_path: Path
) -> None:
    person = ProcessedFolder(strangers[0])
    write_exr(tmp_path / "T.exr", np.full((192, 128, 3), 0.3, np.float32))
    asked = ["infer", "--texture", str(tmp_path / "T.exr"), "--mesh", str(person.registered_mesh)]
    asked += ["--out", str(tmp_path / "out"), "--mesostructure", str(run), "--refine", "0"]
    assert "--mesostructure: found" in refusal(*asked)
    assert not (tmp_path / "out" / "diffuse_albedo.exr").exists()
