"""Coarse maps between the stages: kept as half floats in OUT/work, read back or refused."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.errors import DiskFullError, FormatError
from lightstage.formats.mesh import write_ply
from lightstage.formats.processed import MAPS, ProcessedFolder
from lightstage.formats.session import load_session
from lightstage.formats.template import default_template_path
from processing import pipeline
from processing.coarse_maps import (
    coarse_path,
    read_coarse,
    write_as_view,
    write_as_views,
    write_coarse,
)
from processing.errors import ProcessingError
from processing.frames.read import write_foreground
from processing.pipeline import read_job, run, why
from processing.pipeline_config import PipelineConfig
from processing.reconstruction.config import ReconstructConfig
from processing.refinement.config import RefineConfig
from processing.view_maps import MAP_NAMES, PixelMaps
from tests.processing import lit_ball
from tests.processing.test_given_meshes import ball_mesh

TEMPLATE = default_template_path()
MASK = np.zeros((6, 7), bool)
MASK[1:5, 2:6] = True
COUNT = int(MASK.sum())
DAMAGES: dict[str, Callable[[Path], object]] = {
    "cut": lambda path: path.write_bytes(path.read_bytes()[:-6]),
    "empty": lambda path: path.write_bytes(b""),
    "text": lambda path: path.write_text("no array"),
    "gone": lambda path: path.unlink(),
    "other numbers": lambda path: np.save(path, np.zeros((COUNT, 3), np.float32)),
    "of another mask": lambda path: np.save(path, np.zeros((COUNT - 1, 3), np.float16)),
    "not finite": lambda path: np.save(path, np.full((COUNT, 3), np.nan, np.float16)),
}


def maps_of(values: np.ndarray) -> PixelMaps:
    """Maps whose (n, 12) values differ from map to map."""
    three = (values[:, 3 * k : 3 * k + 3] for k in range(3))
    return PixelMaps(*three, *(values[:, 9 + k] for k in range(3)))


def written(out: Path) -> PixelMaps:
    maps = maps_of(np.random.default_rng(1).normal(size=(COUNT, 12)).astype(np.float32))
    write_foreground(out, "cam0", MASK)
    write_coarse(out, "cam0", maps)
    return maps


@given(
    seed=st.integers(0, 2**32 - 1),
    scale=st.sampled_from([0.0, 1e-9, 1e-6, 1.0, -1.0, 6e4]),
)
@settings(max_examples=20, deadline=None)
def test_maps_come_back_as_the_nearest_half_floats(seed: int, scale: float) -> None:
    values = scale * np.random.default_rng(seed).uniform(-1, 1, (COUNT, 12)).astype(np.float32)
    maps = maps_of(values)
    with tempfile.TemporaryDirectory() as name:
        out = Path(name)
        write_foreground(out, "cam0", MASK)
        write_coarse(out, "cam0", maps)
        found = read_coarse(out, "cam0")
        np.testing.assert_array_equal(found.mask, MASK)
        for field, map_name in MAP_NAMES.items():
            twin = getattr(maps, field).astype(np.float16)
            np.testing.assert_array_equal(found.values(map_name), twin)
            picture = found.picture(map_name)
            np.testing.assert_array_equal(picture[MASK], twin)
            assert not picture[~MASK].any()


def test_what_is_written_to_views_has_the_same_bits(tmp_path: Path) -> None:
    maps, folder = written(tmp_path), ProcessedFolder(tmp_path)
    files = write_as_views(tmp_path, ["cam0"])
    assert {tmp_path / name for name in files} == set((tmp_path / "views" / "cam0").iterdir())
    np.testing.assert_array_equal(folder.read_mask("cam0"), MASK)
    for field, name in MAP_NAMES.items():
        half = getattr(maps, field).astype(np.float16)
        np.testing.assert_array_equal(folder.read_half_view("cam0", name)[MASK], half)


@pytest.mark.parametrize("value", [7e4, -7e4, np.inf, np.nan])
def test_values_that_half_floats_cannot_hold_are_refused_and_the_older_maps_stay(
    value: float, tmp_path: Path
) -> None:
    maps = written(tmp_path)
    before = {path: path.read_bytes() for path in coarse_path(tmp_path, "cam0").iterdir()}
    albedo = maps.albedo.copy()
    albedo[3, 1] = value
    with pytest.raises(FormatError, match=r"diffuse_albedo\.npy.*(65504|NaN)"):
        write_coarse(tmp_path, "cam0", dataclasses.replace(maps, albedo=albedo))
    assert before == {path: path.read_bytes() for path in (tmp_path / "work/coarse").rglob("*.*")}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_map_is_refused_with_the_command_that_makes_it_anew(
    damage: str, tmp_path: Path
) -> None:
    written(tmp_path)
    DAMAGES[damage](coarse_path(tmp_path, "cam0") / "diffuse_normal.npy")
    maps = read_coarse(tmp_path, "cam0")
    with pytest.raises(FormatError, match=r"diffuse_normal\.npy"):
        maps.picture("diffuse_normal")
    assert maps.values("roughness").shape == (COUNT,)
    with pytest.raises(FormatError, match=r"diffuse_normal\.npy"):
        write_as_view(ProcessedFolder(tmp_path), "cam0")


def test_maps_of_another_foreground_and_missing_ones_are_refused(tmp_path: Path) -> None:
    written(tmp_path)
    with pytest.raises(FormatError, match=r"coarse maps of cam1.*lightstage-processing separate"):
        read_coarse(tmp_path, "cam1")
    write_foreground(tmp_path, "cam0", ~MASK)
    with pytest.raises(FormatError, match=rf"coarse\.json, pixels: found {COUNT}, expected 26"):
        read_coarse(tmp_path, "cam0")


def test_a_full_disk_leaves_the_older_maps(tmp_path: Path, small_disk: Path) -> None:
    written(small_disk)
    before = read_coarse(small_disk, "cam0").picture("diffuse_albedo")
    large = maps_of(np.zeros((20_000, 12), np.float32))
    with pytest.raises(DiskFullError, match=r"work/coarse/cam0"):
        write_coarse(small_disk, "cam0", large)
    assert list(small_disk.rglob(".*")) == []
    found = read_coarse(small_disk, "cam0").picture("diffuse_albedo")
    np.testing.assert_array_equal(found, before)


KILLED = """
import os, sys
from pathlib import Path
import numpy as np
from processing import coarse_maps
from processing.view_maps import PixelMaps
write = coarse_maps._write_array
def dying(path, array):
    write(path, array)
    if path.name == "roughness.npy":
        os.kill(os.getpid(), 9)
