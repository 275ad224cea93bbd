"""What an experiment measures: lights, errors, intervals, plots, and the published size's cost."""

from __future__ import annotations

import dataclasses
import itertools
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from learning.bootstrap import Interval, interval
from learning.checkpoint import code_version
from learning.data import PatchData
from learning.encoding import OWN_CHANNELS, OWN_INPUTS
from learning.experiments.config import sized
from learning.experiments.cost import full_size_line, measure_full_size, step_seconds
from learning.experiments.held_out import FIGURES, measure, read_subjects, texel_mesh
from learning.experiments.lights import NAMES, aside, lights_around
from learning.experiments.plot import Column, draw
from learning.experiments.statistics import over_seeds, paired, table
from learning.losses import rendering_loss
from learning.patch_config import TrainConfig
from learning.patch_light import target_environment
from learning.presets import preset
from learning.render import occlusion
from learning.render.environments import RandomLightConfig
from learning.render.kept_shadows import KeptShadows, shadows_of_scan
from learning.render.occlusion import PositionGrid, bake_grid
from learning.render.uv import rasterise
from processing.dataset import open_store


def target():
    return target_environment(RandomLightConfig(), "physical", 3)


def test_the_ten_lights_are_the_target_what_lies_around_it_and_directional_ones() -> None:
    found = lights_around(target())
    assert tuple(found) == NAMES
    assert len(found) == 10
    torch.testing.assert_close(found["intensity-30"].rgb, 0.7 * target().rgb)
    torch.testing.assert_close(found["intensity+30"].rgb, 1.3 * target().rgb)
    for name in ("position-30", "position+30"):
        moved = found[name].position_mm - target().position_mm
        share = moved.norm(dim=-1) / target().position_mm.norm(dim=-1)
        torch.testing.assert_close(share, torch.full_like(share, 0.3))
        assert moved[..., 1].abs().max() == 0
    for name in NAMES[5:]:
        assert found[name].position_mm.shape == (1, 1, 3)


def test_a_lamp_straight_above_moves_along_x() -> None:
    moved = aside(torch.tensor([[0.0, 1000.0, 0.0]]), 0.3)
    torch.testing.assert_close(moved, torch.tensor([[300.0, 1000.0, 0.0]]))


@pytest.fixture(scope="module")
def subject(store_path: Path):
    store = open_store(store_path)
    (one,) = read_subjects(
        dataclasses.replace(
            store,
            scans=tuple(dataclasses.replace(s, subject=f"b-{s.subject}") for s in store.scans),
        ),
        {"b-person-1"},
        32,
    )
    return one


def test_the_texels_of_a_subject_make_the_mesh_that_has_its_positions(subject) -> None:
    rows, columns = subject.measured.shape
    position = subject.skin.position_mm[0].permute(1, 2, 0).numpy()
    covered = (position != 0).any(axis=2)
    mesh = texel_mesh(position, covered)
    raster = rasterise(mesh, rows, columns)
    assert (raster.covered & covered).sum() > 0.95 * covered.sum()
    here = raster.covered & covered
    error = np.abs(raster.interpolate(mesh.vertices) - position)[here]
    assert error.max() < 0.01
    # Outward, as the ball's own normals are.
    normal = raster.normals(mesh)[here]
    assert (normal * position[here]).sum(axis=1).min() > 0


def test_true_maps_have_no_error_and_wrong_ones_have_one_in_each_figure(subject) -> None:
    def told(maps):
        return lambda *_: SimpleNamespace(maps=maps)

    for found in measure(subject, target(), NAMES[:2], told(subject.maps)):
        assert set(found.figures) == set(FIGURES)
        assert all(value < 1e-12 for value in found.figures.values())
    wrong = {
        "diffuse_albedo": 0.5 * subject.maps["diffuse_albedo"],
        "specular_albedo": subject.maps["specular_albedo"] + 0.05,
        "diffuse_normal": np.roll(subject.maps["diffuse_normal"], 1, axis=2),
        "specular_normal": np.roll(subject.maps["specular_normal"], 1, axis=2),
    }
    (found,) = measure(subject, target(), ("front",), told(wrong))
    assert all(value > 1e-4 for value in found.figures.values())
    assert found.figures["specular_albedo"] == pytest.approx(0.25)


def test_a_constant_difference_is_distinguished_and_noise_about_zero_is_not() -> None:
    keys = list(itertools.product(range(5), ("a", "b", "c")))
    rng = np.random.default_rng(0)
    one = {key: float(rng.normal()) for key in keys}
    found, seeds, people = paired(one, {key: value + 0.1 for key, value in one.items()})
    assert (seeds, people) == (5, 3)
    assert found.mean == pytest.approx(0.1)
    assert found.low == pytest.approx(0.1)
    assert found.distinguished
    noise = {key: value + float(rng.normal(0, 1)) for key, value in one.items()}
    assert not paired(one, noise)[0].distinguished


