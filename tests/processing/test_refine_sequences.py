"""Other sequences than `binary` through the pipeline up to `refine`, on a simulated person."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lightstage.commands import quiet
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.template import default_template_path
from lightstage.rig import Rig, default_rig
from processing import pipeline
from processing.pipeline import run
from processing.pipeline_config import PipelineConfig
from processing.refinement.config import RefineConfig
from sim.light.world import World
from sim.session import SessionConfig, truth_path, write_direct
from tests.processing.lit_ball import angle_deg
from tests.processing.shots import coloured_rig
from tests.sim.conftest import one_person, write_truth_of_one_person

CONFIG = PipelineConfig(
    refine=RefineConfig(
        occlusion_directions=32, bounce_rays=0, scattering=(0.0,), finest_mm=4.0, edge_px=1.0
    )
)


def one_camera() -> Rig:
    rig = default_rig().scaled(0.04)
    return dataclasses.replace(rig, cameras=rig.cameras[:1])


def photographed(rig: Rig, sequence: str, root: Path) -> Path:
    """A session of one person, truth beside it."""
    session = root / "session"
    world = World(one_person(), rig)
    write_direct(world, session, SessionConfig(sequence=sequence), 3, quiet)
    write_truth_of_one_person(world, truth_path(session))
    return session


def refined(
    session: Path, out: Path, until: str, monkeypatch: pytest.MonkeyPatch
) -> dict[str, Any]:
    """The report of a run in which `reconstruct` finds the true mesh."""

    def true_mesh(*_: object) -> dict[str, Any]:
        shutil.copy(ProcessedFolder(truth_path(session)).base_mesh, ProcessedFolder(out).base_mesh)
        return {}

    monkeypatch.setattr(pipeline, "reconstruct", true_mesh)
    return run(session, out, default_template_path(), CONFIG, until=until)


def errors(session: Path, out: Path) -> dict[str, float]:
    """Means over the skin that is trusted, and how much that is."""
    truth, found = ProcessedFolder(truth_path(session)), ProcessedFolder(out)
    skin = truth.read_mask("cam0")
    sure = skin & (found.read_view("cam0", "confidence") > 0.5)

    def both(name: str) -> tuple[np.ndarray, np.ndarray]:
        return found.read_view("cam0", name)[sure], truth.read_view("cam0", name)[sure]

    albedo, true_albedo = both("diffuse_albedo")
    specular, true_specular = both("specular_albedo")
    return {
        "normal_deg": float(angle_deg(*both("diffuse_normal")).mean()),
        "facet_deg": float(angle_deg(*both("specular_normal")).mean()),
        "albedo": float(np.abs(albedo - true_albedo).mean()),
        "specular": float(np.abs(specular - true_specular).mean()),
        "covered": float(sure.sum() / skin.sum()),
    }


def test_polarised_photographs_are_refined(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    session, out = photographed(one_camera(), "binary-polarised", tmp_path), tmp_path / "out"
    refined(session, out, "separate", monkeypatch)
    coarse = errors(session, out)
    report = refined(session, out, "refine", monkeypatch)
    exact = errors(session, out)
    assert report["stages"]["refine"]["maps"] == "exact"
    assert not [warning for warning in report["warnings"] if warning.startswith("refine")]
    assert exact["normal_deg"] < 0.5 * coarse["normal_deg"]
    assert exact["facet_deg"] < 0.5 * coarse["facet_deg"]
    assert exact["albedo"] < 0.5 * coarse["albedo"]
    assert exact["specular"] < 0.004
    assert exact["covered"] > 0.4


def test_two_coloured_shots_keep_their_coarse_maps_and_a_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session, out = photographed(coloured_rig(one_camera()), "mux", tmp_path), tmp_path / "out"
    refined(session, out, "separate", monkeypatch)
    folder = ProcessedFolder(out)
    before = folder.read_view("cam0", "diffuse_albedo")
    report = refined(session, out, "refine", monkeypatch)
    assert report["stages"]["refine"]["maps"] == "coarse"
    assert any("mux-1, mux-2 cannot be refined" in warning for warning in report["warnings"])
    np.testing.assert_array_equal(folder.read_view("cam0", "diffuse_albedo"), before)
    open_sky = folder.read_view("cam0", "ambient_occlusion")[folder.read_mask("cam0")]
    assert 0.1 < open_sky.min() < 0.8 < open_sky.max() <= 1