coarse_maps._write_array = dying
three, one = np.ones((int(sys.argv[2]), 3), np.float32), np.ones(int(sys.argv[2]), np.float32)
coarse_maps.write_coarse(Path(sys.argv[1]), "cam0", PixelMaps(three, three, three, one, one, one))
"""


def test_a_kill_while_maps_are_written_leaves_the_older_ones_whole(tmp_path: Path) -> None:
    maps = written(tmp_path)
    words = [sys.executable, "-c", KILLED, str(tmp_path), str(COUNT)]
    assert subprocess.run(words, check=False).returncode == -9
    (beside,) = (tmp_path / "work" / "coarse").glob(".*")
    assert (beside / "roughness.npy").is_file()
    found = read_coarse(tmp_path, "cam0")
    for field, name in MAP_NAMES.items():
        np.testing.assert_array_equal(found.values(name), getattr(maps, field).astype(np.float16))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("coarse")


@pytest.fixture(scope="module")
def session(folder: Path) -> Path:
    ball = lit_ball.Ball(coated=True)
    return lit_ball.write_session(ball, lit_ball.small_rig(1, 0.015), folder / "session")


@pytest.fixture(scope="module")
def config(folder: Path) -> PipelineConfig:
    """Of a run up to `refine` that takes a given mesh, and skips what takes long."""
    mesh = write_ply(ball_mesh(subdivisions=3), folder / "ball.ply")
    return PipelineConfig(
        reconstruct=ReconstructConfig(mesh=str(mesh)),
        refine=RefineConfig(
            occlusion_directions=32, bounce_rays=0, scattering=(0.0,), finest_mm=6.0
        ),
    )


def stages(session: Path, out: Path, config: PipelineConfig, until: str) -> list[str]:
    return list(run(session, out, TEMPLATE, config, until=until)["ran"])


def content(out: Path, *folders: str) -> dict[str, bytes]:
    """The files of some folders by name."""
    files = [path for name in folders for path in (out / name).rglob("*") if path.is_file()]
    return {str(path.relative_to(out)): path.read_bytes() for path in files}


def test_a_mesh_and_maps_are_made_anew_without_separate_and_are_the_same_bits(
    session: Path, tmp_path: Path, config: PipelineConfig
) -> None:
    out = tmp_path / "out"
    assert stages(session, out, config, "refine") == ["decode", "separate", "reconstruct", "refine"]
    maps = {f"{name}.exr" for name in [*MAP_NAMES.values(), "ambient_occlusion"]}
    assert {path.name for path in (out / "views/cam0").iterdir()} == maps | {"mask.png"}
    first, mesh = content(out, "views", "work"), (out / "base_mesh.ply").read_bytes()
    (out / "base_mesh.ply").unlink()
    assert stages(session, out, config, "refine") == ["reconstruct", "refine"]
    assert content(out, "views", "work") == first
    assert (out / "base_mesh.ply").read_bytes() == mesh


def test_maps_are_in_views_where_a_run_ends_with_separate_or_refine_alone(
    session: Path, tmp_path: Path, config: PipelineConfig
) -> None:
    out = tmp_path / "out"
    assert stages(session, out, config, "reconstruct") == ["decode", "separate", "reconstruct"]
    assert [path.name for path in (out / "views/cam0").iterdir()] == ["mask.png"]
    assert "Diffuse albedo" in (out / "report.html").read_text()
    # The maps are written without any stage's work, and count as outputs.
    assert stages(session, out, config, "separate") == []
    folder = ProcessedFolder(out)
    coarse = content(out, "views")
    assert set(coarse) == {f"views/cam0/{n}.exr" for n in MAP_NAMES.values()} | {
        "views/cam0/mask.png"
    }
    job = read_job(session, out, TEMPLATE, config, "refine")
    assert why(job, "reconstruct") == {"decode": None, "separate": None, "reconstruct": None}
    # `refine` puts its own in their place; they are not taken for those of `separate`.
    assert stages(session, out, config, "refine") == ["refine"]
    exact = folder.read_view("cam0", "diffuse_albedo")
    assert stages(session, out, config, "separate") == []
    np.testing.assert_array_equal(folder.read_view("cam0", "diffuse_albedo"), exact)
    run(session, out, TEMPLATE, config, only="reconstruct")
    assert stages(session, out, config, "separate") == []
    kept = content(out, "views")
    assert {name: kept[name] for name in coarse} == coarse


def test_a_missing_work_file_is_made_anew_and_a_damaged_one_refused(
    session: Path, tmp_path: Path, config: PipelineConfig, run_command: Callable[..., Any]
) -> None:
    out = tmp_path / "out"
    stages(session, out, config, "reconstruct")
    before = content(out, "work")
    (coarse_path(out, "cam0") / "confidence.npy").unlink()
    job = read_job(session, out, TEMPLATE, config, "reconstruct")
    missing = "work/coarse/cam0/confidence.npy, which it wrote, is missing"
    assert why(job, "reconstruct")["separate"] == missing
    assert stages(session, out, config, "reconstruct") == ["separate", "reconstruct"]
    assert content(out, "work") == before
    path = coarse_path(out, "cam0") / "confidence.npy"
    path.write_bytes(path.read_bytes()[:-1])
    refused = run_command("processing", "run", session, "--out", out, "--until", "separate")
    assert refused.code == 2
    assert "confidence.npy" in refused.err
    assert "lightstage-processing separate" in refused.err
    assert run_command("processing", "separate", session, "--out", out).code == 0
    assert content(out, "work/coarse") == {
        name: data for name, data in before.items() if name.startswith("work/coarse/")
    }


def test_stages_that_need_coarse_maps_name_separate_where_an_older_version_made_the_folder(
    session: Path, tmp_path: Path, config: PipelineConfig
) -> None:
    out = tmp_path / "out"
    stages(session, out, config, "reconstruct")
    (out / "work" / "coarse").rename(tmp_path / "aside")
    for only, until in (("reconstruct", "separate"), ("refine", "reconstruct")):
        with pytest.raises(ProcessingError, match=rf"no output of separate.*--until {until}"):
            run(session, out, TEMPLATE, config, only=only)


def test_a_run_killed_while_it_writes_views_writes_them_at_the_next_call(
    session: Path, tmp_path: Path, config: PipelineConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"

    def killed(*_: object) -> list[str]:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(pipeline, "write_as_views", killed)
        with pytest.raises(KeyboardInterrupt):
            stages(session, out, config, "separate")
    job = pipeline.Job(load_session(session), out, config, None, "")
    assert not pipeline.is_reported(job, "separate")
    record = json.loads((out / "stages.json").read_text())["stages"]["separate"]
    assert not any(name.startswith("views/") for name in record["outputs"])
    assert stages(session, out, config, "separate") == []
    assert pipeline.is_reported(job, "separate")
    assert all(ProcessedFolder(out).view_path("cam0", n).is_file() for n in MAP_NAMES.values())


def test_every_coarse_map_is_one_that_a_view_may_hold() -> None:
    assert all(MAPS[name].half for name in MAP_NAMES.values())