def test_only_seeds_and_people_of_both_settings_are_compared() -> None:
    found, seeds, people = paired({(0, "a"): 1.0, (1, "a"): 5.0}, {(0, "a"): 3.0, (2, "a"): 9.0})
    assert (found.mean, seeds, people) == (2.0, 1, 1)
    assert not found.distinguished
    assert np.isnan(paired({}, {})[0].mean)


def test_intervals_agree_with_a_plain_bootstrap() -> None:
    values = np.random.default_rng(5).normal(1.0, 0.3, (4, 6))
    found = interval(values)
    rng, means = np.random.default_rng(1), []
    for _ in range(4000):
        rows, columns = rng.integers(0, 4, 4), rng.integers(0, 6, 6)
        means.append(np.mean([values[r, c] for r in rows for c in columns]))
    low, high = np.percentile(means, (2.5, 97.5))
    assert found.mean == pytest.approx(values.mean())
    assert found.low == pytest.approx(low, abs=0.02)
    assert found.high == pytest.approx(high, abs=0.02)


@given(
    arrays.arrays(
        float,
        st.tuples(st.integers(1, 4), st.integers(1, 4)),
        elements=st.floats(-1e6, 1e6) | st.just(float("nan")) | st.just(float("inf")),
    )
)
def test_an_interval_holds_its_mean_or_nothing_is_known(values: np.ndarray) -> None:
    found = interval(values)
    known = values[np.isfinite(values)]
    assert np.isnan(found.mean) == (known.size == 0)
    if not np.isnan(found.low):
        assert found.low <= found.high
        assert known.min() - 1e-6 <= found.low
        assert found.high <= known.max() + 1e-6


def test_the_spread_over_seeds_is_a_percentage_of_the_mean() -> None:
    values, seeds, people = table({(0, "a"): 0.9, (1, "a"): 1.1, (2, "a"): 1.0})
    assert (seeds, people) == ([0, 1, 2], ["a"])
    assert over_seeds(values) == pytest.approx(10.0)
    assert np.isnan(over_seeds(values[:1]))


def test_a_plot_is_whole_where_figures_are_missing(tmp_path: Path) -> None:
    nan = float("nan")
    columns = [
        Column("one & <two>", [1.0, nan], Interval(1.0, 0.5, 1.5)),
        Column("nothing", [], Interval(nan, nan, nan)),
    ]
    root = ElementTree.parse(draw("title", "across", "up", columns, tmp_path / "p.svg")).getroot()
    text = [element.text for element in root.iter() if element.text and element.text.strip()]
    assert {"title", "across", "up", "one & <two>", "nothing"} <= set(text)
    assert sum(element.tag.endswith("circle") for element in root.iter()) == 1
    draw("nothing", "", "", [], tmp_path / "empty.svg")


def grid(folder: Path | None = None, head: str = "a head") -> PositionGrid:
    row, column = np.mgrid[:12, :8].astype(np.float32)
    position = np.stack([column, -row, 3 * np.sin(column)], axis=2) * 10 + 1
    normal = np.zeros_like(position)
    normal[..., 2] = 1
    kept = shadows_of_scan(folder, head, "skin")
    return PositionGrid(position, normal, np.ones((12, 8), bool), kept)


def test_kept_shadows_are_those_that_were_baked_also_where_none_can_be(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lights = np.array([[300.0, 0, 80.0], [-300.0, 0, 80.0], [0.0, 0, 900.0]])
    baked = bake_grid(grid(), lights)
    assert 0 < baked.mean() < 1
    np.testing.assert_array_equal(bake_grid(grid(tmp_path), lights), baked)

    def none(*_: object) -> None:
        raise ModuleNotFoundError("open3d")

    monkeypatch.setattr(occlusion, "ShadowCaster", none)
    # Lamps that differ by the last bit of a sine, and positions that torch rounded otherwise.
    kept = grid(tmp_path)
    other = dataclasses.replace(kept, position_mm=kept.position_mm * np.float32(1.0001))
    np.testing.assert_array_equal(bake_grid(other, lights * (1 + 1e-12)), baked)
    for surface, places in (
        (grid(tmp_path, "another"), lights),
        (kept, 2 * lights),
        (grid(), lights),
    ):
        with pytest.raises(ModuleNotFoundError):
            bake_grid(surface, places)


@pytest.mark.parametrize("damage", [b"", b"nothing", b"PK\x03\x04"])
def test_a_damaged_file_of_shadows_is_baked_again(tmp_path: Path, damage: bytes) -> None:
    lights = np.array([[300.0, 0, 80.0]])
    baked = bake_grid(grid(tmp_path), lights)
    (path,) = tmp_path.iterdir()
    path.write_bytes(damage)
    np.testing.assert_array_equal(bake_grid(grid(tmp_path), lights), baked)
    assert len(path.read_bytes()) > len(damage)
    wrong = path.read_bytes()
    np.savez_compressed(path, bits=np.zeros(3, np.uint8))
    np.testing.assert_array_equal(bake_grid(grid(tmp_path), lights), baked)
    assert path.read_bytes() == wrong


def test_a_file_of_shadows_with_one_changed_byte_is_baked_again(tmp_path: Path) -> None:
    seen = (np.random.default_rng(0).random((4, 96, 64)) > 0.3).astype(np.float32)
    kept, lights = KeptShadows(tmp_path, "a head"), 1000 * np.eye(4, 3)
    kept.read_or_bake((96, 64), lights, lambda: seen)
    (path,) = tmp_path.iterdir()
    good = path.read_bytes()
    for place in range(0, len(good), 97):
        path.write_bytes(good[:place] + bytes([good[place] ^ 0xFF]) + good[place + 1 :])
        found = kept.read_or_bake((96, 64), lights, lambda: seen)
        np.testing.assert_array_equal(found, seen)


def test_shadows_of_a_scan_without_a_hash_or_a_folder_are_not_kept(tmp_path: Path) -> None:
    assert shadows_of_scan(None, "abc", "skin") is None
    assert shadows_of_scan(tmp_path, "", "skin") is None
    # Other code may bake others: they are not taken for these.
    kept = KeptShadows(tmp_path, f"abc of skin by {code_version()}")
    assert shadows_of_scan(tmp_path, "abc", "skin") == kept


def patches(store_path: Path, **data: object) -> tuple[TrainConfig, PatchData]:
    values = {"patch_px": 32, "stride_px": 32, "shadow_sets": 1, "shadow_rows": 0, **data}
    config = preset("demo", {"data": values, "environments": 0}, "test")
    assert isinstance(config, TrainConfig)
    rng = np.random.default_rng(0)
    how = (config.data, config.lights, config.augment, rng, config.shading)
    return config, PatchData(open_store(store_path), {"person-0"}, *how, draws=config.draws)


def test_a_patch_without_the_whole_texture_shows_and_asks_for_nothing_of_it(
    store_path: Path,
) -> None:
    batches = []
    for whole in (True, False):
        _, data = patches(store_path, whole=whole)
        batches.append(data.draw(2, np.random.default_rng(4)))
    shown, hidden = batches
    torch.testing.assert_close(shown.inputs[:, :OWN_INPUTS], hidden.inputs[:, :OWN_INPUTS])
    assert shown.inputs[:, OWN_INPUTS:].abs().max() > 0
    assert hidden.inputs[:, OWN_INPUTS:].abs().max() == 0
    assert shown.covered_channels[:, OWN_CHANNELS:].max() == 1
    assert hidden.covered_channels[:, OWN_CHANNELS:].max() == 0
    assert hidden.target[:, OWN_CHANNELS:].abs().max() == 0


def test_without_other_environments_the_rendering_loss_is_that_of_the_input_s_own(
    store_path: Path,
) -> None:
    config, data = patches(store_path)
    assert config.render_weight > 0
    batch = data.draw(1, np.random.default_rng(4))
    assert batch.draws == ()
    assert float(rendering_loss(batch.target, batch)) < float(
        rendering_loss(0.5 * batch.target, batch)
    )


def test_steps_of_a_training_on_patches_go_before_its_epochs() -> None:
    config = preset("demo", {"steps": 7, "seconds": None}, "test")
    assert isinstance(config, TrainConfig)
    assert config.steps == 7


def test_a_step_of_the_published_networks_can_be_measured_and_its_line_follows_from_it(
    store_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cpu = torch.device("cpu")
    monkeypatch.setattr("learning.experiments.cost.WARM", 0)
    monkeypatch.setattr("learning.experiments.cost.STEPS", 1)
    for name in ("paper", "avatarme"):
        with monkeypatch.context() as patch:
            clock = itertools.count(100.0, 1.5)
            fake = SimpleNamespace(perf_counter=lambda ticks=clock: next(ticks))
            patch.setattr("learning.experiments.cost.time", fake)
            assert step_seconds(name, cpu, patch_px=64, width=2) == 1.5
    assert full_size_line(tmp_path) == ""
    monkeypatch.setattr("learning.experiments.cost.step_seconds", lambda name, _: len(name) / 10)
    store = open_store(store_path)
    line = measure_full_size(tmp_path, cpu, store)
    steps = store.patch_origins(0, 8, 4, 0.5)
    days = 200 * 1400 * len(steps) * 0.5 / 86400
    assert f"`paper` 0.500 s a step, {days:.0f} days" in line

    def full(*_: object) -> float:
        raise torch.OutOfMemoryError("CUDA out of memory")

    monkeypatch.setattr("learning.experiments.cost.step_seconds", full)
    assert "not measured" in measure_full_size(tmp_path / "other", cpu, store)


def test_sizes_have_the_published_number_of_lights_and_people() -> None:
    config = sized("small", {}, "test")
    assert (config.environments, config.held_out, config.seeds) == (10, 5, 5)
